"""Wrong keys and shapes: exceptions of Python, as short and as clear."""

from __future__ import annotations

from types import SimpleNamespace

import pytest
import torch
from tensordict import TensorDict
from torchrl.data import Unbounded
from torchrl.envs import TransformedEnv

from torchrl_atr._errors import InputError
from torchrl_atr._registry import UnknownNameError
from torchrl_atr.envs import RidingEnv, make_env, make_riding_env
from torchrl_atr.envs.tasks import make_task
from torchrl_atr.envs.transforms import CommandCurriculum, ObservationHistory
from torchrl_atr.modules import AssignActSource, Exploration, NetworkKeys, make_networks, register_estimator
from torchrl_atr.objectives import ROAClipPPOLoss

NAN = float("nan")


@pytest.fixture(scope="module")
def given():
    """Two robots, their networks, a batch, its loss; ``step(name=value)`` steps the bare env with such entries."""
    base, env = (make(num_envs=2, num_threads=1, seed=0) for make in (RidingEnv, make_riding_env))
    walker = make_env(make_task("walking"), num_envs=2, num_threads=1, seed=0)
    spec = env.observation_spec
    nets = make_networks(
        spec, env.action_spec, actor_cells=[8], critic_cells=[8], estimator_inputs=["dead_reckoned_velocity"]
    )
    with torch.no_grad():
        batch = env.rollout(2, nets.rollout_policy("mixed"))
    parts = (nets.critic_module, nets.encoder_module, nets.intrinsic_estimator_module, nets.extrinsic_estimator_module)

    def step(**entries):
        return base.step(base.reset().update(TensorDict(entries, batch_size=[2])))

    def with_transform(transform):
        return TransformedEnv(RidingEnv(num_envs=2, num_threads=1, seed=0), transform).rollout(1)

    def loss(**options):
        return ROAClipPPOLoss(nets.training_actor(), *parts, **options)

    def networks(**options):
        return make_networks(spec.clone().update(options.pop("spec", {})), env.action_spec, **options)

    return SimpleNamespace(**locals())


def _action(value=0.0, size=12):
    return torch.full((2, size), value)


@pytest.mark.parametrize(
    ("provoke", "kind", "culprit", "remedy"),
    [
        (lambda g: g.step(action=_action(NAN)), ValueError, "'action' is not finite for env ids [0, 1]", "check the p"),
        (lambda g: g.step(action=_action(size=11)), ValueError, "'action' has shape (2, 11)", "needs (2, 12)"),
        (lambda g: g.step(actions=_action()), KeyError, "there is no 'action'", "run a policy that writes it"),
        (
            lambda g: g.step(action=_action(), command=_action(size=3)),
            ValueError,
            "'command' has shape (2, 3)",
            "(2, 2): (speed, yaw_rate)",
        ),
        (
            lambda g: g.step(action=_action(), command=_action(NAN, 2)),
            ValueError,
            "'command' is not finite for env ids [0, 1]",
            "give m/s, rad/s",
        ),
        (
            lambda g: g.base.set_state(g.base.get_state().exclude("qpos")),
            KeyError,
            "the state lacks 'qpos'",
            "pass what get_state() returned",
        ),
        (lambda g: g.env.curriculum.pin([20.0, 0.0]), InputError, "command [20.0, 0.0]", "within ±(15.0, 2.0)"),
        (lambda g: g.walker.curriculum.pin([1.6, 0.0]), InputError, "command [1.6", "within ±(1.5, 1.0)"),
        (lambda g: g.walker.curriculum.pin([-0.5, 0.0]), InputError, "command [-0.5, 0.0]", "within [0, 1.5] m/s"),
        (
            lambda g: g.walker.curriculum.pin([[0.5, 0.0], [-0.25, 1.0]]),
            InputError,
            "command [-0.25, 1.0] asks for a negative speed",
            "within [0, 1.5] m/s",
        ),
        (
            lambda g: g.walker.curriculum.load_weights(torch.ones(13, 9)),
            ValueError,
            "weights of speeds below zero",
            "must be 0: the grid is forward_only",
        ),
        (lambda g: make_task("walkng"), UnknownNameError, "unknown task 'walkng'", "did you mean 'walking'?"),
        (
            lambda g: make_task("walking", transporter="two_board"),
            InputError,
            "the task 'walking' has no argument 'transporter'",
            "there are",
        ),
        (
            lambda g: g.with_transform(CommandCurriculum([1.0], thresholds=[0.8], tracking_keys=["quality"])),
            KeyError,
            "tracking key 'quality'",
            "there are",
        ),
        (
            lambda g: g.with_transform(
                CommandCurriculum([1.0], thresholds=[0.8], tracking_keys=[("reward_terms", "forward")])
            ),
            KeyError,
            "('reward_terms', 'forward')",
            "did you mean \"('reward_terms', 'forward_command')\"?",
        ),
        (
            lambda g: g.with_transform(CommandCurriculum([1.0], thresholds=[0.8], tracking_keys=["proprio"])),
            ValueError,
            "'proprio' has shape (2, 44)",
            "a score needs (2, 1)",
        ),
        (
            lambda g: g.with_transform(CommandCurriculum([1.0, 1.0], unscored_key="speed")),
            KeyError,
            "unscored_key 'speed'",
            "did you mean 'speeds'?",
        ),
        (lambda g: g.with_transform(ObservationHistory(3, in_key="obs")), KeyError, "'obs'", "name one of these"),
        (lambda g: g.networks(spec={"history": Unbounded((2, 10, 45))}), ValueError, "(10, 45)", "must end with (H, "),
        (lambda g: g.networks(keys=NetworkKeys(observation="observe")), KeyError, "'observe'", "'observation'?"),
        (lambda g: g.networks(estimator="cnn-gru"), UnknownNameError, "'cnn-gru'", "did you mean 'cnn_gru'?"),
        (lambda g: Exploration(12, [0.1, 0.2]), ValueError, "got 2", "one value or 12"),
        (lambda g: g.networks(exploration=Exploration(2)), ValueError, "is of 2 actions", "give Exploration(12, ...)"),
        (lambda g: g.networks(critic_inputs=["odo"]), KeyError, "critic_inputs names 'odo'", "Leave it out, or add"),
        (
            lambda g: g.nets.deployed_policy()(g.batch[:, 0].set("history", torch.zeros(2, 5, 46))),
            ValueError,
            "got (2, 5, 46)",
            "was built for a history of shape (*, 10, 46)",
        ),
        (
            lambda g: g.nets.update_normalizers(g.batch.exclude("dead_reckoned_velocity")),
            KeyError,
            "lacks 'dead_reckoned_velocity'",
            "rename it",
        ),
        (lambda g: AssignActSource()(g.batch[0, 0]), ValueError, "'observation' is (46,)", "Use source="),
        (lambda g: g.nets.rollout_policy("teacher"), ValueError, "'teacher'", "privileged, estimated, mixed"),
        (lambda g: register_estimator("mlp", dict), InputError, "'mlp' is registered already", "choose another name"),
        (
            lambda g: g.loss().adaptation_loss(g.batch.exclude("history")),
            KeyError,
            "intrinsic_estimator_network reads ['history']",
            "keep them",
        ),
        (
            lambda g: g.loss().adaptation_loss(g.batch.exclude(("privileged", "extrinsic"))),
            KeyError,
            "('privileged', 'extrinsic')",
            "loss.set_keys(extrinsic=...)",
        ),
        (lambda g: g.loss(extrinsic_scale=[1.0]), ValueError, "extrinsic_scale", "must be a Tensor"),
        (lambda g: g.loss(roa_coeff=-1.0), ValueError, "roa_coeff must be >= 0, got -1", "0 switches the term off"),
    ],
)
def test_refused(given, check_message, provoke, kind, culprit, remedy):
    with pytest.raises(kind) as caught:
        provoke(given)
    check_message(str(caught.value.args[0]), culprit, remedy)
