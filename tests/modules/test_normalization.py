from __future__ import annotations

import pytest
import torch
from tensordict import TensorDict

from torchrl_atr.modules import RunningNormalizer


def test_statistics_of_batches_are_those_of_all_samples():
    data = torch.randn(1000, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(0)) * 7 + 100
    norm = RunningNormalizer(3)
    for batch in data.float().split([1, 399, 100, 500]):
        norm.update(batch.reshape(-1, 1, 3))
    assert norm.count.item() == 1000
    assert norm.count.dtype == torch.float64
    torch.testing.assert_close(norm.mean, data.mean(0).float(), rtol=1e-5, atol=1e-5)
    torch.testing.assert_close(norm.var, data.var(0, correction=0).float(), rtol=1e-4, atol=1e-4)


def test_hand_computed_values_and_clip():
    norm = RunningNormalizer(2, clip=3.0, eps=1e-12)
    norm.update(torch.tensor([[0.0, 1.0], [4.0, 3.0]]))  # means 2 and 2, variances 4 and 1
    x = torch.tensor([[4.0, 1.0], [100.0, -100.0]])
    torch.testing.assert_close(norm(x), torch.tensor([[1.0, -1.0], [3.0, -3.0]]))


def test_fresh_normaliser_is_the_identity_up_to_eps():
    x = torch.randn(4, 3)
    torch.testing.assert_close(RunningNormalizer(3, eps=1e-12)(x), x)


def test_inverse_undoes_forward():
    norm = RunningNormalizer(5)
    norm.update(torch.randn(50, 5) * 3 + 2)
    x = torch.randn(2, 4, 5)
    torch.testing.assert_close(norm.inverse(norm(x)), x)


def test_forward_never_updates_and_updates_carry_no_gradient():
    norm = RunningNormalizer(3)
    before = {key: value.clone() for key, value in norm.state_dict().items()}
    norm.train()(torch.randn(8, 3))
    assert all(torch.equal(value, before[key]) for key, value in norm.state_dict().items())
    norm.update(torch.randn(8, 3, requires_grad=True))
    assert not norm.mean.requires_grad
    assert not list(norm.parameters())


def test_non_finite_samples_are_ignored():
    clean, dirty = RunningNormalizer(2), RunningNormalizer(2)
    rows = torch.randn(6, 2)
    clean.update(rows)
    dirty.update(torch.cat([rows, torch.tensor([[float("nan"), 1.0], [1.0, float("inf")]])]))
    dirty.update(torch.full((3, 2), float("nan")))
    assert all(torch.equal(a, b) for a, b in zip(clean.state_dict().values(), dirty.state_dict().values()))


def test_a_constant_component_stays_finite():
    norm = RunningNormalizer(1)
    norm.update(torch.full((10, 1), 4.0))
    assert norm(torch.tensor([4.0])).item() == 0.0
    assert norm(torch.tensor([5.0])).item() == 10.0


def test_updates_reach_functional_copies_of_the_buffers():
    norm = RunningNormalizer(2)
    params = TensorDict.from_module(norm, as_module=True)
    norm.update(torch.randn(9, 2))
    assert torch.equal(params["mean"], norm.mean)
    assert torch.equal(params["count"], norm.count)


def test_state_dict_round_trip():
    norm, other = RunningNormalizer(3), RunningNormalizer(3)
    norm.update(torch.randn(20, 3))
    other.load_state_dict(norm.state_dict())
    x = torch.randn(4, 3)
    assert torch.equal(norm(x), other(x))


def test_bad_input():
    with pytest.raises(ValueError, match=r"\(\*, 3\).*\(4, 2\)"):
        RunningNormalizer(3)(torch.zeros(4, 2))
    with pytest.raises(ValueError, match="clip"):
        RunningNormalizer(3, clip=0.0)
