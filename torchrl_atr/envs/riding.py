"""``RidingEnv``: N robots riding N transporters as one natively batched TorchRL env."""

from __future__ import annotations

from typing import Any, Literal

import mujoco
import numpy as np
import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor
from torchrl.data import Binary, Composite, Unbounded
from torchrl.envs import EnvBase

from torchrl_atr.envs.models import ROBOTS, TRANSPORTERS, build_scene
from torchrl_atr.envs.physics.engine import Engine
from torchrl_atr.envs.profiles import Readings, get_readings
from torchrl_atr.envs.task import disturbances, observations, randomization as intrinsics, rewards
from torchrl_atr.envs.task.state import CONTROL_DT, RidingState, StateReader
from torchrl_atr.envs.task.terminations import fallen

PhysicsEngine = Literal["batch", "dm_control"]
_COMMAND_FEATURES = 2


class RidingEnv(EnvBase):
    """Quadrupeds riding tilt-driven transporters.

    Each robot has its own intrinsic parameters (Table II), drawn anew at every reset. The env scores with the command it
    is given and echoes it; :class:`~torchrl_atr.envs.transforms.CommandCurriculum` usually draws it. Without a command
    it is zero. Partial resets (``_reset`` mask) touch only the rows they name.

    Args:
        robot: name of a registered robot.
        transporter: name of a registered transporter.
        num_envs: N.
        physics: ``"batch"`` (N robots, all CPUs) or ``"dm_control"`` (one robot, the reference).
        randomization: ``"train"`` or ``"test"`` range of Table II, or ``"off"``.
        profile: name of a profile, or :class:`~torchrl_atr.envs.profiles.Readings`.
        num_threads: physics threads; None for the CPUs this process may use.
        pushes: whether robot and platform are pushed every 3 s.
        seed: of intrinsics, initial states and pushes.

    Raises:
        UnknownNameError: for an unknown robot, transporter or profile.
        ValueError: for an impossible ``num_envs``, ``physics`` or ``randomization``, a NaN action or a misshapen command.

    Keys: ``action`` (N, 12) and ``command`` (N, 2) in; ``proprio`` (N, 44), ``command``, ``observation`` (N, 46),
    ``("privileged", "intrinsic")`` (N, 34), ``("privileged", "extrinsic")`` (N, 16), ``("reward_terms", name)`` and
    ``reward`` (N, 1), ``done``, ``terminated``, ``truncated`` (N, 1) out; float32, SI units.

    Example:
        >>> env = RidingEnv(num_envs=4, seed=0)
        >>> env.rollout(3)["next", "observation"].shape
        torch.Size([4, 3, 46])
    """

    batch_locked = True
    _has_frame_skip = True  # no attribute of ours may be taken for a frame skip

    def __init__(
        self,
        robot: str = "a1",
        transporter: str = "single_board",
        num_envs: int = 256,
        physics: PhysicsEngine = "batch",
        randomization: intrinsics.Randomization = "train",
        profile: str | Readings = "default",
        num_threads: int | None = None,
        pushes: bool = True,
        seed: int | None = None,
    ) -> None:
        if not isinstance(num_envs, int) or num_envs < 1:
            raise ValueError(f"num_envs={num_envs!r}: choose a whole number of robots, 1 or more")
        if randomization not in intrinsics.RANDOMIZATIONS:
            known = ", ".join(intrinsics.RANDOMIZATIONS)
            raise ValueError(f"unknown randomization {randomization!r}; choose one of {known}")
        super().__init__(device=torch.device("cpu"), batch_size=torch.Size([num_envs]))
        self.readings = get_readings(profile)
        self.scene = build_scene(ROBOTS.get(robot), TRANSPORTERS.get(transporter), self.readings)
        self.randomization = randomization
        self.pushes = pushes
        self.engine = _make_engine(physics, self, num_envs, num_threads)
        self.num_diverged = 0
        self._joints = len(self.scene.robot.joints)
        self._nominal = torch.tensor(self.scene.robot.q0, dtype=torch.float64)
        self._reader = StateReader(self.engine)
        self._push_every = round(disturbances.PUSH_INTERVAL / CONTROL_DT)
        self._steps = torch.zeros(num_envs, dtype=torch.long)
        self._previous_action = torch.zeros(num_envs, self._joints)
        self._emitted: dict[Any, Tensor] = {}
        self.rng = torch.Generator()
        self.set_seed(seed if seed is not None else int(torch.randint(2**31, ())))
        self._start(np.arange(num_envs))
        self._emitted = self._observe(self._reader.read(), torch.zeros(num_envs, _COMMAND_FEATURES))
        self._make_specs()

    @property
    def model(self) -> mujoco.MjModel:
        """The compiled nominal scene; keyframe 0, ``stand``, is the robot standing in q0."""
        return self.scene.model

    def _make_specs(self) -> None:
        n = self.batch_size[0]

        def flag() -> Binary:
            return Binary(n=1, shape=(n, 1), dtype=torch.bool)

        def values(size: int) -> Unbounded:
            return Unbounded((n, size), dtype=torch.float32)

        observation = Composite(shape=(n,))
        for key, value in self._emitted.items():
            observation[key] = values(value.shape[-1])
        for name in rewards.REWARD_TERMS:
            observation["reward_terms", name] = values(1)
        self.observation_spec = observation
        self.state_spec = Composite(command=values(_COMMAND_FEATURES), shape=(n,))
        self.action_spec = values(self._joints)
        self.reward_spec = values(1)
        self.full_done_spec = Composite(done=flag(), terminated=flag(), truncated=flag(), shape=(n,))

    def _set_seed(self, seed: int | None) -> None:
        if seed is not None:
            self.rng.manual_seed(int(seed))

    def _reset(self, tensordict: TensorDictBase | None = None, **kwargs: Any) -> TensorDictBase:
        n = self.batch_size[0]
        mask = None if tensordict is None else tensordict.get("_reset", None)
        chosen = torch.ones(n, dtype=torch.bool) if mask is None else mask.reshape(n)
        rows = chosen.nonzero().squeeze(-1).numpy()
        if len(rows):
            self._start(rows)
            command = self._command(tensordict)
            fresh = self._observe(self._reader.read(rows), command[chosen], rows)
            index = chosen.unsqueeze(-1)
            for key, value in fresh.items():
                self._emitted[key] = self._emitted[key].masked_scatter(index, value)
        return self._pack(self._emitted, terminated=torch.zeros(n, dtype=torch.bool), terms=None)

    def _start(self, rows: np.ndarray) -> None:
        """Fresh intrinsics and initial states for ``rows``."""
        n = len(rows)
        x_int = intrinsics.sample_intrinsics(n, self._joints, self.randomization, self.rng)
        qpos, qvel = disturbances.initial_state(self.scene, n, self.rng)
        self.engine.reset(rows, qpos, qvel, intrinsics.physical_parameters(x_int, self.scene, self.readings))
        if n == self.batch_size[0]:
            self.x_int = x_int
        else:
            self.x_int = self.x_int.clone()
            self.x_int[rows] = x_int
        self._steps[rows] = 0
        self._previous_action = self._previous_action.clone()
        self._previous_action[rows] = 0.0
        self._reader.forget(rows)

    def _step(self, tensordict: TensorDictBase) -> TensorDictBase:
        action, command = tensordict["action"].to(torch.float32), self._command(tensordict)
        if not torch.isfinite(action).all():
            bad = (~torch.isfinite(action)).any(-1).nonzero().squeeze(-1).tolist()
            raise ValueError(f"'action' is not finite for env ids {bad[:8]}; check the policy that wrote it")
        self._push()
        targets = self._nominal + self.scene.robot.action_scale * action
        self.engine.step(targets.numpy())
        state = self._reader.read()
        diverged = torch.from_numpy(self.engine.diverged)
        self.num_diverged += int(diverged.sum())
        terminated = fallen(state, self.scene, self.readings) | diverged
        context = rewards.RewardContext(
            state, command, action, self._previous_action, terminated, self.scene.robot, self.scene.transporter.size[2]
        )
        reward, terms = rewards.compute_rewards(
            context,
            scale=CONTROL_DT if self.readings.rewards_times_dt else 1.0,
            clip_to_positive=self.readings.positive_rewards,
        )
        self._previous_action = action
        self._steps += 1
        self._emitted = self._observe(state, command)
        return self._pack(self._emitted, terminated=terminated, terms=terms).set("reward", reward)

    def _push(self) -> None:
        if self.pushes:
            due = (self._steps > 0) & (self._steps % self._push_every == 0)
            if due.any():
                disturbances.push(self.engine, due.nonzero().squeeze(-1).numpy(), self.rng)

    def _command(self, tensordict: TensorDictBase | None) -> Tensor:
        shape = (*self.batch_size, _COMMAND_FEATURES)
        command = None if tensordict is None else tensordict.get("command", None)
        if command is None:
            return torch.zeros(shape)
        if command.shape != torch.Size(shape):
            raise ValueError(f"'command' has shape {tuple(command.shape)}; this env needs {shape}: (c_v, c_omega)")
        return command.to(torch.float32)

    def _observe(self, state: RidingState, command: Tensor, rows: np.ndarray | slice = slice(None)) -> dict[Any, Tensor]:
        proprio = observations.proprio(state, self._previous_action[rows], self.readings)
        return {
            "proprio": proprio,
            "command": command.clone(),
            "observation": torch.cat([proprio, command], -1),
            ("privileged", "intrinsic"): self.x_int[rows],
            ("privileged", "extrinsic"): observations.extrinsic(state),
        }

    def _pack(self, observed: dict[Any, Tensor], terminated: Tensor, terms: dict[str, Tensor] | None) -> TensorDict:
        n = self.batch_size[0]
        terminated = terminated.unsqueeze(-1)
        out = TensorDict(
            {
                "proprio": observed["proprio"],
                "command": observed["command"],
                "observation": observed["observation"],
                "privileged": {
                    "intrinsic": observed["privileged", "intrinsic"],
                    "extrinsic": observed["privileged", "extrinsic"],
                },
                "reward_terms": terms or {name: torch.zeros(n, 1) for name in rewards.REWARD_TERMS},
                "terminated": terminated,
                "truncated": torch.zeros_like(terminated),
                "done": terminated.clone(),
            },
            batch_size=self.batch_size,
        )
        return out

    def get_state(self) -> TensorDict:
        """Everything :meth:`set_state` needs to continue from here, on either engine (float64 simulation state)."""
        state = {name: torch.from_numpy(value) for name, value in self.engine.get_state().items()}
        own = {"x_int": self.x_int, "previous_action": self._previous_action, "steps": self._steps}
        own["command"] = self._emitted["command"]
        return TensorDict({**state, **{k: v.clone() for k, v in own.items()}}, batch_size=self.batch_size)

    def set_state(self, state: TensorDictBase) -> None:
        """Restores a state of :meth:`get_state`: intrinsic parameters, simulation state and bookkeeping.

        Raises:
            KeyError: if an entry is missing.
            ValueError: if an entry's shape does not fit this env.
        """
        if state.batch_size != self.batch_size:
            raise ValueError(f"the state is of {tuple(state.batch_size)} robots; this env has {tuple(self.batch_size)}")
        self.x_int = state["x_int"].clone()
        self._previous_action = state["previous_action"].clone()
        self._steps = state["steps"].clone()
        rows = np.arange(self.batch_size[0])
        parameters = intrinsics.physical_parameters(self.x_int, self.scene, self.readings)
        arrays = {key: value.numpy() for key, value in state.items()}
        self.engine.reset(rows, arrays["qpos"], arrays["qvel"], parameters)
        self.engine.set_state(arrays)
        self._reader.forget()
        self._emitted = self._observe(self._reader.read(), state["command"])


def _make_engine(physics: str, env: RidingEnv, num_envs: int, num_threads: int | None) -> Engine:
    if physics == "batch":
        from torchrl_atr.envs.physics.batch import BatchEngine

        return BatchEngine(env.scene, num_envs, env.readings, num_threads)
    if physics == "dm_control":
        if num_envs != 1:
            raise ValueError(f"physics='dm_control' simulates one robot; num_envs={num_envs} needs physics='batch'")
        from torchrl_atr.envs.physics.dmc import DmControlEngine  # slow to import: never on the training path

        return DmControlEngine(env.scene, env.readings)
    raise ValueError(f"unknown physics {physics!r}; choose 'batch' or 'dm_control'")
