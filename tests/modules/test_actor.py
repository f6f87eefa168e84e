"""The actor beyond Table I: input_products of observations as inputs, and a map of its outputs."""

from __future__ import annotations

import pytest
import torch

from torchrl_atr.modules import ActorBackbone, RunningNormalizer
from torchrl_atr.modules.actor import INPUT_GAIN


def backbone(input_products: list[tuple[int, int]] = (), **options) -> ActorBackbone:
    torch.manual_seed(0)
    return ActorBackbone(
        RunningNormalizer(3), RunningNormalizer(1), 1, 2, cells=(), input_products=input_products, **options
    )


def test_a_product_is_one_more_input_with_the_sign_of_both():
    """Without hidden layers the mean is linear in its inputs: the product's column is what is not odd."""
    actor = backbone([(1, 2)])
    (layer,) = [module for module in actor.net if isinstance(module, torch.nn.Linear)]
    assert layer.in_features == 3 + 1 + 1 + 1
    x = torch.tensor([[0.0, 0.5, -2.0]])
    rest = torch.zeros(1, 1)
    mean = actor(x, rest, rest) + actor(-x, rest, rest) - 2 * actor(0 * x, rest, rest)
    gated = INPUT_GAIN * torch.tanh(torch.tensor(0.5)) * -2.0
    expected = 2 * layer.weight[:, 3] * gated
    torch.testing.assert_close(mean[0], expected, rtol=1e-4, atol=1e-6)


@pytest.mark.parametrize("pair", [(0, 3), (-1, 0)])
def test_products_beyond_the_observation_are_refused(pair):
    with pytest.raises(ValueError, match=r"input_products=.* names entries beyond the 3 and 3"):
        backbone([pair])


def test_an_error_is_one_more_input_in_si_units():
    """Without hidden layers the mean is linear in its inputs: an error alone changes with where both numbers are."""
    actor = backbone(input_errors=[(2, 0)])
    (layer,) = [module for module in actor.net if isinstance(module, torch.nn.Linear)]
    assert layer.in_features == 3 + 1 + 1 + 1
    actor.observation_norm.mean.fill_(7.0)  # which moves the normalised observation, not the error
    rest = torch.zeros(1, 1)

    def mean_at(command: float, speed: float) -> torch.Tensor:
        return actor(torch.tensor([[7.0, 7.0, command]]), rest, torch.tensor([[speed]]))[0]

    far, at = mean_at(7.0, 7.3), mean_at(7.0, 7.0)
    expected = layer.weight[:, 3] * INPUT_GAIN * torch.tanh(torch.tensor(0.6)) + layer.weight[:, 5] * 0.3
    torch.testing.assert_close(far - at, expected, rtol=1e-3, atol=1e-5)


@pytest.mark.parametrize("pair", [(3, 0), (0, 1), (-1, 0)])
def test_errors_beyond_observation_and_state_are_refused(pair):
    with pytest.raises(ValueError, match=r"input_errors=.* names entries beyond the 3 and 1"):
        backbone(input_errors=[pair])


def test_a_product_may_be_of_an_error():
    actor = backbone([(0, 3)], input_errors=[(2, 0)])
    (layer,) = [module for module in actor.net if isinstance(module, torch.nn.Linear)]
    rest, speed = torch.zeros(1, 1), torch.tensor([[0.5]])
    x = torch.tensor([[0.5, 0.0, 0.0]])
    both = actor(x, rest, speed) - actor(x, rest, rest) - actor(0 * x, rest, speed) + actor(0 * x, rest, rest)
    gated = INPUT_GAIN * torch.tanh(torch.tensor(0.5)) * torch.tanh(torch.tensor(1.0))
    torch.testing.assert_close(both[0], layer.weight[:, 4] * gated, rtol=1e-4, atol=1e-6)


def test_an_output_moves_the_mean_along_its_row_of_the_map():
    rows = torch.tensor([[2.0, 0.0], [0.3, -0.1]])
    x, rest = torch.randn(4, 3), torch.randn(4, 1)
    plain, mapped = (actor(x, rest, rest) for actor in (backbone(), backbone(output_map=rows)))
    torch.testing.assert_close(mapped, plain[:, :1] * rows[0] + plain[:, 1:] * rows[1])


def test_a_map_is_saved_with_the_weights_and_the_identity_is_nothing():
    assert "output_map" in backbone(output_map=torch.eye(2)).state_dict()
    assert "output_map" not in backbone().state_dict()


@pytest.mark.parametrize("output_map", [torch.eye(3), torch.ones(2, 2), torch.zeros(2, 2)])
def test_a_map_without_an_inverse_is_refused(output_map):
    with pytest.raises(ValueError, match=r"output_map must be an invertible matrix, \(2, 2\)"):
        backbone(output_map=output_map)


@pytest.mark.parametrize(
    ("reads", "shapes"),
    [
        ((), []),
        (("latent",), [(4,)]),
        (("extrinsic",), [(2,)]),
        (("history",), [(5, 3)]),
        (("extrinsic", "history", "latent"), [(5, 3), (4,), (2,)]),
    ],
)
def test_it_reads_what_it_is_told_to_and_the_mirrored_robot_acts_mirrored(reads, shapes):
    """Observation (command, sides), state and action change sign or sides; the latent's halves change places."""
    flip, sides = torch.diag(torch.tensor([1.0, -1.0, -1.0])), torch.tensor([[0.0, -1.0], [-1.0, 0.0]])
    torch.manual_seed(0)
    actor = ActorBackbone(
        RunningNormalizer(3, reflection=flip),
        RunningNormalizer(2, reflection=-torch.eye(2)) if "extrinsic" in reads else None,
        4 if "latent" in reads else 0,
        2,
        cells=(8,),
        reflection=sides,
        history_length=5 if "history" in reads else 0,
    )
    mirrors = {"history": lambda x: x @ flip, "latent": lambda x: x.roll(2, -1), "extrinsic": lambda x: -x}
    assert actor.reads == tuple(name for name in mirrors if name in reads)  # in this order, whatever is given
    observation, *read = (torch.randn(7, *shape) for shape in [(3,), *shapes])
    mean = actor(observation, *read)
    mirrored = [mirrors[name](value) for name, value in zip(actor.reads, read, strict=True)]
    torch.testing.assert_close(actor(observation @ flip, *mirrored), mean @ sides)
    for i in range(len(read)):
        changed = [value + (i == j) for j, value in enumerate(read)]
        assert not torch.allclose(actor(observation, *changed), mean)
