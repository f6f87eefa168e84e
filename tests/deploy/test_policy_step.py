"""The step that is exported acts as the policy in its env, for every kind of dead reckoning and history."""

from __future__ import annotations

import numpy as np
import pytest
import torch

import torchrl_atr
from torchrl_atr._errors import InputError
from torchrl_atr.deploy.episode import record
from torchrl_atr.deploy.policy_step import SENSORS, PolicyStep
from torchrl_atr.envs.tasks import ObservationTerm
from torchrl_atr.envs.transforms import FootRepositioning
from torchrl_atr.modules import CommandRange
from torchrl_atr.training import Trainer, load_run, make_config

TINY = {"env.num_envs": 2, "total_frames": 8, "ppo.rollout_steps": 2, "ppo.minibatches": 1, "compute.num_threads": 1}
OTHERS = [
    {"task.velocity_filter": "integral", "task.interpretation.current_in_history": True},
    {
        "task.velocity_filter": "leaky_integral",
        "task.interpretation.gravity_in_acceleration": True,
        "preset": "concurrent",
    },
    {"env.reposition_feet": 0.02},
    {"task.name": "walking"},
    {"task.name": "walking", "task.robot": "spot"},
    {"preset": "asymmetric", "env.history_length": 3, "task.transporter": "two_board", "curriculum.slew_rates": ()},
]


def anything(env, step):
    """Return a state that is not read: all episodes start first."""
    history = torch.full(env.observation_spec["history"].shape, torch.nan)
    memory = {"memory": torch.full_like(step.memory(2), torch.nan)} if "memory" in step.inputs else {}
    nothing = {**memory, "last_action": torch.zeros(2, 12), "last_command": torch.full((2, 2), torch.nan)}
    return {"history": history, "dead_reckoning": step.rest.expand(2, -1), **nothing}


@pytest.fixture(scope="module")
def limited(tmp_path_factory):
    """A step whose command is limited to 2 m/s and 1 rad/s, and approached by 1 m/s and 0.5 rad/s a step."""
    folder = tmp_path_factory.mktemp("limited")
    Trainer(make_config(TINY), folder).save()
    _, env, networks, _ = load_run(folder, num_envs=2)
    base = env.base_env
    return PolicyStep(networks, base.task, base.scene, CommandRange(2.0, 1.0, 0.5), (50.0, 25.0)).eval(), env


def follow(limited, commands):
    """Outputs of the first steps of an episode in which a robot stands still, by what each of them is asked for."""
    step, env = limited
    state, sizes, outputs = anything(env, step), env.base_env.runner.terms.observations.sizes["proprio"], []
    readings = dict(zip(sizes, env.reset()["proprio"].split(list(sizes.values()), -1)))
    given = {name: readings[name] for name in SENSORS}
    for t, command in enumerate(commands):
        with torch.no_grad():
            outputs.append(step(start=torch.full((2, 1), t == 0), **given, command=command, **state))
        state = {name: getattr(outputs[-1], source) for name, source in step.state.items()}
    return outputs


@pytest.mark.parametrize("settings", OTHERS)
def test_it_acts_as_the_policy_does_in_its_env(tmp_path, settings):
    Trainer(make_config({**TINY, **settings}), tmp_path).save()
    limits = CommandRange(2.0, 1.0, 0.5, forward_only=settings.get("task.name") == "walking")
    limits.save(tmp_path)
    config, env, networks, _ = load_run(tmp_path, num_envs=2)
    base = env.base_env
    rates = config.curriculum.slew_rates
    steps = [each.steps for each in env.transform if isinstance(each, FootRepositioning)]
    step = PolicyStep(networks, base.task, base.scene, limits, rates, *steps).eval()
    recorded = record(torchrl_atr.load_policy(tmp_path), steps=120)
    episode = {name: torch.from_numpy(value) for name, value in recorded.items()}
    assert episode["start"][1:].any()
    state = anything(env, step)
    errors = []
    for t in range(len(episode["start"])):
        readings = {name: episode[name][t] for name in (*SENSORS, "command")}
        with torch.no_grad():
            out = step(start=episode["start"][t].unsqueeze(-1), **readings, **state)
        state = {name: getattr(out, source) for name, source in step.state.items()}
        errors.append((out.action - episode["action"][t]).abs().max().item())
    assert np.max(errors) < 1e-4


def test_a_policy_that_reads_something_else_is_refused(tmp_path):
    """As a clock of another task's own, which happens to have the name of ours."""
    Trainer(make_config({**TINY, "task.name": "walking"}), tmp_path).save()
    _, env, networks, _ = load_run(tmp_path, num_envs=2)
    task, scene = env.base_env.task, env.base_env.scene
    own = ObservationTerm(lambda c: c.command, (1.0, 1.0))
    proprio = {**task.observations["proprio"], "clock": own}
    other = task.replace(observations={**task.observations, "proprio": proprio})
    with pytest.raises(InputError, match="'walking' cannot be exported: of clock the runtime knows nothing"):
        PolicyStep(networks, other, scene, None)


def test_the_command_approaches_what_is_asked_for_within_the_range(limited):
    followed = []
    for out in follow(limited, [torch.tensor([[9.0, 0.2], [0.5, -4.0]])] * 4):
        assert torch.allclose(out.command_in_range, torch.tensor([[2.0, 0.2], [0.5, -1.0]]))  # |v ω| is 0.4 and 0.5
        assert torch.equal(out.next_history[:, -1, -2:], out.command_in_force)
        followed.append(out.command_in_force)
    line = torch.stack(followed)  # by 1 m/s and 0.5 rad/s a step, from zero
    assert torch.allclose(line[:, 0], torch.tensor([[0.0, 0.0], [1.0, 0.2], [2.0, 0.2], [2.0, 0.2]]))
    assert torch.allclose(line[:, 1], torch.tensor([[0.0, 0.0], [0.5, -0.5], [0.5, -1.0], [0.5, -1.0]]))


def test_a_reversal_begins_at_once_however_much_was_asked_for(limited):
    """A command that is approached stops at the range, and does not run on towards 9 m/s and 4 rad/s beyond it."""
    much = torch.tensor([[9.0, 0.0], [0.0, -4.0]])
    *_, last, reversed_once = follow(limited, [*[much] * 8, -much])
    assert torch.allclose(last.command_in_force, torch.tensor([[2.0, 0.0], [0.0, -1.0]]))
    assert torch.allclose(reversed_once.command_in_force, torch.tensor([[1.0, 0.0], [0.0, -0.5]]))


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_a_large_action_asks_for_the_joints_limits_and_no_more(limited, monkeypatch, side):
    """A1's: abduction, thigh and calf, rad."""
    far = torch.full((2, 12), side * 50.0)
    monkeypatch.setattr(type(limited[0].networks.backbone), "forward", lambda *_: far)
    (out,) = follow(limited, [torch.zeros(2, 2)])
    leg = [0.802851, 4.18879, -0.916298] if side > 0 else [-0.802851, -1.0472, -2.69653]
    assert torch.equal(out.action, far)
    torch.testing.assert_close(out.joint_targets, torch.tensor(leg * 4).expand(2, -1), atol=1e-4, rtol=0.0)
