"""Trips: robots follow planned paths to a goal, by a policy that takes (c_v, c_ω)."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import shapely
import torch
from numpy.typing import NDArray
from tensordict.nn import TensorDictModuleBase
from torchrl.envs import EnvBase

from torchrl_atr._errors import InputError
from torchrl_atr.envs.access import base_env
from torchrl_atr.envs.physics import CONTROL_DT
from torchrl_atr.envs.tasks.rotations import euler_from_matrix, matrix_from_quaternion
from torchrl_atr.evaluation.access import command_limits, command_owner
from torchrl_atr.evaluation.energy import CostOfTransport, cost_of_transport, measure_power, robot_mass
from torchrl_atr.evaluation.ride import MakeEnv, RideStep, build_env, ride
from torchrl_atr.modules import CommandRange
from torchrl_atr.navigation.map import Map
from torchrl_atr.navigation.paths import Path, rectangles
from torchrl_atr.navigation.pursuit import PurePursuit, PursuitConfig

Array = NDArray[np.float64]
TRACE_STEPS = 10
"""Control steps between two recorded poses."""
PATIENCE = 2.0
"""Time limit of a trip, in multiples of the path's length over the cruising speed."""
GOAL, FELL, COLLIDED, TIMEOUT = "goal", "fell", "collided", "timeout"


@dataclass(frozen=True)
class TripsResult:
    """Outcome of n trips.

    Attributes:
        outcome: ``"goal"``, ``"fell"``, ``"collided"`` or ``"timeout"``, (n,).
        seconds: duration, (n,).
        planned: length of the path, m, (n,).
        travelled: distance covered, m, (n,).
        deviation: mean distance to the path, m, (n,).
        largest_deviation: the largest, m, (n,).
        joint_power: mean positive power, summed over joints, W, (n,).
        drive_power: mean power of the transporter's drive, W, (n,).
        cost: of transport, (n,) each.
        traces: x, y (m), yaw (rad), time (s), and mean powers of joints and drive since the row before (W), every
            :data:`TRACE_STEPS` control steps and at the end, (n,) arrays of (T, 6).
    """

    outcome: NDArray[np.str_]
    seconds: Array
    planned: Array
    travelled: Array
    deviation: Array
    largest_deviation: Array
    joint_power: Array
    drive_power: Array
    cost: CostOfTransport
    traces: list[Array]

    @property
    def spl(self) -> Array:
        """Success weighted by path length, S l / max(l, p), (n,)."""
        share = self.planned / np.maximum(self.planned, np.maximum(self.travelled, 1e-9))
        return np.where(self.outcome == GOAL, share, 0.0)


def footprint_of(env: EnvBase) -> tuple[float, float]:
    """Return length and width of what must not touch an obstacle: transporter, or the rectangle of the feet, m.

    Example:
        >>> from torchrl_atr.envs import make_riding_env
        >>> length, width = footprint_of(make_riding_env(num_envs=1))
        >>> length > width > 0.2
        True
    """
    scene = base_env(env).scene
    if hasattr(scene.support_layout, "planar_qpos"):
        length, width = scene.support.size
        return float(length), float(width)
    feet = base_env(env).runner.terms.extractor.read().foot_position[0, :, :2]
    length, width = (feet.amax(0) - feet.amin(0)).tolist()
    return float(length), float(width)


def poses_of(env: EnvBase) -> Array:
    """Return x, y (m) and yaw (rad) of the transporters, or of the robots where there are none, (N, 3)."""
    base = base_env(env)
    layout = base.scene.support_layout
    if hasattr(layout, "planar_qpos"):
        poses = base.engine.qpos[:, torch.as_tensor(layout.planar_qpos)].clone()
        poses[:, :2] += base.engine.world_offset
        return poses.numpy()
    x = base.scene.layout.root_qpos
    yaw = euler_from_matrix(matrix_from_quaternion(base.engine.qpos[:, x + 3 : x + 7]))[:, 2]
    places = base.engine.qpos[:, x : x + 2] + base.engine.world_offset
    return torch.cat([places, yaw.unsqueeze(-1)], -1).numpy()


def run_trips(
    policy: TensorDictModuleBase,
    make_env: MakeEnv,
    paths: Sequence[Path],
    where: Map,
    config: PursuitConfig | None = None,
    *,
    seed: int = 0,
    progress: Callable[[int, int], None] | None = None,
) -> TripsResult:
    """Let one robot follow each path from rest until it is at the goal, falls, collides or takes too long.

    The robots know where they are; a collision is found from the footprint and the map, as the simulated floor is
    empty.

    Args:
        policy: any that reads a command of speed and yaw rate and writes the action.
        make_env: called as ``make_env(num_envs=n, seed=s)``; its transform pins commands.
        paths: one for each robot.
        where: the map.
        config: of the pursuit; by default 1.5 m/s.
        seed: of the env.
        progress: called with (steps done, steps at most) after each step.

    Raises:
        InputError: for a speed beyond what the env's commands allow; before the simulation starts.
        TypeError: if the env cannot pin commands.
    """
    config = config or PursuitConfig()
    env = build_env(make_env, len(paths), seed)
    check_commands(env, config)
    log = _TripLog(env, paths, where, config, progress)
    still = torch.zeros(1, len(paths), 2)
    ride(policy, env, still, log.limit, log, until_down=True)
    result = log.result()
    env.close(raise_if_closed=False)
    return result


def check_commands(env: EnvBase, config: PursuitConfig, limits: CommandRange | None = None) -> None:
    """Check that an env and a policy take the commands of a pursuit.

    Args:
        env: whose transform pins commands.
        config: of the pursuit.
        limits: to which the policy clips commands.

    Raises:
        InputError: for a speed or a yaw rate that is too large; names it and the largest.
    """
    _, high = command_limits(env, (math.inf, math.inf))
    own = (math.inf, math.inf) if limits is None else (limits.max_speed, limits.max_yaw_rate)
    values = {"speed": config.speed, "max_yaw_rate": config.max_yaw_rate}
    for (name, value), env_most, policy_most in zip(values.items(), high, own):
        most, whose = min((float(env_most), "env"), (policy_most, "policy"))
        if value > most:
            raise InputError(
                f"{name}={value:g} is beyond the {whose}'s largest command, {most:g}; choose a smaller one"
            )


class _TripLog:
    """Watch of a ride: pins the commands of the pursuit, and records the trips."""

    def __init__(
        self,
        env: EnvBase,
        paths: Sequence[Path],
        where: Map,
        config: PursuitConfig,
        progress: Callable[[int, int], None] | None,
    ) -> None:
        self.env, self.where, self.progress = env, where, progress
        self.pursuit, self.owner, self.footprint = PurePursuit(paths, config), command_owner(env), footprint_of(env)
        self.planned = np.array([path.length for path in paths])
        self.deadline = np.ceil(PATIENCE * self.planned / config.speed / CONTROL_DT).astype(int)
        self.limit = int(self.deadline.max())
        n = len(paths)
        self.starts = np.stack([[*path.points[0], path.headings[0]] for path in paths])
        self.outcome = np.full(n, "", dtype="<U8")
        self.steps, self.travelled, self.deviation, self.largest, self.joints, self.drive = np.zeros((6, n))
        self.poses, self.traces = self.starts.copy(), [[np.pad(start, (0, 3))] for start in self.starts]
        self.energy_before, self.steps_before = np.zeros((n, 2)), np.zeros(n)

    def _world(self) -> Array:
        """Return the poses on the map: each robot starts at the origin of its own plane."""
        x, y, yaw = poses_of(self.env).T
        cosine, sine = np.cos(self.starts[:, 2]), np.sin(self.starts[:, 2])
        return np.stack([cosine * x - sine * y, sine * x + cosine * y, yaw], -1) + self.starts

    def __call__(self, step: RideStep) -> None:
        active, poses = self.outcome == "", self._world()
        power = measure_power(self.env)
        commands, distance = self.pursuit.command(poses), self.pursuit.distance
        self.steps += active
        self.travelled += active * np.linalg.norm(poses[:, :2] - self.poses[:, :2], axis=-1)
        self.deviation += active * distance
        self.largest = np.where(active, np.maximum(self.largest, distance), self.largest)
        self.joints += active * power.joints.sum(-1).numpy()
        self.drive += active * power.drive.numpy()
        self.poses = poses
        free = shapely.contains_properly(self.where.free, rectangles(poses[:, :2], poses[:, 2], self.footprint))
        for name, which in (
            (FELL, step.down.numpy()),
            (COLLIDED, ~free),
            (GOAL, self.pursuit.reached(poses)),
            (TIMEOUT, self.steps >= self.deadline),
        ):
            self.outcome[active & which & (self.outcome == "")] = name
        ended = self.outcome != ""
        step.down = step.down | torch.from_numpy(ended)
        self._trace(active & (ended | (step.index % TRACE_STEPS == TRACE_STEPS - 1)))
        self.owner.pin(torch.as_tensor(np.where((self.outcome == "")[:, None], commands, 0.0), dtype=torch.float32))
        if self.progress is not None:
            self.progress(step.index + 1, self.limit)

    def _trace(self, rows: NDArray[np.bool_]) -> None:
        """Add a row to the traces of some robots."""
        energy = np.stack([self.joints, self.drive], -1)
        power = (energy - self.energy_before) / np.maximum(self.steps - self.steps_before, 1)[:, None]
        values = np.concatenate([self.poses, (self.steps * CONTROL_DT)[:, None], power], -1)
        for i in np.flatnonzero(rows):
            self.traces[i].append(values[i])
        self.energy_before[rows], self.steps_before[rows] = energy[rows], self.steps[rows]

    def result(self) -> TripsResult:
        """Return the outcome; after the ride."""
        steps, seconds = np.maximum(self.steps, 1), self.steps * CONTROL_DT
        joints, drive = self.joints / steps, self.drive / steps
        speed = np.maximum(self.travelled, 1e-3) / np.maximum(seconds, CONTROL_DT)
        mass, count = robot_mass(self.env).numpy().astype(float), self.env.action_spec.shape[-1]
        return TripsResult(
            outcome=self.outcome,
            seconds=seconds,
            planned=self.planned,
            travelled=self.travelled,
            deviation=self.deviation / steps,
            largest_deviation=self.largest,
            joint_power=joints,
            drive_power=drive,
            cost=cost_of_transport(joints, drive, mass, speed, count),
            traces=[np.stack(trace) for trace in self.traces],
        )
