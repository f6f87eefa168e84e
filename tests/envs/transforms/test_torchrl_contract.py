"""TorchRL's own list of checks for a transform, for each of ours and for the whole stack."""

from __future__ import annotations

from functools import partial

import pytest
import torch
from tensordict import TensorDict
from tensordict.nn import TensorDictModule, TensorDictSequential
from torchrl.data import LazyTensorStorage, TensorDictReplayBuffer
from torchrl.envs import Compose, ParallelEnv, SerialEnv, TransformedEnv, check_env_specs
from toy import ToyEnv

from torchrl_atr.envs.transforms import CommandCurriculum, ObservationHistory, task_transforms

LIFE = torch.tensor([1, 2, 0])


def curriculum():
    return CommandCurriculum((1.0, 1.0), window=2)


def history():
    return ObservationHistory(3)


def stack():
    return task_transforms((1.0, 1.0), history_length=3, max_steps=2, window=2)


def toy(batch=(3,)):
    return ToyEnv(batch, lifetime=LIFE if batch else 2)


def transformed(maker, batch=(3,)):
    return TransformedEnv(toy(batch), maker())


def check(env):
    try:
        check_env_specs(env, break_when_any_done="both")
    finally:
        env.close()


every = pytest.mark.parametrize("maker", [curriculum, history, stack])
bare = pytest.mark.parametrize("maker", [curriculum, history])
batches = pytest.mark.parametrize("batch", [(), (3,)])


class TestTransforms:
    @every
    @batches
    def test_single_trans_env_check(self, maker, batch):
        check(transformed(maker, batch))

    @every
    @batches
    def test_serial_trans_env_check(self, maker, batch):
        check(SerialEnv(2, partial(transformed, maker, batch)))

    @every
    def test_parallel_trans_env_check(self, maker):
        check(ParallelEnv(2, partial(transformed, maker), mp_start_method="fork"))

    @every
    @batches
    def test_trans_serial_env_check(self, maker, batch):
        check(TransformedEnv(SerialEnv(2, partial(toy, batch)), maker()))

    @every
    def test_trans_parallel_env_check(self, maker):
        check(TransformedEnv(ParallelEnv(2, toy, mp_start_method="fork"), maker()))

    def test_transform_no_env(self):
        td = TensorDict({"observation": torch.arange(4.0).reshape(2, 2)}, [2])
        transform = history()
        assert transform._reset(td.empty(), td)["history"].tolist() == [[[0, 1]] * 3, [[2, 3]] * 3]
        newer = TensorDict({"observation": torch.full((2, 2), 9.0)}, [2])
        transform._step(td, newer)
        last = TensorDict({"observation": torch.zeros(2, 2)}, [2])
        assert transform._step(newer, last)["history"][0].tolist() == [[0, 1], [0, 1], [9, 9]]
        with pytest.raises(RuntimeError, match="not attached"):
            curriculum()._reset_env_preprocess(None)

    def test_transform_compose(self):
        td = TensorDict({"observation": torch.arange(4.0).reshape(2, 2)}, [2])
        out = Compose(history())._reset(td.empty(), td)
        assert out["history"].tolist() == [[[0, 1]] * 3, [[2, 3]] * 3]
        with pytest.raises(RuntimeError, match="not attached"):
            Compose(curriculum())._reset_env_preprocess(None)

    @every
    def test_transform_env(self, maker):
        env = transformed(maker)
        td = env.reset()
        for key in env.observation_spec.keys(True, True):
            assert td[key].shape == env.observation_spec[key].shape
        step = env.step(env.rand_action(td))["next"]
        assert env.observation_spec.is_in(step.select(*env.observation_spec.keys()))

    @bare
    def test_transform_model(self, maker):
        module = TensorDictModule(torch.nn.Identity(), ["observation"], ["copy"])
        with pytest.raises(NotImplementedError, match="only works on the reset and step"):
            TensorDictSequential(maker(), module)(TensorDict({"observation": torch.zeros(3, 2)}, [3]))

    @bare
    def test_transform_rb(self, maker):
        buffer = TensorDictReplayBuffer(storage=LazyTensorStorage(8), batch_size=4)
        buffer.append_transform(maker())
        buffer.extend(TensorDict({"observation": torch.zeros(8, 2)}, [8]))
        with pytest.raises(NotImplementedError, match="only works on the reset and step"):
            buffer.sample()

    @bare
    def test_transform_inverse(self, maker):
        td = TensorDict({"observation": torch.ones(3, 2), "command": torch.ones(3, 2)}, [3])
        assert (maker().inv(td) == td).all()


def test_workers_without_a_seed_draw_different_commands():
    env = ParallelEnv(2, partial(transformed, stack), mp_start_method="fork")
    try:
        commands = env.reset()["command"]
        assert not (commands[0] == commands[1]).any()
    finally:
        env.close()


def test_stack_order_keys_and_limits():
    transforms = stack()
    env = TransformedEnv(toy(), transforms)
    names = ["CommandCurriculum", "CatTensors", "ObservationHistory", "StepCounter", "RewardSum"]
    assert [type(t).__name__ for t in env.transform] == names
    data = env.rollout(6, break_when_any_done=False)
    assert data["history"].shape == (3, 6, 3, 5)
    assert (data["next", "step_count"][2, :, 0] == torch.tensor([1, 2, 1, 2, 1, 2])).all()
    assert data["next", "truncated"][2, 1::2].all()
    pairs = data["next", "reward"][2].reshape(3, 2)
    torch.testing.assert_close(data["next", "episode_reward"][2, 1::2, 0], pairs.sum(1))
