"""Scene: one robot on its support, compiled, with the addresses that tasks read."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np

from torchrl_atr.envs.models.contacts import CONTACTS
from torchrl_atr.envs.models.feet import find_feet
from torchrl_atr.envs.models.isolation import check_names
from torchrl_atr.envs.models.loading import compile_spec, load_robot_model
from torchrl_atr.envs.models.robot import RobotSpec
from torchrl_atr.envs.models.stance import standing_qpos
from torchrl_atr.envs.models.support import FLOOR, Support

STAND = "stand"
"""Keyframe of the robot standing in q0 with ctrl = q0; the scene has no other."""
_ROBOT_FORCE = "robot_force"
"""Sensor name unlike those of the feet, ``force_`` and ``position_`` with a geom's name."""
TIMESTEP = 0.005
"""Simulation step, s (200 Hz)."""


@dataclass(frozen=True)
class Layout:
    """Addresses of the robot's parts in ``qpos``, ``qvel``, ``sensordata`` and the model's fields.

    Attributes:
        root_qpos, root_dof: first addresses of the trunk's free joint.
        joint_qpos, joint_dof, actuators: of the leg joints in the spec's order, (12,).
        sensors: of forces and positions, by name.
        trunk_body: the root body.
        support_geoms: geoms that the feet touch.
        origin_qpos: x and y of the point that recentring keeps near the world's origin, (2,); empty for a support that
            is fixed in the world.
        carried_qpos: x and y of all that is recentred with it, (k, 2).
        followed_body: body that cameras follow.
        foot_sizes: number of geoms of each foot: the sensors ``foot_force`` and ``foot_position`` have one for each.
    """

    root_qpos: int
    root_dof: int
    joint_qpos: np.ndarray
    joint_dof: np.ndarray
    actuators: np.ndarray
    sensors: dict[str, slice]
    trunk_body: int
    support_geoms: np.ndarray
    origin_qpos: np.ndarray
    carried_qpos: np.ndarray
    followed_body: int
    foot_sizes: tuple[int, ...]


@dataclass(frozen=True)
class Scene:
    """Compiled scene; ``model``'s keyframe 0, ``stand``, is the robot standing in q0 with ctrl = q0.

    Attributes:
        robot: its spec.
        support: a :class:`~torchrl_atr.envs.models.support.Support`.
        model: the compiled model.
        layout: addresses of the robot's parts.
        support_layout: addresses of the support's parts, as its ``locate`` returns them.
    """

    robot: RobotSpec
    support: Any
    model: mujoco.MjModel
    layout: Layout
    support_layout: Any


def build_scene(robot: RobotSpec, support: Support) -> Scene:
    """Join a robot and its support into one compiled model.

    Args:
        robot: its spec.
        support: such as :class:`~torchrl_atr.envs.models.boards.Transporter` or
            :class:`~torchrl_atr.envs.models.support.FlatGround`.

    Returns:
        The compiled scene: robot first, then the support.

    Raises:
        RobotError: if the robot cannot stand there as it is described.

    Example:
        >>> from torchrl_atr.envs.models import ROBOTS, FlatGround
        >>> build_scene(ROBOTS.get("a1"), FlatGround()).model.nu
        12
    """
    return join(robot, support, compile_spec(scene_mjspec(robot, support), robot))


def join(robot: RobotSpec, support: Support, model: mujoco.MjModel) -> Scene:
    """Return the scene of a compiled ``model``."""
    return Scene(robot, support, model, _layout(model, robot, support), support.locate(model))


def scene_mjspec(robot: RobotSpec, support: Support) -> mujoco.MjSpec:
    """Return the editable scene with its keyframe ``stand``; MuJoCo reads what ``to_xml()`` gives as the same model."""
    spec, alone = load_robot_model(robot)
    names = {geom.id: geom.name for geom in spec.geoms}
    feet = [names[geom] for foot in find_feet(alone, robot) for geom in foot]
    mass = float(mujoco.mj_getTotalmass(alone))
    fixtures = mujoco.MjSpec()
    _add_fixtures(fixtures, support, mass)
    check_names(spec, fixtures, robot)
    spec.modelname = f"{robot.name}-{support.name}"
    spec.compiler.savecompiled = spec.compiler.savecanonical = False  # every digit, in the order written
    _set_options(spec)
    _add_fixtures(spec, support, mass)
    _add_sensors(spec, feet, robot, support)
    model = compile_spec(spec, robot)
    layout = _layout(model, robot, support)
    key = spec.add_key(name=STAND, ctrl=np.asarray(robot.q0)[_inverse(layout.actuators)])
    key.qpos = standing_qpos(model, robot, support)
    key.qvel = np.zeros(model.nv)
    return spec


def _add_fixtures(spec: mujoco.MjSpec, support: Support, robot_mass: float) -> None:
    _add_surroundings(spec)
    support.build(spec, robot_mass)


def _set_options(spec: mujoco.MjSpec) -> None:
    option = spec.option
    option.timestep = TIMESTEP
    option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    option.solver = mujoco.mjtSolver.mjSOL_NEWTON
    option.iterations, option.ls_iterations = 10, 20
    CONTACTS.write(option)
    option.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_ISLAND)
    spec.memory = 1 << 20


def _add_surroundings(spec: mujoco.MjSpec) -> None:
    """Add floor, sky and light, for rendering; a support may enable contacts of the floor."""
    spec.visual.global_.offwidth, spec.visual.global_.offheight = 1280, 960
    spec.visual.headlight.ambient = [0.35, 0.35, 0.35]
    spec.visual.headlight.diffuse = [0.5, 0.5, 0.5]
    spec.add_texture(
        name="scene_sky",
        type=mujoco.mjtTexture.mjTEXTURE_SKYBOX,
        builtin=mujoco.mjtBuiltin.mjBUILTIN_GRADIENT,
        rgb1=[0.55, 0.7, 0.9],
        rgb2=[0.95, 0.97, 1.0],
        width=256,
        height=256,
    )
    spec.add_texture(
        name="scene_floor",
        type=mujoco.mjtTexture.mjTEXTURE_2D,
        builtin=mujoco.mjtBuiltin.mjBUILTIN_CHECKER,
        rgb1=[0.72, 0.74, 0.76],
        rgb2=[0.62, 0.64, 0.67],
        width=256,
        height=256,
    )
    material = spec.add_material(name="scene_floor", texrepeat=[0.5, 0.5], texuniform=True, reflectance=0.05)
    material.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = "scene_floor"
    world = spec.worldbody
    world.add_geom(
        name=FLOOR,
        type=mujoco.mjtGeom.mjGEOM_PLANE,
        size=[0, 0, 0.05],
        material="scene_floor",
        contype=0,
        conaffinity=0,
    )
    world.add_light(pos=[0, 0, 4], dir=[0.2, 0.1, -1], type=mujoco.mjtLightType.mjLIGHT_DIRECTIONAL)


def _add_sensors(spec: mujoco.MjSpec, feet: list[str], robot: RobotSpec, support: Support) -> None:
    """Add foot forces and positions, the contact force on the support, the robot's centre of mass: one array."""
    # data, reduction, number: a world-frame sum, zero without contact
    force, netforce, one = 1 << 1, 3, 1

    def add_force(name: str, objtype: mujoco.mjtObj, objname: str) -> None:
        spec.add_sensor(
            name=name,
            type=mujoco.mjtSensor.mjSENS_CONTACT,
            objtype=objtype,
            objname=objname,
            reftype=support.contact[0],
            refname=support.contact[1],
            intprm=[force, netforce, one],
        )

    for foot in feet:
        add_force(f"force_{foot}", mujoco.mjtObj.mjOBJ_GEOM, foot)
    add_force(_ROBOT_FORCE, mujoco.mjtObj.mjOBJ_XBODY, robot.trunk)
    for foot in feet:
        spec.add_sensor(
            name=f"position_{foot}",
            type=mujoco.mjtSensor.mjSENS_FRAMEPOS,
            objtype=mujoco.mjtObj.mjOBJ_GEOM,
            objname=foot,
        )
    spec.add_sensor(
        name="com",
        type=mujoco.mjtSensor.mjSENS_SUBTREECOM,
        objtype=mujoco.mjtObj.mjOBJ_BODY,
        objname=robot.trunk,
    )


def columns(addresses: np.ndarray) -> slice | np.ndarray:
    """Return contiguous addresses as a slice, which gives a view instead of a copy.

    Example:
        >>> columns(np.array([3, 4, 5])), columns(np.array([4, 3]))
        (slice(3, 6, None), array([4, 3]))
    """
    n = len(addresses)
    first = int(addresses[0]) if n else 0
    return slice(first, first + n) if np.array_equal(addresses, np.arange(first, first + n)) else addresses


def _inverse(permutation: np.ndarray) -> np.ndarray:
    inverse = np.empty_like(permutation)
    inverse[permutation] = np.arange(len(permutation))
    return inverse


def _layout(model: mujoco.MjModel, robot: RobotSpec, support: Support) -> Layout:
    joints = np.array([model.joint(name).id for name in robot.joints], dtype=int)
    actuator_of_joint = {int(joint): i for i, joint in enumerate(model.actuator_trnid[:, 0])}
    root = model.body(robot.trunk).jntadr[0]
    root_qpos = int(model.jnt_qposadr[root])
    place = np.array([root_qpos, root_qpos + 1])
    moved = np.array([model.jnt_qposadr[model.joint(name).id] for name in support.origin], dtype=int)
    origin = place if support.endless else moved

    def sensor(first: str, last: str) -> slice:
        end = model.sensor(last)
        return slice(int(model.sensor(first).adr[0]), int(end.adr[0] + end.dim[0]))

    feet = find_feet(model, robot)
    first, last = model.geom(feet[0][0]).name, model.geom(feet[-1][-1]).name
    return Layout(
        root_qpos=root_qpos,
        root_dof=int(model.jnt_dofadr[root]),
        joint_qpos=model.jnt_qposadr[joints],
        joint_dof=model.jnt_dofadr[joints],
        actuators=np.array([actuator_of_joint[int(joint)] for joint in joints], dtype=int),
        sensors={
            "foot_force": sensor(f"force_{first}", f"force_{last}"),
            "robot_force": sensor(_ROBOT_FORCE, _ROBOT_FORCE),
            "foot_position": sensor(f"position_{first}", f"position_{last}"),
            "com": sensor("com", "com"),
        },
        trunk_body=model.body(robot.trunk).id,
        support_geoms=np.array([model.geom(name).id for name in support.geoms]),
        origin_qpos=origin,
        carried_qpos=np.stack([place] if support.endless or not len(moved) else [moved, place]),
        followed_body=model.body(support.bodies[0] if support.bodies else robot.trunk).id,
        foot_sizes=tuple(len(foot) for foot in feet),
    )
