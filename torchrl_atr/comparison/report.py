"""Files of a comparison: ``comparison.json``, the page ``README.md`` and its figures."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any
from urllib.parse import quote

from torchrl_atr._files import atomic, write_json
from torchrl_atr._text import markdown_table, with_unit
from torchrl_atr.comparison.summary import by_history, own_length


def write_comparison(metrics: Mapping[str, Any], folder: str | Path) -> dict[str, Path]:
    """Write ``comparison.json``, ``README.md`` and, for each set of sensors, its figures; return the files by name.

    Args:
        metrics: ``sensors``, by name what :func:`~torchrl_atr.comparison.summarize` returns, ``settings`` and ``run``.
        folder: to write to.

    Raises:
        ValueError: if ``metrics`` holds NaN or infinity, which JSON cannot.
    """
    from torchrl_atr.comparison.figures import plot_components, plot_drift, plot_history  # imports matplotlib

    folder = Path(folder)
    files = {"comparison.json": folder / "comparison.json", "README.md": folder / "README.md"}
    write_json(files["comparison.json"], metrics, allow_nan=False)
    for sensors, figures in metrics["sensors"].items():
        rows = figures["estimators"]
        plots = [("components", plot_components, own_length(rows)), ("drift", plot_drift, own_length(rows))]
        plots += [("history", plot_history, rows)] if by_history(rows) else []
        for kind, plot, shown in plots:
            name = _figure_file(kind, sensors)
            files[name] = plot(shown, folder / name)
    with atomic(files["README.md"]) as file:
        file.write_text(page(metrics), encoding="utf-8")
    return files


def _figure_file(kind: str, sensors: str) -> str:
    return f"{kind}_{quote(sensors, safe='')}.png"


def page(metrics: Mapping[str, Any]) -> str:
    """Return the page as Markdown."""
    settings, run = metrics["settings"], metrics["run"]
    parts = [
        "# Comparison of estimators",
        f"All in one policy, of {run.get('frames', 0):,} robot steps (`{run.get('command', '')}`): "
        f"{settings['updates']:,} updates on {settings['batch']:,} steps each, of rides of {settings['robots']} robots "
        f"for {settings['seconds']:g} s. Brackets are 95 % intervals over robots and trainings. What the figures mean: "
        "docs/compare.md.",
        f"Measured by `{metrics['command']}`.",
    ]
    for sensors, figures in metrics["sensors"].items():
        parts += [f"## Sensors: {sensors}", *_section(sensors, figures)]
    return "\n\n".join(parts) + "\n"


def _section(sensors: str, figures: Mapping[str, Any]) -> Iterable[str]:
    rows, sizes, true = figures["estimators"], figures["recording"], figures["latent"]
    scored = {name: row for name, row in rows.items() if "error" in row}
    yield (
        f"{sizes['rides']} rides, of which those of {sizes['training']} robots for training and those of "
        f"{sizes['robots'] - sizes['training']} for validation. Error: root mean square over all extrinsic states, in "
        "their standard deviations."
    )
    head = ["estimator", "trainings", "parameters", "µs a step", "error", "calibration", "latent error", "latent R²"]
    body = [
        [
            name,
            f"{row['trainings']}",
            f"{row['parameters']:,}",
            f"{row['microseconds']:.0f}",
            _with_interval(row["error"]),
            _number(row["calibration"] and row["calibration"]["value"]),
            _with_interval(row["latent"]["rmse"]),
            _with_interval(row["latent"]["r_squared"]),
            _number(row["latent"]["effective_dimension"], 1),
            _number(row["probe"]["mean"]),
        ]
        for name, row in scored.items()
    ]
    probe = ["true latent", *[""] * 7, _number(true["effective_dimension"], 1), _number(true["probe"]["mean"])]
    yield markdown_table([*head, "dimension", "probe R²"], [*body, probe])
    yield "What the errors cost, with each estimator in the policy:"
    head = ["estimator", "robots", "up at the end", "falls a minute", "speed error, m/s", "yaw rate error, rad/s"]
    yield markdown_table(head, [_ride(name, row["rides"]) for name, row in rows.items()])
    yield "Root mean square error of each extrinsic state (R² in parentheses):"
    scored = own_length(scored)
    components = [row["components"] for row in scored.values()]
    body = [
        [
            with_unit(same[0]["label"], same[0]["unit"]),
            *(f"{_number(each['rmse']['value'])} ({_number(each['r_squared']['value'])})" for each in same),
        ]
        for same in zip(*components)
    ]
    yield markdown_table(["state", *scored], body)
    yield f"![errors by state]({_figure_file('components', sensors)})"
    yield f"![errors by time in the ride]({_figure_file('drift', sensors)})"
    if by_history(rows):
        yield f"![errors by the length of the history]({_figure_file('history', sensors)})"


def _ride(name: str, ride: Mapping[str, Any]) -> list[str]:
    errors = [
        _with_interval(dict(zip(("value", "low", "high"), [ride[key], *ride[f"{key}_interval"]])))
        for key in ("settled_speed_error", "settled_yaw_error")
    ]
    low, high = ride["survival_interval"]
    up = f"{ride['survival']:.1%} [{low:.1%}, {high:.1%}]"
    return [name, str(ride["n"]), up, _number(ride["falls_per_minute"]), *errors]


def _with_interval(figure: Mapping[str, Any]) -> str:
    if figure["low"] is None:
        return _number(figure["value"])
    return f"{_number(figure['value'])} [{_number(figure['low'])}, {_number(figure['high'])}]"


def _number(value: float | None, decimals: int = 3) -> str:
    return "" if value is None else f"{value:.{decimals}f}"
