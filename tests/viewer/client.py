"""A browser's part of viser's protocol: connects, tells its camera, moves what the page has, reads what it is told."""

from __future__ import annotations

import time
from contextlib import contextmanager

import msgspec
import viser
import zstandard
from viser import _messages
from websockets.sync.client import connect
from websockets.typing import Subprotocol


class Browser:
    """A connected client without a picture."""

    def __init__(self, socket):
        self._socket = socket
        self.messages = []

    def tell(self, message):
        self._socket.send(msgspec.msgpack.encode(message.as_serializable_dict()))

    def show_camera(self, position=(-2.5, 0.9, 1.7)):
        """Send the message that a browser sends first, after which the server counts it."""
        zero, up = (0.0, 0.0, 0.0), (0.0, 0.0, 1.0)
        self.tell(_messages.ViewerCameraMessage((1.0, 0.0, 0.0, 0.0), position, 1.0, 0.1, 100.0, 700, 900, zero, up))

    def listen(self, seconds):
        """Read messages for some time."""
        end = time.monotonic() + seconds
        while (left := end - time.monotonic()) > 0:
            try:
                frame = self._socket.recv(timeout=left)
            except TimeoutError:
                return
            size = int.from_bytes(frame[8:16], "little")  # of the compressed messages, before arrays as they are
            self.messages.append(zstandard.ZstdDecompressor().decompress(frame[16 : 16 + size]) + frame[16 + size :])


@contextmanager
def browser(port):
    url, protocol = f"ws://127.0.0.1:{port}", Subprotocol(f"viser-v{viser.__version__}")
    with connect(url, subprotocols=[protocol], max_size=None, compression=None) as socket:
        client = Browser(socket)
        client.show_camera()
        yield client


def wait_until(condition, seconds=20.0):
    """Wait for a condition; the machine may be slow."""
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        if condition():
            return True
        time.sleep(0.02)
    return False
