"""Control step of a deployed policy as one module whose state is tensors in and out: what ``policy.onnx`` computes."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import Any, NamedTuple

import torch
from torch import Tensor, nn

from torchrl_atr._errors import InputError
from torchrl_atr.envs.interpretation import Interpretation
from torchrl_atr.envs.models import Scene
from torchrl_atr.envs.models.leg_kinematics import leg_kinematics
from torchrl_atr.envs.physics.engine import CONTROL_DT
from torchrl_atr.envs.tasks.dead_reckoning import KEY, METHODS, method_of
from torchrl_atr.envs.tasks.proprioception import PROPRIO
from torchrl_atr.envs.tasks.riding.foot_steps import FootSteps
from torchrl_atr.envs.tasks.support_tilt import NAME, feet_tilt
from torchrl_atr.envs.tasks.walking import gait
from torchrl_atr.envs.transforms.slew import slew
from torchrl_atr.modules import CommandRange, NetworkKeys, ROANetworks

SENSORS = tuple(name for name in PROPRIO if name != "action")
"""Sensor values that the policy reads, in the order of its inputs."""
INPUTS = ("start", *SENSORS, "command", "history", "dead_reckoning", "last_action", "last_command")
"""Inputs of every policy."""
MEMORY = "memory"
"""Further input of a policy that walks by a clock, its phase, and of one with scripted steps, their state."""
CLOCK, _PHASE = "clock", "phase"
"""Names of the clock's observation and of its memory term."""


class StepOutput(NamedTuple):
    """Outputs of :class:`PolicyStep`, (N, ...) each.

    Attributes:
        action: joint displacement in units of the action scale, that of scripted steps included.
        joint_targets: q0 + scale · action within the joints' control ranges, rad.
        command_in_range: the command that is asked for, clipped to the range.
        command_in_force: what is followed: it approaches the command at a limited rate.
        latent, extrinsic: estimates of the intrinsics' latent and of the extrinsic state (SI units), (N, 0) of what the
            actor does not read.
        dead_reckoned_velocity: m/s.
        next_history, next_dead_reckoning, next_command, next_memory: state for the next step, as ``action`` is; the
            memory is (N, 0) where there is none.
    """

    action: Tensor
    joint_targets: Tensor
    command_in_range: Tensor
    command_in_force: Tensor
    latent: Tensor
    extrinsic: Tensor
    dead_reckoned_velocity: Tensor
    next_history: Tensor
    next_dead_reckoning: Tensor
    next_command: Tensor
    next_memory: Tensor


STATE = {
    "history": "next_history",
    "dead_reckoning": "next_dead_reckoning",
    "last_action": "action",
    "last_command": "next_command",
}
"""Output that each part of the state is read from, by the input that it is the next step's value of."""


@dataclass
class _Sensed:
    """Part of a :class:`~torchrl_atr.envs.tasks.context.StepContext` that memory terms and the clock read."""

    memory: Mapping[str, Tensor]
    proprio: Mapping[str, Tensor]
    interpretation: Interpretation
    state: Any = None
    command: Tensor | None = None

    def sensed(self, name: str) -> Tensor:
        return self.proprio[name]


class PolicyStep(nn.Module):
    """Estimators and actor with normalisers, observation history, dead reckoning and limits of the command around them.

    A row whose ``start`` is true begins an episode, whatever its state is: the robot stands at rest, its history is
    filled with the first observation, and its last action is zero; so is the first command, if its rate is limited.

    Args:
        networks: in eval mode.
        task: that they were trained in.
        scene: of its robot, for q0, action scale and control ranges.
        limits: range that commands are clipped to; None for no clipping.
        slew_rates: largest change of the command per second; None for no limit.
        steps: scripted steps, if the policy was trained with them.

    Raises:
        InputError: if the policy reads anything but sensors, command, history, dead reckoning and the gait's clock.
    """

    rest: Tensor
    q0: Tensor
    low: Tensor
    high: Tensor
    slew: Tensor | None

    def __init__(
        self,
        networks: ROANetworks,
        task: Any,
        scene: Scene,
        limits: CommandRange | None,
        slew_rates: Sequence[float] | None = None,
        steps: FootSteps | None = None,
    ) -> None:
        super().__init__()
        self.steps = steps
        self.order = tuple(task.observations["proprio"])
        clock = task.observations["proprio"].get(CLOCK)
        self.clocked = clock is not None and clock.function is gait.clock
        strange = (set(self.order) - {NAME, *[CLOCK] * self.clocked}) ^ {*SENSORS, "action"}
        strange |= {str(key) for key in networks.estimator_inputs if key != NetworkKeys.dead_reckoned_velocity}
        if strange:
            raise InputError(
                f"a policy of the task {task.name!r} cannot be exported: of {', '.join(sorted(strange))} the runtime "
                f"knows nothing; it knows policies that read {', '.join(SENSORS)}, the last action and {KEY}"
            )
        self.networks, self.limits, self.interpretation = networks, limits, task.interpretation
        self.method, self.scale = METHODS[method_of(task.memory)], scene.robot.action_scale
        self.legs = leg_kinematics(scene.robot) if NAME in self.order else None
        for name, value in {"q0": scene.robot.q0, **target_limits(scene), "rest": self._rest()}.items():
            self.register_buffer(name, torch.as_tensor(value, dtype=torch.float32), persistent=False)
        per_step = torch.tensor(slew_rates) * CONTROL_DT if slew_rates else None
        self.register_buffer("slew", per_step, persistent=False)

    @property
    def inputs(self) -> tuple[str, ...]:
        """Names of the inputs, in order."""
        return (*INPUTS, *[MEMORY] * self._remembers)

    @property
    def state(self) -> dict[str, str]:
        """Output that each part of the state is read from, by the input that it is the next step's value of."""
        return {**STATE, MEMORY: "next_memory"} if self._remembers else STATE

    @property
    def _remembers(self) -> bool:
        return self.clocked or self.steps is not None

    def memory(self, robots: int) -> Tensor:
        """Return the memory at the start of an episode, (N, S), zero-sized without one."""
        return torch.zeros(robots, int(self.clocked)) if self.steps is None else self.steps.start(robots)

    def _rest(self) -> Tensor:
        """Return the state of the dead reckoning of a robot at rest, (1, size)."""
        zero, one = torch.zeros(1, 3), torch.eye(3).unsqueeze(0)
        at_rest = SimpleNamespace(velocity=zero, euler=zero, rotation=one)
        return self.method.start(_Sensed({}, {}, self.interpretation, at_rest)).clone()

    def _follow(self, asked: Tensor, start: Tensor, last: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Return the command in range, the one in force, and the one that the next step's approaches from."""
        limits = self.limits or CommandRange(math.inf, math.inf)
        in_range = limits(asked)
        if self.slew is None:
            return in_range, in_range, in_range
        # what approaches is bounded by the box alone: the lateral acceleration couples components, rates do not
        box = replace(limits, max_lateral_acceleration=None)(asked)
        approached = torch.where(start, 0.0, slew(last, box, self.slew))
        return in_range, limits(approached), approached

    def forward(
        self,
        start: Tensor,
        acceleration: Tensor,
        angular_velocity: Tensor,
        orientation: Tensor,
        joint_position: Tensor,
        joint_velocity: Tensor,
        command: Tensor,
        history: Tensor,
        dead_reckoning: Tensor,
        last_action: Tensor,
        last_command: Tensor,
        memory: Tensor | None = None,
    ) -> StepOutput:
        """Compute one control step of N robots.

        Args:
            start: whether an episode begins, (N, 1) bool.
            acceleration: of the IMU, m/s², (N, 3).
            angular_velocity: of the IMU, rad/s, (N, 3).
            orientation: roll and pitch, rad, (N, 2).
            joint_position: rad, (N, 12).
            joint_velocity: rad/s, (N, 12).
            command: forward speed and yaw rate, m/s and rad/s, (N, 2).
            history: state, see :data:`STATE`, (N, H, D).
            dead_reckoning: state, (N, size).
            last_action: state, (N, 12).
            last_command: state, (N, 2).
            memory: state, see :meth:`memory`.
        """
        in_range, command, approached = self._follow(command, start, last_command)
        sensors = (acceleration, angular_velocity, orientation, joint_position, joint_velocity)
        proprio = dict(zip(SENSORS, sensors), action=torch.where(start, 0.0, last_action))
        memory = command[:, :0] if memory is None else memory
        if self.clocked:  # in an env the clock runs by the command of the step that has ended
            ridden = torch.where(start, command, last_command)
            before: Any = _Sensed({_PHASE: memory}, {}, self.interpretation, command=ridden)
            memory = torch.where(start, 0.0, gait.MEMORY[_PHASE].update(before))
            proprio[CLOCK] = gait.clock(replace(before, memory={_PHASE: memory}))
        if self.legs is not None:
            proprio[NAME] = feet_tilt(self.legs(joint_position), orientation)
        observation = torch.cat([*(proprio[name] for name in self.order), command], -1)
        history = torch.where(start.unsqueeze(-1), observation.unsqueeze(-2), history)
        newest = torch.cat([history[:, 1:], observation.unsqueeze(-2)], 1)
        moved = self.method.update(_Sensed({KEY: dead_reckoning}, proprio, self.interpretation))
        reckoned = torch.where(start, self.rest, moved)
        velocity = self.method.observe(_Sensed({KEY: reckoned}, {}, self.interpretation), KEY)
        shown, networks = newest if self.interpretation.current_in_history else history, self.networks
        latent = extrinsic = observation[:, :0]
        if networks.intrinsic_estimator is not None:
            latent = networks.intrinsic_estimator(shown)
        if networks.extrinsic_estimator is not None:
            extrinsic = networks.extrinsic_estimator(shown, *([velocity] if networks.estimator_inputs else []))
        read = {"history": shown, "latent": latent, "extrinsic": extrinsic}
        action = networks.backbone(observation, *(read[name] for name in networks.backbone.reads))
        if self.steps is not None:
            memory = torch.where(start, self.steps.start(1), memory)
            action, memory = self.steps(action, observation[:, : -command.shape[-1]], extrinsic, memory)
        targets = torch.clamp(self.q0 + self.scale * action, self.low, self.high)
        return StepOutput(
            action, targets, in_range, command, latent, extrinsic, velocity, newest, reckoned, approached, memory
        )


def target_limits(scene: Scene) -> dict[str, list[float]]:
    """Return the control ranges ``low`` and ``high`` of the joints in the spec's order, rad; ±2π for none."""
    model, chosen = scene.model, scene.layout.actuators
    limited = model.actuator_ctrllimited[chosen].astype(bool)
    low, high = model.actuator_ctrlrange[chosen].T
    full = 2.0 * torch.pi
    return {
        "low": [float(value) if has else -full for value, has in zip(low, limited)],
        "high": [float(value) if has else full for value, has in zip(high, limited)],
    }
