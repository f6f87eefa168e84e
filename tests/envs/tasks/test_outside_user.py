"""What is added from outside: terms in one short file, a third task in another, without a change to the package."""

from __future__ import annotations

import inspect
import math

import pytest
import torch

from examples import balance, own_task
from torchrl_atr._compilation import compiler
from torchrl_atr.envs import QuadrupedEnv, make_env
from torchrl_atr.envs.tasks import make_task, riding
from torchrl_atr.training import Trainer, make_config

with_compiler = pytest.mark.skipif(compiler() is None, reason="no C++ compiler on PATH")
TINY = {
    "env.num_envs": 8,
    "ppo.rollout_steps": 6,
    "total_frames": 96,
    "compute.torch_threads": 1,
    "compute.num_threads": 1,
}


def test_the_files_are_as_short_as_promised():
    assert len(inspect.getsource(own_task).splitlines()) < 60
    assert len(inspect.getsource(balance).splitlines()) < 150


def test_terms_of_ones_own_appear_in_specs_data_model_mirror_images_and_suite():
    env = make_env(own_task.careful_riding(), num_envs=3, seed=0)
    plain = make_env(riding(), num_envs=3, seed=0)
    td = env.rollout(4)
    after = td["next"]
    grown = {key: after[key].shape[-1] - plain.observation_spec[key].shape[-1] for key in ("proprio", "observation")}
    assert grown == {"proprio": 4, "observation": 4}
    assert after["history"].shape[-1] == after["observation"].shape[-1]
    assert ("reward_terms", "leaning") in after.keys(True, True)
    total = torch.stack(list(after["reward_terms"].values())).sum(0)
    torch.testing.assert_close(total, after["reward"], atol=1e-5, rtol=1e-5)
    base = env.base_env
    loss = base.engine.fields["dof_frictionloss"][:, base.scene.layout.joint_dof]
    drawn = after["privileged", "intrinsic"][:, -1, 34:].double()
    torch.testing.assert_close(loss, 0.2 + 0.2 * drawn)
    for key, image in base.reflections.items():
        size = after[key].shape[-1] if key != "action" else 12
        assert image.shape == (size, size)
        assert torch.equal(image @ image, torch.eye(size)), key


def test_they_are_in_the_suite_too():
    pytest.importorskip("dm_control")
    from torchrl_atr.envs import suite

    environment = suite.load_task(own_task.careful_riding(), random=0)
    environment.reset()
    step = environment.step([0.0] * 12)
    assert step.observation["proprio"].shape == (48,)
    assert "leaning" in environment.task.reward_terms


@with_compiler
@pytest.mark.usefixtures("traced")
def test_compiled_or_not_they_come_to_the_same():
    task = own_task.careful_riding().with_observation(
        "proprio", foot_loads=own_task.ObservationTerm(own_task.foot_loads, mirror=own_task.mirrors.legs)
    )
    rollouts = []
    for compiled in (False, True):
        env = QuadrupedEnv(task, num_envs=3, seed=0, compiled=compiled)
        rollouts.append(env.rollout(3, lambda td: td.set("action", torch.zeros(3, 12))))
    plain, fast = rollouts
    for key in (("next", "reward"), ("next", "proprio"), ("next", "reward_terms", "leaning")):
        torch.testing.assert_close(fast[key], plain[key], atol=2e-4, rtol=1e-3)


@pytest.mark.usefixtures("traced")
@pytest.mark.parametrize(
    ("module", "name", "compiled"),
    [
        ("own_task", "careful_riding", False),
        pytest.param("own_task", "careful_riding", True, marks=with_compiler),
        ("balance", "balance", False),
    ],
)
def test_they_train(tmp_path, module, name, compiled):
    config = make_config({**TINY, "task.name": name, "imports": (f"examples.{module}",), "compute.compiled": compiled})
    trainer, seen = Trainer(config, tmp_path), []
    trainer.train(seen.append)
    assert len(seen) == 2
    assert all(math.isfinite(value) for metrics in seen for value in metrics.values())
    if name == "careful_riding":
        assert all("reward/leaning" in metrics for metrics in seen)


def test_the_plate_rocks_as_it_is_told_and_the_robot_stays_on_it():
    env = QuadrupedEnv(make_task("balance"), num_envs=2, seed=0, randomization="off")
    td = env.reset()
    hinges, _ = env.scene.support_layout
    for _ in range(100):
        td = env.step(td.set("action", torch.zeros(2, 12)))["next"]
    time = env.engine.get_state()["rocking_time"]
    wanted = 0.1 * torch.sin(2 * math.pi * time * torch.tensor([0.2, 0.4], dtype=torch.float64))
    torch.testing.assert_close(env.engine.qpos[:, hinges], wanted, atol=0.02, rtol=0)
    assert not td["terminated"].any()


def test_its_state_is_restored_bit_for_bit():
    env = QuadrupedEnv(make_task("balance"), num_envs=2, seed=0)
    env.rollout(5)
    state, ends = env.get_state(), []
    for _ in range(2):
        env.set_state(state)
        torch.manual_seed(1)
        ends.append(torch.stack([env.step(env.rand_action())["next", "observation"] for _ in range(3)]))
    assert torch.equal(*ends)
