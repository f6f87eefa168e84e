"""Robustness of a policy: endurance rides under conditions that it was not trained for, one parameter at a time."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any

from tensordict.nn import TensorDictModuleBase
from torchrl.envs import EnvBase

from torchrl_atr.envs.access import base_env
from torchrl_atr.envs.physics import CONTROL_DT
from torchrl_atr.evaluation.conditions import BASELINE, REGIONS, Condition, Sweep, describe, sweeps_of
from torchrl_atr.evaluation.endurance import evaluate_endurance
from torchrl_atr.evaluation.endurance_metrics import endurance_metrics
from torchrl_atr.evaluation.intervals import share_text
from torchrl_atr.evaluation.ride import MAX_ROBOTS, build_env

Row = dict[str, Any]
FIGURES = (
    "n",
    "survival",
    "survival_interval",
    "settled_speed_error",
    "settled_speed_error_interval",
    "settled_yaw_error",
    "settled_yaw_error_interval",
    "falls_per_minute",
)
"""Figures of a row, as in the metrics of an endurance evaluation."""
BREAKS = 0.5
"""Share of the robots that stay up in training below which a policy counts as broken."""


def row_of(metrics: Mapping[str, Any]) -> Row:
    """Return the figures of :data:`FIGURES` of the metrics of an endurance evaluation, and its falls by cause."""
    causes = {name: cause["falls"] for name, cause in metrics["falls_by_cause"].items()}
    return {**{name: metrics[name] for name in FIGURES}, "falls_by_cause": causes}


def evaluate_robustness(
    policy: TensorDictModuleBase,
    make_env: Callable[..., EnvBase],
    parameters: Sequence[str] | None = None,
    robots: int = 100,
    seconds: float = 20.0,
    *,
    finished: Sequence[Row] = (),
    save: Callable[[list[Row]], None] | None = None,
    progress: Callable[[int, int], None] | None = None,
    **ride: Any,
) -> dict[str, Any]:
    """Ride under every condition of :func:`~torchrl_atr.evaluation.conditions.sweeps_of`, after one as in training.

    All rides have the same commands and, apart from what is varied, the same robots.

    Args:
        policy: writes the action.
        make_env: called as ``make_env(num_envs=n, seed=s)``, with ``physics=Simulation(...)`` for some conditions; its
            env has ``reconfigure``, its robots are of the training range.
        parameters: names of those to vary; None for all.
        robots: number of robots in each ride.
        seconds: length of a ride.
        finished: rows of an evaluation like this one that was stopped; they are not measured again.
        save: called with all rows so far after each.
        progress: called with (steps done, steps in total).
        **ride: further arguments of :func:`~torchrl_atr.evaluation.evaluate_endurance`.

    Returns:
        Contents of ``metrics.json``, see :func:`robustness_metrics`.

    Raises:
        InputError: for an unknown parameter.

    Example:
        >>> from torchrl_atr.envs import make_riding_env
        >>> from torchrl_atr.modules import make_networks
        >>> make_env = partial(make_riding_env, "a1", "single_board", num_threads=1)
        >>> env = make_env(num_envs=1, seed=0)
        >>> policy = make_networks(env.observation_spec, env.action_spec).deployed_policy()
        >>> short = {"command_seconds": 0.04, "settle": 0.0}
        >>> found = evaluate_robustness(policy, make_env, ["timestep"], 1, 0.04, **short)
        >>> [row["value"] for row in found["parameters"]["timestep"]["rows"]]
        [2.0, 4.0, 10.0]
    """
    first = build_env(make_env, 1, 0)
    sweeps = sweeps_of(base_env(first).task, parameters)
    first.close(raise_if_closed=False)
    conditions = [Condition(BASELINE, "training", "training")]
    conditions += [condition for sweep in sweeps.values() for condition in sweep.conditions]
    steps, rows = round(seconds / CONTROL_DT) * -(-robots // MAX_ROBOTS), list[Row]()
    protocol: dict[str, Any] = {}
    for number, condition in enumerate(conditions):
        described = describe(condition)
        row = next((each for each in finished if each["condition"] == described), None)
        if row is None:
            result = evaluate_endurance(
                policy,
                partial(_changed, make_env, condition),
                robots,
                seconds,
                progress=shifted(progress, number * steps, len(conditions) * steps),
                **ride,
            )
            metrics = endurance_metrics(result)
            protocol = {name: metrics[name] for name in _PROTOCOL}
            row = {**row_of(metrics), "condition": described, "protocol": protocol}
        rows.append(row)
        protocol = row["protocol"]
        if save is not None:
            save(rows)
    return robustness_metrics(rows, sweeps, protocol)


def _changed(make_env: Callable[..., EnvBase], condition: Condition, **arguments: Any) -> EnvBase:
    """Return an env under a condition."""
    numerics = {} if condition.simulation is None else {"physics": condition.simulation}
    env: Any = make_env(**arguments, **numerics)
    env.reconfigure(randomization=condition.ranges or None, sensors=condition.sensors)
    return env


def shifted(progress: Callable[[int, int], None] | None, before: int, total: int) -> Callable[[int, int], None] | None:
    """Return the progress of one of several rides, as that of all of them."""
    return None if progress is None else lambda done, _: progress(before + done, total)


_PROTOCOL = ("seconds", "command_seconds", "settle", "push_seconds", "commands")
"""Figures of a ride that say how it was done."""


def robustness_metrics(rows: Sequence[Row], sweeps: Mapping[str, Sweep], protocol: Mapping[str, Any]) -> dict[str, Any]:
    """Return the contents of ``metrics.json`` of a robustness evaluation.

    ``baseline``, the figures as in training, and by parameter its ``unit``, ranges of ``training`` and ``test``,
    ``rows`` (``value``, ``region`` and the figures of :data:`FIGURES`), and ``breaks_at``: going out from training, the
    first value on each side, or the names, at which less than half as many robots stay up as in training.
    """
    flat = [_flat(row) for row in rows]
    baseline = next(row for row in flat if row["parameter"] == BASELINE)
    found: dict[str, Any] = {}
    for name, sweep in sweeps.items():
        own = [{k: v for k, v in row.items() if k != "parameter"} for row in flat if row["parameter"] == name]
        found[name] = {
            "unit": sweep.unit,
            "training": None if sweep.training is None else list(sweep.training),
            "test": None if sweep.test is None else list(sweep.test),
            "rows": own,
            "breaks_at": breaks_at(own, baseline["survival"], sweep.training),
        }
    return {"protocol": "robustness", "n": baseline["n"], **protocol, "baseline": baseline, "parameters": found}


def _flat(row: Row) -> Row:
    condition = row["condition"]
    named = {name: condition[name] for name in ("parameter", "value", "region")}
    return {**named, **{name: value for name, value in row.items() if name not in ("condition", "protocol")}}


def breaks_at(rows: Sequence[Row], up: float, training: Sequence[float] | None) -> list[float | str]:
    """Return the first values out from the training range at which fewer than half of ``up`` stay up; names likewise.

    Example:
        >>> rows = [{"value": v, "survival": s} for v, s in ((0.5, 0.2), (0.8, 0.9), (1.6, 0.3), (2.0, 0.0))]
        >>> breaks_at(rows, 0.95, (0.8, 1.2))
        [0.5, 1.6]
    """
    broken = [row["value"] for row in rows if row["survival"] < BREAKS * up]
    if training is None or any(isinstance(value, str) for value in broken):
        return broken
    middle = sum(training) / 2
    below, above = ([value for value in broken if (value < middle) is low] for low in (True, False))
    return [*below[-1:], *above[:1]]


def worst_rows(sweep: Mapping[str, Any]) -> dict[str, Row]:
    """Return the row of a parameter with the smallest share up, by region; there is none of a region without rows.

    Args:
        sweep: of one parameter in :func:`robustness_metrics`.

    Example:
        >>> rows = [{"region": "test", "survival": s} for s in (0.9, 0.4)]
        >>> worst_rows({"rows": rows})
        {'test': {'region': 'test', 'survival': 0.4}}
    """
    ordered = sorted(sweep["rows"], key=lambda row: row["survival"], reverse=True)
    return {row["region"]: row for row in ordered}


def robustness_table(metrics: Mapping[str, Any]) -> list[str]:
    """Return a Markdown table: by parameter the smallest share up in the training range, the test range and beyond.

    Args:
        metrics: of :func:`robustness_metrics`.
    """
    pushes = metrics["push_seconds"]
    lines = [
        f"{metrics['n']} robots in every ride of {metrics['seconds']:g} s, a new command every "
        f"{metrics['command_seconds']:g} s, {'no pushes' if pushes is None else f'pushes every {pushes:g} s'}; share "
        "up at the end, with its 95 % interval, at the worst value of each range. As trained: "
        f"{_up(metrics['baseline'])}.",
        "",
        "| parameter | training range | test range | beyond | less than half as many up from |",
        "| --- | --- | --- | --- | --- |",
    ]
    for name, sweep in metrics["parameters"].items():
        cells = [name.replace("_", " ")]
        worst = worst_rows(sweep)
        for region in REGIONS:
            row = worst.get(region)
            cells.append("-" if row is None else f"{_up(row)} at {_value(row['value'], sweep['unit'])}")
        cells.append(", ".join(_value(value, sweep["unit"]) for value in sweep["breaks_at"]) or "-")
        lines.append(f"| {' | '.join(cells)} |")
    return lines


def _up(row: Mapping[str, Any]) -> str:
    return share_text(row["survival"], row["survival_interval"])


def _value(value: float | str, unit: str) -> str:
    return value if isinstance(value, str) else f"{value:g} {unit}".strip()
