"""An estimator alone, made from recorded data."""

from __future__ import annotations

import pytest
import torch
from tensordict import TensorDict

from torchrl_atr.modules import make_estimator
from torchrl_atr.objectives import regression


@pytest.fixture
def data():
    """Histories whose newest frame, times two, is the target; and the wind."""
    torch.manual_seed(0)
    history = 3 * torch.randn(400, 4, 2) + 1
    return TensorDict(history=history, wind=torch.randn(400, 1), mass=2 * history[:, -1], batch_size=[400])


def test_its_normalisers_are_fitted_to_the_data(data):
    estimator = make_estimator(data, "mlp", target="mass", inputs=["wind"])
    torch.testing.assert_close(estimator.output_norm.mean, data["mass"].mean(0))
    torch.testing.assert_close(estimator.input_norm.mean, data["history"].flatten(0, 1).mean(0))
    torch.testing.assert_close(estimator.side_norms[0].mean, data["wind"].mean(0))
    assert sorted(estimator.in_keys) == ["history", "wind"]


@pytest.mark.parametrize("name", ["mlp", "gaussian"])
def test_it_learns_in_the_units_of_its_target(data, name):
    estimator = make_estimator(data, name, target="mass", **({"trunk": "mlp"} if name == "gaussian" else {}))
    (written,), (scale,) = estimator.spec.estimate_keys, estimator.spec.scale_keys
    optimizer = torch.optim.Adam(estimator.parameters(), 3e-3)
    for _ in range(150):
        out, own = estimator.estimate_and_losses(data)
        loss, *_ = regression(out[written], data["mass"], estimator.output_norm.std, out.get(scale, None))
        assert own == {}
        optimizer.zero_grad()
        loss.mean().backward()
        optimizer.step()
    error = (estimator(data.clone())[written] - data["mass"]).square().mean().sqrt()
    assert error < 0.2 * data["mass"].std()


def test_data_that_lack_an_entry_are_named(data):
    with pytest.raises(KeyError, match=r"the data lack 'mas'; did you mean 'mass'\?"):
        make_estimator(data, "mlp", target="mas")
    with pytest.raises(ValueError, match=r"'wind' of the data has shape \(400,\); 2 dimensions are needed"):
        make_estimator(data.set("wind", data["wind"][:, 0]), "mlp", target="mass", inputs=["wind"])
