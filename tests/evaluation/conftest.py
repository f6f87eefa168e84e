import numpy as np
import pytest
import torch
from tensordict import TensorDict
from tensordict.nn import TensorDictModule
from torchrl.data import Binary, Composite, Unbounded
from torchrl.envs import Compose, EnvBase, TransformedEnv

from torchrl_atr.envs.transforms import CommandCurriculum
from torchrl_atr.evaluation import evaluate_endurance, evaluate_tracking

TRACKING = (("reward_terms", "forward_command"), ("reward_terms", "steering_command"))


class PuppetEnv(EnvBase):
    """Its speeds are its actions; a row whose action is NaN falls; it emits the truth to be estimated."""

    batch_locked = True

    def __init__(self, num_envs, seed=0):
        super().__init__(batch_size=[num_envs])
        n, self.seed = num_envs, seed
        self.speeds = torch.zeros(n, 2)
        self.steps_taken = 0
        terms = Composite({name: Unbounded((n, 1)) for _, name in TRACKING}, shape=(n,))
        privileged = Composite(intrinsic=Unbounded((n, 3)), extrinsic=Unbounded((n, 4)), shape=(n,))
        self.observation_spec = Composite(
            command=Unbounded((n, 2)), reward_terms=terms, privileged=privileged, shape=(n,)
        )
        self.state_spec = Composite(command=Unbounded((n, 2)), shape=(n,))
        self.action_spec = Unbounded((n, 2))
        self.reward_spec = Unbounded((n, 1))
        flag = {name: Binary(1, (n, 1), dtype=torch.bool) for name in ("done", "terminated", "truncated")}
        self.full_done_spec = Composite(flag, shape=(n,))

    def _set_seed(self, seed):
        pass

    def _output(self, command, fallen):
        n, flag = len(command), fallen.unsqueeze(-1)
        terms = {name: torch.zeros(n, 1) for _, name in TRACKING}
        truth = {"intrinsic": torch.ones(n, 3), "extrinsic": torch.arange(4.0).expand(n, 4).clone()}
        flags = {"done": flag, "terminated": flag.clone(), "truncated": torch.zeros_like(flag)}
        return {"command": command.clone(), "reward_terms": terms, "privileged": truth, **flags}

    def _reset(self, tensordict=None, **kwargs):
        n = self.batch_size[0]
        self.steps_taken = 0
        return TensorDict(self._output(tensordict["command"], torch.zeros(n, dtype=torch.bool)), [n])

    def _step(self, tensordict):
        action = tensordict["action"]
        fallen = action.isnan().any(-1)
        self.speeds = torch.where(fallen[:, None], self.speeds, action)
        self.steps_taken += 1
        out = self._output(tensordict["command"], fallen)
        return TensorDict({**out, "reward": torch.zeros(len(action), 1)}, self.batch_size)


def puppet_env(num_envs, seed):
    return TransformedEnv(PuppetEnv(num_envs, seed), Compose(CommandCurriculum((1.0, 1.0), seed=seed)))


def puppet_speeds(env):
    return env.base_env.speeds


def policy_of(function):
    """A policy whose speeds are ``function`` of the commands, (N, 2) both."""
    return TensorDictModule(function, in_keys=["command"], out_keys=["action"])


@pytest.fixture
def evaluate():
    """Evaluates ``function`` on the puppet: 20 steps of 0.1 s, the first 10 to settle."""

    def run(function, commands=((-1.0, 0.0, 2.0), (-0.5, 0.0, 0.5)), robots=2, make_env=puppet_env, **options):
        policy = function if isinstance(function, torch.nn.Module) else policy_of(function)
        return evaluate_tracking(policy, make_env, commands, robots, 2.0, 1.0, speeds=puppet_speeds, dt=0.1, **options)

    return run


@pytest.fixture
def random_result(evaluate):
    """A result with survivors, falls and errors of all sizes."""
    generator = torch.Generator().manual_seed(0)

    def noisy(command):
        action = command + torch.randn(command.shape, generator=generator)
        return action.where(torch.rand(len(command), 1, generator=generator) > 0.02, torch.tensor(np.nan))

    return evaluate(noisy, robots=4)


@pytest.fixture
def endure():
    """Rides the puppet for two commands of a second, ten steps each, the first 0.3 s of which settle."""

    def run(function, robots=4, make_env=puppet_env, **options):
        policy = function if isinstance(function, torch.nn.Module) else policy_of(function)
        options = {"seconds": 2.0, "command_seconds": 1.0, "settle": 0.3, "speeds": puppet_speeds, "dt": 0.1, **options}
        return evaluate_endurance(policy, make_env, robots, **options)

    return run
