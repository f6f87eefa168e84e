"""Riding: a quadruped on a tilt-driven transporter follows forward-speed and yaw-rate commands (the paper's task)."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path

import numpy as np

from torchrl_atr._checks import check_choice, check_flag, check_number
from torchrl_atr._errors import InputError
from torchrl_atr.envs.interpretation import Interpretation, get_interpretation
from torchrl_atr.envs.models import RobotSpec, Transporter, TransporterSpec, get_robot, get_transporter
from torchrl_atr.envs.models.leg_kinematics import with_stance
from torchrl_atr.envs.models.robot_file import describe_robot
from torchrl_atr.envs.models.transporter import describe_transporter
from torchrl_atr.envs.tasks import mirrors
from torchrl_atr.envs.tasks.dead_reckoning import KEY, METHODS, dead_reckoning
from torchrl_atr.envs.tasks.events import Disturbance, Pushes
from torchrl_atr.envs.tasks.parameters import Gains, gain_arguments, with_gains
from torchrl_atr.envs.tasks.proprioception import PROPRIO
from torchrl_atr.envs.tasks.reward_terms import RewardTerm
from torchrl_atr.envs.tasks.riding.drive_law import DriveHook
from torchrl_atr.envs.tasks.riding.intrinsics import riding_intrinsics
from torchrl_atr.envs.tasks.riding.observations import observations
from torchrl_atr.envs.tasks.riding.resets import TERMINATIONS, push, start
from torchrl_atr.envs.tasks.riding.rewards import RIDING_REWARDS, STEADY, foot_slip
from torchrl_atr.envs.tasks.riding.state import RidingStateExtractor
from torchrl_atr.envs.tasks.sensors import SensorSet, with_sensors
from torchrl_atr.envs.tasks.support_tilt import NAME, support_tilt
from torchrl_atr.envs.tasks.task import CommandSpace, Task
from torchrl_atr.envs.transforms.grid import CommandGrid

__all__ = ["RIDING_REWARDS", "TERMINATIONS", "riding"]

COMMANDS = CommandSpace(
    names=("speed", "yaw_rate"),
    units=("m/s", "rad/s"),
    grid=CommandGrid(),
    mirror=mirrors.FORWARD_YAW,
    followed_by=("platform_velocity[0]", "platform_angular_velocity[2]"),
)
"""(c_v, c_ω)."""

SLIP = "foot_slip"
"""Name of the term of ``slip_weight``."""


def riding(
    robot: str | Path | RobotSpec = "a1",
    transporter: str | Path | TransporterSpec = "single_board",
    *,
    profile: str | Interpretation = "default",
    sensors: str | SensorSet = "ideal",
    velocity_filter: str = "kalman_filter",
    observe_tilt: bool = False,
    pushes: bool | Pushes = True,
    gains: Gains | None = None,
    stance: tuple[float, float, float] | None = None,
    moving_start: float = 0.0,
    displaced_start: float = 0.0,
    rewards: Mapping[str, RewardTerm] = RIDING_REWARDS,
    steering_weight_peak: float = 1.0,
    steering_weight_end: float = 1.0,
    steering_weight_peak_at: float = 1.0,
    steadiness: float = 0.0,
    fall_weight: float = 1.0,
    slip_weight: float = 0.0,
) -> Task:
    """Return the riding task: a robot on a transporter follows a forward speed and a yaw rate.

    Args:
        robot: name of a registered robot, path of a ``.toml`` file that describes one, or a spec of your own.
        transporter: ``"single_board"`` or ``"two_board"`` in the robot's size, another registered name, path of a
            ``.toml`` file that describes one, or a spec.
        profile: name of a profile, or :class:`~torchrl_atr.envs.interpretation.Interpretation`.
        sensors: name of a set of sensor errors, ``"ideal"`` or ``"realistic"``, or your own.
        velocity_filter: method of ``dead_reckoned_velocity``, a name of
            :data:`~torchrl_atr.envs.tasks.dead_reckoning.METHODS`.
        observe_tilt: whether the observation has the tilt of the feet's plane
            (:mod:`~torchrl_atr.envs.tasks.support_tilt`).
        pushes: whether robot and transporter are pushed, every 3 s, or the sizes and interval.
        gains: nominal PD gains, see :data:`~torchrl_atr.envs.tasks.parameters.Gains`; None for the robot's own.
        stance: how much wider, longer and lower the robot stands than in its own q0, as shares of its standing height
            (:func:`~torchrl_atr.envs.models.leg_kinematics.with_stance`); None or empty for its own.
        moving_start: share of the episodes whose transporter starts at part of the commanded speeds (for training).
        displaced_start: share of the episodes whose robot starts shifted and turned on the boards, as after a minute of
            pushes (for training).
        rewards: the terms of the reward by name.
        steering_weight_peak: factor of r1 in the learner's reward, at its peak: it rises from 1 until
            ``steering_weight_peak_at``. The reward of a turn comes later and with more noise than that of a speed: once
            speeds are tracked, it may have a larger weight.
        steering_weight_end: the factor that it falls to from there until training ends, so that fewer robots fall.
        steering_weight_peak_at: share of the training, in (0, 1].
        steadiness: how much larger the weights of the body's pose and motion are in the learner's reward: 0 leaves
            them, 1 multiplies them by :data:`~torchrl_atr.envs.tasks.riding.rewards.STEADY`.
        fall_weight: factor of r17, early termination, in the learner's reward.
        slip_weight: weight of a penalty that Table III lacks, the sum of the speeds at which feet slide over the
            boards, 1/m; 0 for none. Pushes move feet, and robots fall at the boards' edges within minutes.

    Raises:
        UnknownNameError: for an unknown robot, transporter or profile.
        ValueError: for an impossible share of starts or steering weight.

    Example:
        >>> task = riding("go1", "two_board")
        >>> task.name, task.rewards["heading_alignment"].weight
        ('riding', -4.0)
    """
    pushed = Pushes.of(pushes)
    moving_start = check_number("moving_start", moving_start, 0.0, 1.0)
    displaced_start = check_number("displaced_start", displaced_start, 0.0, 1.0)
    dead_reckoned, velocity = dead_reckoning(check_choice("velocity_filter", velocity_filter, METHODS))
    interpretation = get_interpretation(profile)
    shares = _checked_stance(stance)
    rider = with_stance(with_gains(get_robot(robot), gains), *shares)
    spec = get_transporter(transporter, rider)
    more = check_number("steadiness", steadiness, 0.0)
    factors = {name: 1.0 + more * (factor - 1.0) for name, factor in STEADY.items() if name in (rewards or ())}
    factors["termination"] = check_number("fall_weight", fall_weight, 0.0)
    if check_number("slip_weight", slip_weight, 0.0):
        rewards = {SLIP: RewardTerm(foot_slip, -slip_weight), **(rewards or {})}
    tilt = {NAME: support_tilt(rider)} if check_flag("observe_tilt", observe_tilt) else {}
    return Task(
        name="riding",
        robot=rider,
        support=Transporter(spec, interpretation),
        command=COMMANDS,
        observations=observations(interpretation, {**with_sensors(PROPRIO, sensors), **tilt}, dead_reckoned),
        rewards=rewards,
        intrinsics=riding_intrinsics(rider, spec, interpretation),
        terminations=TERMINATIONS,
        reset=start(moving_start, displaced_start),
        disturbances={}
        if pushed is None
        else {"push": Disturbance(partial(push, pushes=pushed), pushed.interval, is_push=True)},
        memory={KEY: velocity},
        tracking_rewards=("forward_command", "steering_command"),
        state_extractor=RidingStateExtractor,
        substep_hook=DriveHook,
        interpretation=interpretation,
        reward_schedule={
            **_steering_schedule(steering_weight_peak, steering_weight_end, steering_weight_peak_at),
            **{term: partial(np.interp, xp=(0.0, 1.0), fp=(f, f)) for term, f in factors.items() if f != 1.0},
        },
        arguments={
            "robot": describe_robot(robot),
            "transporter": describe_transporter(spec),
            **gain_arguments(gains),
            **({"stance": list(shares)} if any(shares) else {}),
        },
    )


def _checked_stance(stance: Sequence[float] | None) -> tuple[float, float, float]:
    shares = tuple(check_number("stance", share, -0.5, 0.5) for share in stance or (0.0, 0.0, 0.0))
    if len(shares) != 3:
        raise InputError(f"stance={stance!r} has {len(shares)} numbers; give three (wider, longer, lower), or none")
    return shares


def _steering_schedule(peak: float, end: float, peak_at: float) -> dict[str, Callable[[float], float]]:
    peak, end = check_number("steering_weight_peak", peak, 0.0), check_number("steering_weight_end", end, 0.0)
    peak_at = check_number("steering_weight_peak_at", peak_at, high=1.0, above=0.0)
    if peak == end == 1.0:
        return {}
    return {"steering_command": partial(np.interp, xp=(0.0, peak_at, 1.0), fp=(1.0, peak, end))}
