"""What a run shows while it learns: a live table, ``progress.csv``, and TensorBoard or a logger of TorchRL."""

from __future__ import annotations

import csv
import sys
import time
from collections import deque
from pathlib import Path
from statistics import fmean
from typing import TYPE_CHECKING, Any, NamedTuple

from torchrl_atr._errors import InputError
from torchrl_atr._files import atomic, naming, say
from torchrl_atr._text import number
from torchrl_atr.training.config import TrainConfig

if TYPE_CHECKING:
    from torchrl.record.loggers import Logger


class _Shown(NamedTuple):
    """A metric: its label and format in the live table; head, unit and width of its column elsewhere, 0 for none."""

    name: str
    label: str
    style: str
    head: str
    unit: str
    width: int

    def cell(self, metrics: dict[str, float]) -> str:
        """Its column's text, at least one space before it."""
        value = metrics.get(self.name)
        text = "-" if value is None else self.style.format(value)
        return text.rjust(self.width) if len(text) < self.width else " " + number(value, self.width - 1, 0)


_SHOWN = (
    _Shown("frames", "robot steps", "{:,.0f}", "robot", "steps", 12),
    _Shown("frames_per_second", "per second", "{:,.0f}", "rate", "steps/s", 8),
    _Shown("episode_length", "episode length, steps", "{:.0f}", "length", "steps", 7),
    _Shown("falls_per_minute", "falls per robot and minute", "{:.2f}", "falls", "/min", 7),
    _Shown("speed_error", "speed error, m/s", "{:.3f}", "v err", "m/s", 7),
    _Shown("yaw_error", "yaw error, rad/s", "{:.3f}", "w err", "rad/s", 7),
    _Shown("student_speed_error", "... acting on estimates", "{:.3f}", "est v", "m/s", 7),
    _Shown("yaw_gain", "yaw gain", "{:.2f}", "yaw", "gain", 6),
    _Shown("command_area", "command area", "{:.4f}", "area", "share", 7),
    _Shown("latent_error", "latent error", "{:.3f}", "latent", "error", 7),
    _Shown("extrinsic_error", "extrinsic error, std", "{:.3f}", "extrin", "error", 7),
    _Shown("std", "action std", "{:.3f}", "act", "std", 6),
    _Shown("chatter", "action chatter", "{:.3f}", "action", "rms", 7),
    _Shown("kl_approx", "KL", "{:.4f}", "KL", "", 8),
    _Shown("diverged", "diverged simulations", "{:.0f}", "", "", 0),  # each is logged when it happens
    _Shown("skipped_steps", "skipped steps", "{:.0f}", "skip", "steps", 6),
)
_COLUMNS = tuple(shown for shown in _SHOWN if shown.width)
_LEFT = 10
"""Width of the time that is left; with it, a line has 119 characters."""
_PAGE = 20
"""Lines between two heads."""
_HEAD = "\n".join(
    "".join(text.rjust(width) for text, width in row)
    for row in (
        [*((each.head, each.width) for each in _COLUMNS), ("left", _LEFT)],
        [*((each.unit, each.width) for each in _COLUMNS), ("h:min:s", _LEFT)],
    )
)
_MOVING = {"falls_per_minute": 50}
"""Iterations over whose mean a metric is shown that is rare in each; logs hold every iteration's own."""
_LINE_SECONDS = 15.0
"""Seconds between lines where there is no terminal to redraw."""


class Progress:
    """Logs metrics of every iteration; a context manager around the training loop.

    Args:
        run: the run folder.
        config: for time and frames left.
        logger: of TorchRL, which gets every iteration's metrics by robot steps; None for TensorBoard in the run folder.
        title: of the live table, before the folder.
        resume_from: frames of the checkpoint that the run goes on from; later rows of its log are dropped. None for a
            new run.
    """

    def __init__(
        self,
        run: Path,
        config: TrainConfig,
        resume_from: int | None = None,
        logger: Logger | None = None,
        title: str = "",
    ) -> None:
        self.run, self.config, self.logger, self.title = run, config, logger, title
        self._csv_path = run / "progress.csv"
        self._fields: list[str] = []
        self._purge_step = None if resume_from is None else resume_from + 1
        if resume_from is None:
            self._csv_path.unlink(missing_ok=True)
        elif self._csv_path.is_file():
            self._fields = self._keep_rows(resume_from)
        self._shown: dict[str, float] = {}
        self._recent = {name: deque[float](maxlen=iterations) for name, iterations in _MOVING.items()}
        self._last_line = 0.0
        self._lines = 0
        self._live: Any = None
        self._writer: Any = None

    def __enter__(self) -> Progress:
        if self.logger is None:
            self._writer = self._make_writer()
        else:
            self.logger.log_hparams(self.config.to_dict())
        if sys.stdout.isatty():
            from rich.live import Live

            self._live = Live(refresh_per_second=2)
            self._live.__enter__()
        return self

    def __exit__(self, *exception: Any) -> None:
        if self._live is not None:
            self._live.__exit__(*exception)
        if self._writer is not None:
            self._writer.close()

    def update(self, metrics: dict[str, float]) -> None:
        """Shows and stores one iteration."""
        self._shown.update(metrics)
        self._append(self._shown)
        for name, recent in self._recent.items():
            if name in metrics:
                recent.append(metrics[name])
                self._shown[name] = fmean(recent)
        tagged = {name if "/" in name else f"train/{name}": value for name, value in metrics.items()}
        if self.logger is not None:
            self.logger.log_metrics(tagged, step=int(metrics["frames"]))
        elif self._writer is not None:
            for tag, value in tagged.items():
                self._writer.add_scalar(tag, value, int(metrics["frames"]))
        if self._live is not None:
            self._live.update(self._table())
        elif time.monotonic() - self._last_line > _LINE_SECONDS:
            self._last_line = time.monotonic()
            say(self._line() if self._lines % _PAGE else f"{_HEAD}\n{self._line()}")
            self._lines += 1

    def _make_writer(self) -> Any:
        """TensorBoard's; None where it cannot write: it knows no names of files that are no text in this locale."""
        folder = str(self.run / "tensorboard")
        try:
            folder.encode()
        except UnicodeEncodeError:
            say("no TensorBoard log: this locale cannot spell the run folder; progress.csv holds the same")
            return None
        from torch.utils.tensorboard import SummaryWriter  # heavy: only where a run starts

        return SummaryWriter(folder, purge_step=self._purge_step)

    def _keep_rows(self, frames: int) -> list[str]:
        """Drops the rows of iterations that the checkpoint has not seen; returns the columns."""
        with self._csv_path.open(newline="", encoding="utf-8") as file:
            reader = csv.DictReader(file)
            columns = list(reader.fieldnames or [])
            if columns and "frames" not in columns:
                raise InputError(f"{self._csv_path} is not the log of a run: it has no column 'frames'; move it away")
            whole = (row for row in reader if None not in row.values())  # a kill may have cut the last one
            rows = [row for row in whole if float(row["frames"]) <= frames]
        with atomic(self._csv_path) as path, path.open("w", newline="", encoding="utf-8") as file:
            writer = csv.DictWriter(file, columns)
            writer.writeheader()
            writer.writerows(rows)
        return columns

    def _append(self, metrics: dict[str, float]) -> None:
        fresh = not self._fields
        if fresh:
            # a metric that the first batch lacks (no episode had ended) still gets its column
            self._fields = list(dict.fromkeys([*metrics, "episode_length", "episode_reward"]))
        with naming(self._csv_path), self._csv_path.open("a", newline="", encoding="utf-8") as file:
            writer = csv.DictWriter(file, self._fields, extrasaction="ignore", restval="")
            if fresh:
                writer.writeheader()
            writer.writerow({k: f"{v:.6g}" if isinstance(v, float) else v for k, v in metrics.items()})

    def _left(self) -> str:
        seconds, frames = self._shown["minutes"] * 60, self._shown["frames"]
        by_frames = (self.config.total_frames - frames) * seconds / frames
        by_time = 60 * self.config.max_minutes - seconds if self.config.max_minutes else float("inf")
        left = max(0, int(min(by_frames, by_time)))
        return f"{left // 3600}:{left // 60 % 60:02d}:{left % 60:02d}"

    def _rows(self) -> list[tuple[str, str]]:
        rows = [(each.label, each.style.format(self._shown[each.name])) for each in _SHOWN if each.name in self._shown]
        return [*rows, ("time left", self._left())]

    def _line(self) -> str:
        return "".join(shown.cell(self._shown) for shown in _COLUMNS) + f" {self._left()}".rjust(_LEFT)

    def _table(self) -> Any:
        from rich.table import Table

        table = Table(title=f"{self.title}: {self.run}", show_header=False)
        for label, value in self._rows():
            table.add_row(label, value)
        return table
