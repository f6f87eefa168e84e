"""Output of ``torchrl-atr list``, from the registries."""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable, Iterable, Iterator
from typing import Any

from torchrl_atr._settings import Setting
from torchrl_atr._settings import settings as declared


def _table(rows: Iterable[Iterable[str]]) -> Iterator[str]:
    """Yield lines of left-aligned columns, the first row their heads."""
    cells = [list(row) for row in rows]
    widths = [max(len(row[i]) for row in cells) for i in range(len(cells[0]))]
    for row in cells:
        yield "  ".join(cell.ljust(width) for cell, width in zip(row, widths)).rstrip()


def robots() -> Iterator[str]:
    """Yield the registered robots with mass, desired height, gains, and names of joints and feet in our order."""
    import mujoco

    from torchrl_atr.envs import ROBOTS
    from torchrl_atr.envs.models import LEGS, load_robot_model

    rows = [["robot", "group", "mass, kg", "h_des, m", "kp", "kd", f"joints of {LEGS[0]}", f"feet {', '.join(LEGS)}"]]
    for name in ROBOTS.names():
        robot = ROBOTS.get(name)
        mass = mujoco.mj_getTotalmass(load_robot_model(robot)[1])
        figures = [f"{mass:.2f}", f"{robot.standing_height:.2f}", f"{robot.kp:g}", f"{robot.kd:g}"]
        feet = " ".join("+".join(names) for names in robot.foot_names)
        rows.append([name, robot.group, *figures, " ".join(robot.joints[:3]), feet])
    return _table(rows)


def transporters() -> Iterator[str]:
    """Yield the registered transporters with their measures; short names mean the one of the robot's size class."""
    from torchrl_atr.envs import TRANSPORTERS
    from torchrl_atr.envs.interpretation import Interpretation
    from torchrl_atr.envs.models import TRANSPORTER_DESIGNS

    rows = [["transporter", "size, m", "mass, kg", "boards", "hinges", "springs, N m/rad"]]
    for name in TRANSPORTERS.names():
        spec = TRANSPORTERS.get(name)
        size = " x ".join(f"{side:g}" for side in spec.size)
        hinges = ", ".join(hinge.name.removeprefix("platform_") for hinge in spec.design.hinges)
        springs = ", ".join(f"{value:.1f}" for value in spec.springs(Interpretation())[0])
        rows.append([name, size, f"{spec.mass:g}", str(len(spec.design.boards)), hinges, springs])
    yield from _table(rows)
    yield ""
    yield f"{' or '.join(TRANSPORTER_DESIGNS)} alone means the one of the robot's size class (group)."


def estimators() -> Iterator[str]:
    """Yield the registered estimators: factory, number of parameters by default, first line of the docstring."""
    from torchrl_atr.modules import EstimatorError, available_estimators, get_estimator
    from torchrl_atr.modules.estimators import EstimatorSpec, build_estimator

    rows = [["estimator", "made by", "parameters", "what it is"]]
    for name in sorted(available_estimators()):
        factory = get_estimator(name)
        try:
            net = build_estimator(factory, EstimatorSpec("extrinsic", _HISTORY, {"extrinsic": _ESTIMATE}))
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
    """Return module and name of a registered factory; of a partial, those of its function."""
    while isinstance(factory, functools.partial):
        factory = factory.func
    named = factory if hasattr(factory, "__qualname__") else type(factory)
    return f"{named.__module__}.{named.__qualname__}"


def _made_by(factory: Any, net: Any) -> Any:
    """Return the object that describes an estimator: its factory if that has a docstring, else its module's class."""
    while isinstance(factory, functools.partial):
        factory = factory.func
    return factory if getattr(factory, "__doc__", None) else type(net)


def policies() -> Iterator[str]:
    """Yield the policies that are installed: what they stand on, and the share that stays up by their scorecards."""
    from torchrl_atr.deploy import policies as installed
    from torchrl_atr.deploy import read_manifest
    from torchrl_atr.deploy.manifest import ground_of

    rows = [["policy", "robot", "on", "commands", "up at 10 s", "at 60 s", "trained, minutes"]]
    for name in installed():
        manifest = read_manifest(name)
        limits, figures = manifest["command"]["limits"], manifest["figures"] or {}
        at_60 = figures.get("endurance") or figures.get("train")  # of riding, with pushes; of walking
        up = [_share(figures.get("tracking")), _share(at_60)]
        sign = "up to " if limits.get("forward_only") else "±"
        commands = f"{sign}{limits['max_speed']:g} m/s, ±{limits['max_yaw_rate']:g} rad/s"
        what = [manifest["robot"]["name"], ground_of(manifest), commands]
        rows.append([name, *what, *up, f"{manifest['training']['minutes']:.0f}"])
    yield from _table(rows)
    if len(rows) == 1:
        yield "none is installed; `torchrl-atr export` makes one of a run"


def _share(figure: dict[str, Any] | None) -> str:
    return "-" if figure is None else f"{figure['survival']:.1%}"


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
    """Yield the registered tasks: factory, components of a command, first line of the docstring."""
    from torchrl_atr.envs.tasks import TASKS, make_task

    rows = [["task", "made by", "command", "what it is"]]
    for name in TASKS:
        command = make_task(name).command
        asked = ", ".join(f"{part} {unit}" for part, unit in zip(command.names, command.units))
        rows.append([name, _origin(TASKS.get(name)), asked, _summary(TASKS.get(name))])
    return _table(rows)


def settings() -> Iterator[str]:
    """Yield every setting of a run with its default, its value in the preset ``paper``, its range and its reason."""
    rows = [["setting", "default", "paper", "range", "what it is, and why"]]
    for path, each in _settings().items():
        rows.append([path, _value(each.default), _value(each.value_in("paper")), each.range, each.text])
    return _table(rows)


def presets() -> Iterator[str]:
    """Yield every preset with the settings that differ from the defaults."""
    from torchrl_atr.training import PRESETS

    for name in PRESETS:
        yield name
        yield from (f"  {path} = {_value(value)}" for path, value in PRESETS.get(name).items())


def additions() -> Iterator[str]:
    """Yield what this package adds to the paper's method: the setting, its values, and why it is on by default."""
    from torchrl_atr.training import additions as known

    rows = [["addition", "setting", "off (paper)", "default", "what it is, and why"]]
    return _table([*rows, *([each.addition, each.path, *_off_and_on(each), each.text] for each in known())])


def questions() -> Iterator[str]:
    """Yield every open question of the paper that a setting answers: its value in each preset, and why."""
    from torchrl_atr.training import PRESETS

    for path, each in _settings().items():
        if each.question:
            values = ", ".join(f"{name} {_value(PRESETS.get(name).get(path, each.default))}" for name in PRESETS)
            yield f"{path} ({each.question}): {values}"
            yield f"    {each.text}"


def settings_page() -> Iterator[str]:
    """Yield docs/settings.md: the presets ``default`` and ``paper`` field by field, and the additions."""
    from torchrl_atr.training import additions as known

    yield from _PAGE.splitlines()
    yield from ("", "| addition | setting | off (`paper`) | default | what it is, and why |")
    yield "| --- | --- | --- | --- | --- |"
    for each in known():
        yield f"| {each.addition} | `{each.path}` | {' | '.join(_off_and_on(each))} | {_cell(each.text)} |"
    group = ""
    for path, declaration in _settings().items():
        own = path.rpartition(".")[0] or "run"
        if own != group:
            yield from ("", f"## {own}", "", "| setting | `default` | `paper` | range | what it is, and why |")
            yield "| --- | --- | --- | --- | --- |"
            group = own
        default, paper = _value(declaration.default), _value(declaration.value_in("paper"))
        paper = paper if paper == default else f"**{paper}**"
        text = _cell(declaration.text)
        yield f"| `{path.rpartition('.')[2]}` | {default} | {paper} | {declaration.range} | {text} |"


def _off_and_on(addition: Setting) -> tuple[str, str]:
    return _value(addition.value_in("paper")), _value(addition.default)


def _cell(text: str) -> str:
    return text.replace("|", "\\|")


_PAGE = """# Settings

Written by `torchrl-atr list settings --markdown`; a test holds this page to the code.

A run is described by nested settings. They come from Python (`make_config`), from a file (`--config run.toml`) and from
the command line (`--ppo.gamma 0.99`; `torchrl-atr train --help` shows the short options). Where several say something,
the later of these wins:

1. the default,
2. the preset (`--preset paper`, or `preset = "paper"` in a file),
3. what the task says (`TASK_SETTINGS`; riding says nothing, walking has its own),
4. the run that a new one begins from (`--from`), and then the file (`--config`),
5. the command line.

Every run writes `config.toml`, all of its settings with what they are: edit it and start from it with `--config`.
Its settings win over a preset's.

The preset `paper` is the paper's own method. It answers the open questions so that the paper's text comes true
([open_questions.md](open_questions.md)), has the printed rewards (r8 included), 4,096 robots, episodes of 10 s with a
change of command at 5 s and pushes at 3, 6 and 9 s, and Extreme Parkour's hyper-parameters of PPO where the paper
gives none. Four things are neither the paper's nor switched off, since something has to take their place: networks read
observations in standard deviations (a running normaliser), the rate of the policy follows the KL divergence (as in
legged_gym), critic and estimators have optimisers of their own, and steps that are not finite are left out.

## What is added to the paper's method

Each addition is one setting. All are off in `paper`, `literal` and `legged_gym`."""


def _settings() -> dict[str, Setting]:
    from torchrl_atr.training import TrainConfig

    return declared(TrainConfig)


def _value(value: Any) -> str:
    if isinstance(value, dict):
        return str(value or "none")
    if isinstance(value, list | tuple):
        return ",".join(map(_value, value)) or "none"
    return f"{value:,}" if type(value) is int else f"{value:g}" if isinstance(value, float) else str(value).lower()


def _summary(thing: Any) -> str:
    """Return the first line of an object's own docstring, not of one that it inherits."""
    return inspect.cleandoc(getattr(thing, "__doc__", None) or "").partition("\n")[0]


LISTINGS: dict[str, Callable[[], Iterable[str]]] = {
    "tasks": tasks,
    "robots": robots,
    "transporters": transporters,
    "estimators": estimators,
    "rewards": rewards,
    "questions": questions,
    "additions": additions,
    "presets": presets,
    "policies": policies,
    "settings": settings,
}
"""Listings by the name that ``torchrl-atr list`` takes."""
