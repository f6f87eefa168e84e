"""Contenders of other libraries on the same cores: one simulation per process, as many processes as cores."""

from __future__ import annotations

import signal
import sys
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from importlib.util import find_spec
from multiprocessing import resource_tracker

from torchrl.envs import AntEnv, EnvBase, ParallelEnv

from benchmarks.contenders import stepped
from benchmarks.timing import Contender, Key
from torchrl_atr._interrupt import signals_held

SKIPPED_MJBATCH = (
    "cannot be installed beside us: mjbatch 0.1.4 needs mujoco==3.14.0, we need 3.17; "
    "mujoco.batch, the physics limit, is its successor"
)
Peer = Callable[[int], Contender]


def dm_control_ride(seed: int) -> EnvBase:
    """Return one robot of the same task in TorchRL's wrapper, as a user would build it without this library's env."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # glfw's, about a display that is not needed
        from torchrl.envs.libs.dm_control import DMControlWrapper

        from torchrl_atr.envs import suite  # slow to import: only in the workers

    return DMControlWrapper(suite.load("a1", "single_board", random=seed))


def dm_control(workers: int) -> Contender:
    """Return ``ParallelEnv`` of ``DMControlWrapper(suite.load("a1", "single_board"))``."""
    seeds = [{"seed": seed} for seed in range(workers)]
    return stepped("dm_control", _started(ParallelEnv(workers, dm_control_ride, create_env_kwargs=seeds)), workers)


def torchrl_ant(workers: int) -> Contender:
    """Return TorchRL's ``MujocoEnv(backend="mujoco")`` on its ant: another task, 5 substeps, 8 joints."""
    return stepped("torchrl_ant", _started(ParallelEnv(workers, partial(AntEnv, backend="mujoco"))), workers)


def _started(env: ParallelEnv) -> ParallelEnv:
    with _ctrl_c_held():
        env.start()
    return env


@contextmanager
def _ctrl_c_held() -> Iterator[None]:
    """Hold SIGINT while workers start, so that a terminal's Ctrl-C does not reach them; this process ends them."""
    resource_tracker.ensure_running()  # it lets signals through when it starts
    with signals_held([signal.SIGINT]):
        yield


def gymnasium_ant(workers: int) -> Contender:
    """Return Gymnasium's ``AsyncVectorEnv`` of ``Ant-v5``: another task, 5 substeps, 8 joints."""
    import gymnasium

    with _ctrl_c_held():
        env = gymnasium.vector.AsyncVectorEnv([partial(gymnasium.make, "Ant-v5")] * workers)
    env.reset(seed=0)
    still = 0.0 * env.action_space.sample()

    def step() -> int:
        env.step(still)
        return workers

    return Contender(Key("gymnasium_ant", workers, workers), step, env.close)


def available() -> tuple[list[Peer], dict[str, str]]:
    """Return the peers that can run on this machine, and by name the reasons why the others cannot."""
    optional = {
        "dm_control": (dm_control, "dm_control", "torchrl_atr[suite]"),
        "gymnasium_ant": (gymnasium_ant, "gymnasium", "gymnasium[mujoco]"),
    }
    peers: list[Peer] = [torchrl_ant]
    skipped = {"mjbatch": SKIPPED_MJBATCH}
    for name, (peer, package, requirement) in optional.items():
        if sys.modules.get(package, package) is None or find_spec(package) is None:
            skipped[name] = f'not installed; pip install "{requirement}" adds it'
        else:
            peers.append(peer)
    return peers, skipped
