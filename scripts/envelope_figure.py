"""Draw the figure of docs/task.md: ``python scripts/envelope_figure.py``, from the root of a clone."""

from __future__ import annotations

from pathlib import Path

from torchrl_atr.envs.tasks import riding
from torchrl_atr.evaluation import Envelope
from torchrl_atr.evaluation.envelope_figure import plot_envelope

if __name__ == "__main__":
    envelope = Envelope.of(riding("a1", "single_board"))
    assert envelope is not None
    print(plot_envelope(envelope, Path(__file__).parents[1] / "docs" / "envelope.png"))
