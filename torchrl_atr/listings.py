"""What ``torchrl-atr list`` prints, from the registries."""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable, Iterable, Iterator
from typing import Any


def _table(rows: Iterable[Iterable[str]]) -> Iterator[str]:
    """Left-aligned columns, the first row their heads."""
    cells = [list(row) for row in rows]
    widths = [max(len(row[i]) for row in cells) for i in range(len(cells[0]))]
    for row in cells:
        yield "  ".join(cell.ljust(width) for cell, width in zip(row, widths)).rstrip()


def robots() -> Iterator[str]:
    """Registered robots with mass, desired height, gains, and the names of joints and feet in our order."""
    import mujoco

    from torchrl_atr.envs import ROBOTS
    from torchrl_atr.envs.models import LEGS, load_robot

    rows = [["robot", "group", "mass, kg", "h_des, m", "kp", "kd", f"joints of {LEGS[0]}", f"feet {', '.join(LEGS)}"]]
    for name in ROBOTS.names():
        robot = ROBOTS.get(name)
        mass = mujoco.mj_getTotalmass(load_robot(robot)[1])
        figures = [f"{mass:.2f}", f"{robot.standing_height:.2f}", f"{robot.kp:g}", f"{robot.kd:g}"]
        feet = " ".join("+".join(names) for names in robot.foot_names)
        rows.append([name, robot.group, *figures, " ".join(robot.joints[:3]), feet])
    return _table(rows)


def transporters() -> Iterator[str]:
    """Registered transporters with their measures; the short names mean the one of the robot's size class."""
    from torchrl_atr.envs import TRANSPORTERS
    from torchrl_atr.envs.models import DESIGNS
    from torchrl_atr.envs.profiles import Readings

    rows = [["transporter", "size, m", "mass, kg", "boards", "hinges", "springs, N m/rad"]]
    for name in TRANSPORTERS.names():
        spec = TRANSPORTERS.get(name)
        size = " x ".join(f"{side:g}" for side in spec.size)
        hinges = ", ".join(hinge.name.removeprefix("platform_") for hinge in spec.design.hinges)
        springs = ", ".join(f"{value:.1f}" for value in spec.springs(Readings())[0])
        rows.append([name, size, f"{spec.mass:g}", str(len(spec.design.boards)), hinges, springs])
    yield from _table(rows)
    yield ""
    yield f"{' or '.join(DESIGNS)} alone means the one of the robot's size class (group)."


def estimators() -> Iterator[str]:
    """Registered estimators: what makes them, how many parameters they have by default, what their docstring says."""
    from torchrl_atr.modules import EstimatorError, available_estimators, get_estimator
    from torchrl_atr.modules.estimators import build_estimator

    rows = [["estimator", "made by", "parameters", "what it is"]]
    for name in available_estimators():
        factory = get_estimator(name)
        try:
            net = build_estimator(factory, history_shape=_HISTORY, out_features=_ESTIMATE)
            size = sum(parameter.numel() for parameter in net.parameters())
            figures = [f"{size:,}", _summary(_made_by(factory, net))]
        except (EstimatorError, ValueError) as error:  # a parameter without a shape yet
            figures = ["-", str(error)]
        rows.append([name, _origin(factory), *figures])
    yield from _table(rows)
    yield ""
    yield f"Parameters: of one that maps a history of {_HISTORY[0]} x {_HISTORY[1]} to {_ESTIMATE} numbers."


_HISTORY, _ESTIMATE = (10, 46), 16


def _origin(factory: Any) -> str:
    """Module and name of what was registered, of partials what they call."""
    while isinstance(factory, functools.partial):
        factory = factory.func
    named = factory if hasattr(factory, "__qualname__") else type(factory)
    return f"{named.__module__}.{named.__qualname__}"


def _made_by(factory: Any, net: Any) -> Any:
    """What describes an estimator: its factory if that has a docstring of its own, else its module's class."""
    while isinstance(factory, functools.partial):
        factory = factory.func
    return factory if getattr(factory, "__doc__", None) else type(net)


def rewards() -> Iterator[str]:
    """Yield the reward terms of every task, riding's in Table III's order."""
    from torchrl_atr.envs.tasks import TASKS, make_task

    for number, task in enumerate(TASKS):
        rows = [[f"{task}: term", "weight", "meaning"]]
        for name, term in make_task(task).rewards.items():
            rows.append([name, f"{term.weight:g}", _summary(term.function)])
        yield from ([""] if number else [])
        yield from _table(rows)


def tasks() -> Iterator[str]:
    """Yield the registered tasks: what makes them, what a command asks for, what their docstring says."""
    from torchrl_atr.envs.tasks import TASKS, make_task

    rows = [["task", "made by", "command", "what it is"]]
    for name in TASKS:
        command = make_task(name).command
        asked = ", ".join(f"{part} {unit}" for part, unit in zip(command.names, command.units))
        rows.append([name, _origin(TASKS.get(name)), asked, _summary(TASKS.get(name))])
    return _table(rows)


def settings() -> Iterator[str]:
    """Every setting of a run (``--set NAME=VALUE``) with its default and range."""
    import dataclasses

    from torchrl_atr.training.config import TrainConfig
    from torchrl_atr.training.ranges import RANGES

    rows = [["setting", "default", "range"]]
    for field in dataclasses.fields(TrainConfig):
        limits = " to ".join(f"{limit:.10g}" for limit in RANGES.get(field.name, ()))
        rows.append([field.name, _value(field.default), limits])
    return _table(rows)


def profiles() -> Iterator[str]:
    """Every open point of the paper: its value in each profile, and why; first the env's, then the recipe's."""
    from torchrl_atr.envs import PROFILES
    from torchrl_atr.envs.profiles import points
    from torchrl_atr.training import RECIPE_POINTS, make_config

    names = PROFILES.names()
    for title, chosen, settings in (
        ("Env (torchrl_atr.envs.Readings)", points(), {name: PROFILES.get(name) for name in names}),
        ("Recipe (--set NAME=VALUE)", RECIPE_POINTS, {name: make_config({"profile": name}) for name in names}),
    ):
        yield title
        for field, point in chosen.items():
            values = ", ".join(f"{name} {_value(getattr(settings[name], field))}" for name in names)
            yield f"  {field} ({point.number}): {values}"
            yield from (f"      {line}" for line in point.why.splitlines())


def _value(value: Any) -> str:
    return f"{value:g}" if isinstance(value, float) else str(value).lower()


def _summary(thing: Any) -> str:
    """The first line of its own docstring, not of one that it inherits."""
    return inspect.cleandoc(getattr(thing, "__doc__", None) or "").partition("\n")[0]


LISTINGS: dict[str, Callable[[], Iterable[str]]] = {
    "tasks": tasks,
    "robots": robots,
    "transporters": transporters,
    "estimators": estimators,
    "rewards": rewards,
    "profiles": profiles,
    "settings": settings,
}
"""What can be listed."""
