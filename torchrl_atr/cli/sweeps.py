"""Protocols of ``evaluate`` that ride under many conditions: robustness, and robots and transporters beside its own."""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from torchrl_atr._files import write_json
from torchrl_atr.cli.measured import Measured
from torchrl_atr.cli.printing import compatibility_lines, robustness_lines

if TYPE_CHECKING:
    from torchrl_atr.modules import ROANetworks
    from torchrl_atr.training import TrainConfig

_UNFINISHED = "unfinished.json"
"""Rows of a sweep that was stopped, in the folder of its report."""
_RIDE = ("robots", "seconds", "command_seconds", "max_speed", "max_yaw_rate", "seed")
SHORT_RIDE: dict[str, Any] = {
    "randomization": "train",
    "max_speed": None,
    "max_yaw_rate": None,
    "robots": 100,
    "seconds": 20.0,
    "command_seconds": 5.0,
    "pushes": True,
}
"""Options of a ride of which there are many, with their defaults."""


def robustness(
    arguments: argparse.Namespace,
    config: TrainConfig,
    networks: ROANetworks,
    make_env: Callable[..., Any],
    progress: Callable[[int, int], None],
) -> Measured:
    """Measure where a policy breaks: one parameter at a time, and all together, from training to beyond test range."""
    from torchrl_atr.evaluation.endurance import overspeed_of
    from torchrl_atr.evaluation.robustness import evaluate_robustness

    rows = _Unfinished(arguments, networks)
    metrics = evaluate_robustness(
        networks.deployed_policy(arguments.act_source),
        partial(make_env, pushes=arguments.pushes),
        arguments.parameters,
        finished=rows.read(),
        save=rows.write,
        progress=progress,
        overspeed=overspeed_of(config.env.overspeed_margin),
        **{name: getattr(arguments, name) for name in _RIDE},
    )

    def write(folder: Path) -> None:
        from torchrl_atr.evaluation.robustness_figure import plot_robustness  # imports matplotlib

        write_json(folder / "metrics.json", metrics, allow_nan=False)
        plot_robustness(metrics, folder / "robustness.png")

    return Measured(metrics, metrics, write, list(robustness_lines(metrics)), rows.remove)


def compatibility(
    arguments: argparse.Namespace,
    config: TrainConfig,
    networks: ROANetworks,
    make_env: Callable[..., Any],
    progress: Callable[[int, int], None],
) -> Measured:
    """Measure a policy on other robots and transporters, those of its own size class unless others are given."""
    from torchrl_atr.evaluation.compatibility import evaluate_compatibility
    from torchrl_atr.evaluation.endurance import overspeed_of

    metrics = evaluate_compatibility(
        networks.deployed_policy(arguments.act_source),
        partial(make_env, pushes=arguments.pushes),
        arguments.on,
        progress=progress,
        overspeed=overspeed_of(config.env.overspeed_margin),
        **{name: getattr(arguments, name) for name in _RIDE},
    )

    def write(folder: Path) -> None:
        from torchrl_atr.evaluation.compatibility_figure import plot_compatibility  # imports matplotlib

        write_json(folder / "metrics.json", metrics, allow_nan=False)
        plot_compatibility(metrics, folder / "compatibility.png")

    return Measured(metrics, metrics, write, list(compatibility_lines(metrics)))


class _Unfinished:
    """File of the rows of a sweep, which a later call with the same options and weights goes on from."""

    def __init__(self, arguments: argparse.Namespace, networks: ROANetworks) -> None:
        self.path = arguments.output / _UNFINISHED
        from torchrl_atr.modules import fingerprint

        told = {name: str(value) for name, value in vars(arguments).items() if name not in ("parser", "parameters")}
        self.settings = {**told, "policy": fingerprint(networks)}

    def read(self) -> list[dict[str, Any]]:
        """Return the rows that are there, if they are of the same options and weights."""
        if not self.path.is_file():
            return []
        found = json.loads(self.path.read_text(encoding="utf-8"))
        return found["rows"] if found["settings"] == self.settings else []

    def write(self, rows: list[dict[str, Any]]) -> None:
        """Write all rows so far."""
        write_json(self.path, {"settings": self.settings, "rows": rows})

    def remove(self) -> None:
        """Remove the file: the report has its rows."""
        self.path.unlink(missing_ok=True)
