"""Schedules of loss coefficients over the progress of a run."""

from __future__ import annotations

from typing import Any

from torchrl.objectives import LossModule


class LinearSchedule:
    """Ramp one schedulable coefficient of a loss linearly over the progress of a run (reading A23).

    The paper keeps lambda constant; its ancestors ramp it from 0 to 0.1, which is ``LinearSchedule(loss)``.

    Args:
        loss (LossModule): the loss; the coefficient is set at once to ``start``.
        name (str): one of the loss's schedulable buffers. Defaults to ``"roa_coeff"``.
        start, end (float): values before and after the ramp. Default to 0 and 0.1.
        begin, until (float): progress at which the ramp begins and ends. Default to 0 and 1.

    Raises:
        ValueError: if the loss has no such coefficient, or not ``0 <= begin < until <= 1``.

    Examples:
        >>> schedule = LinearSchedule(loss, "roa_coeff", 0.0, 0.1)  # doctest: +SKIP
        >>> schedule.step(0.5), loss.roa_coeff  # doctest: +SKIP
        (0.05, tensor(0.0500))
    """

    def __init__(
        self,
        loss: LossModule,
        name: str = "roa_coeff",
        start: float = 0.0,
        end: float = 0.1,
        begin: float = 0.0,
        until: float = 1.0,
    ) -> None:
        buffers = dict(loss.named_buffers(recurse=False))
        allowed = sorted(key for key in type(loss)._all_schedulable_buffers if key in buffers)
        if name not in allowed:
            raise ValueError(f"{type(loss).__name__} has no coefficient {name!r}. Allowed: {', '.join(allowed)}.")
        if not 0.0 <= begin < until <= 1.0:
            raise ValueError(f"Need 0 <= begin < until <= 1, got begin={begin}, until={until}.")
        self.loss, self.name = loss, name
        self.start, self.end = float(start), float(end)
        self.begin, self.until = float(begin), float(until)
        self.step(0.0)

    def value(self, progress: float) -> float:
        """Return the coefficient at a progress in [0, 1]."""
        fraction = min(max((progress - self.begin) / (self.until - self.begin), 0.0), 1.0)
        return self.start + fraction * (self.end - self.start)

    def step(self, progress: float) -> float:
        """Set the coefficient for a progress in [0, 1] (frames so far / total frames) and return it."""
        self.progress = float(progress)
        value = self.value(self.progress)
        setattr(self.loss, self.name, value)
        return value

    def state_dict(self) -> dict[str, Any]:
        """Return the progress; the ramp itself is configuration."""
        return {"progress": self.progress}

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        """Restore the progress and set the coefficient that belongs to it."""
        self.step(state_dict["progress"])
