"""Standing pose of a robot on its support in q0, the keyframe ``stand``, and its checks."""

from __future__ import annotations

import math

import mujoco
import numpy as np
from numpy.typing import NDArray

from torchrl_atr.envs.models.feet import find_feet, foot_positions, reach
from torchrl_atr.envs.models.robot import LEGS, RobotSpec
from torchrl_atr.envs.models.support import Support

_MAX_PITCH = 0.3
_MAX_UNEVENNESS = 0.01
"""Tolerance, m: initial heights are randomised over 2 cm anyway."""
_SIDES = {(1, -1): "front right", (-1, -1): "rear right", (1, 1): "front left", (-1, 1): "rear left"}
"""Signs of x and y, in the order of :data:`LEGS`."""


def standing_qpos(model: mujoco.MjModel, robot: RobotSpec, support: Support) -> NDArray[np.float64]:
    """Return q0 with the feet level on the support and the robot's centre of mass over its middle.

    Args:
        model: a scene with the robot in it.
        robot: its spec.
        support: must be large enough.

    Returns:
        (nq,)

    Raises:
        RobotError: if it stands upside down, on uneven feet, on feet in another order, beside the surface, or at
            another height than it says.
    """
    data = mujoco.MjData(model)
    root = int(model.joint(int(model.body(robot.trunk).jntadr[0])).qposadr[0])
    data.qpos[[int(model.joint(name).qposadr[0]) for name in robot.joints]] = robot.q0
    data.qpos[root : root + 7] = [0, 0, 0, 1, 0, 0, 0]
    mujoco.mj_kinematics(model, data)
    geoms = find_feet(model, robot)
    feet = foot_positions(data, geoms)
    _check_upright(feet, robot)
    slope, _ = np.polyfit(feet[:, 0], feet[:, 2], 1)
    pitch = math.atan(slope)  # turning by +pitch about y lowers the front by as much
    data.qpos[root + 3 : root + 7] = [math.cos(pitch / 2), 0, math.sin(pitch / 2), 0]
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)
    soles = np.array([min(lowest_point(model, data, geom) for geom in foot) for foot in geoms])
    _check_level(soles, pitch, robot)
    _check_height(-soles.min(), robot)
    com = data.subtree_com[model.body(robot.trunk).id]
    _check_on_surface(foot_positions(data, geoms)[:, :2] - com[:2], robot, support)
    data.qpos[root : root + 3] = [-com[0], -com[1], support.height - soles.min()]
    return data.qpos.copy()


def lowest_point(model: mujoco.MjModel, data: mujoco.MjData, geom: int) -> float:
    """Return the height of a geom's lowest point in its present pose, m; exact for every convex type.

    Args:
        model: the scene.
        data: with current kinematics.
        geom: id.
    """
    return float(data.geom_xpos[geom, 2] - reach(model, geom, -data.geom_xmat[geom, 6:9]))


def _check_upright(feet: NDArray[np.float64], robot: RobotSpec) -> None:
    """Check, for an upright trunk at the origin, that the feet are below it, each on the side that its name says."""
    for (foot, *_), height in zip(robot.foot_names, feet[:, 2]):
        if height >= 0:
            raise robot.error(
                f"in q0 foot {foot!r} is {height:.2f} m above the origin of {robot.trunk!r}: upside down? Check the "
                "signs of q0; the trunk's z axis points up"
            )
    sides = list(_SIDES)
    for leg, (foot, *_), position in zip(LEGS, robot.foot_names, np.sign(feet[:, :2] - feet[:, :2].mean(axis=0))):
        here = (int(position[0]), int(position[1]))
        if here != sides[LEGS.index(leg)]:
            raise robot.error(
                f"in q0 foot {foot!r} is {_SIDES.get(here, 'under the trunk')}, but it is listed as {leg}: list "
                f"joints, feet and q0 in the order {', '.join(LEGS)} (x points forward, y left)"
            )


def _check_level(soles: NDArray[np.float64], pitch: float, robot: RobotSpec) -> None:
    if abs(pitch) > _MAX_PITCH:
        raise robot.error(
            f"in q0 front and rear feet are level only if the trunk pitches by {pitch:.2f} rad; check thighs and "
            "calves of q0"
        )
    uneven = soles - soles.min()
    if uneven.max() > _MAX_UNEVENNESS:
        foot = robot.foot_names[int(uneven.argmax())][0]
        raise robot.error(
            f"in q0 the feet are not level: {foot!r} hangs {uneven.max():.3f} m above the lowest; check its signs: "
            "left and right legs may mirror each other"
        )


def _check_height(height: float, robot: RobotSpec) -> None:
    if robot.min_height >= height:
        raise robot.error(
            f"in q0 {robot.trunk!r} stands {height:.3f} m above the surface, below min_height={robot.min_height:g}: "
            "every episode would end at once; give a lower min_height, in m"
        )
    if not 0.5 * height < robot.standing_height < 1.5 * height:
        raise robot.error(
            f"standing_height={robot.standing_height:g}, but in q0 {robot.trunk!r} stands {height:.3f} m above the "
            "surface; give about that, in m"
        )


def _check_on_surface(feet: NDArray[np.float64], robot: RobotSpec, support: Support) -> None:
    if support.size is None:
        return
    length, width = support.size
    for (foot, *_), (x, y) in zip(robot.foot_names, feet):
        if abs(x) > length / 2 or abs(y) > width / 2:
            raise robot.error(
                f"in q0 foot {foot!r} is off the surface of {support.name!r} ({length:g} x {width:g} m), {x:.2f} m "
                f"ahead and {y:.2f} m left of its pivot; choose a narrower q0, a larger transporter or group"
            )
