"""The page over viser's own protocol: served, steered by two clients at once, quiet when they have left."""

from __future__ import annotations

import socket
import sys
import threading
import urllib.request

import numpy as np
import pytest

pytest.importorskip("viser")
pytest.importorskip("mjviser")
from viser import _messages

from tests.viewer.client import browser, wait_until
from torchrl_atr._errors import InputError, MissingPackageError
from torchrl_atr.viewer import Loop, Session, Setup, ridable
from torchrl_atr.viewer.joystick import CENTRE, SIZE, command_at
from torchrl_atr.viewer.page import Page
from torchrl_atr.viewer.serve import free_port, viser_server


@pytest.fixture
def ride(run):
    with viser_server(port=0) as server:
        loop = Loop(Session(Setup(run)))
        page = Page(server, loop, ridable(run))
        thread = threading.Thread(target=loop.run)
        thread.start()
        yield server, loop, page
        loop.end()
        thread.join()


def set_slider(client, handle, value):
    client.tell(_messages.GuiUpdateMessage(handle._impl.uuid, {"value": value}))


def test_it_is_served_to_this_machine_and_steered_by_two_browsers(ride):
    server, loop, page = ride
    port, session, controls = server.get_port(), loop.session, page._controls
    assert server.get_host() == "127.0.0.1"
    with urllib.request.urlopen(f"http://127.0.0.1:{port}/", timeout=10) as answer:
        assert answer.status == 200
        assert b"<html" in answer.read()
    assert session.time == 0.0  # nobody looks
    with browser(port) as first:
        assert wait_until(lambda: session.time > 0.1)
        set_slider(first, controls._speed, 1.25)
        assert wait_until(lambda: session.command[0] == 1.25)
        with browser(port) as second:
            assert wait_until(lambda: len(server.get_clients()) == 2)
            set_slider(second, controls._yaw_rate, 0.5)
            assert wait_until(lambda: session.command == (1.25, 0.5))
            second.listen(0.5)
            assert sum(map(len, second.messages)) > 10_000  # meshes and inputs, though it came late
        assert wait_until(lambda: len(server.get_clients()) == 1)
        time = session.time
        assert wait_until(lambda: session.time > time + 0.1)  # the other browser's ride goes on
        drag_stick(first, 1.0, -0.25, session.limits)
        assert wait_until(lambda: session.command == pytest.approx((1.0, -0.25), abs=1e-3))
    assert wait_until(lambda: not page.watched())
    threading.Event().wait(0.3)
    time = session.time
    threading.Event().wait(0.3)
    assert session.time == time


def drag_stick(client, speed, yaw_rate, limits):
    """Tell what a browser whose camera is above the pad tells of a drag."""
    client.show_camera((CENTRE[0], CENTRE[1], 3.0))
    target = (CENTRE[0] + speed / limits[0] * SIZE / 2, CENTRE[1] + yaw_rate / limits[1] * SIZE / 2, CENTRE[2] + 0.05)
    for phase in ("start", "update", "end"):
        client.tell(
            _messages.SceneNodeDragMessage(
                name="/joystick/stick",
                phase=phase,
                instance_index=None,
                start_position=CENTRE,
                end_position=target,
                start_screen_pos=(0.5, 0.5),
                end_screen_pos=(0.5, 0.5),
                button="left",
                modifier=None,
            )
        )


def test_a_broken_policy_is_said_and_the_ride_goes_on(ride, tmp_path):
    server, loop, _ = ride
    with browser(server.get_port()) as client:
        assert wait_until(lambda: loop.session.time > 0.1)
        loop.post(lambda session: session.change(policy=tmp_path))
        assert wait_until(lambda: _heard(client, b"there is no checkpoint"))
        time = loop.session.time
        assert wait_until(lambda: loop.session.time > time)
        robots = loop.session.builds
        loop.post(lambda session: session.change(robots=2))
        assert wait_until(lambda: loop.session.builds > robots and loop.session.time > 0.1)


def _heard(client, text):
    client.listen(0.2)
    return any(text in message for message in client.messages)


def test_a_port_in_use(capsys):
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        port = other.getsockname()[1]
        with pytest.raises(InputError, match=f"port {port} is in use"), viser_server(port=port):
            pass
    with pytest.raises(InputError, match="not an IPv4 address of this machine"):
        free_port("192.0.2.1", 0)
    assert capsys.readouterr().out == ""


def test_without_viser_it_says_how_to_install_it(monkeypatch):
    monkeypatch.setitem(sys.modules, "mjviser", None)
    message = r"mjviser is not installed; pip install 'torchrl_atr\[viewer\]'"
    with pytest.raises(MissingPackageError, match=message), viser_server(port=0):
        pass


def test_the_line_of_sight_meets_the_pad():
    eye = np.array([-2.5, 0.9, 1.7])
    for command in ((0.0, 0.0), (1.0, -0.5), (-2.0, 1.0)):
        place = np.array([CENTRE[0] + command[0] / 2.0 * SIZE / 2, CENTRE[1] + command[1] * SIZE / 2, CENTRE[2]])
        assert command_at(eye, eye + 0.3 * (place - eye), (2.0, 1.0)) == pytest.approx(command, abs=1e-5)
    assert command_at(eye, eye + [0.0, 0.0, 1.0], (2.0, 1.0)) is None
