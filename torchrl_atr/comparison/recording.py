"""Recording of the steps that a policy visits, on disk: what every estimator is trained and measured on."""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from tensordict import NestedKey, TensorDict, TensorDictBase
from torch import Tensor
from torchrl.envs.utils import step_mdp

from torchrl_atr._files import write_json
from torchrl_atr.comparison.options import CompareOptions, ComparisonError
from torchrl_atr.envs.physics import CONTROL_DT
from torchrl_atr.evaluation.access import (
    Component,
    command_owner,
    deterministic,
    extrinsic_components,
    intrinsic_names,
)
from torchrl_atr.evaluation.endurance import command_bounds, draw_commands
from torchrl_atr.evaluation.ride import MakeEnv, build_env
from torchrl_atr.modules import ROANetworks
from torchrl_atr.modules.estimators import IS_INIT, with_state

AGE = "ride_step"
"""Entry of a recording: control steps since the robot's ride began, (N, T, 1)."""
_ABOUT = "recording.json"


@dataclass(frozen=True)
class Recording:
    """Steps of N robots over T control steps, memory-mapped, and the names of their components.

    Attributes:
        data: (N, T): ``history``, ``observation``, the estimators' further inputs, ``is_init``, the next observation,
            the action, the intrinsic parameters and the extrinsic state, the latent z, and :data:`AGE`.
        training: number of robots for training, the first ones; the others are for validation.
        components: the extrinsic states.
        intrinsics: names of the intrinsic parameters.
    """

    data: TensorDictBase
    training: int
    components: tuple[Component, ...]
    intrinsics: tuple[str, ...]

    @property
    def train(self) -> TensorDictBase:
        """Steps of the robots for training, (n, T)."""
        return self.data[: self.training]

    @property
    def validation(self) -> TensorDictBase:
        """Steps of the other robots."""
        return self.data[self.training :]

    def check_holds(self, keys: Sequence[NestedKey], name: str, folder: str | Path = "the recording") -> None:
        """Check that an estimator and its losses find what they read.

        Raises:
            ComparisonError: naming the estimator, the entry and the remedy.
        """
        known = self.data.keys(True, True)
        missing = [key for key in keys if key not in known]
        if missing:
            raise ComparisonError(
                f"the estimator {name!r} reads {missing[0]!r}, which was not recorded ({folder} holds "
                f"{', '.join(map(str, known))}); leave it out, or compare it in another --output, where what the env "
                "has of it is recorded"
            )


@dataclass(frozen=True)
class Window:
    """Histories of another length than the recorded ones, made of the recorded observations.

    Attributes:
        length: H, observations of a history.
        current: whether o_t is the newest of them, not o_{t-1} (question A19).
        observation, history: entries of the observation and of its history.

    Example:
        >>> import torch
        >>> from tensordict import TensorDict
        >>> seen = torch.arange(6.0).reshape(1, 6, 1)
        >>> age = torch.tensor([0, 1, 2, 0, 1, 2]).reshape(1, 6, 1)
        >>> data = TensorDict({"observation": seen, AGE: age}, [1, 6])
        >>> rows, steps = torch.tensor([0, 0]), torch.tensor([2, 4])
        >>> Window(3, False, "observation", "history").take(data, rows, steps)["history"].squeeze(-1)
        tensor([[0., 0., 1.],
                [3., 3., 3.]])
    """

    length: int
    current: bool
    observation: NestedKey
    history: NestedKey

    def take(self, data: TensorDictBase, rows: Tensor, steps: Tensor) -> TensorDictBase:
        """Return some steps of a recording (N, T) with their histories; before a ride has H steps these begin with o_0.

        Args:
            data: with the observation and :data:`AGE`.
            rows: robots of the wanted steps.
            steps: their control steps; both shapes broadcast.
        """
        back = torch.arange(self.length, 0, -1) - int(self.current)
        rows, steps = torch.broadcast_tensors(rows, steps)
        before = torch.minimum(back, data[AGE][rows, steps])
        history = data[self.observation][rows.unsqueeze(-1), steps.unsqueeze(-1) - before]
        return data[rows, steps].set(self.history, history)


def take(data: TensorDictBase, rows: Tensor, steps: Tensor, window: Window | None) -> TensorDictBase:
    """Return some steps of a recording, with the recorded histories or those of ``window``."""
    return data[rows, steps] if window is None else window.take(data, rows, steps)


def load_recording(folder: Path) -> Recording:
    """Return the recording in a folder, which stays on disk."""
    about = json.loads((folder / _ABOUT).read_text(encoding="utf-8"))
    components = tuple(Component(*row) for row in about["components"])
    return Recording(TensorDict.load_memmap(folder), about["training"], components, tuple(about["intrinsics"]))


def record(
    networks: ROANetworks,
    make_env: MakeEnv,
    options: CompareOptions,
    folder: Path,
    further: Sequence[NestedKey] = (),
    tick: Callable[[], None] = lambda: None,
) -> Recording:
    """Record rides of the deployed policy, without exploration, on commands that change; robots that fall ride again.

    Robots for training also begin anew by themselves, after log-uniform times between a second and the whole recording:
    estimators have to see many intrinsic parameters, and long rides, too. Those for validation only do when they fall.

    Args:
        networks: of the policy.
        make_env: called as ``make_env(num_envs=n, seed=s)``.
        options: robots, seconds, seed and commands.
        folder: to write; it appears when the recording is complete.
        further: entries that some estimator reads; those that the env does not have are left out.
        tick: called after every step.

    Raises:
        ComparisonError: if the disk has no room for it.
    """
    bounds = command_bounds(make_env, options.max_speed, options.max_yaw_rate)
    lasts = max(1, round(options.command_seconds / CONTROL_DT))
    commands = draw_commands(bounds, -(-options.steps // lasts), options.robots, options.seed)
    policy = networks.deployed_policy()
    env = with_state(build_env(make_env, options.robots, options.seed), policy)
    owner, part = command_owner(env), folder.with_name(f"{folder.name}.part")
    shutil.rmtree(part, ignore_errors=True)
    owner.pin(commands[0])
    store: Any = None
    draw = torch.Generator().manual_seed(options.seed)
    with deterministic(policy):
        root = env.reset()
        age, lasting = torch.zeros(options.robots, 1, dtype=torch.int64), _lifetimes(options, draw)
        for index in range(options.steps):
            if (index + 1) % lasts == 0 and (index + 1) // lasts < len(commands):
                owner.pin(commands[(index + 1) // lasts])
            root = root.copy().update(policy(root.select(*policy.in_keys, strict=False)))
            step = env.step(root)
            over = (age + 1 >= lasting) | step["next", "done"].reshape(age.shape)
            kept = _kept(networks, step, age, further)
            if store is None:
                store = _room_for(kept, options.steps, part)
            store[:, index] = kept
            root = env.maybe_reset(step_mdp(step).set("truncated", over).set("done", over))
            age, lasting = (
                (age + 1).where(~over, torch.zeros_like(age)),
                lasting.where(~over, _lifetimes(options, draw)),
            )
            tick()
    about = {
        "training": options.training,
        "components": extrinsic_components(env, store[networks.keys.extrinsic].shape[-1]),
        "intrinsics": intrinsic_names(env, store[networks.keys.intrinsic].shape[-1]),
    }
    env.close(raise_if_closed=False)
    write_json(part / _ABOUT, about)
    os.replace(part, folder)
    return load_recording(folder)


def _lifetimes(options: CompareOptions, draw: torch.Generator) -> Tensor:
    """Return the steps after which each robot's next ride ends, (N, 1); endless for validation."""
    longest = torch.tensor(max(options.seconds, 1.0))
    seconds = longest ** torch.rand(options.robots, 1, generator=draw)
    seconds[options.training :] = torch.inf
    return seconds / CONTROL_DT


def _kept(networks: ROANetworks, step: TensorDictBase, age: Tensor, further: Sequence[NestedKey]) -> TensorDictBase:
    """Return what is recorded of a step, with its latent."""
    keys, encoder = networks.keys, networks.encoder_module
    following = ("next", *(keys.observation if isinstance(keys.observation, tuple) else (keys.observation,)))
    own = [keys.observation, keys.history, keys.intrinsic, keys.extrinsic, keys.action, *networks.estimator_inputs]
    # the latent is computed below, and the policy's hidden states are its own
    kept = step.select(*own, following, *(key for key in further if key != IS_INIT), strict=False)
    assert encoder is not None  # else there is no comparison
    latent = encoder(step.select(*encoder.in_keys))[keys.latent]
    return kept.set(keys.latent, latent).set(IS_INIT, age == 0).set(AGE, age)


def _room_for(step: TensorDictBase, steps: int, folder: Path) -> TensorDictBase:
    """Return a memory-mapped TensorDict of as many such steps; to write to a full disk would end the process."""
    size = sum(value.element_size() * value.numel() for value in step.values(True, True)) * steps
    folder.mkdir(parents=True)
    free = shutil.disk_usage(folder).free
    if size > 0.95 * free:
        raise ComparisonError(
            f"{folder}: the recording takes {size / 1e9:.1f} GB and {free / 1e9:.1f} GB are free; take fewer --robots "
            "or --seconds, or another --output"
        )
    return step.unsqueeze(1).expand(step.shape[0], steps).memmap_like(folder)
