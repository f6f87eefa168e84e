"""Panels of the page: status, reward bars, velocities, estimates against the truth, tilt, power."""

from __future__ import annotations

import html
import math
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from torchrl_atr._text import with_unit
from torchrl_atr.viewer.loop import Loop
from torchrl_atr.viewer.session import Session

if TYPE_CHECKING:
    from viser import ViserServer

Array = NDArray[np.float64]
_COLOURS = ("#286edc", "#eb781e", "#2a9d5c")
_WIDTH = 330
"""Width of the charts, pixels."""
_RECENT, _TRIP = 25, 100
"""Steps that reward bars and the cost of transport average over."""


class Chart:
    """Lines over the last seconds.

    Args:
        gui: of the server.
        title: above the chart.
        labels: of the lines.
    """

    def __init__(self, gui: Any, title: str, labels: tuple[str, ...]) -> None:
        empty = tuple(np.zeros(2) for _ in range(len(labels) + 1))
        lines = tuple({"label": label, "stroke": colour, "width": 2} for label, colour in zip(labels, _COLOURS))
        self._handle = gui.add_uplot(
            empty,
            ({"label": "s"}, *lines),
            title=title,
            height=150,
            scales={"x": {"time": False}},
            legend={"show": True},
        )

    @property
    def title(self) -> str:
        """Text above the chart."""
        return str(self._handle.title)

    @title.setter
    def title(self, text: str) -> None:
        if self._handle.title != text:
            self._handle.title = text

    def draw(self, time: Array, *lines: Array) -> None:
        """Draw lines, (T,) each, over the time, s, (T,)."""
        if len(time) > 1:
            self._handle.data = tuple(np.nan_to_num(values) for values in (time, *lines))


class Panels:
    """Tables and charts of the followed robot.

    Args:
        server: of the page.
        loop: of the session.
    """

    def __init__(self, server: ViserServer, loop: Loop) -> None:
        gui = server.gui
        self._loop = loop
        self._status = gui.add_html("")
        charts = gui.add_panel()
        charts.dock_left()
        charts.set_width(_WIDTH)
        with charts.add_tab("Motion"):
            self._speed = Chart(gui, "Speed, m/s", ("commanded", "actual", "estimated"))
            self._yaw_rate = Chart(gui, "Yaw rate, rad/s", ("commanded", "actual", "estimated"))
            self._tilt = Chart(gui, "Tilt of the boards, degrees", ("forward", "steering"))
        with charts.add_tab("Rewards"):
            self._rewards = gui.add_html("")
        with charts.add_tab("Estimates"):
            self._component = gui.add_dropdown("Component", ("-",))
            self._component.on_update(lambda _: loop.post(lambda session: None))  # drawn anew while paused, too
            self._estimate = Chart(gui, "", ("truth", "estimate"))
            self._estimates = gui.add_html("")
        with charts.add_tab("Power"):
            self._power = Chart(gui, "Mechanical power, W", ("joints", "drive"))
            self._cost = gui.add_html("")

    def show(self, session: Session) -> None:
        """Prepare for a session's components."""
        self._component.options = tuple(component.label for component in session.components)

    def update(self, session: Session) -> None:
        """Draw the record."""
        record, reading = session.record, session.reading
        self._status.content = status_table(session, self._loop)
        if reading is None:
            return
        time = record["time"]
        commanded, actual, estimated = record["command"], record["actual"], record["estimated"]
        self._speed.draw(time, commanded[:, 0], actual[:, 0], estimated[:, 0])
        self._yaw_rate.draw(time, commanded[:, 1], actual[:, 1], estimated[:, 1])
        self._tilt.draw(time, *np.degrees(record["tilt"]).T)
        self._rewards.content = reward_bars(record.mean_rewards(_RECENT))
        index = self._component.options.index(self._component.value)
        component = session.components[index]
        self._estimate.title = with_unit(component.label, component.unit)
        self._estimate.draw(time, record["truth"][:, index], record["estimate"][:, index])
        self._estimates.content = estimates_table(session)
        self._power.draw(time, record["joint_power"], record["drive_power"])
        joints, system = record.cost_of_transport(_TRIP)
        self._cost.content = _table([("CoT, joints", _number(joints)), ("CoT, joints and drive", _number(system))])


def status_table(session: Session, loop: Loop) -> str:
    """Return the time, pace, falls and origin of the policy as HTML."""
    pace = "paused" if loop.paused else f"{loop.measured_rate:.2f} × real time"
    actual = (0.0, 0.0) if session.reading is None else session.reading.actual
    falls = "no falls" if session.falls == 0 else f"{session.falls} fall{'s' * (session.falls > 1)}"
    return _table(
        [
            ("Time", f"{session.time:.1f} s, {pace}"),
            ("Speed", f"{actual[0]:+.2f} m/s (asked {session.command[0]:+.2f})"),
            ("Yaw rate", f"{actual[1]:+.2f} rad/s (asked {session.command[1]:+.2f})"),
            ("Robot", falls),
            ("Trained", f"{session.frames:,} robot steps"),
            ("Pad", "limits of the commands" if session.area is None else f"green: {session.area.source}"),
        ]
    )


def reward_bars(rewards: dict[str, float]) -> str:
    """Return the terms of the reward as bars, costs to the left and gains to the right.

    Example:
        >>> "forward" in reward_bars({"forward": 0.1, "torque": -0.02})
        True
    """
    largest = max([abs(value) for value in rewards.values()], default=0.0) or 1.0
    rows = []
    for name, value in rewards.items():
        share = 50.0 * abs(value) / largest
        left = 50.0 if value >= 0 else 50.0 - share
        colour = _COLOURS[2] if value >= 0 else "#c8443c"
        bar = f"position:absolute;left:{left:.1f}%;width:{share:.1f}%;height:100%;background:{colour}"
        text = html.escape(name.replace("_", " "))
        rows.append(
            f'<div style="display:flex;gap:6px;font-size:11px;line-height:15px"><div style="width:46%">{text}</div>'
            f'<div style="position:relative;flex:1;background:#8882"><div style="{bar}"></div></div>'
            f'<div style="width:17%;text-align:right">{value:+.4f}</div></div>'
        )
    return f'<div style="padding:6px 12px">{"".join(rows)}</div>'


def estimates_table(session: Session) -> str:
    """Return truth and estimate of every component of the extrinsic state as HTML."""
    assert session.reading is not None
    rows = [("", "truth", "estimate")]
    for component, truth, estimate in zip(session.components, session.reading.truth, session.reading.estimate):
        rows.append((with_unit(component.label, component.unit), f"{truth:+.2f}", _number(estimate, "+.2f")))
    return _table(rows)


def _number(value: float, form: str = ".3f") -> str:
    return "-" if math.isnan(value) else format(value, form)


def _table(rows: list[Any]) -> str:
    cells = ["".join(f'<td style="padding:0 6px">{html.escape(cell)}</td>' for cell in row) for row in rows]
    body = "".join(f"<tr>{row}</tr>" for row in cells)
    return f'<table style="font-size:12px;width:100%;padding:4px 6px">{body}</table>'
