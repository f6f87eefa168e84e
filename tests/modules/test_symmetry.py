"""Networks that treat a robot and its mirror image alike."""

from __future__ import annotations

import pytest
import torch
from tensordict import TensorDict
from torchrl.data import Composite, Unbounded

from torchrl_atr.modules import (
    ActorBackbone,
    EquivariantLinear,
    Exploration,
    IntrinsicEncoder,
    NetworkKeys,
    RunningNormalizer,
    equivariant_mlp,
    hadamard_leg_basis,
    make_networks,
)
from torchrl_atr.modules.symmetry import check_reflection, halves_swapped

SIZES = {"observation": 5, ("privileged", "intrinsic"): 6, ("privileged", "extrinsic"): 3, "action": 12}


def reflection_of(size: int) -> torch.Tensor:
    """Swaps the first two, turns the third round, leaves the rest."""
    matrix = torch.eye(size)
    matrix[[0, 1]] = matrix[[1, 0]]
    matrix[2, 2] = -1.0
    return matrix


MIRROR = {key: reflection_of(size) for key, size in SIZES.items()} | {
    "action": torch.kron(torch.eye(4).roll(2, 0), torch.diag(torch.tensor([-1.0, 1.0, 1.0])))
}
SPEC = Composite(
    observation=Unbounded((5,)),
    history=Unbounded((4, 5)),
    privileged=Composite(intrinsic=Unbounded((6,)), extrinsic=Unbounded((3,))),
)


def networks(**options):
    torch.manual_seed(0)
    options = {
        "exploration": Exploration(12, basis=hadamard_leg_basis()),
        "output_map": hadamard_leg_basis().T,
        **options,
    }
    inputs = {"input_products": [(3, 4), (3, 5)], "input_errors": [(2, 2)]}
    nets = make_networks(SPEC, Unbounded((12,)), **inputs, reflections=MIRROR, **options)
    data = SPEC.expand(64).rand()
    data["observation"] += torch.tensor([3.0, 0.0, 1.0, 0.0, -1.0])  # no symmetric statistics of their own
    nets.update_normalizers(data)
    return nets, data


def mirrored(data: TensorDict) -> TensorDict:
    out = data.clone()
    for key in ("observation", ("privileged", "intrinsic"), ("privileged", "extrinsic")):
        out[key] = data[key] @ MIRROR[key].T
    return out


@pytest.mark.parametrize(
    ("inputs", "outputs"),
    [
        (reflection_of(5), halves_swapped(8)),
        (halves_swapped(8), reflection_of(5)),
        (reflection_of(5), reflection_of(4)),
        (halves_swapped(4), torch.eye(3)),
        (torch.eye(3), -torch.eye(2)),
    ],
    ids=["to hidden units", "from hidden units", "between entries", "to what is kept", "to what is negated"],
)
def test_a_layer_commutes_with_reflections(inputs, outputs):
    torch.manual_seed(0)
    layer, x = EquivariantLinear(inputs, outputs), torch.randn(7, len(inputs))
    assert layer(x).shape == (7, len(outputs))
    torch.testing.assert_close(layer(x @ inputs.T), layer(x) @ outputs.T)


def test_a_layer_is_any_that_commutes_and_treats_sides_apart():
    torch.manual_seed(0)
    inputs, outputs = reflection_of(5), halves_swapped(8)
    layer, x = EquivariantLinear(inputs, outputs), torch.randn(200, 5)
    assert not torch.allclose(layer(x), layer(x) @ outputs.T, atol=0.1)
    free, bias = torch.randn(8, 5), torch.randn(8)
    wanted = x @ (free + outputs @ free @ inputs).T + bias + outputs @ bias
    optimizer = torch.optim.LBFGS(layer.parameters(), max_iter=100, line_search_fn="strong_wolfe")

    def loss():
        optimizer.zero_grad()
        value = (layer(x) - wanted).square().mean()
        value.backward()
        return value

    optimizer.step(loss)
    assert loss() < 1e-6


def test_a_layer_holds_half_of_a_plain_ones_weights():
    layer = EquivariantLinear(halves_swapped(64), halves_swapped(32))
    assert sum(parameter.numel() for parameter in layer.parameters()) == 64 * 32 // 2 + 16


def test_a_layer_between_hidden_units_starts_with_a_bias_as_large_as_a_plain_ones():
    """Uniform up to 1 / sqrt(64) for 64 inputs."""
    torch.manual_seed(0)
    bias = EquivariantLinear(halves_swapped(64), halves_swapped(1024))(torch.zeros(64)).abs()
    assert 0.98 / 8 < bias.max() <= 1 / 8 + 1e-6
    assert bias.mean().item() == pytest.approx(0.5 / 8, rel=0.1)


def test_an_mlp_starts_with_outputs_as_large_as_a_plain_one():
    torch.manual_seed(0)
    x, swapped = torch.randn(512, 64), halves_swapped(64)
    ours = torch.stack([equivariant_mlp(swapped, swapped, [128])(x).std() for _ in range(20)]).mean()
    plain = torch.nn.Sequential
    layers = lambda: plain(torch.nn.Linear(64, 128), torch.nn.ELU(), torch.nn.Linear(128, 64))  # noqa: E731
    theirs = torch.stack([layers()(x).std() for _ in range(20)]).mean()
    assert (ours / theirs - 1).abs() < 0.05


def test_the_mirrored_robot_acts_mirrored_and_is_worth_the_same():
    nets, data = networks()
    actor, critic = nets.training_actor("privileged"), nets.critic_module
    means = [actor.get_dist(part).mean for part in (data, mirrored(data))]
    torch.testing.assert_close(means[1], means[0] @ MIRROR["action"].T, atol=1e-5, rtol=1e-4)
    values = [critic(part)["state_value"] for part in (data.clone(), mirrored(data))]
    torch.testing.assert_close(values[1], values[0], atol=1e-4, rtol=1e-4)
    assert means[0].std() > 0.005
    assert values[0].std() > 0.1


@pytest.mark.parametrize(
    "output_map",
    [
        None,
        torch.logspace(-8, 1, 12).unsqueeze(-1) * hadamard_leg_basis().T,
        torch.diag(torch.tensor([1.0, 2.0, 3.0]).repeat(4)),
    ],
    ids=["identity", "gains of all sizes", "alike in both sides' legs"],
)
def test_the_mean_is_mirrored_whatever_the_output_map(output_map):
    nets, data = networks(output_map=output_map)
    actor = nets.training_actor("privileged")
    means = [actor.get_dist(part).mean for part in (data, mirrored(data))]
    torch.testing.assert_close(means[1], means[0] @ MIRROR["action"].T, atol=1e-5, rtol=1e-4)


def test_an_output_map_that_treats_sides_apart_is_refused():
    with pytest.raises(ValueError, match="its own inverse"):
        networks(output_map=torch.diag(torch.arange(1.0, 13.0)))


def test_log_probabilities_are_those_of_the_mirror_image():
    nets, data = networks(exploration=Exploration(12, [0.3] * 3 + [0.1] * 9, basis=hadamard_leg_basis()))
    actor = nets.training_actor("privileged")
    action = torch.randn(64, 12) * 0.2
    here = actor.get_dist(data).log_prob(action)
    there = actor.get_dist(mirrored(data)).log_prob(action @ MIRROR["action"].T)
    torch.testing.assert_close(here, there, atol=1e-3, rtol=1e-4)


def test_it_stays_symmetric_under_training():
    nets, data = networks()
    actor = nets.training_actor("privileged")
    optimizer = torch.optim.Adam(nets.policy_parameters(), lr=1e-2)
    for _ in range(5):
        loss = (actor.get_dist(data).mean - 1.0).square().mean()
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
    means = [actor.get_dist(part).mean for part in (data, mirrored(data))]
    torch.testing.assert_close(means[1], means[0] @ MIRROR["action"].T, atol=1e-4, rtol=1e-3)


def test_statistics_are_those_of_both_sides():
    x = torch.randn(100, 5) * 3 + 1
    norm, both = RunningNormalizer(5, reflection=reflection_of(5)), RunningNormalizer(5)
    norm.update(x)
    both.update(torch.cat([x, x @ reflection_of(5).T]))
    torch.testing.assert_close(norm.mean, both.mean, atol=1e-5, rtol=1e-5)
    torch.testing.assert_close(norm.var, both.var, atol=1e-4, rtol=1e-4)


def test_without_reflections_networks_are_plain():
    nets = make_networks(SPEC, Unbounded((12,)))
    assert not any(isinstance(module, EquivariantLinear) for module in nets.modules())


@pytest.mark.parametrize(
    "matrix",
    [
        torch.eye(3),
        torch.ones(2, 2),
        0.5 * torch.eye(2),
        torch.tensor([[0.0, 1.0], [-1.0, 0.0]]),
        torch.tensor([[1.0, 1.0], [0.0, -1.0]]),
    ],
    ids=["size", "no permutation", "no sign", "not its own inverse", "a shear"],
)
def test_what_is_no_reflection_is_refused(matrix):
    with pytest.raises(ValueError, match="its own inverse"):
        check_reflection(matrix, 2)


def test_missing_reflections_are_named():
    with pytest.raises(KeyError, match="reflections lack 'action'"):
        make_networks(SPEC, Unbounded((12,)), reflections={k: v for k, v in MIRROR.items() if k != "action"})
    norm, plain = RunningNormalizer(5, reflection=reflection_of(5)), RunningNormalizer(3)
    with pytest.raises(ValueError, match="reflection of every input"):
        ActorBackbone(norm, plain, 4, 12, reflection=MIRROR["action"])


@pytest.mark.parametrize("pair", [(0, 3), (3, 1)])
def test_a_product_of_what_changes_places_is_refused(pair):
    norm = RunningNormalizer(5, reflection=reflection_of(5))
    with pytest.raises(ValueError, match="its own inverse"):
        ActorBackbone(
            norm,
            RunningNormalizer(3, reflection=torch.eye(3)),
            4,
            12,
            input_products=[pair],
            reflection=MIRROR["action"],
        )


def test_an_error_between_unlike_mirror_images_is_refused():
    with pytest.raises(ValueError, match="input_errors pair entries of unlike mirror images"):
        make_networks(SPEC, Unbounded((12,)), input_errors=[(3, 2)], reflections=MIRROR)


def test_odd_widths_are_refused():
    with pytest.raises(ValueError, match="even number of units, got 15"):
        IntrinsicEncoder(6, 15, reflection=torch.eye(6))


def test_keys_of_another_env():
    keys = NetworkKeys(observation="obs", action="act_")
    spec = Composite(obs=SPEC["observation"], history=SPEC["history"], privileged=SPEC["privileged"])
    mirror = {"obs": MIRROR["observation"], "act_": MIRROR["action"]} | {
        key: MIRROR[key] for key in (("privileged", "intrinsic"), ("privileged", "extrinsic"))
    }
    nets = make_networks(spec, Unbounded((12,)), reflections=mirror, keys=keys)
    assert isinstance(nets.encoder.net[0], EquivariantLinear)
