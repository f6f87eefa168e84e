"""Rate and latency of the viewer: ``python -m benchmarks.viewer`` serves the page, connects a client, and steers.

The client reads all that a browser is sent, over viser's own protocol, and draws nothing. Measure on an idle machine.
"""

from __future__ import annotations

import argparse
import sys
import threading
import time
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from viser import _messages

from benchmarks import results
from tests.viewer.client import browser
from torchrl_atr._files import say
from torchrl_atr.deploy.manifest import find_policy
from torchrl_atr.envs.physics import CONTROL_DT
from torchrl_atr.runs.provenance import machine
from torchrl_atr.viewer import Loop, Session, Setup, ridable
from torchrl_atr.viewer.page import Page
from torchrl_atr.viewer.serve import viser_server

WARM_UP = 3.0
"""Time before the measurement, s: meshes are sent, first steps are slow."""


class Clock:
    """Times of a loop's steps and pictures.

    Attributes:
        step, picture: time that each took, s.
        stepped: when each step ended, s.
        shown: when each picture was sent, s, and the speed commanded then.
    """

    def __init__(self, loop: Loop) -> None:
        self.step: list[float] = []
        self.picture: list[float] = []
        self.stepped: list[float] = []
        self.shown: list[tuple[float, float]] = []
        self._step, self._show = loop.session.step, loop.show
        loop.session.step = self._stepped  # type: ignore[method-assign]
        loop.show = self._shown

    def _stepped(self) -> Any:
        begun = time.monotonic()
        reading = self._step()
        self.stepped.append(time.monotonic())
        self.step.append(self.stepped[-1] - begun)
        return reading

    def _shown(self, session: Session) -> None:
        begun = time.monotonic()
        self._show(session)
        self.shown.append((time.monotonic(), session.command[0]))
        self.picture.append(self.shown[-1][0] - begun)


def measure(policy: str, seconds: float, drags: int) -> dict[str, Any]:
    """Ride with a connected client, then move the slider of the speed ``drags`` times.

    Returns:
        ``rate``, simulated seconds per second; ``late``, share of the control steps that ended half a step or more
        after their time; ``hidden``, share whose picture was left out; ``step_ms`` and ``picture_ms``, medians;
        ``latency_ms``, median and maximum from the client's message until the picture of the first step under the new
        command was sent.
    """
    with viser_server(port=0) as server:
        setup = Setup(find_policy(policy))
        loop = Loop(Session(setup))
        page = Page(server, loop, ridable(setup.policy))
        clock = Clock(loop)
        rider = threading.Thread(target=loop.run)
        rider.start()
        try:
            with browser(server.get_port()) as client:
                reader = threading.Thread(target=client.listen, args=(WARM_UP + seconds + drags,))
                reader.start()
                time.sleep(WARM_UP)
                first, pictures = len(clock.stepped), len(clock.shown)
                time.sleep(seconds)
                ends, pictures = np.array(clock.stepped[first:]), len(clock.shown) - pictures
                waits = [_drag(client, page, clock, 0.5 * (-1) ** number) for number in range(drags)]
                reader.join()
        finally:
            loop.end()
            rider.join()
    return {
        "rate": float((len(ends) - 1) * CONTROL_DT / (ends[-1] - ends[0])),
        "late": float((np.diff(ends) > 1.5 * CONTROL_DT).mean()),
        "hidden": max(0.0, 1.0 - pictures / len(ends)),
        "step_ms": float(np.median(clock.step[first:]) * 1e3),
        "picture_ms": float(np.median(clock.picture[first:]) * 1e3),
        "latency_ms": [float(np.median(waits) * 1e3), float(np.max(waits) * 1e3)],
    }


def _drag(client: Any, page: Page, clock: Clock, speed: float) -> float:
    """Return the time until a speed that the client asks for is ridden and shown, s."""
    time.sleep(1.0 - CONTROL_DT * float(np.random.default_rng().uniform()))  # at any time within a step
    asked = time.monotonic()
    client.tell(_messages.GuiUpdateMessage(page._controls._speed._impl.uuid, {"value": speed}))
    while True:
        shown = [end for end, command in clock.shown[-50:] if end > asked and command == speed]
        if shown:
            return shown[0] - asked
        if time.monotonic() > asked + 5.0:
            raise RuntimeError("the command did not arrive within 5 s")
        time.sleep(0.001)


def summary(report: dict[str, Any]) -> str:
    """Return the report as Markdown."""
    found = report["figures"]
    median, largest = found["latency_ms"]
    return "\n".join(
        [
            "# The viewer's rate",
            "",
            results.origin(report),
            "",
            f"One robot rides at {found['rate']:.3f} times real time, at 50 Hz: {found['late']:.1%} of the control "
            f"steps are late by half a step or more, and the pictures of {found['hidden']:.1%} are left out. A step "
            f"takes {found['step_ms']:.1f} ms, its picture {found['picture_ms']:.1f} ms. From the client's message "
            f"until a step under the new command is shown: {median:.0f} ms, at most {largest:.0f} ms in "
            f"{report['drags']} trials. The client draws nothing.",
            "",
        ]
    )


def main(argv: Sequence[str] | None = None) -> int:
    """Measure and write the report."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.viewer", description=__doc__)
    parser.add_argument("--policy", default="a1-single_board")
    parser.add_argument("--seconds", type=float, default=30.0)
    parser.add_argument("--drags", type=int, default=20)
    parser.add_argument("--output", type=Path, default=Path("results/viewer"), metavar="FOLDER")
    return results.exit_code("viewer", partial(_measure, parser.parse_args(argv)))


def _measure(arguments: argparse.Namespace) -> None:
    begun = time.monotonic()
    figures = measure(arguments.policy, arguments.seconds, arguments.drags)
    options = f"--policy {arguments.policy} --seconds {arguments.seconds:g} --drags {arguments.drags}"
    command = f"python -m benchmarks.viewer {options}"
    report = {"command": command, **machine(), "wall_seconds": time.monotonic() - begun}
    report |= {"drags": arguments.drags, "figures": figures}
    results.write(arguments.output, "viewer", report, summary(report))
    say(summary(report))


if __name__ == "__main__":
    sys.exit(main())
