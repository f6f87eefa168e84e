"""The loop keeps time, stops it, and carries out what other threads ask for."""

from __future__ import annotations

import threading
import time

import pytest

from torchrl_atr._errors import InputError
from torchrl_atr.viewer import Loop


class Puppet:
    """A session whose steps cost nothing."""

    def __init__(self):
        self.steps, self.refreshed = 0, 0

    def step(self):
        self.steps += 1

    def refresh(self):
        self.refreshed += 1


def steps_in(loop, seconds):
    threading.Timer(seconds, loop.end).start()
    begun, before = time.monotonic(), loop.session.steps
    loop.run()
    loop._ended.clear()
    return loop.session.steps - before, time.monotonic() - begun


@pytest.mark.parametrize("rate", [1.0, 0.25])
def test_it_keeps_time(rate):
    loop = Loop(Puppet())
    loop.rate = rate
    steps, seconds = steps_in(loop, 0.6)
    assert steps <= 1 + seconds * 50 * rate
    assert steps >= 0.5 * seconds * 50 * rate  # a busy machine may be late, not early


def test_pause_single_step_and_go_on():
    shown = []
    loop = Loop(Puppet(), show=lambda session: shown.append(session.steps))
    loop.toggle_pause()
    loop.turn()
    assert (loop.paused, loop.session.steps, shown) == (True, 0, [0])
    for _ in range(2):
        loop.single_step()
    for _ in range(4):
        loop.turn()
    assert (loop.session.steps, shown[-1]) == (2, 2)
    loop.toggle_pause()
    loop.turn()
    assert loop.session.steps == 3


def test_a_slow_machine_shows_every_second_step():
    shown = []
    loop = Loop(Puppet(), show=lambda session: shown.append(session.steps))
    loop.rate = 1e6  # no machine is that fast
    loop._restart_clock()
    for _ in range(5):
        loop.turn()
    assert shown == [1, 3, 5]


def test_nobody_looks_nothing_moves():
    seen = []
    loop = Loop(Puppet(), watched=lambda: bool(seen))
    loop.turn()
    assert loop.session.steps == 0
    seen.append("a browser")
    loop.turn()
    assert loop.session.steps == 1


def test_what_fails_is_one_line_and_the_ride_goes_on():
    lines = []
    loop = Loop(Puppet(), warn=lines.append)

    def fail(error):
        def action(session):
            raise error

        return action

    for error in (InputError("no such robot"), FileNotFoundError(2, "No such file", "x.pt"), RuntimeError("bad\nlong")):
        loop.post(fail(error))
    loop.turn()
    assert lines[0] == "no such robot"
    assert "x.pt" in lines[1]
    assert lines[2] == "RuntimeError: bad"
    assert loop.session.steps == 1


def test_actions_come_from_any_thread():
    loop, told = Loop(Puppet()), []
    threads = [threading.Thread(target=loop.post, args=(told.append,)) for _ in range(20)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    loop.turn()
    assert len(told) == 20
