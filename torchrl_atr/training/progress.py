"""Progress of a run: lines of the main metrics, ``progress.csv``, and a logger of TorchRL."""

from __future__ import annotations

import csv
import math
import time
from collections import deque
from contextlib import ExitStack
from pathlib import Path
from statistics import fmean
from typing import TYPE_CHECKING, Any, NamedTuple

from torchrl_atr._errors import InputError
from torchrl_atr._files import atomic, naming, say
from torchrl_atr._text import number
from torchrl_atr.config import TrainConfig
from torchrl_atr.runs.files import LOG
from torchrl_atr.training.loggers import make_logger

if TYPE_CHECKING:
    from torchrl.record.loggers import Logger


class _Column(NamedTuple):
    """Column of a line: the metric, its format, the two lines of its head, and its width."""

    name: str
    style: str
    head: str
    unit: str
    width: int

    def cell(self, metrics: dict[str, float]) -> str:
        """Return the column's text, at least one space before it."""
        value = metrics.get(self.name)
        text = "-" if value is None else self.style.format(value)
        return text.rjust(self.width) if len(text) < self.width else " " + number(value, self.width - 1, 0)


_COLUMNS = (
    _Column("frames", "{:,.0f}", "robot", "steps", 12),
    _Column("frames_per_second", "{:,.0f}", "rate", "steps/s", 8),
    _Column("falls_per_minute", "{:.2f}", "falls", "/min", 7),
    _Column("up_after_a_minute", "{:.0%}", "up at", "60 s", 7),
    _Column("speed_error", "{:.3f}", "v err", "m/s", 7),
    _Column("yaw_error", "{:.3f}", "w err", "rad/s", 7),
    _Column("student_speed_error", "{:.3f}", "est v", "m/s", 7),
    _Column("yaw_gain", "{:.2f}", "yaw", "gain", 6),
    _Column("command_area", "{:.4f}", "area", "share", 7),
    _Column("latent_error", "{:.3f}", "latent", "error", 7),
    _Column("extrinsic_error", "{:.3f}", "extrin", "error", 7),
    _Column("std", "{:.3f}", "act", "std", 6),
    _Column("action_rate_rms", "{:.3f}", "action", "rms", 7),
    _Column("kl_divergence", "{:.4f}", "KL", "", 8),
    _Column("skipped_steps", "{:.0f}", "skip", "steps", 6),
)
_LEFT = 10
"""Width of the column of the time left; with it, a line has 119 characters."""
_PAGE = 20
"""Lines between two heads."""
_HEAD = "\n".join(
    "".join(getattr(each, row).rjust(each.width) for each in _COLUMNS) + left.rjust(_LEFT)
    for row, left in (("head", "left"), ("unit", "h:min:s"))
)
_RARE = 50
"""Iterations over which falls, rare events, are averaged for display; logs hold every iteration's value."""
_LINE_SECONDS = 15.0
"""Seconds between lines."""


class Progress:
    """Log of the metrics of every iteration; a context manager around the training loop.

    ``progress.csv``, one row per iteration, is written whatever the logger: TorchRL's ``CSVLogger`` has a file without
    header for each metric, to which a resumed run would append the iterations since its checkpoint once more.

    Args:
        run: the run folder.
        config: of the run.
        resume_from: frames of the checkpoint that it continues from; later rows of its log are dropped.
        logger: of TorchRL, which gets every iteration's metrics by robot steps and stays open; None for the one that
            ``config.logging.logger`` names.
        title: of the run, for the logger.
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
        self._csv_path, self._resume_from = run / LOG, resume_from
        self._fields: list[str] = []
        if resume_from is None:
            self._csv_path.unlink(missing_ok=True)
        elif self._csv_path.is_file():
            self._fields = self._keep_rows(resume_from)
        self._shown: dict[str, float] = {}
        self._falls = deque[float](maxlen=_RARE)
        self._last_line, self._lines = 0.0, 0
        self._open = ExitStack()
        self._logger: Logger | None = None

    def __enter__(self) -> Progress:
        self._logger = self.logger or self._make_logger()
        if self._logger is not None and (self.logger is not None or self.config.logging.logger != "tensorboard"):
            self._logger.log_hparams(self.config.to_dict())  # TensorBoard takes no lists; config.toml has them all
        return self

    def __exit__(self, *exception: Any) -> None:
        self._open.__exit__(*exception)

    def update(self, metrics: dict[str, float]) -> None:
        """Show and store one iteration."""
        self._shown.update(metrics)
        self._append(metrics)
        if "falls_per_minute" in metrics:
            self._falls.append(metrics["falls_per_minute"])
            self._shown["falls_per_minute"] = fmean(self._falls)
            self._shown["up_after_a_minute"] = math.exp(-self._shown["falls_per_minute"])  # at a constant rate of falls
        if self._logger is not None:
            tagged = {name if "/" in name else f"train/{name}": value for name, value in metrics.items()}
            self._logger.log_metrics(tagged, step=int(metrics["frames"]))
        if time.monotonic() - self._last_line > _LINE_SECONDS:
            self._last_line = time.monotonic()
            say(self._line() if self._lines % _PAGE else f"{_HEAD}\n{self._line()}")
            self._lines += 1

    def _make_logger(self) -> Logger | None:
        """Return the logger that the configuration names; None where it cannot write."""
        name = self.config.logging.logger
        try:
            str(self.run).encode()
        except UnicodeEncodeError:
            say(f"no log for {name}: this locale cannot spell the folder; progress.csv holds the same")
            return None
        logger = make_logger(name, self.run, self.title or self.run.name, self._resume_from)
        if logger is not None:
            self._open.enter_context(logger.experiment)  # a SummaryWriter, or a run of W&B or MLflow
        return logger

    def _keep_rows(self, frames: int) -> list[str]:
        """Drop the rows of iterations after the checkpoint; return the columns."""
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

    def _line(self) -> str:
        return "".join(shown.cell(self._shown) for shown in _COLUMNS) + f" {self._left()}".rjust(_LEFT)
