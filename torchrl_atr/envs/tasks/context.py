"""Input of the terms of a task."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from tensordict import NestedKey
from torch import Tensor

from torchrl_atr.envs.interpretation import Interpretation
from torchrl_atr.envs.models.robot import RobotSpec
from torchrl_atr.envs.models.scene import Scene
from torchrl_atr.envs.tasks.sensor_errors import GroupErrors


@dataclass
class StepContext:
    """Control step of N robots: the input of reward, observation, termination and memory terms.

    At the start of an episode the actions are zero and ``terminated`` is false.

    Attributes:
        state: after the step, a :class:`~torchrl_atr.envs.tasks.state.QuadrupedState` or the task's own subclass of it.
        command: in force during the step, (N, C).
        action: a_t, (N, 12).
        previous_action: a_{t-1}, (N, 12).
        terminated: early terminations, (N,) bool.
        scene: robot, support and their compiled nominal model.
        interpretation: answers to the paper's open questions.
        memory: values of the memory terms, by name, (N, size) each; memory terms see the step before.
        observations: the task's groups of observation terms, by key and name; for :meth:`sensed`.
        errors: of the sensors at this step, by the key of the group; exact groups are left out.
    """

    state: Any
    command: Tensor
    action: Tensor
    previous_action: Tensor
    terminated: Tensor
    scene: Scene
    interpretation: Interpretation = field(default_factory=Interpretation)
    memory: Mapping[str, Tensor] = field(default_factory=dict)
    observations: Mapping[NestedKey, Mapping[str, Any]] = field(default_factory=dict)
    errors: Mapping[NestedKey, GroupErrors] = field(default_factory=dict)

    @property
    def robot(self) -> RobotSpec:
        """Spec of the robot."""
        return self.scene.robot

    def sensed(self, name: str, key: NestedKey = "proprio") -> Tensor:
        """Return an observation term as observed: with noise, bias and delay, (N, D).

        Memory terms that stand for a computation on the robot, such as dead reckoning, read this and not the state.

        Args:
            name: of the term.
            key: of its group.

        Raises:
            KeyError: if the task has no such term.
        """
        exact = self.observations[key][name].function(self)
        if key not in self.errors:
            return exact
        errors = self.errors[key]
        return errors(exact, errors.columns[name])
