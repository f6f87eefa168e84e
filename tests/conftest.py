"""Small networks that the tests of modules and objectives share, no size of which is the paper's; short evaluations."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Any

import pytest
import torch
from matplotlib.figure import Figure
from torchrl.data import Composite, Unbounded

from torchrl_atr import evaluation
from torchrl_atr.modules import ROANetworks, make_networks


@pytest.fixture
def spec() -> Composite:
    """A batched observation spec (5 robots) whose sizes are not the paper's."""
    return Composite(
        observation=Unbounded((5, 7)),
        history=Unbounded((5, 4, 7)),
        privileged=Composite(intrinsic=Unbounded((5, 6)), extrinsic=Unbounded((5, 3)), shape=(5,)),
        shape=(5,),
    )


@pytest.fixture
def networks(spec: Composite) -> ROANetworks:
    torch.manual_seed(0)
    nets = make_networks(spec, Unbounded((5, 2)), latent_features=4, actor_cells=(16,), critic_cells=(16,))
    nets.update_normalizers(spec.rand() * 3 + 1)
    return nets


@pytest.fixture
def undrawn(monkeypatch: pytest.MonkeyPatch) -> None:
    """Figures are made but not drawn, for tests of what is around them: drawing takes most of a short evaluation."""
    monkeypatch.setattr(Figure, "savefig", lambda self, file, **_: Path(file).touch())


@pytest.fixture
def traced(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let ``torch.compile`` trace, and run the trace eagerly: to generate and build C++ takes minutes."""
    compile_it = torch.compile

    def trace(function: Callable[..., Any], options: Mapping[str, Any]) -> Callable[..., Any]:
        return compile_it(function, backend="eager", options={"guard_filter_fn": options["guard_filter_fn"]})

    monkeypatch.setattr(torch, "compile", trace)


@pytest.fixture
def short_trials(monkeypatch: pytest.MonkeyPatch) -> None:
    """Trials of ``torchrl-atr evaluate`` last a second, not ten."""
    monkeypatch.setattr(evaluation, "evaluate_tracking", partial(evaluation.evaluate_tracking, seconds=1.0, settle=0.5))
