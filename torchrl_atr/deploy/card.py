"""Model card of a bundle, from its manifest and the run's scorecard."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from torchrl_atr._errors import UserError
from torchrl_atr.deploy.manifest import ground_of
from torchrl_atr.evaluation.compatibility import compatibility_table
from torchrl_atr.evaluation.robustness import robustness_table
from torchrl_atr.runs.provenance import cores

_SCORECARD = "scorecard.json"
_SWEEPS: Mapping[str, tuple[str, Callable[[Mapping[str, Any]], list[str]]]] = {
    "robustness": ("Robustness: one parameter at a time, all others of the training range", robustness_table),
    "compatibility": ("On other robots and transporters", compatibility_table),
}
"""Title and table of further reports, by the protocol of ``evaluate`` and the folder in the run."""


def check_scorecard(run: Path, trained: Mapping[str, Any]) -> None:
    """Check that a run's scorecard and sweeps, where it has any, are of this training.

    Args:
        run: its folder.
        trained: provenance of the checkpoint that is exported.

    Raises:
        UserError: if one is of another training.
    """
    again = {f"{name}/metrics.json": f"`torchrl-atr evaluate RUN --protocol {name}`" for name in _SWEEPS}
    for file, command in {_SCORECARD: "`python -m benchmarks.scorecard RUN` from a clone", **again}.items():
        report = read_report(run / file)
        if report is not None and report.get("run") != trained:
            raise UserError(
                f"{run / file} is of another training than the checkpoint of {trained['frames']:,} robot steps; "
                f"measure it anew with {command}, or remove it"
            )


def figures(run: Path) -> dict[str, Any] | None:
    """Return the shares of robots that stay up, by evaluation of the run's scorecard; None without one."""
    scorecard = read_report(run / _SCORECARD)
    if scorecard is None:
        return None
    names = ("n", "survival", "survival_interval", "settled_speed_error", "settled_yaw_error", "commands_mastered")
    return {
        evaluation: {name: metrics[name] for name in names if name in metrics}
        for evaluation, metrics in scorecard["evaluations"].items()
    }


def card(run: Path, manifest: Mapping[str, Any]) -> str:
    """Return the model card as Markdown; the table is the scorecard's own page, whose title is left out."""
    robot, command, support = manifest["robot"]["name"], manifest["command"], ground_of(manifest)
    trained, parity = command["trained"] or {}, manifest["parity"]
    page = run / "README.md"
    lines = [
        f"# {manifest['name']}: {robot} on {support}",
        "",
        f"A policy of the task {manifest['task']}. It follows {' and '.join(command['names'])} commands "
        f"({', '.join(command['units'])}) from IMU and joint encoders, at {manifest['control']['rate_hz']:g} Hz. "
        "Written by `torchrl-atr export`; "
        "`manifest.json` says all that a deployment needs, and `torchrl-atr verify` checks the folder.",
        "",
        "```python",
        "from torchrl_atr.deploy import PolicyRunner  # needs numpy and onnxruntime alone",
        "",
        f'runner = PolicyRunner("{manifest["name"]}", robot="{robot}")',
        "targets, gains = runner.step(imu, joint_positions, joint_velocities, command=(1.0, 0.0))",
        "```",
        "",
        f"- Commands: {command['clipping']} ({command['source']}). Trained: "
        + (", ".join(f"{name} ±{bound:g}" for name, bound in trained.items()) or "no grid")
        + ".",
        f"- Sensors it was trained with: {_sensors(manifest)}.",
        f"- ONNX Runtime acts as torch within {parity['error']:.1e} of the action scale, over {parity['steps']} steps "
        f"of {parity['robots']} robots with {parity['resets']} resets.",
        f"- {_origin(manifest['training'])}",
        "- Limits: trained and measured in simulation alone. It starts from a stand at rest in q0; it estimates its "
        "speed by dead reckoning, which drifts.",
        "",
    ]
    if (run / _SCORECARD).is_file() and page.is_file():
        measured = page.read_text(encoding="utf-8").strip().splitlines()[2:]
        lines += ["## Measured", "", *(line for line in measured if not line.startswith("Trained by ")), ""]
    else:
        lines += ["## Measured", "", "Nothing yet: the run had no scorecard when it was exported.", ""]
    return "\n".join([*lines, *_sweeps(run)])


def _sweeps(run: Path) -> list[str]:
    """Return the tables of the sweeps that a run has been measured by."""
    lines: list[str] = []
    for protocol, (title, table) in _SWEEPS.items():
        metrics = read_report(run / protocol / "metrics.json")
        if metrics is not None:
            first, *rest = table(metrics)
            lines += [f"## {title}", "", f"`torchrl-atr evaluate RUN --protocol {protocol}`: {first}", *rest, ""]
    return lines


def _sensors(manifest: Mapping[str, Any]) -> str:
    texts = []
    for sensor in manifest["sensors"]:
        own = sensor["trained_with"]
        parts = [f"{what} {own[key]:.3g}" for what, key in (("noise", "noise_std"), ("bias", "bias_std")) if own[key]]
        parts += [f"up to {1e3 * own['max_delay_s']:.0f} ms late"] if own["max_delay_s"] else []
        texts.append(f"{sensor['name'].replace('_', ' ')} ({', '.join(parts) or 'exact'}, {sensor['unit']})")
    return "; ".join(texts)


def _origin(run: Mapping[str, Any]) -> str:
    began = f" It began from {run['from']['run']}." if "from" in run else ""
    commit = f", commit {run['versions']['commit']}" if "commit" in run.get("versions", {}) else ""
    return (
        f"Trained by `{run['command']}`: {run['frames']:,} robot steps in {run['minutes']:.0f} minutes on "
        f"{cores(run['hardware'])}, seed {run['seed']}{commit}.{began}"
    )


def read_report(path: Path) -> Any:
    """Return the content of a JSON file; None if there is none."""
    return json.loads(path.read_text(encoding="utf-8")) if path.is_file() else None
