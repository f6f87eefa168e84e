"""``Task``: observations, rewards, randomisation, resets and terminations as data that an env reads once."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from tensordict import NestedKey

from torchrl_atr._checks import check_kind
from torchrl_atr._registry import nearest
from torchrl_atr.envs.interpretation import Interpretation
from torchrl_atr.envs.models.robot import RobotSpec
from torchrl_atr.envs.models.support import Support
from torchrl_atr.envs.physics.engine import Engine
from torchrl_atr.envs.physics.hook import SubstepHook
from torchrl_atr.envs.tasks.events import Disturbance, Reset, Termination, stand
from torchrl_atr.envs.tasks.intrinsic_parameters import IntrinsicParameter
from torchrl_atr.envs.tasks.memory_terms import MemoryTerm
from torchrl_atr.envs.tasks.mirrors import Mirror
from torchrl_atr.envs.tasks.observation_terms import Group
from torchrl_atr.envs.tasks.reward_terms import RewardTerm
from torchrl_atr.envs.tasks.state import StateExtractor
from torchrl_atr.envs.tasks.task_checks import check_components, check_task
from torchrl_atr.envs.transforms.grid import CommandGrid


@dataclass(frozen=True)
class CommandSpace:
    """Components of a command, and the grid from which commands are drawn.

    Attributes:
        names: of its components.
        units: of them.
        grid: from which a curriculum draws them, and its bounds; None for a command that only your own transforms
            draw.
        mirror: its mirror image, which symmetric networks need.
        followed_by: names of the components of the extrinsic state that follow it, such as ``platform_velocity[0]``,
            one for each component; empty if the extrinsic state has no such components.

    Raises:
        InputError: if names or units are not tuples of strings of one length.

    Example:
        >>> len(CommandSpace(("speed", "yaw_rate"), ("m/s", "rad/s"), mirror=(1.0, -1.0)))
        2
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    grid: CommandGrid | None = None
    mirror: Mirror | None = None
    followed_by: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        check_components(self.names, self.units)
        check_kind("grid", self.grid, CommandGrid, "a CommandGrid", optional=True)

    def __len__(self) -> int:
        return len(self.names)


@dataclass(frozen=True)
class Task:
    """Task, read once by :class:`~torchrl_atr.envs.QuadrupedEnv` and :func:`~torchrl_atr.envs.suite.load_task`.

    Attributes:
        name: of the task.
        robot: spec of the robot.
        support: transporter or ground under the robot.
        command: components and distribution of the command.
        observations: by key, the terms that are concatenated there. ``proprio`` is needed; it and the command make up
            ``observation``. ``("privileged", "extrinsic")`` is the target of the extrinsic estimator, ``speeds`` the
            measured speeds that follow the command, per component.
        rewards: the terms of the reward by name. One called ``termination`` scores early terminations; failed
            simulations cost it.
        intrinsics: parameters that are drawn for every episode: ``("privileged", "intrinsic")``.
        terminations: functions that end an episode early, by name.
        reset: function that returns initial states.
        disturbances: periodic disturbances, by name.
        memory: quantities that are carried from step to step, by name.
        tracking_rewards: reward terms that a command curriculum scores, one for each component of the command.
        state_extractor: class that computes a state from an engine's tensors.
        substep_hook: class that acts on an engine before every substep; None for nothing.
        interpretation: answers to the paper's open questions.
        reward_schedule: factors by which a learner multiplies terms of the reward, by the term's name, as functions of
            the progress of training in [0, 1]. The env's rewards are those of :attr:`rewards` throughout.
        arguments: plain values from which :func:`~torchrl_atr.envs.tasks.make_task` makes a task of the same name and
            scene; empty for a task that is not registered.

    Add, drop or change a term by :meth:`replace`. Some fields depend on the answers to the paper's open questions: for
    another :attr:`interpretation`, use the argument ``profile`` of the task's function.

    Raises:
        InputError: for a field of another kind, or one that names a term that does not exist.

    Example:
        >>> from torchrl_atr.envs.tasks import RewardTerm, riding
        >>> task = riding("a1", "single_board")
        >>> slow = RewardTerm(lambda context: context.state.speeds[:, 0].abs(), weight=-0.1)
        >>> "slow" in task.replace(rewards={**task.rewards, "slow": slow}).rewards
        True
    """

    name: str
    robot: RobotSpec
    support: Support
    command: CommandSpace
    observations: Mapping[NestedKey, Group]
    rewards: Mapping[str, RewardTerm]
    intrinsics: Mapping[str, IntrinsicParameter] = field(default_factory=dict)
    terminations: Mapping[str, Termination] = field(default_factory=dict)
    reset: Reset = stand
    disturbances: Mapping[str, Disturbance] = field(default_factory=dict)
    memory: Mapping[str, MemoryTerm] = field(default_factory=dict)
    tracking_rewards: Sequence[str] = ()
    state_extractor: type[StateExtractor] = StateExtractor
    substep_hook: Callable[[Engine], SubstepHook] | None = None
    interpretation: Interpretation = field(default_factory=Interpretation)
    reward_schedule: Mapping[str, Callable[[float], float]] = field(default_factory=dict)
    arguments: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for each in dataclasses.fields(self):
            if isinstance(value := getattr(self, each.name), Mapping):  # read-only views cannot be pickled or copied
                object.__setattr__(self, each.name, dict(value))
        check_kind("command", self.command, CommandSpace, "a CommandSpace")
        check_task(self)

    def replace(self, **fields: Any) -> Task:
        """Return the task with some fields replaced.

        Raises:
            TypeError: for a name that is not a field.
            InputError: see the class.
        """
        known = [each.name for each in dataclasses.fields(self)]
        for name in fields:
            if name not in known:
                raise TypeError(f"a Task has no field {name!r}; {nearest(name, known)}")
        return dataclasses.replace(self, **fields)

    def with_observation(self, key: NestedKey, **terms: Any) -> Task:
        """Return the task with observation terms added to the group ``key``, or replaced there.

        Example:
            >>> from torchrl_atr.envs.tasks import ObservationTerm, riding
            >>> height = ObservationTerm(lambda context: context.state.position[:, 2:], mirror=(1.0,))
            >>> list(riding().with_observation("proprio", height=height).observations["proprio"])[-1]
            'height'
        """
        return self.replace(observations={**self.observations, key: {**self.observations.get(key, {}), **terms}})
