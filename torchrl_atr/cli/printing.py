"""Output of commands while they work and when they are done."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from torchrl_atr._files import say
from torchrl_atr._text import number, with_unit

if TYPE_CHECKING:
    from torchrl_atr.evaluation import ReplayedStep

_HEADLINES = {
    "survival": "share",
    "settled_speed_error_straight": "m/s",
    "settled_speed_error": "m/s",
    "settled_yaw_error": "rad/s",
    "yaw_slope": "rad/s per rad/s",
    "commands_mastered": "share",
}
"""Figures that ``evaluate`` prints, and their units."""
_REPLAY = (("step", 8), ("v, m/s", 11), ("w, rad/s", 11), ("tilt, rad", 11), ("max |qvel|", 12), ("max |a|", 10))
"""Columns of ``replay`` and their widths."""


class StepCounter:
    """Display of the number of steps done: one line that is redrawn in a terminal, elsewhere a line at intervals.

    Args:
        what: name of the activity.
        every: steps between two updates in a terminal; ten times as many elsewhere.

    Example:
        >>> with StepCounter("evaluating", every=1) as counter:
        ...     for step in range(1, 11):
        ...         counter(step, 20)
        evaluating: 10 of 20 control steps
    """

    def __init__(self, what: str, every: int = 50) -> None:
        self.what = what
        self._redraws = sys.stdout.isatty()
        self._every = every if self._redraws else 10 * every
        self._open = False

    def __call__(self, done: int, total: int) -> None:
        """Print ``done`` of ``total`` steps, at intervals."""
        if done % self._every == 0 or done == total:
            text = f"{self.what}: {done} of {total} control steps"
            say(f"\r{text}" if self._redraws else text, end="" if self._redraws else "\n")
            self._open = self._redraws

    def note(self, text: str) -> None:
        """Print a separate line."""
        self._end_line()
        say(text)

    def _end_line(self) -> None:
        if self._open:
            say("")
            self._open = False

    def __enter__(self) -> StepCounter:
        return self

    def __exit__(self, *exception: Any) -> None:
        self._end_line()


@contextmanager
def step_progress(what: str) -> Iterator[Callable[[int, int], None]]:
    """Yield a function of the steps done and in total that prints them, and adapts torch's threads to the machine.

    Args:
        what: name of the activity.
    """
    from torchrl_atr._threads import TorchThreads

    with StepCounter(what) as counter, TorchThreads(announce=counter.note) as threads:

        def progress(done: int, total: int) -> None:
            threads.update()
            counter(done, total)

        yield progress


def headlines(metrics: dict[str, Any]) -> Iterator[str]:
    """Yield lines of the headline figures, beside those of a board that never moves, from which no robot falls."""
    still = metrics["do_nothing"]
    yield f"{'':40}{'ours':>10}{'still board':>14}"
    for name, unit in _HEADLINES.items():
        yield f"{f'{name}, {unit}':40}{number(metrics[name], 10, 3)} {number(still[name], 13, 3)}"


def endurance_lines(metrics: dict[str, Any]) -> Iterator[str]:
    """Yield lines of an endurance evaluation: headline figures with 95 % intervals, and the causes of falls."""
    still, up, seconds = metrics["do_nothing"], metrics["survival_over_time"], metrics["seconds"]
    yield f"{'':40}{'ours':>10}{'95 % interval':>20}{'still board':>14}"
    shown = {float(round(seconds * share)) for share in (1 / 6, 1 / 3, 2 / 3)} | {seconds}
    for second, *figures in zip(*(up[name] for name in ("seconds", "share", "low", "high"))):
        if second in shown and second > 0:
            yield _endurance_line(f"up at {second:g} s, share", figures[0], figures[1:], still["survival"])
    for name, unit in (("settled_speed_error", "m/s"), ("settled_yaw_error", "rad/s")):
        yield _endurance_line(f"{name}, {unit}", metrics[name], metrics[f"{name}_interval"], still[name])
    if metrics["estimate_drift"] is not None:
        label = f"drift of the estimated {metrics['estimate_over_time']['label']}"
        yield _endurance_line(label, metrics["estimate_drift"], metrics["estimate_drift_interval"])
    yield _endurance_line("falls a minute of riding", metrics["falls_per_minute"])
    for cause, fallen in metrics["falls_by_cause"].items():
        yield _endurance_line(f"  {cause.replace('_', ' ')}, share", fallen["share"], fallen["share_interval"])


def _endurance_line(
    label: str, value: float | None, interval: Sequence[float | None] = (), still: float | None = None
) -> str:
    ends = f"[{', '.join(number(end, 8, 3).strip() for end in interval)}]" if interval else ""
    line = f"{label:40}{number(value, 10, 3)}{ends:>20}"
    return line if still is None else f"{line}{number(still, 14, 3)}"


def robustness_lines(metrics: dict[str, Any]) -> Iterator[str]:
    """Yield lines of a robustness evaluation: by parameter the smallest share up by range, and where it breaks."""
    from torchrl_atr.evaluation.conditions import REGIONS
    from torchrl_atr.evaluation.robustness import worst_rows

    up = metrics["baseline"]["survival"]
    yield f"{'up at the end, share':24}{'training':>10}{'test':>10}{'beyond':>10}  less than half of {up:.3f} from"
    for name, sweep in metrics["parameters"].items():
        worst = worst_rows(sweep)
        cells = [number(worst.get(region, {}).get("survival"), 10, 3) for region in REGIONS]
        ends = [
            f"{value:g} {sweep['unit']}".strip() if isinstance(value, float) else value for value in sweep["breaks_at"]
        ]
        yield f"{name.replace('_', ' '):24}{''.join(cells)}  {', '.join(ends) or '-'}"


def compatibility_lines(metrics: dict[str, Any]) -> Iterator[str]:
    """Yield lines of a compatibility evaluation: share up and errors on each pair."""
    yield f"{'':32}{'up, share':>10}{'95 % interval':>20}{'speed, m/s':>12}{'yaw, rad/s':>12}"
    for cell in metrics["cells"]:
        pair = f"{cell['robot']} on {cell['transporter']}"
        if "refused" in cell:
            yield f"{pair:32}  {cell['refused']}"
            continue
        ends = ", ".join(number(end, 8, 3).strip() for end in cell["survival_interval"])
        errors = "".join(number(cell[f"settled_{name}_error"], 12, 3) for name in ("speed", "yaw"))
        yield f"{pair:32}{number(cell['survival'], 10, 3)}{f'[{ends}]':>20}{errors}"


def estimator_lines(errors: dict[str, Any] | None) -> Iterator[str]:
    """Yield lines of Table V: the estimates' errors by component; none without estimates.

    Args:
        errors: ``estimator_errors`` of the metrics.
    """
    if errors is None:
        return
    yield f"{'estimation error, |estimate - truth|':40}{'mean':>10}{'std':>14}"
    rows = [] if errors["latent"] is None else [errors["latent"]]
    for row in [*rows, *errors["extrinsic"]]:
        yield f"{with_unit(row['label'], row['unit']):40}{number(row['mean'], 10, 3)} {number(row['std'], 13, 3)}"


def replay_head() -> str:
    """Return the head of ``replay``'s columns."""
    return "".join(f"{head:>{width}}" for head, width in _REPLAY)


def replay_line(step: ReplayedStep) -> str:
    """Return one step in ``replay``'s columns, which leave a space before large values."""
    values = (step.speed, step.yaw_rate, step.tilt, step.largest_velocity, step.largest_action)
    cells = [f" {number(value, width - 1, 3)}" for value, (_, width) in zip(values, _REPLAY[1:])]
    return f"{step.step:>{_REPLAY[0][1]}}{''.join(cells)}{'  failed' if step.diverged else ''}"
