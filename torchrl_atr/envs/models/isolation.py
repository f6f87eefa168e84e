"""Isolation of the robot in its MJCF file: removes other elements and settings, which would affect the scene."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import mujoco
import numpy as np

from torchrl_atr._registry import nearest
from torchrl_atr.envs.models.robot import RobotSpec

_IDENTITY = ("classname", "compiler", "frame", "id", "info", "name", "parent", "plugin", "signature", "userdata")
"""Attributes of an ``MjSpec`` element that are not settings; some cannot be read on a default."""
_NOTATION = ("autolimits", "degree", "eulerseq", "fitaabb", "meshdir", "texturedir")
"""Compiler settings of the notation of the robot's elements; the scene's are written without them."""
_INERTIAL = ("balanceinertia", "boundinertia", "boundmass", "inertiafromgeom", "inertiagrouprange", "settotalmass")
"""Compiler settings that affect the inertia of every body."""
_SIZES = ("nconmax", "nemax", "njmax", "nkey", "nstack", "nuserdata", "memory")
_USER_SIZES = tuple(f"nuser_{kind}" for kind in ("actuator", "body", "cam", "geom", "jnt", "sensor", "site", "tendon"))
_NAMED = {
    "body": "bodies",
    "joint": "joints",
    "geom": "geoms",
    "site": "sites",
    "camera": "cameras",
    "light": "lights",
    "material": "materials",
    "texture": "textures",
}
"""Lists of ``MjSpec`` by the kinds of elements that both a robot and the scene may name."""


def isolate(spec: mujoco.MjSpec, robot: RobotSpec) -> None:
    """Remove everything but the robot from ``spec``, and reset every setting that would affect the scene.

    Settings that affect the inertia of bodies stay until :func:`write_inertias`.

    Args:
        spec: the robot's MJCF file.
        robot: names its root body.

    Raises:
        RobotError: if there is no such root body.
    """
    _delete_surroundings(spec, robot)
    _delete_dangling(spec)
    for geom in spec.geoms:
        if geom.contype or geom.conaffinity:
            geom.contype, geom.conaffinity, geom.priority = 1, 0, 0
    for joint in spec.joints:  # the trunk's frame is that of the file, not of its principal axes
        joint.align = mujoco.mjtAlignFree.mjALIGNFREE_AUTO
    _reset_settings(spec)


def _delete_surroundings(spec: mujoco.MjSpec, robot: RobotSpec) -> None:
    world = spec.worldbody
    bodies = [body.name for body in world.bodies]
    if robot.trunk not in bodies:
        raise robot.error(f"{robot.mjcf} has no root body {robot.trunk!r} (trunk); {nearest(robot.trunk, bodies)}")
    for body in [body for body in world.bodies if body.name != robot.trunk]:
        spec.delete(body)  # and all references to it or to its parts
    custom = [*spec.numerics, *spec.texts, *spec.tuples]
    driving = [*spec.sensors, *spec.actuators, *spec.keys, *spec.pairs]
    for element in [*custom, *driving, *world.geoms, *world.cameras, *world.sites, *spec.lights]:
        spec.delete(element)
    for texture in spec.textures:
        if texture.type == mujoco.mjtTexture.mjTEXTURE_SKYBOX:
            spec.delete(texture)


def _delete_dangling(spec: mujoco.MjSpec) -> None:
    """Delete references to the world or to elements removed from it, where MuJoCo has not done so."""
    bodies, sites = ({element.name for element in elements} for elements in (spec.bodies, spec.sites))
    for tendon in list(spec.tendons):
        if any(wrap.type != mujoco.mjtWrap.mjWRAP_PULLEY and wrap.target is None for wrap in tendon.path):
            spec.delete(tendon)
    tendons = {tendon.name for tendon in spec.tendons}
    for equality in list(spec.equalities):
        if equality.type == mujoco.mjtEq.mjEQ_TENDON and not {equality.name1, equality.name2} <= {"", *tendons}:
            spec.delete(equality)
        if equality.type in (mujoco.mjtEq.mjEQ_CONNECT, mujoco.mjtEq.mjEQ_WELD):
            known = sites if equality.objtype == mujoco.mjtObj.mjOBJ_SITE else bodies - {"world"}
            if not {equality.name1, equality.name2} <= known:
                spec.delete(equality)
    for camera in list(spec.cameras):
        if camera.targetbody and camera.targetbody not in bodies:
            spec.delete(camera)
    for skin in list(spec.skins):
        if not set(skin.bodyname) <= bodies:
            spec.delete(skin)
    for flex in list(spec.flexes):
        if not {*flex.nodebody, *flex.vertbody} <= bodies - {"world"}:
            spec.delete(flex)
    used = {element.plugin.name for element in (*spec.bodies, *spec.geoms, *spec.meshes) if element.plugin.active}
    for plugin in list(spec.plugins):
        if plugin.name not in used:
            spec.delete(plugin)


def _reset_settings(spec: mujoco.MjSpec) -> None:
    fresh = mujoco.MjSpec()
    for part in ("option", "stat"):
        _reset(getattr(spec, part), getattr(fresh, part))
    for part in ("global_", "headlight", "map", "quality", "rgba", "scale"):
        _reset(getattr(spec.visual, part), getattr(fresh.visual, part))
    for compiler in _compilers(spec):
        _reset(compiler, fresh.compiler, keep=(*_NOTATION, *_INERTIAL, "LRopt"))
    for name in (*_SIZES, *_USER_SIZES):
        setattr(spec, name, getattr(fresh, name))
    for default in _global_defaults(spec):
        for kind in ("joint", "geom", "site", "camera", "light", "material", "actuator"):
            _reset(getattr(default, kind), getattr(fresh.default, kind))


def _compilers(spec: mujoco.MjSpec) -> list[Any]:
    """Return the compiler settings of the file, and of the models that it attaches: each part keeps its own."""
    return [spec.compiler, *(body.compiler for body in spec.bodies)]


def _global_defaults(spec: mujoco.MjSpec) -> list[Any]:
    """Return the classes ``main`` of the file, and of the models that it attaches, as far as an element is in them.

    The file's elements keep the values that they have from them; elements of the scene start from MuJoCo's defaults.
    """
    elements = (*spec.geoms, *spec.joints, *spec.sites, *spec.cameras, *spec.materials, *spec.meshes)
    classes = [element.classname for element in elements]
    return [spec.default, *(each for each in classes if each.name == spec.default.name)]


def _reset(settings: Any, fresh: Any, keep: Iterable[str] = ()) -> None:
    """Give every field of ``settings`` its value in ``fresh``."""
    for name in dir(settings):
        if not name.startswith("_") and name not in (*_IDENTITY, *keep) and not callable(getattr(settings, name)):
            setattr(settings, name, getattr(fresh, name))


def write_inertias(spec: mujoco.MjSpec, model: mujoco.MjModel) -> None:
    """Write the inertias of ``model`` into its ``spec`` where compiler settings affect them, and reset those settings.

    They then do not affect the scene's own bodies, or a file that the scene is saved to.
    """
    fresh, compilers = mujoco.MjSpec().compiler, _compilers(spec)
    if all(np.array_equal(getattr(each, name), getattr(fresh, name)) for each in compilers for name in _INERTIAL):
        return
    for body in spec.bodies[1:]:
        if model.body_mass[body.id] > 0:
            body.mass, body.inertia = model.body_mass[body.id], model.body_inertia[body.id]
            body.ipos, body.iquat = model.body_ipos[body.id], model.body_iquat[body.id]
            body.ialt.type = mujoco.mjtOrientation.mjORIENTATION_QUAT
            body.fullinertia = np.full(6, np.nan)
            body.explicitinertial = True
    for compiler in compilers:
        for name in _INERTIAL:
            setattr(compiler, name, getattr(fresh, name))


def check_names(spec: mujoco.MjSpec, fixtures: mujoco.MjSpec, robot: RobotSpec) -> None:
    """Raise if a robot has names of the scene's own parts; drop unused assets instead.

    Args:
        spec: the robot alone.
        fixtures: the scene without the robot.
        robot: for messages.

    Raises:
        RobotError: names every such element.
    """
    _drop_unused_assets(spec, _names(fixtures.materials), _names(fixtures.textures))
    taken = []
    for kind, elements in _NAMED.items():
        clashes = _names(getattr(spec, elements)) & _names(getattr(fixtures, elements))
        taken += [f"{kind} {name!r}" for name in sorted(clashes)]
    if taken:
        raise robot.error(
            f"the scene has parts of the same name as its {', '.join(taken)}; give it another name in a copy of "
            f"{robot.mjcf}"
        )


def _names(elements: Iterable[Any]) -> set[str]:
    return {element.name for element in elements} - {"", "world"}


def _drop_unused_assets(spec: mujoco.MjSpec, materials: set[str], textures: set[str]) -> None:
    used = {element.material for element in (*spec.geoms, *spec.sites, *spec.skins, *spec.tendons, *spec.flexes)}
    for material in list(spec.materials):
        if material.name in materials - used:
            spec.delete(material)
    used = {name for material in spec.materials for name in material.textures}
    for texture in list(spec.textures):
        if texture.name in textures - used:
            spec.delete(texture)
