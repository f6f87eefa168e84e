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


def test_the_command_approaches_what_is_asked_for_within_the_range(tmp_path):
    Trainer(make_config(TINY), tmp_path).save()
    _, env, networks, _ = load_run(tmp_path, num_envs=2)
    base, limits = env.base_env, CommandRange(2.0, 1.0, 0.5)
    step = PolicyStep(networks, base.task, base.scene, limits, (50.0, 25.0)).eval()
    state, sizes = anything(env, step), base.runner.terms.observations.sizes["proprio"]
    readings = dict(zip(sizes, env.reset()["proprio"].split(list(sizes.values()), -1)))
    asked, followed = torch.tensor([[9.0, 0.2], [0.5, -4.0]]), []
    for t in range(4):
        with torch.no_grad():
            given = {name: readings[name] for name in SENSORS}
            out = step(start=torch.full((2, 1), t == 0), **given, command=asked, **state)
        state = {name: getattr(out, source) for name, source in step.state.items()}
        assert torch.allclose(out.command_in_range, torch.tensor([[2.0, 0.2], [0.5, -1.0]]))  # |v ω| is 0.4 and 0.5
        assert torch.equal(out.next_history[:, -1, -2:], out.command_in_force)
        followed.append(out.command_in_force)
    line = torch.stack(followed)  # by 1 m/s and 0.5 rad/s a step, from zero
    assert torch.allclose(line[:, 0], torch.tensor([[0.0, 0.0], [1.0, 0.2], [2.0, 0.2], [2.0, 0.2]]))
    assert torch.allclose(line[:, 1], torch.tensor([[0.0, 0.0], [0.5, -0.5], [0.5, -1.0], [0.5, -1.0]]))
