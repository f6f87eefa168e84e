"""``EpisodeRunner``: a task on an engine, without TorchRL or dm_control; both front ends use it."""

from __future__ import annotations

from collections.abc import Mapping

import torch
from torch import Tensor

from torchrl_atr._checks import check_choice, check_flag, check_number
from torchrl_atr._errors import InputError
from torchrl_atr._inference import keeps_normal_tensors
from torchrl_atr.envs.physics.engine import Engine
from torchrl_atr.envs.tasks.events import Disturbance
from torchrl_atr.envs.tasks.finite import as_float32, bad_rows, not_finite
from torchrl_atr.envs.tasks.intrinsic_parameters import RANDOMIZATIONS, Intrinsics, Randomization
from torchrl_atr.envs.tasks.memory_terms import MemoryTermError
from torchrl_atr.envs.tasks.per_episode import PerEpisode
from torchrl_atr.envs.tasks.reconfiguration import Changes
from torchrl_atr.envs.tasks.reward_terms import TERMINATION
from torchrl_atr.envs.tasks.sensor_errors import SensorErrors
from torchrl_atr.envs.tasks.task import Task
from torchrl_atr.envs.tasks.task_checks import checked_start
from torchrl_atr.envs.tasks.terms import DIVERGED, Memory, Observed, StepOutcome, TaskTerms

ACTION_LIMIT = 3.0
"""Bounds of the action specs, in units of the action scale: with 0.25 rad per unit, joint targets of q0 ± 0.75 rad.

The same for all joints, so that 0, the stand, is the middle of a squashed policy's range and left is right's mirror
image; the committed A1 policy stays within it in 99 of 100 steps. Actions beyond it are applied as they are; the model
clips all joint targets at its control ranges.
"""
_BOOKKEEPING = ("x_int", "previous_action", "steps", "failed", "moving")


class EpisodeRunner:
    """Runner of N robots' episodes: intrinsics, initial states, disturbances, actions, rewards, observations.

    A control step is :meth:`apply_action`, then the engine's ``advance``, then :meth:`evaluate_step`.

    Args:
        task: read once, at construction.
        engine: of the task's scene, with the task's hook.
        randomization: ``"train"`` or ``"test"`` range of the intrinsics, or ``"off"``.
        rng: source of intrinsics, initial states, disturbances and sensor errors.
        failed_episode_replay: share of the failures after which the same robot, with the intrinsics it failed with,
            tries again.
        compiled: whether observations, rewards and terminations are compiled (``compile_methods``).

    Attributes:
        terms: rewards, terminations, observations and memory.
        intrinsics: components of x_int.
        ends: scaled ends of the ranges from which the next episodes draw it, (2, I).
        x_int: scaled intrinsic parameters, (N, I).
        previous_action: a_{t-1}, (N, 12), zero at the start of an episode.
        memory: values of the memory terms, by name, (N, size) each.
        moving: whether the episode started with part of the commanded speeds, (N,) bool.
        steps: control steps since the start of the episode, (N,).
        failed: whether the last control step ended the episode early, (N,) bool.
        causes: which of ``terms.causes`` did, (causes, N) bool.
        num_diverged: number of failures so far, counted by the front end.

    Raises:
        InputError: for an unknown ``randomization``, a share outside [0, 1], ``compiled`` without a C++ compiler, or a
            term that cannot be used; names it.
    """

    @keeps_normal_tensors
    def __init__(
        self,
        task: Task,
        engine: Engine,
        randomization: Randomization,
        rng: torch.Generator,
        failed_episode_replay: float = 0.0,
        compiled: bool = False,
    ) -> None:
        self.failed_episode_replay = check_number("failed_episode_replay", failed_episode_replay, 0.0, 1.0)
        check_choice("randomization", randomization, RANDOMIZATIONS)
        check_flag("compiled", compiled)
        self.task, self.engine, self.scene = task, engine, engine.scene
        self.rng = rng
        self.num_diverged = 0
        self.joints = len(self.scene.robot.joints)
        n = engine.num_envs
        self._nominal = torch.tensor(self.scene.robot.q0, dtype=torch.float64)
        self._reader = task.state_extractor(engine)
        self.steps = torch.zeros(n, dtype=torch.long)
        self.failed, self.moving = torch.zeros(2, n, dtype=torch.bool)
        self.previous_action = torch.zeros(n, self.joints, dtype=torch.float32)
        self.intrinsics = Intrinsics(task.intrinsics, self.scene)
        self.ends = self.intrinsics.ends(randomization)
        self.x_int = self.intrinsics.sample(n, "off", rng)
        self._disturbances = PerEpisode(task.disturbances, n)
        self.terms = TaskTerms(task, self._reader, compiled)
        self.causes = torch.zeros(len(self.terms.causes), n, dtype=torch.bool)
        self._check_names()
        self.memory: Memory = self.terms.no_memory
        observations = self.terms.observations
        self.sensor_errors = SensorErrors(observations.groups, observations.sizes, n, rng)
        self.start_episodes(torch.arange(n), torch.zeros(n, len(task.command), dtype=torch.float32))

    def _check_names(self) -> None:
        """Raise if a memory term has the name of another entry of the state."""
        for name in self.task.memory:
            if name in (*_BOOKKEEPING, *self.engine.live_state, *self._reader.unrecoverable, "command", "emitted"):
                raise MemoryTermError(f"the memory term {name!r} has the name of a state entry; give it another name")

    @keeps_normal_tensors
    @torch.no_grad()
    def start_episodes(self, rows: Tensor, command: Tensor) -> Observed:
        """Start episodes of ``rows`` with fresh intrinsics and initial states; leave the others alone.

        Robots with difficult intrinsics have short episodes, so that uniform sampling gives them few steps. With
        ``failed_episode_replay`` a share of those that failed keep their intrinsics.

        Args:
            rows: (n,) integers.
            command: initial command of those episodes, (n, C); read by moving starts.

        Returns:
            Observations of those rows, with sensor errors; keys as of :meth:`observe`.
        """
        n = len(rows)
        x_int = self.intrinsics.draw(n, self.ends, self.rng)
        if self.failed_episode_replay > 0.0:
            draw = torch.rand(n, generator=self.rng, dtype=torch.float32)
            again = self.failed[rows] & (draw < self.failed_episode_replay)
            x_int = torch.where(again.unsqueeze(-1), self.x_int[rows], x_int)
        begun = checked_start(self.task, self.task.reset(self.scene, command, self.rng), self.scene, n)
        self.engine.reset(rows, begun.qpos, begun.qvel, lambda fields: self.intrinsics.apply(fields, x_int))
        self._disturbances.begin(rows)
        errors = self.sensor_errors.start(rows)
        observed, differentiated, memory, exact = self.terms.first(self._reader.gather(rows), command, x_int, errors)
        self.sensor_errors.remember(exact, rows)
        self._reader.differentiated[rows] = differentiated
        # out of place: callers may hold tensors that were returned before
        self.x_int = self.x_int.index_copy(0, rows, x_int)
        self.memory = {name: value.index_copy(0, rows, memory[name]) for name, value in self.memory.items()}
        self.previous_action = self.previous_action.index_fill(0, rows, 0.0)
        self.moving = self.moving.index_copy(0, rows, begun.moving)
        self.steps, self.failed = self.steps.index_fill(0, rows, 0), self.failed.index_fill(0, rows, False)
        return {**observed, "moving_start": begun.moving.unsqueeze(-1)}

    @keeps_normal_tensors
    def apply_action(self, action: Tensor) -> None:
        """Begin a control step: disturbances that are due, then the joint targets q0 + scale · action.

        Args:
            action: (N, 12).

        Raises:
            InputError: for a wrong shape, or an action that is not finite in float32.
        """
        shape, remedy = tuple(self.previous_action.shape), "check the policy that wrote it"
        single = as_float32("action", action.detach(), shape, "one value per joint", remedy)
        self._disturb()
        self._action = single.clone()  # callers reuse their buffers
        self.engine.command(self._nominal + self.scene.robot.action_scale * self._action)

    @property
    def disturbances(self) -> Mapping[str, Disturbance]:
        """Disturbances of episodes that begin from now on, by name."""
        return self._disturbances.latest

    def _disturb(self) -> None:
        for disturbances, rows in self._disturbances:
            for name, disturbance in disturbances.items():
                due = ((self.steps % disturbance.steps == 0) & (self.steps > 0) & rows).nonzero().squeeze(-1)
                if len(due):
                    try:
                        disturbance.function(self.engine, due, self.rng)
                    except Exception as error:  # of the user's function
                        reason = f"{type(error).__name__}: {error}"
                        raise InputError(f"the disturbance {name!r} failed: {reason}") from error

    @keeps_normal_tensors
    def change(self, changes: Changes) -> None:
        """Change randomisation, sensors and disturbances of every robot from its next episode on."""
        if changes.ends is not None:
            self.ends = changes.ends
        if changes.observations is not None:
            self.sensor_errors.set(changes.observations)
        if changes.disturbances is not None:
            self._disturbances.set(changes.disturbances)

    @keeps_normal_tensors
    @torch.no_grad()
    def evaluate_step(self, command: Tensor) -> StepOutcome:
        """End a control step, after the engine advanced.

        Args:
            command: in force during the step, (N, C).

        Returns:
            Reward, terms, terminations and observations of all robots.
        """
        diverged = self.engine.diverged
        if diverged.any():  # the previous state is not valid for differences
            self._reader.forget(diverged.nonzero().squeeze(-1))
        before = self._reader.differentiated, self._action, self.previous_action, self.memory
        outcome, self._reader.differentiated, self.memory, exact = self.terms.evaluate(
            self._reader.gather(), *before, command, self.x_int, diverged, self.sensor_errors.step()
        )
        self.sensor_errors.remember(exact)
        self.previous_action = self._action
        self.steps, self.failed, self.causes = self.steps + 1, outcome.terminated, outcome.causes
        outcome.observed["moving_start"] = self.moving.unsqueeze(-1)
        return outcome

    def terminate_failed(self, outcome: StepOutcome) -> dict[int, str]:
        """End the episodes of robots whose simulation, observation or reward failed in a step.

        Their reward is the cost of termination alone, and observations that are not finite become zero.

        Args:
            outcome: of the step, changed in place.

        Returns:
            The reason by robot.
        """
        failed = dict.fromkeys(self.engine.diverged.nonzero().squeeze(-1).tolist(), "its simulation diverged")
        if not outcome.finite:
            terms = {("reward_terms", name): term for name, term in outcome.terms.items()}
            unnumbered = not_finite({**outcome.observed, **terms, "reward": outcome.reward})
            failed |= {row: f"{name!r} is not finite" for row, name in unnumbered.items()}
        if failed:
            rows = list(failed)
            for key, value in outcome.observed.items():
                outcome.observed[key] = value.clone()  # some are views of the runner's own
                outcome.observed[key][rows] = value[rows].nan_to_num(0.0, 0.0, 0.0)
            self._terminate(rows, outcome)
        return failed

    def _terminate(self, rows: list[int], outcome: StepOutcome) -> None:
        for term in outcome.terms.values():
            term[rows] = 0.0
        outcome.reward[rows] = self.terms.rewards.termination_cost
        if TERMINATION in outcome.terms:
            outcome.terms[TERMINATION][rows] = self.terms.rewards.termination_cost
        outcome.terminated[rows] = True
        outcome.causes[self.terms.causes.index(DIVERGED), rows] = True
        self.failed = outcome.terminated

    def observe(self, command: Tensor) -> Observed:
        """Return the present observations of all robots, without sensor errors.

        Args:
            command: (N, C).

        Returns:
            Observations by key, (N, features) each, raw SI units.
        """
        observed = self.terms.observe(command, self.previous_action, self.memory, self.x_int)
        return {**observed, "moving_start": self.moving.unsqueeze(-1)}

    def get_state(self) -> dict[str, Tensor]:
        """Return simulation state (float64) and bookkeeping, copied."""
        own = {**self._bookkeeping(), **self._reader.unrecoverable}
        return {**self.engine.get_state(), **{name: value.clone() for name, value in own.items()}}

    def _bookkeeping(self) -> dict[str, Tensor]:
        own = {name: getattr(self, name) for name in _BOOKKEEPING}
        return {**own, **self.memory, **self.sensor_errors.state}

    @keeps_normal_tensors
    def set_state(self, state: dict[str, Tensor]) -> None:
        """Restore a :meth:`get_state`, of any engine: intrinsic parameters, simulation and bookkeeping.

        What the next state differentiates may be missing: differences then start from the present state.

        Raises:
            KeyError: if another entry is missing.
            ValueError: if an entry's shape does not fit.
        """
        previous = {name: state[name] for name in self._reader.unrecoverable if name in state}
        for name, value in self.get_state().items():
            if name in self._reader.unrecoverable and name not in previous:
                continue
            if name not in state:
                raise KeyError(f"the state lacks {name!r}; pass what get_state() returned")
            if state[name].shape != value.shape:
                got, needed = tuple(state[name].shape), tuple(value.shape)
                raise ValueError(f"state entry {name!r} has shape {got}; this env needs {needed}")
        own = {name: state[name].to(value.dtype, copy=True) for name, value in self._bookkeeping().items()}
        for name, value in {**own, **previous}.items():
            if value.ndim == 2 and (bad := bad_rows(value)):
                raise InputError(f"state entry {name!r} is not finite in float32 for env ids {bad[:8]}; correct it")
        for held in (self.memory, self.sensor_errors.state):
            held.update({name: own.pop(name) for name in list(held)})
        vars(self).update(own)
        rows = torch.arange(self.engine.num_envs)
        qpos, qvel = (state[name].double() for name in ("qpos", "qvel"))
        self.engine.reset(rows, qpos, qvel, lambda fields: self.intrinsics.apply(fields, self.x_int))
        self.engine.set_state(dict(state))
        self._reader.forget()
        for name, value in previous.items():
            self._reader.unrecoverable[name].copy_(value)
