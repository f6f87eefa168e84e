from __future__ import annotations

import pytest
import torch
from tensordict import TensorDict
from torch import nn
from torchrl.data import Composite, Unbounded
from torchrl.envs.utils import ExplorationType, set_exploration_type
from torchrl.modules import IndependentNormal

from torchrl_atr.modules import Exploration, IntrinsicEncoder, NetworkKeys, make_networks

SOURCES = ["privileged", "estimated", "mixed"]


def linear_sizes(module: nn.Module) -> list[tuple[int, int]]:
    return [(m.in_features, m.out_features) for m in module.modules() if isinstance(m, nn.Linear)]


def act(policy, td, mode=ExplorationType.DETERMINISTIC):
    with torch.no_grad(), set_exploration_type(mode):
        return policy(td.clone())["action"]


def test_default_networks_are_those_of_table_1():
    spec = Composite(
        observation=Unbounded((46,)),
        history=Unbounded((10, 46)),
        privileged=Composite(intrinsic=Unbounded((34,)), extrinsic=Unbounded((16,))),
    )
    nets = make_networks(spec, Unbounded((12,)))
    assert linear_sizes(nets.encoder) == [(34, 128), (128, 64), (64, 16)]
    assert linear_sizes(nets.backbone) == [(78, 512), (512, 256), (256, 128), (128, 12)]
    assert linear_sizes(nets.critic) == [(96, 512), (512, 256), (256, 128), (128, 1)]
    assert [type(m) for m in nets.encoder.net if not isinstance(m, nn.Linear)] == [nn.ELU, nn.ELU]
    assert sum(isinstance(m, nn.ELU) for m in nets.backbone.net) == 3
    torch.testing.assert_close(nets.exploration.std(), torch.full((12,), 0.3))


def test_encoder_has_no_output_activation():
    encoder = IntrinsicEncoder(3, 2, hidden=(4,))
    last = encoder.net[-1]
    assert isinstance(last, nn.Linear)
    with torch.no_grad():
        last.bias.fill_(-5.0)
        last.weight.zero_()
    assert torch.equal(encoder(torch.randn(1, 3)), torch.full((1, 2), -5.0))


@pytest.mark.parametrize(
    ("policy", "reads"),
    [
        (lambda n: n.deployed_policy(), {"history", "observation"}),
        (lambda n: n.rollout_policy("estimated"), {"history", "observation"}),
        (
            lambda n: n.rollout_policy("privileged"),
            {"observation", ("privileged", "intrinsic"), ("privileged", "extrinsic")},
        ),
        (
            lambda n: n.training_actor("privileged"),
            {"observation", ("privileged", "intrinsic"), ("privileged", "extrinsic")},
        ),
        (
            lambda n: n.training_actor("estimated"),
            {"observation", ("estimate", "intrinsic"), ("estimate", "extrinsic")},
        ),
        (
            lambda n: n.rollout_policy("mixed"),
            {"observation", "history", ("privileged", "intrinsic"), ("privileged", "extrinsic")},
        ),
        (
            lambda n: n.training_actor("mixed"),
            {
                "observation",
                ("privileged", "intrinsic"),
                ("privileged", "extrinsic"),
                ("estimate", "intrinsic"),
                ("estimate", "extrinsic"),
                ("act", "student"),
            },
        ),
    ],
)
def test_policies_read_exactly_what_their_source_needs(networks, policy, reads):
    assert set(policy(networks).in_keys) == reads


@pytest.mark.parametrize("mode", [ExplorationType.DETERMINISTIC, ExplorationType.RANDOM])
def test_privileged_entries_change_nothing_in_a_deployed_action(networks, spec, mode):
    td, policy = spec.rand(), networks.deployed_policy()
    other = td.clone()
    other["privileged"] = other["privileged"].apply(lambda x: x + 100)
    torch.manual_seed(3)
    expected = act(policy, td, mode)
    torch.manual_seed(3)
    assert torch.equal(act(policy, other, mode), expected)
    torch.manual_seed(3)
    assert torch.equal(act(policy, td.exclude("privileged"), mode), expected)


def test_the_current_observation_is_not_in_the_estimates(networks, spec):
    td = spec.rand()
    other = td.clone()
    other["observation"] += 1.0
    with torch.no_grad():
        policy = networks.deployed_policy()
        first, second = policy(td), policy(other)
    for side in ("intrinsic", "extrinsic"):
        assert torch.equal(first["estimate", side], second["estimate", side])
    assert not torch.equal(first["loc"], second["loc"])


def test_mixed_rows_act_as_estimated_and_privileged_rows_do(networks, spec):
    td = spec.rand()
    mixed = act(networks.rollout_policy("mixed", 0.4), td)
    torch.testing.assert_close(mixed[:2], act(networks.rollout_policy("estimated"), td)[:2])
    torch.testing.assert_close(mixed[2:], act(networks.rollout_policy("privileged"), td)[2:])


@pytest.mark.parametrize("source", SOURCES)
def test_training_actor_repeats_the_rollouts_distribution(networks, spec, source):
    with torch.no_grad(), set_exploration_type(ExplorationType.RANDOM):
        td = networks.rollout_policy(source)(spec.rand())
    assert not torch.equal(td["action"], td["loc"])
    dist = networks.training_actor(source).get_dist(td.exclude("history"))
    assert isinstance(dist, IndependentNormal)
    torch.testing.assert_close(dist.log_prob(td["action"]), td["action_log_prob"], rtol=0, atol=1e-5)


def test_estimated_training_actor_uses_the_recorded_estimates(networks, spec):
    with torch.no_grad():
        td = networks.rollout_policy("estimated")(spec.rand())
        for parameter in networks.estimator_parameters():
            parameter.mul_(2.0)
        assert torch.equal(networks.training_actor("estimated")(td.clone())["loc"], td["loc"])


def test_extrinsic_estimate_is_in_the_units_of_the_target(networks, spec):
    history = spec.rand()["history"]
    with torch.no_grad():
        for parameter in networks.extrinsic_estimator.parameters():
            parameter.zero_()  # the network then says "the mean", whatever it is
        estimate = networks.extrinsic_estimator_module(TensorDict(history=history, batch_size=[5]))
    expected = networks.ext_norm.mean.expand(5, 3)
    torch.testing.assert_close(estimate["estimate", "extrinsic"], expected)


def test_normalisation_makes_actions_independent_of_units(spec):
    """Rescaled observations and extrinsic states, with statistics to match, change nothing."""
    nets = make_networks(spec, Unbounded((5, 2)), actor_cells=(16,), critic_cells=(16,))
    td, batch = spec.rand(), spec.expand(200, 5).rand()
    outputs = []
    for scale in (1.0, 1000.0):
        nets.obs_norm.count.zero_()
        nets.ext_norm.count.zero_()
        scaled, stats = td.clone(), batch.clone()
        for each in (scaled, stats):
            each["observation"] *= scale
            each["privileged", "extrinsic"] *= scale
        nets.update_normalizers(stats)
        out = nets.critic_module(nets.training_actor("privileged")(scaled))
        outputs.append((out["loc"], out["state_value"]))
    for one, other in zip(*outputs):
        torch.testing.assert_close(one, other, rtol=1e-3, atol=1e-3)


def test_a_critic_without_privileges_reads_the_observation_alone(spec):
    nets = make_networks(spec, Unbounded((5, 2)), critic_cells=(16,), privileged_critic=False)
    assert nets.critic_module.in_keys == ["observation"]
    nets.update_normalizers(spec.rand())
    assert nets.critic_module(spec.rand().select("observation"))["state_value"].shape == (5, 1)


@pytest.fixture
def fuller(spec):
    """The spec of an env that offers more: velocities by dead reckoning, and what the critic alone may see."""
    extra = Composite(
        dead_reckoned_velocity=Unbounded((5, 2)),
        privileged=Composite(tracking_forecast=Unbounded((5, 8)), shape=(5,)),
        shape=(5,),
    )
    return spec.clone().update(extra)


def test_what_an_env_offers_is_not_read_unless_it_is_asked_for(spec, fuller):
    options = {"estimator": "mlp", "actor_cells": (16,), "critic_cells": (16,)}
    plain, offered = (make_networks(each, Unbounded((5, 2)), **options) for each in (spec, fuller))
    assert linear_sizes(offered) == linear_sizes(plain)
    assert offered.state_dict().keys() == plain.state_dict().keys()
    assert set(offered.deployed_policy().in_keys) == {"history", "observation"}
    asked = make_networks(
        fuller,
        Unbounded((5, 2)),
        estimator_inputs=["dead_reckoned_velocity"],
        critic_inputs=[("privileged", "tracking_forecast"), "dead_reckoned_velocity"],
        **options,
    )
    assert set(asked.deployed_policy().in_keys) == {"history", "observation", "dead_reckoned_velocity"}
    assert asked.critic_module.in_keys[-2:] == [("privileged", "tracking_forecast"), "dead_reckoned_velocity"]
    assert linear_sizes(asked.critic)[0][0] == linear_sizes(plain.critic)[0][0] + 8 + 2
    assert linear_sizes(asked.extrinsic_estimator)[0][0] == 4 * (7 + 2)
    asked.update_normalizers(fuller.rand())
    assert [int(norm.count) for norm in asked.critic.input_norms] == [5, 5]
    assert asked.critic_module(fuller.rand())["state_value"].shape == (5, 1)


@pytest.mark.parametrize("argument", ["estimator_inputs", "critic_inputs"])
def test_an_input_that_the_spec_lacks_is_named(spec, argument):
    with pytest.raises(KeyError, match=rf"{argument} names 'dead_reckoned_velocity', which the spec lacks"):
        make_networks(spec, Unbounded((5, 2)), **{argument: ["dead_reckoned_velocity"]})


def test_a_critic_without_privileges_may_read_more_than_the_observation(fuller):
    options = {"privileged_critic": False, "critic_inputs": ["dead_reckoned_velocity"], "critic_cells": (16,)}
    nets = make_networks(fuller, Unbounded((5, 2)), **options)
    assert nets.critic_module.in_keys == ["observation", "dead_reckoned_velocity"]
    assert nets.critic_module(fuller.rand())["state_value"].shape == (5, 1)


def test_an_exploration_of_another_size_is_refused_and_one_that_fits_is_part_of_the_networks(spec):
    with pytest.raises(ValueError, match="exploration is of 3 actions and the action spec has 2"):
        make_networks(spec, Unbounded((5, 2)), exploration=Exploration(3))
    exploration = Exploration(2, [0.2, 0.1])
    nets = make_networks(spec, Unbounded((5, 2)), exploration=exploration)
    assert nets.exploration is exploration
    assert any(parameter is exploration.raw for parameter in nets.policy_parameters())


def test_policies_share_their_parameters(networks):
    ids = {id(p) for p in networks.parameters()}
    views = [networks.training_actor(s) for s in SOURCES] + [networks.rollout_policy(s) for s in SOURCES]
    assert all(id(p) in ids for view in [*views, networks.deployed_policy()] for p in view.parameters())
    policy = [id(p) for p in networks.policy_parameters()]
    estimators = [id(p) for p in networks.estimator_parameters()]
    assert len(set(policy)) == len(policy)
    assert set(policy) | set(estimators) == ids
    assert not set(policy) & set(estimators)


def test_state_dict_round_trip(networks, spec):
    twin = make_networks(spec, Unbounded((2,)), latent_features=4, actor_cells=(16,), critic_cells=(16,))
    twin.load_state_dict(networks.state_dict())
    td = spec.rand()
    for name in ("deployed_policy", "training_actor"):
        assert torch.equal(act(getattr(twin, name)(), td), act(getattr(networks, name)(), td))


def test_renamed_keys(spec):
    keys = NetworkKeys(observation=("robot", "obs"), history="window", action=("robot", "target"))
    renamed = Composite(
        robot=Composite(obs=spec["observation"].clone(), shape=(5,)),
        window=spec["history"].clone(),
        privileged=spec["privileged"].clone(),
        shape=(5,),
    )
    action = Composite(robot=Composite(target=Unbounded((5, 2)), shape=(5,)), shape=(5,))
    nets = make_networks(renamed, action, keys=keys, estimator="mlp")
    assert set(nets.deployed_policy().in_keys) == {("robot", "obs"), "window"}
    assert nets.rollout_policy("mixed")(renamed.rand())["robot", "target"].shape == (5, 2)


def test_bad_specs_are_named(spec):
    action = Unbounded((5, 2))
    with pytest.raises(KeyError, match=r"history.*NetworkKeys"):
        make_networks(Composite(observation=Unbounded((5, 7)), shape=(5,)), action)
    wrong = spec.clone()
    wrong["history"] = Unbounded((5, 4, 8))
    with pytest.raises(ValueError, match=r"\(H, 7\).*\(4, 8\)"):
        make_networks(wrong, action)
    with pytest.raises(ValueError, match="cnn_gru"):
        make_networks(spec, action, estimator="oracle")
    with pytest.raises(ValueError, match="oracle"):
        make_networks(spec, action).training_actor("oracle")


@pytest.mark.parametrize("odd", ["observation", "history", ("privileged", "extrinsic")])
def test_entries_of_two_dtypes_are_named_before_a_layer_fails(odd):
    privileged = Composite(intrinsic=Unbounded((6,)), extrinsic=Unbounded((3,)))
    spec = Composite(observation=Unbounded((5,)), history=Unbounded((4, 5)), privileged=privileged)
    spec[odd] = Unbounded(spec[odd].shape, dtype=torch.float64)
    with pytest.raises(ValueError, match=r"torch\.float(32|64).*DoubleToFloat"):
        make_networks(spec, Unbounded((2,)))
