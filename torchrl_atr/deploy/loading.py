"""Loading of a policy for use in TorchRL, from a bundle or a run."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import NamedTuple

from tensordict.nn import TensorDictModuleBase
from torchrl.envs import EnvBase

from torchrl_atr.training import DEPLOYMENT_OVERRIDES, load_run, make_env


class LoadedPolicy(NamedTuple):
    """Deployed policy in eval mode, and the factory of envs that it was trained in.

    Attributes:
        policy: reads what a robot senses, writes the action.
        make_env: ``make_env(num_envs=4, seed=0)``: rides from rest without pushes that only a fall ends, with the
            sensors of the training; takes further arguments of :func:`torchrl_atr.training.make_env`.
    """

    policy: TensorDictModuleBase
    make_env: Callable[..., EnvBase]


def load_policy(policy: str | Path, imports: Sequence[str] = ()) -> LoadedPolicy:
    """Load a policy as a TensorDictModule, with its env's factory.

    Args:
        policy: name of an installed policy, or the folder of a bundle or a run.
        imports: modules to import besides those that the run remembers.

    Returns:
        The policy, whose commands are clipped to its range, and the factory.

    Raises:
        CheckpointError, BundleError: see :func:`torchrl_atr.training.load_run`.

    Example:
        >>> from torchrl_atr.training import Trainer, make_config
        >>> import tempfile
        >>> tiny = {"env.num_envs": 2, "total_frames": 8, "ppo.rollout_steps": 2, "ppo.minibatches": 1}
        >>> run = tempfile.mkdtemp()
        >>> Trainer(make_config(tiny), run).save()
        >>> policy, make_env = load_policy(run)
        >>> make_env(num_envs=2, seed=0).rollout(3, policy)["action"].shape
        torch.Size([2, 3, 12])
    """
    config, env, networks, _ = load_run(policy, imports=imports, num_envs=1)
    env.close()
    policy = networks.deployed_policy().eval().requires_grad_(False)
    return LoadedPolicy(policy, partial(make_env, config, **DEPLOYMENT_OVERRIDES))
