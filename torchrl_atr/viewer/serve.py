"""Server of the viewer's page: its address, its start, and its end when the last browser has left."""

from __future__ import annotations

import contextlib
import errno
import io
import socket
import time
import webbrowser
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from torchrl_atr._errors import InputError, MissingPackageError
from torchrl_atr._files import say
from torchrl_atr.evaluation.rendering import has_display
from torchrl_atr.viewer.loop import Loop
from torchrl_atr.viewer.session import Session, Setup
from torchrl_atr.viewer.sources import ridable

if TYPE_CHECKING:
    from viser import ViserServer

    from torchrl_atr.viewer.page import Page

LOCAL = "127.0.0.1"
PORT = 8080
_TRIED = 20
"""Ports after :data:`PORT` that are tried where none was asked for."""


def free_port(host: str, port: int | None) -> int:
    """Return a port that can be listened on.

    Args:
        host: address or name of this machine.
        port: the one asked for, 0 for any; None for :data:`PORT` or one of the next.

    Raises:
        InputError: if the one asked for is in use, or the host is not an address of this machine.

    Example:
        >>> free_port("127.0.0.1", 0) > 0
        True
    """
    wanted = range(PORT, PORT + _TRIED) if port is None else [port]
    for number in wanted:
        with socket.socket() as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            try:
                probe.bind((host, number))
            except OSError as error:
                failure = error
                continue
            return int(probe.getsockname()[1])
    if isinstance(failure, socket.gaierror) or failure.errno == errno.EADDRNOTAVAIL:
        text = "is not an IPv4 address of this machine; leave out --host, or give 0.0.0.0 for all of them"
        raise InputError(f"{host} {text}")
    asked = f"port {port}" if port is not None else f"every port from {PORT} to {PORT + _TRIED - 1}"
    why = "in use" if failure.errno == errno.EADDRINUSE else "refused"
    raise InputError(f"{asked} is {why} ({failure.strerror}); give another one with --port, or --port 0 for any")


@contextmanager
def viser_server(host: str = LOCAL, port: int | None = None) -> Iterator[ViserServer]:
    """Run a viser server in a block.

    Args:
        host: to listen on.
        port: see :func:`free_port`.

    Raises:
        MissingPackageError: if viser or mjviser is not installed.
        InputError: if the port is in use.
    """
    viser = _import_viser()
    number = free_port(host, port)
    with contextlib.redirect_stdout(io.StringIO()):  # it prints a table of its addresses, and we say ours
        server = viser.ViserServer(host=host, port=number, label="torchrl_atr", verbose=False)
    try:
        if server.get_port() != number:  # another program took it in between
            raise InputError(f"port {number} is in use; give another one with --port, or --port 0 for any")
        # any page that a browser shows can talk to this server: none may open it to the world by viser's tunnel
        server.request_share_url = lambda verbose=True: None
        yield server
    finally:
        with contextlib.redirect_stdout(io.StringIO()):
            server.stop()


def _import_viser() -> Any:
    try:
        import mjviser  # noqa: F401
        import viser
    except ImportError as error:
        raise MissingPackageError(error.name or "viser", "viewer") from error
    return viser


def serve(
    setup: Setup,
    host: str = LOCAL,
    port: int | None = None,
    open_browser: bool = True,
    linger: float | None = None,
    started: Callable[[Page, Loop], object] = lambda page, loop: None,
) -> None:
    """Serve the page of a session until it is stopped.

    Args:
        setup: what is ridden first.
        host: to listen on; only programs of this machine reach the default.
        port: see :func:`free_port`.
        open_browser: whether to open the page in a browser, where there is a display.
        linger: seconds after the last browser has left until it ends; None for never.
        started: called with page and loop once the page is served.

    Raises:
        MissingPackageError: if viser or mjviser is not installed.
        InputError: if the port is in use.
        CheckpointError, BundleError: for a policy that cannot be loaded.
    """
    with viser_server(host, port) as server:
        from torchrl_atr.viewer.page import Page

        session = Session(setup)
        loop = Loop(session)
        policies = ridable(setup.policy)
        page = Page(server, loop, policies)
        address = f"http://{'localhost' if host in ('0.0.0.0', '') else host}:{server.get_port()}"
        say(f"{address} shows {next(iter(policies))}; Ctrl-C ends it")
        if open_browser and has_display():
            webbrowser.open(address)
        started(page, loop)
        loop.run(Linger(page.watched, linger, loop.end))


class Linger:
    """Clock that calls a function once nobody has looked for some time, after somebody has.

    Args:
        watched: returns whether anyone looks.
        seconds: to wait; None for ever.
        end: to call.

    Example:
        >>> looks = iter([False, True, False])
        >>> clock = Linger(lambda: next(looks), 0.0, lambda: print("ends"))
        >>> clock(), clock(), clock()
        ends
        (None, None, None)
    """

    def __init__(self, watched: Callable[[], bool], seconds: float | None, end: Callable[[], object]) -> None:
        self._watched, self._seconds, self._end = watched, seconds, end
        self._seen: float | None = None

    def __call__(self) -> None:
        """Look, and end it if it is time."""
        if self._seconds is None:
            return
        now = time.monotonic()
        if self._watched():
            self._seen = now
        elif self._seen is not None and now - self._seen >= self._seconds:
            self._end()
