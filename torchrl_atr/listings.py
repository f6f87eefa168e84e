"""What ``torchrl-atr list`` prints, from the registries."""

from __future__ import annotations

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
        deck = TRANSPORTERS.get(name)
        size = " x ".join(f"{side:g}" for side in deck.size)
        hinges = ", ".join(hinge.name.removeprefix("platform_") for hinge in deck.design.hinges)
        springs = ", ".join(f"{value:.1f}" for value in deck.springs(Readings())[0])
        rows.append([name, size, f"{deck.mass:g}", str(len(deck.design.boards)), hinges, springs])
    yield from _table(rows)
    yield ""
    yield f"{' or '.join(DESIGNS)} alone means the one of the robot's size class (group)."


def estimators() -> Iterator[str]:
    """Registered estimators, with the first line of their docstrings."""
    from torchrl_atr.modules import available_estimators, get_estimator

    return _table([name, _summary(get_estimator(name))] for name in available_estimators())


def rewards() -> Iterator[str]:
    """Reward terms in Table III's order."""
    from torchrl_atr.envs.task.rewards import REWARD_TERMS

    return _table([name, _summary(term)] for name, term in REWARD_TERMS.items())


def settings() -> Iterator[str]:
    """Every setting of a run (``--set NAME=VALUE``) with its default and range."""
    import dataclasses

    from torchrl_atr.training.config import RANGES, TrainConfig

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
    return (inspect.getdoc(thing) or "").partition("\n")[0]


LISTINGS: dict[str, Callable[[], Iterable[str]]] = {
    "robots": robots,
    "transporters": transporters,
    "estimators": estimators,
    "rewards": rewards,
    "profiles": profiles,
    "settings": settings,
}
"""What can be listed."""
