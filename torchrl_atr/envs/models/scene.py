"""The scene: one robot on one transporter, compiled, with the addresses of all that the task reads."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np

from torchrl_atr.envs.models.decks import DECK_HEIGHT, PLANAR_JOINTS, PLATFORM, add_transporter
from torchrl_atr.envs.models.feet import find_feet
from torchrl_atr.envs.models.isolation import check_names
from torchrl_atr.envs.models.loading import compile_spec, load_robot
from torchrl_atr.envs.models.robot import RobotSpec
from torchrl_atr.envs.models.stance import standing_qpos
from torchrl_atr.envs.models.transporter import TransporterSpec
from torchrl_atr.envs.profiles import Readings

STAND = "stand"
"""Keyframe of the robot standing in q0 with ctrl = q0; the scene has no other."""
_ROBOT_FORCE = "robot_force"
"""Unlike any of the feet's sensors, ``force_`` and ``position_`` with a geom's name."""
TIMESTEP = 0.005
"""Simulation step, s (200 Hz)."""
_ARMATURE_RATIO = 200.0
# The planar joints carry an armature of 200 robot masses: even wild kicks (random actions of standard
# deviation 1) move the prescribed motion by under 1 mm/s, and the solver, whose tolerance scales with the
# trace of the inertia matrix, still converges.


@dataclass(frozen=True)
class Layout:
    """Addresses of the scene's parts in ``qpos``, ``qvel``, ``sensordata`` and the model's fields."""

    root_qpos: int
    root_dof: int
    joint_qpos: np.ndarray
    joint_dof: np.ndarray
    actuators: np.ndarray
    planar_qpos: np.ndarray
    planar_dof: np.ndarray
    tilt_qpos: np.ndarray
    tilt_dof: np.ndarray
    tilt_joints: np.ndarray
    tilt_gains: np.ndarray
    sensors: dict[str, slice]
    trunk_body: int
    platform_body: int
    deck_bodies: np.ndarray
    deck_geoms: np.ndarray
    foot_sizes: tuple[int, ...]
    """How many geoms each foot has: the sensors ``foot_force`` and ``foot_position`` read them one by one."""


@dataclass(frozen=True)
class Scene:
    """A compiled scene; ``model``'s keyframe 0, ``stand``, is the robot standing in q0 with ctrl = q0."""

    robot: RobotSpec
    transporter: TransporterSpec
    model: mujoco.MjModel
    layout: Layout


def build_scene(robot: RobotSpec, transporter: TransporterSpec, readings: Readings | None = None) -> Scene:
    """Joins a robot and a transporter into one compiled model.

    Args:
        robot: the rider.
        transporter: what it stands on.
        readings: fixes the unit of the self-balancing gains (A12).

    Returns:
        The compiled scene: robot first, then the transporter with planar joints x, y, yaw and two tilt hinges.

    Example:
        >>> from torchrl_atr.envs.models import ROBOTS, TRANSPORTERS
        >>> scene = build_scene(ROBOTS.get("a1"), TRANSPORTERS.get("single_board_g1"))
        >>> scene.model.nu
        12
    """
    model = compile_spec(scene_spec(robot, transporter, readings or Readings()), robot)
    return join(robot, transporter, model)


def join(robot: RobotSpec, transporter: TransporterSpec, model: mujoco.MjModel) -> Scene:
    """Return the scene of which ``model`` is the compiled one."""
    return Scene(robot, transporter, model, _layout(model, robot, transporter))


def scene_spec(robot: RobotSpec, transporter: TransporterSpec, readings: Readings) -> mujoco.MjSpec:
    """The editable scene with its keyframe ``stand``; MuJoCo reads what ``to_xml()`` gives as the same model."""
    spec, alone = load_robot(robot)
    names = {geom.id: geom.name for geom in spec.geoms}
    feet = [names[geom] for foot in find_feet(alone, robot) for geom in foot]
    armature = _ARMATURE_RATIO * float(mujoco.mj_getTotalmass(alone))
    fixtures = mujoco.MjSpec()
    _add_fixtures(fixtures, transporter, readings, armature)
    check_names(spec, fixtures, robot)
    spec.modelname = f"{robot.name}-{transporter.name}"
    spec.compiler.savecompiled = spec.compiler.savecanonical = False  # every digit, and as it was written
    _set_options(spec)
    _add_fixtures(spec, transporter, readings, armature)
    _add_sensors(spec, feet, robot)
    model = compile_spec(spec, robot)
    layout = _layout(model, robot, transporter)
    qpos = standing_qpos(model, robot, transporter, DECK_HEIGHT + transporter.size[2] / 2)
    key = spec.add_key(name=STAND, qpos=qpos, ctrl=np.asarray(robot.q0)[_inverse(layout.actuators)])
    key.qvel = np.zeros(model.nv)
    return spec


def _add_fixtures(spec: mujoco.MjSpec, transporter: TransporterSpec, readings: Readings, armature: float) -> None:
    _add_surroundings(spec)
    add_transporter(spec, transporter, readings, armature)


def _set_options(spec: mujoco.MjSpec) -> None:
    option = spec.option
    option.timestep = TIMESTEP
    option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    option.cone = mujoco.mjtCone.mjCONE_PYRAMIDAL
    option.solver = mujoco.mjtSolver.mjSOL_NEWTON
    option.iterations, option.ls_iterations = 10, 20
    option.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_ISLAND)
    spec.memory = 1 << 20


def _add_surroundings(spec: mujoco.MjSpec) -> None:
    """Floor, sky and light: to look at, never to touch."""
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
        name="floor",
        type=mujoco.mjtGeom.mjGEOM_PLANE,
        size=[0, 0, 0.05],
        material="scene_floor",
        contype=0,
        conaffinity=0,
    )
    world.add_light(pos=[0, 0, 4], dir=[0.2, 0.1, -1], type=mujoco.mjtLightType.mjLIGHT_DIRECTIONAL)


def _add_sensors(spec: mujoco.MjSpec, feet: list[str], robot: RobotSpec) -> None:
    """Foot forces and positions, the contact force on the boards, the robot's centre of mass: one array."""
    force, netforce, one = (
        1 << 1,
        3,
        1,
    )  # what, how reduced, how many: a world-frame sum, zero without contact

    def add_force(name: str, objtype: mujoco.mjtObj, objname: str) -> None:
        spec.add_sensor(
            name=name,
            type=mujoco.mjtSensor.mjSENS_CONTACT,
            objtype=objtype,
            objname=objname,
            reftype=mujoco.mjtObj.mjOBJ_XBODY,
            refname=PLATFORM,
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
    """Addresses as a slice where they run on: a view where they would make a copy.

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


def _layout(model: mujoco.MjModel, robot: RobotSpec, transporter: TransporterSpec) -> Layout:
    joints = np.array([model.joint(name).id for name in robot.joints], dtype=int)
    actuator_of_joint = {int(joint): i for i, joint in enumerate(model.actuator_trnid[:, 0])}
    root = model.body(robot.trunk).jntadr[0]
    planar = np.array([model.joint(name).id for name in PLANAR_JOINTS])
    hinges = transporter.design.hinges
    tilt = np.array([model.joint(hinge.name).id for hinge in hinges])
    decks = np.array([model.geom(board.name).id for board in transporter.design.boards])

    def sensor(first: str, last: str) -> slice:
        end = model.sensor(last)
        return slice(int(model.sensor(first).adr[0]), int(end.adr[0] + end.dim[0]))

    feet = find_feet(model, robot)
    first, last = model.geom(feet[0][0]).name, model.geom(feet[-1][-1]).name
    return Layout(
        root_qpos=int(model.jnt_qposadr[root]),
        root_dof=int(model.jnt_dofadr[root]),
        joint_qpos=model.jnt_qposadr[joints],
        joint_dof=model.jnt_dofadr[joints],
        actuators=np.array([actuator_of_joint[int(joint)] for joint in joints], dtype=int),
        planar_qpos=model.jnt_qposadr[planar],
        planar_dof=model.jnt_dofadr[planar],
        tilt_qpos=model.jnt_qposadr[tilt],
        tilt_dof=model.jnt_dofadr[tilt],
        tilt_joints=tilt,
        tilt_gains=np.array([hinge.gain for hinge in hinges]),
        sensors={
            "foot_force": sensor(f"force_{first}", f"force_{last}"),
            "robot_force": sensor(_ROBOT_FORCE, _ROBOT_FORCE),
            "foot_position": sensor(f"position_{first}", f"position_{last}"),
            "com": sensor("com", "com"),
        },
        trunk_body=model.body(robot.trunk).id,
        platform_body=model.body(PLATFORM).id,
        deck_bodies=model.geom_bodyid[decks],
        deck_geoms=decks,
        foot_sizes=tuple(len(foot) for foot in feet),
    )
