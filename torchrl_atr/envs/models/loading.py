"""Loading of a robot's MJCF file, checked, stripped, and driven by its spec's PD controllers."""

from __future__ import annotations

import contextlib
import itertools
import math
import os
from collections.abc import Iterator
from pathlib import Path

import mujoco

from torchrl_atr._registry import nearest
from torchrl_atr.envs.models.feet import find_feet
from torchrl_atr.envs.models.isolation import isolate, write_inertias
from torchrl_atr.envs.models.robot import JOINTS_PER_LEG, LEGS, RobotSpec


def load_robot_model(robot: RobotSpec) -> tuple[mujoco.MjSpec, mujoco.MjModel]:
    """Load the robot's MJCF file and prepare it for a scene.

    The robot itself stays as the file has it: bodies, inertias, joints with their damping, friction and limits, meshes,
    cameras, constraints. Its surroundings and drives are removed: lights, floor and other bodies of the world, options,
    keyframes, sensors, actuators. Twelve position actuators of the spec's gains and torque limits replace them, in
    the order of ``robot.joints``. Its geoms collide with the transporter only, and by the support's contact parameters.

    Args:
        robot: its spec.

    Returns:
        The editable model without surroundings, and the same compiled (without actuators).

    Raises:
        RobotError: if file and spec do not fit each other, or MuJoCo cannot compile the file.

    Example:
        >>> from torchrl_atr.envs.models import ROBOTS
        >>> spec, model = load_robot_model(ROBOTS.get("go1"))
        >>> len(spec.actuators), round(float(mujoco.mj_getTotalmass(model)), 3)
        (12, 12.14)
    """
    if not robot.mjcf.is_file():
        raise robot.error(f"there is no MJCF file at {robot.mjcf}; check mjcf")
    with blame_file(robot):
        spec = mujoco.MjSpec.from_file(str(robot.mjcf))
    for folder in ("meshdir", "texturedir"):  # absolute: the scene may be saved to any folder
        setattr(spec, folder, str(robot.mjcf.parent.resolve() / Path(getattr(spec, folder))))
    isolate(spec, robot)
    model = compile_spec(spec, robot)
    _check_joints(model, robot)
    _check_feet(model, robot)
    _check_legs(model, robot)
    write_inertias(spec, model)
    _locate_attached(spec, model)
    _name_feet(spec, model, robot)
    _add_actuators(spec, model, robot)
    return spec, model


def compile_spec(spec: mujoco.MjSpec, robot: RobotSpec) -> mujoco.MjModel:
    """Compile a spec that holds the robot.

    Raises:
        RobotError: with MuJoCo's reason, if it cannot.
    """
    with blame_file(robot):
        return spec.compile()


@contextlib.contextmanager
def blame_file(robot: RobotSpec) -> Iterator[None]:
    """Turn MuJoCo's error about a file into a :class:`RobotError`; wrap calls of MuJoCo alone, which raise no other."""
    try:
        yield
    except (ValueError, mujoco.FatalError, mujoco.UnexpectedError) as error:
        # MuJoCo's message names the element, and the missing asset
        raise robot.error(
            f"MuJoCo cannot compile {robot.mjcf}: {' '.join(str(error).split())}. Does it open in "
            "`python -m mujoco.viewer`? Mesh and texture files are looked up in its folder or its meshdir"
        ) from error


def _names(model: mujoco.MjModel, kind: mujoco.mjtObj, count: int) -> list[str]:
    return [mujoco.mj_id2name(model, kind, i) or "" for i in range(count)]


def _check_joints(model: mujoco.MjModel, robot: RobotSpec) -> None:
    names = _names(model, mujoco.mjtObj.mjOBJ_JOINT, model.njnt)
    trunk = model.body(robot.trunk)
    if trunk.jntnum[0] != 1 or model.jnt_type[trunk.jntadr[0]] != mujoco.mjtJoint.mjJNT_FREE:
        raise robot.error(f"its root body {robot.trunk!r} has no free joint; write <freejoint/> into it")
    for joint, angle in zip(robot.joints, robot.q0):
        if joint not in names:
            raise robot.error(f"{robot.mjcf} has no joint {joint!r}; {nearest(joint, names)}")
        i = names.index(joint)
        if model.jnt_type[i] != mujoco.mjtJoint.mjJNT_HINGE:
            kind = mujoco.mjtJoint(model.jnt_type[i]).name.removeprefix("mjJNT_").lower()
            raise robot.error(
                f"joint {joint!r} is a {kind} joint, not a hinge; name the {JOINTS_PER_LEG} hinges per leg"
            )
        low, high = model.jnt_range[i]
        if model.jnt_limited[i] and not low - 1e-6 <= angle <= high + 1e-6:
            raise robot.error(
                f"q0 of joint {joint!r} is {angle:g}, outside of its range [{low:.4g}, {high:.4g}] rad: degrees, "
                "another joint's angle, or a wrong sign?"
            )
    free = [name for i, name in enumerate(names) if name not in robot.joints and i != trunk.jntadr[0]]
    if free:
        raise robot.error(
            f"nothing would drive joint {', '.join(map(repr, free))}; remove it from a copy of the MJCF file, which "
            "welds what hangs on it"
        )


def _check_feet(model: mujoco.MjModel, robot: RobotSpec) -> None:
    names = _names(model, mujoco.mjtObj.mjOBJ_GEOM, model.ngeom)
    tips = set(range(1, model.nbody)) - set(model.body_parentid.tolist())
    candidates = [
        name for i, name in enumerate(names) if name and model.geom_bodyid[i] in tips and model.geom_contype[i]
    ]
    for foot in itertools.chain(*robot.foot_names):
        if foot not in names:
            listed = ", ".join(candidates) or "none: give the foot geoms a name in the MJCF file"
            raise robot.error(
                f"{robot.mjcf} has no geom {foot!r} (feet); named geoms at the ends of its legs: {listed}"
            )
        if not model.geom(foot).contype[0]:
            raise robot.error(
                f"foot geom {foot!r} collides with nothing (contype and conaffinity are 0); choose the collision geom"
            )
    for first, *others in robot.foot_names:
        link = model.body_weldid[model.geom(first).bodyid[0]]
        for other in others:
            if model.body_weldid[model.geom(other).bodyid[0]] != link:
                raise robot.error(f"foot geoms {first!r} and {other!r} are on different links; list those of one foot")


def _check_legs(model: mujoco.MjModel, robot: RobotSpec) -> None:
    """Check that each foot is attached to its leg's three joints, in their order from the trunk."""
    for i, (leg, (foot, *_)) in enumerate(zip(LEGS, robot.foot_names)):
        chain: list[str] = []
        body = int(model.geom(foot).bodyid[0])
        while body > 0:
            first, count = int(model.body_jntadr[body]), int(model.body_jntnum[body])
            hinges = [j for j in range(first, first + count) if model.jnt_type[j] == mujoco.mjtJoint.mjJNT_HINGE]
            chain = [model.joint(j).name for j in hinges] + chain
            body = int(model.body_parentid[body])
        listed = list(robot.joints[i * JOINTS_PER_LEG : (i + 1) * JOINTS_PER_LEG])
        if chain != listed:
            raise robot.error(
                f"leg {leg}: foot {foot!r} hangs on {', '.join(chain) or 'no joint'}, but joints lists "
                f"{', '.join(listed)}; list joints, feet and q0 leg by leg, {', '.join(LEGS)}, from trunk to foot"
            )


def _locate_attached(spec: mujoco.MjSpec, model: mujoco.MjModel) -> None:
    """Make the file paths of attached models absolute: they are relative to folders unknown to a saved scene."""
    for kind, elements, folder in (
        ("mesh", spec.meshes, "meshdir"),
        ("hfield", spec.hfields, "meshdir"),
        ("skin", spec.skins, "meshdir"),
        ("tex", spec.textures, "texturedir"),
    ):
        for element in elements:
            if element.file and getattr(element.compiler, folder) != getattr(spec, folder):
                address = int(getattr(model, f"{kind}_pathadr")[element.id])
                path = model.paths[address:].split(b"\0", 1)[0]
                element.file = os.path.abspath(os.fsdecode(path))


def _name_feet(spec: mujoco.MjSpec, model: mujoco.MjModel, robot: RobotSpec) -> None:
    """Name every geom of a foot, for the scene's sensors."""
    taken = {geom.name for geom in spec.geoms}
    for foot, (named, *_) in zip(find_feet(model, robot), robot.foot_names):
        for geom in (geom for geom in spec.geoms if geom.id in foot and not geom.name):
            geom.name = next(name for i in itertools.count(2) if (name := f"{named}_{i}") not in taken)
            taken.add(geom.name)


def _add_actuators(spec: mujoco.MjSpec, model: mujoco.MjModel, robot: RobotSpec) -> None:
    for i, joint in enumerate(robot.joints):
        limit = robot.torque_limits[i % JOINTS_PER_LEG]
        actuator = spec.add_actuator(name=joint, trntype=mujoco.mjtTrn.mjTRN_JOINT, target=joint)
        actuator.set_to_position(kp=robot.kp, kv=robot.kd)
        actuator.forcelimited, actuator.forcerange = True, [-limit, limit]
        # a joint without limits may be commanded a full turn either way; the compiled range is in radians
        limits = model.joint(joint).range if model.jnt_limited[model.joint(joint).id] else [-2 * math.pi, 2 * math.pi]
        actuator.ctrllimited, actuator.ctrlrange = True, limits
