"""Terms of a task on N robots: rewards, terminations and observations from an engine's tensors."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import torch
from tensordict import NestedKey
from torch import Tensor

from torchrl_atr._compilation import compile_methods
from torchrl_atr.envs.tasks import memory_terms
from torchrl_atr.envs.tasks.context import StepContext
from torchrl_atr.envs.tasks.finite import all_finite
from torchrl_atr.envs.tasks.observation_terms import Observations
from torchrl_atr.envs.tasks.reward_terms import RewardFunction
from torchrl_atr.envs.tasks.sensor_errors import Draw, GroupErrors, columns_of
from torchrl_atr.envs.tasks.state import QuadrupedState, SimulationSnapshot, StateExtractor
from torchrl_atr.envs.tasks.task import Task
from torchrl_atr.envs.tasks.term_checks import try_term

Observed = dict[NestedKey, Tensor]
Memory = dict[str, Tensor]
Errors = Mapping[NestedKey, Draw]
"""Sensor errors drawn for a step, by the key of the group."""
DIVERGED = "diverged"
"""Cause of an early end besides the task's terminations: the simulation failed, or a value is not finite."""


@dataclass
class StepOutcome:
    """Outcome of a control step.

    Attributes:
        reward: (N, 1).
        terms: the weighted reward terms by name, (N, 1) each.
        terminated: (N,) bool.
        causes: which of :attr:`TaskTerms.causes` ended an episode, (causes, N) bool.
        observed: observations by key, (N, features) each, by key.
        finite: whether all of these are finite, () bool.
    """

    reward: Tensor
    terms: dict[str, Tensor]
    terminated: Tensor
    causes: Tensor
    observed: Observed
    finite: Tensor


class TaskTerms:
    """Terms of a task, checked once; its methods are functions of their arguments alone.

    Args:
        task: owner of the terms.
        extractor: of states.
        compiled: whether :meth:`first` and :meth:`evaluate` are compiled (``compile_methods``).

    Attributes:
        rewards: the terms, and their sum.
        observations: the groups of terms.
        causes: causes of early ends, by name.
        no_memory: the memory of standing robots, by name, (N, size) each.

    Raises:
        InputError: names a term that cannot be used.
    """

    def __init__(self, task: Task, extractor: StateExtractor, compiled: bool = False) -> None:
        self.task, self.extractor, self.compiled = task, extractor, compiled
        self.scene = extractor.engine.scene
        self.joints = len(self.scene.robot.joints)
        n = extractor.engine.num_envs
        idle = torch.zeros(n, self.joints, dtype=torch.float32)
        context = self._context(
            extractor.read(), torch.zeros(n, len(task.command), dtype=torch.float32), idle, idle, {}
        )
        memory_terms.check(task.memory, context)
        context.memory = self.no_memory = memory_terms.started(task.memory, context)
        for name, termination in task.terminations.items():
            try_term(f"the termination {name!r}", termination, context, tuple(context.terminated.shape), torch.bool)
        self.rewards = RewardFunction(task.rewards, context, task.tracking_rewards)
        self.observations = Observations(task.observations, context)
        self._columns = {key: columns_of(sizes) for key, sizes in self.observations.sizes.items()}
        self.causes = (DIVERGED, *task.terminations)
        self._compile()

    def _compile(self) -> None:
        if self.compiled:
            compile_methods(self, "evaluate", short=True)
            compile_methods(self, "first", short=True, any_rows=True)  # any number of robots resets

    def __getstate__(self) -> dict[str, Any]:
        """Return the state without compiled functions, which cannot be pickled: a copy compiles its own."""
        return {name: value for name, value in vars(self).items() if name not in ("evaluate", "first")}

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update(state)
        self._compile()

    def _context(
        self,
        state: QuadrupedState,
        command: Tensor,
        action: Tensor,
        previous_action: Tensor,
        memory: Memory,
        errors: Errors | None = None,
    ) -> StepContext:
        nobody = torch.zeros(len(command), dtype=torch.bool)
        task, drawn = self.task, errors or {}
        sensors = {key: GroupErrors(self._columns[key], **draw) for key, draw in drawn.items()}
        return StepContext(
            state,
            command,
            action,
            previous_action,
            nobody,
            self.scene,
            task.interpretation,
            memory,
            task.observations,
            sensors,
        )

    def first(
        self, snapshot: SimulationSnapshot, command: Tensor, x_int: Tensor, errors: Errors
    ) -> tuple[Observed, Tensor, Memory, Observed]:
        """Return observations, what the next state differentiates, memory and exact values at the start of episodes.

        A function of the arguments alone, which can be compiled.
        """
        state, differentiated = self.extractor.interpret(snapshot, None)
        action = torch.zeros(len(x_int), self.joints, dtype=torch.float32)
        context = self._context(state, command, action, action, {}, errors)
        context.memory = memory = memory_terms.started(self.task.memory, context)
        observed, exact = self._observed(context, x_int)
        return observed, differentiated, memory, exact

    def evaluate(
        self,
        snapshot: SimulationSnapshot,
        differentiated: Tensor,
        action: Tensor,
        previous_action: Tensor,
        memory: Memory,
        command: Tensor,
        x_int: Tensor,
        diverged: Tensor,
        errors: Errors,
    ) -> tuple[StepOutcome, Tensor, Memory, Observed]:
        """Return outcome, what the next state differentiates, memory and exact values after a control step.

        A function of the arguments alone, which can be compiled.
        """
        state, differentiated = self.extractor.interpret(snapshot, differentiated)
        context = self._context(state, command, action, previous_action, memory, errors)
        context.terminated = diverged
        context.memory = memory = memory_terms.updated(self.task.memory, context)
        finite = torch.isfinite(state.position.sum(-1) + state.joint_velocity.sum(-1))
        terminations = self.task.terminations.values()
        causes = torch.stack([diverged | ~finite, *(termination(context) for termination in terminations)])
        context.terminated = causes.any(0)
        reward, terms = self.rewards(context)
        observed, exact = self._observed(context, x_int)
        finite = all_finite([*observed.values(), terms, reward])
        named = dict(zip(self.rewards.terms, terms.unbind()))
        outcome = StepOutcome(reward, named, context.terminated, causes, observed, finite)
        return outcome, differentiated, memory, exact

    def observe(self, command: Tensor, action: Tensor, memory: Memory, x_int: Tensor) -> Observed:
        """Return the present observations of all robots without sensor errors, by key, (N, features) each, SI units."""
        return self._observed(self._context(self.extractor.read(), command, action, action, memory), x_int)[0]

    def _observed(self, context: StepContext, x_int: Tensor) -> tuple[Observed, Observed]:
        """Return the observations, and the exact values of the groups that are observed with errors."""
        groups = self.observations(context)
        exact = {key: groups[key] for key in context.errors}
        groups.update({key: errors(exact[key]) for key, errors in context.errors.items()})
        observation = torch.cat([groups["proprio"], context.command], -1)  # o_t is proprioception and the command
        own = {"command": context.command.clone(), ("privileged", "intrinsic"): x_int, "observation": observation}
        return {**groups, **own}, exact
