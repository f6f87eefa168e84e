"""Controls of the page: speed and yaw rate, time, pushes, the robot's parameters, policy and checkpoint."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from torchrl_atr.envs.tasks.sensors import SENSORS
from torchrl_atr.viewer.loop import Loop
from torchrl_atr.viewer.session import Session
from torchrl_atr.viewer.sources import checkpoints_of

if TYPE_CHECKING:
    from viser import ViserServer

MOST_ROBOTS = 16
_ACTS_ON = {"estimates": "estimated", "truth": "privileged"}
_RATES = {"real time": 1.0, "1/2": 0.5, "1/4": 0.25, "1/10": 0.1}
_UNITS = {"payload": "kg"}
_HANDS_OFF = 0.5
"""Seconds after a user's change of a slider in which it is left alone."""
_KEYS = {"arrowup": (0.1, 0.0), "arrowdown": (-0.1, 0.0), "arrowleft": (0.0, 0.1), "arrowright": (0.0, -0.1)}
"""Keys that move the stick, by shares of its way."""


class Controls:
    """Inputs of the page; each posts an action to the loop, and shows what is in force.

    viser tells the other browsers what one of them has set.

    Args:
        server: of the page.
        loop: of the session.
        policies: that can be chosen, by name.
    """

    def __init__(self, server: ViserServer, loop: Loop, policies: dict[str, Path]) -> None:
        self._gui, self._loop, self._policies = server.gui, loop, policies
        self._made: list[Any] = []
        self._touched = 0.0
        self._told: tuple[float, float] | None = None

    def show(self, session: Session) -> None:
        """Make the inputs that fit a session, in place of those before."""
        for handle in self._made:
            handle.remove()
        self._made = []
        for name, add in (
            ("Ride", self._add_ride),
            ("Time", self._add_time),
            ("Push", self._add_push),
            ("Robot", self._add_robot),
            ("Policy", self._add_policy),
        ):
            folder = self._gui.add_folder(name, expand_by_default=name != "Push")
            self._made.append(folder)
            with folder:
                add(session)

    def update(self, session: Session) -> None:
        """Show the command in force, which a stick, a key or another browser may have set."""
        # a slider that is being dragged, or has been and whose change is under way, must not jump back
        if session.command == self._told or time.monotonic() - self._touched < _HANDS_OFF:
            return
        self._told = session.command
        pairs: list[tuple[Any, float]] = list(zip((self._speed, self._yaw_rate), session.command))
        for slider, value in pairs:
            if abs(slider.value - value) > 1e-3:
                slider.value = round(value, 2)

    def _add_ride(self, session: Session) -> None:
        (speed, yaw_rate), lowest = session.limits, float(session.lowest[0])
        self._told = None
        self._speed = self._gui.add_slider("Speed, m/s", max(-speed, lowest), speed, 0.01, 0.0)
        self._yaw_rate = self._gui.add_slider("Yaw rate, rad/s", -yaw_rate, yaw_rate, 0.01, 0.0)

        def asked(event: Any) -> None:
            if event.client is not None:  # None: set by update() above
                self._touched = time.monotonic()
                self.steer(self._speed.value, self._yaw_rate.value)

        for slider in (self._speed, self._yaw_rate):
            slider.on_update(asked)
        self._on_click(self._gui.add_button("Stop", hint="or the space bar"), lambda: self.steer(0.0, 0.0))
        for key, (ahead, left) in _KEYS.items():
            self._add_key(f"Stick: {key.removeprefix('arrow')}", key, self._nudge(ahead, left))
        self._add_key("Stick: stop", "space", lambda: self.steer(0.0, 0.0))

    def steer(self, speed: float, yaw_rate: float) -> None:
        """Ask for a command; any thread may call this."""
        self._loop.post(lambda session: session.steer(speed, yaw_rate))

    def _nudge(self, ahead: float, left: float) -> Callable[[], None]:
        def nudge(session: Session) -> None:
            (speed, yaw_rate), (most, fastest) = session.command, session.limits
            speed, yaw_rate = speed + ahead * most, yaw_rate + left * fastest
            session.steer(max(-most, min(most, speed)), max(-fastest, min(fastest, yaw_rate)))

        return lambda: self._loop.post(nudge)

    def _add_time(self, session: Session) -> None:
        now = next((name for name, rate in _RATES.items() if rate == self._loop.rate), "real time")
        pace = self._gui.add_dropdown("Pace", tuple(_RATES), initial_value=now)
        pace.on_update(lambda _: setattr(self._loop, "rate", _RATES[pace.value]))
        buttons = self._gui.add_button_group("Clock", ("Pause", "Step", "Reset"), hint="keys P, N and R")
        actions = {"Pause": self._loop.toggle_pause, "Step": self._loop.single_step, "Reset": self._reset}
        buttons.on_click(lambda _: actions[buttons.value]())
        for (name, action), key in zip(actions.items(), ("P", "N", "R")):
            self._add_key(name, key, action)

    def _reset(self) -> None:
        self._loop.post(Session.reset)

    def _add_push(self, session: Session) -> None:
        size = self._gui.add_slider("Size, m/s", 0.1, 2.0, 0.1, 0.5)
        ways = {"ahead": (1.0, 0.0), "back": (-1.0, 0.0), "left": (0.0, 1.0), "right": (0.0, -1.0)}
        buttons = self._gui.add_button_group("Push", tuple(ways), hint="key B pushes ahead")

        def push(way: str) -> None:
            ahead, left = (size.value * share for share in ways[way])
            self._loop.post(lambda session: session.push(ahead, left))

        buttons.on_click(lambda _: push(buttons.value))
        self._add_key("Push", "B", lambda: push("ahead"))

    def _add_robot(self, session: Session) -> None:
        for name, (low, high, value) in session.parameters.items():
            label = f"{name.capitalize()}, {_UNITS[name]}" if name in _UNITS else name.capitalize()
            slider = self._gui.add_slider(label, low, high, 0.01, round(min(max(value, low), high), 2))
            self._on_change(slider, self._parameter_setter(name))
        counts = tuple(str(number) for number in range(1, MOST_ROBOTS + 1))
        robots = self._gui.add_dropdown("Robots", counts, initial_value=str(session.setup.robots))
        self._on_change(robots, lambda value: lambda session: session.change(robots=int(value)))
        if session.setup.robots > 1:
            names = tuple(str(number + 1) for number in range(session.setup.robots))
            shown = self._gui.add_dropdown("Follow", names, initial_value=names[session.followed])
            self._on_change(shown, lambda value: lambda session: session.follow(int(value) - 1))
        sensors = self._gui.add_dropdown("Sensors", tuple(SENSORS), initial_value=session.sensors)
        self._on_change(sensors, lambda value: lambda session: session.change(sensors=value))
        acts_on = next(text for text, source in _ACTS_ON.items() if source == session.setup.source)
        source = self._gui.add_dropdown("Policy acts on", tuple(_ACTS_ON), initial_value=acts_on)
        self._on_change(source, lambda value: lambda session: session.change(source=_ACTS_ON[value]))

    @staticmethod
    def _parameter_setter(name: str) -> Callable[[Any], Callable[[Session], object]]:
        return lambda value: lambda session: session.set_parameter(name, value)

    def _add_policy(self, session: Session) -> None:
        names = {folder: name for name, folder in self._policies.items()}
        chosen = self._gui.add_dropdown("Policy", tuple(self._policies), initial_value=names[session.setup.policy])
        self._on_change(
            chosen,
            lambda value: lambda session: session.change(policy=self._policies[value], checkpoint="last", sensors=None),
        )
        checkpoints = tuple(checkpoints_of(session.setup.policy))
        checkpoint = self._gui.add_dropdown("Checkpoint", checkpoints, initial_value=session.setup.checkpoint)
        self._on_change(checkpoint, lambda value: lambda session: session.change(checkpoint=value))
        follows = self._gui.add_checkbox("Load new checkpoints", self._loop.follows, hint="of a run that is training")
        follows.on_update(lambda _: setattr(self._loop, "follows", follows.value))

    def _on_change(self, handle: Any, action: Callable[[Any], Callable[[Session], object]]) -> None:
        def changed(event: Any) -> None:
            if event.client is not None:
                self._loop.post(action(handle.value))

        handle.on_update(changed)

    @staticmethod
    def _on_click(handle: Any, action: Callable[[], None]) -> None:
        handle.on_click(lambda _: action())

    def _add_key(self, label: str, key: Any, action: Callable[[], None]) -> None:
        command = self._gui.add_command(label, hotkey=key)
        command.on_trigger(lambda _: action())
        self._made.append(command)
