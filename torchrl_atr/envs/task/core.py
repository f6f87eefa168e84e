"""``RidingTask``: the task over an engine, without TorchRL or dm_control; both front ends drive it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from torchrl_atr._checks import check_choice, check_flag, check_number
from torchrl_atr._compilation import compile_methods
from torchrl_atr._errors import InputError
from torchrl_atr._inference import keeps_normal_tensors
from torchrl_atr.envs.physics.engine import Engine
from torchrl_atr.envs.profiles import Readings
from torchrl_atr.envs.task import disturbances, observations
from torchrl_atr.envs.task import randomization as intrinsics
from torchrl_atr.envs.task.guard import all_finite, as_float32, bad_rows
from torchrl_atr.envs.task.outlook import outlook
from torchrl_atr.envs.task.reward_terms import TERMINATION, RewardFunction, RewardTerm
from torchrl_atr.envs.task.rewards import RIDING_REWARDS
from torchrl_atr.envs.task.rotations import rotate_back
from torchrl_atr.envs.task.state import CONTROL_DT, Readout, RidingState, StateReader
from torchrl_atr.envs.task.terminations import fallen

ACTION_LIMIT = 3.0
"""Bounds of the action specs, in units of the action scale: with 0.25 rad a unit, joint targets of q0 ± 0.75 rad.

The same for all joints, so that 0, the stand, is the middle of a squashed policy's range and left is right's mirror
image; the committed A1 policy stays within it in 99 of 100 steps. Beyond it, actions are carried out as they are; the
model clips joint targets at its control ranges, wherever they come from.
"""
COMMAND_FEATURES = ("speed", "yaw_rate")
"""What a command asks for: forward speed, m/s, and yaw rate, rad/s."""


@dataclass
class Outcome:
    """What a control step led to.

    Attributes:
        reward: (N, 1).
        terms: the weighted reward terms by name, (N, 1) each.
        terminated: (N,) bool.
        observed: observations by key, (N, features) each, as :meth:`RidingTask.observe` gives them.
        finite: whether all of these are numbers, () bool.
    """

    reward: Tensor
    terms: dict[str, Tensor]
    terminated: Tensor
    observed: dict[Any, Tensor]
    finite: Tensor


class RidingTask:
    """N robots' episodes: intrinsics, initial states, pushes, actions, rewards, terminations, observations.

    A control step is :meth:`act`, then the engine's ``advance``, then :meth:`judge`.

    Args:
        engine: either engine.
        readings: the paper's open points.
        randomization: ``"train"`` or ``"test"`` range of Table II, or ``"off"``.
        pushes: whether robot and platform are pushed every 3 s.
        rng: source of intrinsics, initial states and pushes.
        moving_start: share of the episodes that start at part of the commanded speeds.
        retry: share of the falls after which the same robot, with the intrinsics it fell with, tries again.
        compiled: whether what a step computes from the simulation is compiled (``compile_methods``).
        rewards: the terms of the reward by name.

    Attributes:
        rewards: the terms, and their sum.
        x_int: scaled intrinsic parameters, (N, 34).
        previous_action: a_{t-1}, (N, 12), zero at the start of an episode.
        odometry: body velocity by dead reckoning since the start of the episode, body frame, m/s, (N, 3).
        steps: control steps since the start of the episode, (N,).
        fell: whether the last control step ended the episode, (N,) bool.
        num_diverged: robots that have failed so far, counted by whoever drives the task.

    Raises:
        ValueError: for an unknown ``randomization``, a share outside [0, 1], or ``compiled`` without a C++ compiler.
    """

    @keeps_normal_tensors
    def __init__(
        self,
        engine: Engine,
        readings: Readings,
        randomization: intrinsics.Randomization,
        pushes: bool,
        rng: torch.Generator,
        moving_start: float = 0.0,
        retry: float = 0.0,
        compiled: bool = False,
        rewards: Mapping[str, RewardTerm] = RIDING_REWARDS,
    ) -> None:
        self.moving_start = check_number("moving_start", moving_start, 0.0, 1.0)
        self.retry = check_number("retry", retry, 0.0, 1.0)
        check_choice("randomization", randomization, intrinsics.RANDOMIZATIONS)
        check_flag("pushes", pushes)
        check_flag("compiled", compiled)
        self.engine, self.scene, self.readings = engine, engine.scene, readings
        self.randomization, self.pushes, self.rng = randomization, pushes, rng
        self.num_diverged = 0
        self.joints = len(self.scene.robot.joints)
        n = engine.num_envs
        self._nominal = torch.tensor(self.scene.robot.q0, dtype=torch.float64)
        self._reader = StateReader(engine)
        self._push_every = round(disturbances.PUSH_INTERVAL / CONTROL_DT)
        self.steps = torch.zeros(n, dtype=torch.long)
        self.fell = torch.zeros(n, dtype=torch.bool)
        self.previous_action = torch.zeros(n, self.joints, dtype=torch.float32)
        self.odometry = torch.zeros(n, 3, dtype=torch.float32)
        self.x_int = intrinsics.sample_intrinsics(n, self.joints, "off", rng)
        self.rewards = RewardFunction(rewards, self.scene, readings, self._reader.read())
        self.compiled = compiled
        self._compile()
        self.begin(np.arange(n))

    def _compile(self) -> None:
        if self.compiled:
            compile_methods(self, "_assess", short=True)
            compile_methods(self, "_open", short=True, any_rows=True)  # any number of robots begins

    def __getstate__(self) -> dict[str, Any]:
        """All but compiled functions, which cannot be pickled: a copy compiles its own."""
        return {name: value for name, value in vars(self).items() if name not in ("_assess", "_open")}

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update(state)
        self._compile()

    @keeps_normal_tensors
    @torch.no_grad()
    def begin(self, rows: NDArray[np.int64], command: Tensor | None = None) -> dict[Any, Tensor]:
        """Starts episodes of ``rows`` with fresh intrinsics and initial states; leaves the others alone.

        A robot that is hard to keep up has short episodes: drawn anew each time, such robots would hardly be seen. With
        ``retry`` some of those that fell keep their intrinsics.

        Args:
            rows: (n,) integers.
            command: (c_v, c_ω) that those episodes start with, (n, 2); read by moving starts. None for zero.

        Returns:
            What those rows observe, as :meth:`observe` gives it for all.
        """
        n, index = len(rows), torch.from_numpy(rows)
        x_int = intrinsics.sample_intrinsics(n, self.joints, self.randomization, self.rng)
        if self.retry > 0.0:
            again = self.fell[index] & (torch.rand(n, generator=self.rng, dtype=torch.float32) < self.retry)
            x_int = torch.where(again.unsqueeze(-1), self.x_int[index], x_int)
        speeds = None
        if self.moving_start > 0.0 and command is not None:
            speeds = disturbances.initial_speeds(command.double().numpy(), self.moving_start, self.rng)
        qpos, qvel = disturbances.initial_state(self.scene, n, self.rng, speeds)
        self.engine.reset(rows, qpos, qvel, intrinsics.physical_parameters(x_int, self.scene, self.readings))
        command = torch.zeros(n, len(COMMAND_FEATURES), dtype=torch.float32) if command is None else command
        observed, velocities, odometry = self._open(self._reader.gather(rows), command, x_int)
        self._reader.velocities[index] = velocities
        # out of place: callers may hold what was handed out before
        self.x_int = self.x_int.index_copy(0, index, x_int)
        self.odometry = self.odometry.index_copy(0, index, odometry)
        self.previous_action = self.previous_action.index_fill(0, index, 0.0)
        self.steps, self.fell = self.steps.index_fill(0, index, 0), self.fell.index_fill(0, index, False)
        return observed

    def _open(self, readout: Readout, command: Tensor, x_int: Tensor) -> tuple[dict[Any, Tensor], Tensor, Tensor]:
        """Observations, velocities and odometry of episodes that start: a function of the arguments alone."""
        state, velocities = self._reader.interpret(readout, None)
        # a moving start stands for a ride that began earlier, its odometry with it
        odometry = rotate_back(state.rotation, state.velocity)
        action = torch.zeros(len(x_int), self.joints, dtype=torch.float32)
        return self._observed(state, command, action, odometry, x_int), velocities, odometry

    @keeps_normal_tensors
    def act(self, action: Tensor) -> None:
        """Opens a control step: pushes that are due, then the joint targets q0 + scale · action.

        Args:
            action: (N, 12).

        Raises:
            InputError: for a wrong shape, or an action that is not finite in float32.
        """
        shape, remedy = tuple(self.previous_action.shape), "check the policy that wrote it"
        single = as_float32("action", action.detach(), shape, "one value per joint", remedy)
        self._push()
        self._action = single.clone()  # callers reuse their buffers
        self.engine.command((self._nominal + self.scene.robot.action_scale * self._action).numpy())

    @keeps_normal_tensors
    @torch.no_grad()
    def judge(self, command: Tensor) -> Outcome:
        """Closes a control step, after the engine advanced.

        Args:
            command: (c_v, c_ω) in force during the step, (N, 2).

        Returns:
            Reward, terms, terminations and observations of all robots.
        """
        diverged = self.engine.diverged
        if diverged.any():  # what came before is no state to take differences to
            self._reader.forget(diverged.nonzero()[0])
        before = self._reader.velocities, self._action, self.previous_action, self.odometry
        outcome, self._reader.velocities, self.odometry = self._assess(
            self._reader.gather(), *before, command, self.x_int, torch.from_numpy(diverged)
        )
        self.previous_action = self._action
        self.steps, self.fell = self.steps + 1, outcome.terminated
        return outcome

    def _assess(
        self,
        readout: Readout,
        velocities: Tensor,
        action: Tensor,
        previous_action: Tensor,
        odometry: Tensor,
        command: Tensor,
        x_int: Tensor,
        diverged: Tensor,
    ) -> tuple[Outcome, Tensor, Tensor]:
        """Outcome, velocities and odometry after a step: a function of the arguments alone, which can be compiled."""
        state, velocities = self._reader.interpret(readout, velocities)
        terminated = fallen(state, self.scene, self.readings) | diverged
        reward, terms = self.rewards(self.rewards.context(state, command, action, previous_action, terminated))
        odometry = observations.dead_reckoning(odometry, state)
        observed = self._observed(state, command, action, odometry, x_int)
        finite = all_finite([*observed.values(), terms, reward])
        named = dict(zip(self.rewards.terms, terms.unbind()))
        return Outcome(reward, named, terminated, observed, finite), velocities, odometry

    def end(self, rows: list[int], outcome: Outcome) -> None:
        """Ends the episodes of ``rows``, in which no step can be scored: all that is left is r17.

        Args:
            rows: which robots.
            outcome: of the step, changed in place.
        """
        for term in outcome.terms.values():
            term[rows] = 0.0
        outcome.reward[rows] = self.rewards.termination_cost
        if TERMINATION in outcome.terms:
            outcome.terms[TERMINATION][rows] = self.rewards.termination_cost
        outcome.terminated[rows] = True
        self.fell = outcome.terminated

    def observe(self, command: Tensor) -> dict[Any, Tensor]:
        """What all robots observe.

        Args:
            command: (N, 2).

        Returns:
            Observations by key, (N, features) each, raw SI units.
        """
        return self._observed(self._reader.read(), command, self.previous_action, self.odometry, self.x_int)

    def _observed(
        self, state: RidingState, command: Tensor, action: Tensor, odometry: Tensor, x_int: Tensor
    ) -> dict[Any, Tensor]:
        proprio = observations.proprio(state, action, self.readings)
        return {
            "proprio": proprio,
            "command": command.clone(),
            "speeds": state.speeds,
            "odometry": odometry,
            "observation": torch.cat([proprio, command], -1),
            ("privileged", "intrinsic"): x_int,
            ("privileged", "extrinsic"): observations.extrinsic(state, self.readings),
            ("privileged", "outlook"): outlook(state, command),
        }

    def _push(self) -> None:
        if self.pushes:
            steps = self.steps.numpy()
            due = np.flatnonzero((steps % self._push_every == 0) & (steps > 0))
            if len(due):
                disturbances.push(self.engine, due, self.rng)

    def get_state(self) -> dict[str, Tensor]:
        """Simulation state (float64) and bookkeeping, copied."""
        simulation = {name: torch.from_numpy(value) for name, value in self.engine.get_state().items()}
        return {**simulation, **{name: value.clone() for name, value in self._bookkeeping().items()}}

    def _bookkeeping(self) -> dict[str, Tensor]:
        names = ("x_int", "previous_action", "odometry", "steps", "fell")
        return {name: getattr(self, name) for name in names}

    @keeps_normal_tensors
    def set_state(self, state: dict[str, Tensor]) -> None:
        """Restores a :meth:`get_state`, of either engine: intrinsic parameters, simulation and bookkeeping.

        Raises:
            KeyError: if an entry is missing.
            ValueError: if an entry's shape does not fit.
        """
        for name, value in self.get_state().items():
            if name not in state:
                raise KeyError(f"the state lacks {name!r}; pass what get_state() returned")
            if state[name].shape != value.shape:
                got, needed = tuple(state[name].shape), tuple(value.shape)
                raise ValueError(f"state entry {name!r} has shape {got}; this env needs {needed}")
        own = {name: state[name].to(value.dtype, copy=True) for name, value in self._bookkeeping().items()}
        for name in ("x_int", "previous_action", "odometry"):
            if bad := bad_rows(own[name]):
                raise InputError(f"state entry {name!r} is not finite in float32 for env ids {bad[:8]}; correct it")
        vars(self).update(own)
        arrays = {name: value.numpy() for name, value in state.items()}
        parameters = intrinsics.physical_parameters(self.x_int, self.scene, self.readings)
        self.engine.reset(np.arange(self.engine.num_envs), arrays["qpos"], arrays["qvel"], parameters)
        self.engine.set_state(arrays)
        self._reader.forget()
