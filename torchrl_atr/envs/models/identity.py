"""Descriptions of scenes as plain values, their comparison and named differences."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import math
from collections.abc import Collection, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from torchrl_atr.envs.models.contacts import ContactModel
from torchrl_atr.envs.models.robot import RobotSpec
from torchrl_atr.envs.models.scene import Scene

PARTS = ("robot", "transporter")
"""Parts of a description, each of which can be replaced alone."""
Description = dict[str, dict[str, dict[str, Any]]]
"""Values by part, by element (``"body FL_thigh"``), by field."""
_KINDS = ("body", "jnt", "geom", "actuator", "eq", "tendon")
_INTEGERS = {
    *("jnt_type", "jnt_limited", "jnt_actfrclimited", "jnt_actgravcomp"),
    *("geom_type", "geom_contype", "geom_conaffinity", "geom_condim", "geom_priority"),
    *("actuator_gaintype", "actuator_biastype", "actuator_dyntype", "actuator_forcelimited", "actuator_ctrllimited"),
    *("eq_type", "eq_active0", "tendon_limited"),
}
"""Integer fields that are not addresses of something else."""
_DERIVED = {
    *("body_subtreemass", "body_invweight0", "dof_invweight0", "dof_M0", "dof_length"),
    *("actuator_acc0", "actuator_length0", "actuator_lengthrange", "tendon_invweight0", "tendon_length0"),
    *("geom_rgba", "tendon_rgba", "tendon_width"),
}
"""Fields that MuJoCo computes from the others, differently by version, and those for rendering alone."""
_CONTACTS = {field.name for field in dataclasses.fields(ContactModel)}
"""Options that belong to neither robot nor transporter; policies trained with other ones still run."""
_TOLERANCE = 1e-6
"""Relative tolerance: MuJoCo's versions round differently."""


def describe(scene: Scene) -> Description:
    """Describe the physics of a robot and its support: their specs, and the compiled model.

    Colours, textures, cameras, lights, geoms without contacts, and file paths are left out.

    Args:
        scene: a compiled scene.

    Returns:
        Nested dicts of numbers, texts and lists, the same for the same model wherever it was compiled.

    Example:
        >>> from torchrl_atr.envs.models import ROBOTS, FlatGround, build_scene
        >>> describe(build_scene(ROBOTS.get("a1"), FlatGround()))["robot"]["body FL_thigh"]["body_mass"]
        1.013
    """
    description: Description = {
        "robot": {"spec": _facts(scene.robot), "option": _options(scene.model)},
        scene.support.kind: {"spec": _plain(scene.support.describe())},
    }
    for part, element, fields in _elements(scene):
        description[part][element] = fields
    return description


def digest(description: Description) -> str:
    """Return a fingerprint of a description, 64 hexadecimal digits; numbers count to six digits."""
    return hashlib.sha256(json.dumps(_rounded(description), sort_keys=True).encode()).hexdigest()


def differences(then: Mapping[str, Any], now: Mapping[str, Any], parts: Collection[str] = PARTS) -> list[str]:
    """Name the differences between two descriptions.

    Fields that only one of them has are left out: new versions of MuJoCo and this package add some.

    Args:
        then: of a run.
        now: of the present scene.
        parts: which parts to compare.

    Returns:
        Texts such as ``"body_mass of body FL_thigh: 1.013 then, 2 now"``; none if they are the same.

    Example:
        >>> then, now = ({"robot": {"spec": {"kp": kp, "kd": 1.0}}} for kp in (40.0, 60.0))
        >>> differences(then, now)
        ["the robot's kp: 40 then, 60 now"]
    """
    found: list[str] = []
    for part in parts:
        before, after = then.get(part, {}), now.get(part, {})
        for element in {**before, **after}:
            if element not in after:
                found.append(f"{element} is gone")
            elif element not in before:
                found.append(f"{element} is new")
            else:
                for field, value in before[element].items():
                    if field in after[element] and not _same(value, after[element][field]):
                        name = f"the {part}'s {field}" if element == "spec" else f"{field} of {element}"
                        found.append(f"{name}: {_changed(value, after[element][field])}")
    return found


def first_few(changed: Sequence[str], count: int = 2) -> str:
    """Join the first of :func:`differences` to a line.

    Example:
        >>> first_few(["body_mass of body hip: 1 then, 2 now", "body tail is new", "body ear is new"])
        'body_mass of body hip: 1 then, 2 now; body tail is new; and 1 more'
    """
    more = [f"and {len(changed) - count} more"] if len(changed) > count else []
    return "; ".join([*changed[:count], *more])


def _facts(robot: RobotSpec) -> dict[str, Any]:
    """Return the fields of a robot's spec except its name and its file."""
    return {name: value for name, value in _plain(dataclasses.asdict(robot)).items() if name not in ("name", "mjcf")}


def _options(model: mujoco.MjModel) -> dict[str, Any]:
    names = (name for name in dir(model.opt) if not name.startswith("_") and name not in _CONTACTS)
    return {name: _plain(getattr(model.opt, name)) for name in names}


def _elements(scene: Scene) -> Iterator[tuple[str, str, dict[str, Any]]]:
    """Yield part, label and fields of all elements that move or act; the floor belongs to the scene."""
    model = scene.model
    support = scene.support
    theirs = {model.body(name).id for name in support.bodies}
    labels: dict[str, int] = {}
    for kind in _KINDS:
        names = [name for name in dir(model) if name.startswith(f"{kind}_") and name not in _DERIVED]
        arrays = {name: getattr(model, name) for name in names if _compared(name, getattr(model, name))}
        for i in range({"jnt": model.njnt, "eq": model.neq}.get(kind, getattr(model, f"n{kind}", 0))):
            body = {"body": i}.get(kind, int(getattr(model, f"{kind}_bodyid")[i]) if kind in ("jnt", "geom") else -1)
            name = mujoco.mj_id2name(model, _OBJECTS[kind], i) or ""
            touches = kind != "geom" or model.geom_contype[i] or model.geom_conaffinity[i]
            if body == 0 or not touches or name in support.joints:
                continue
            fields = {field: _plain(array[i]) for field, array in arrays.items()}
            fields |= _EXTRAS.get(kind, lambda *_: {})(model, i)
            label = f"{_NOUNS.get(kind, kind)} {name}" if name else f"{_NOUNS.get(kind, kind)} on {_body(model, body)}"
            labels[label] = count = labels.get(label, 0) + 1
            yield support.kind if body in theirs else "robot", label if count == 1 else f"{label} ({count})", fields


_NOUNS = {"jnt": "joint", "eq": "constraint"}
_OBJECTS = {
    "body": mujoco.mjtObj.mjOBJ_BODY,
    "jnt": mujoco.mjtObj.mjOBJ_JOINT,
    "geom": mujoco.mjtObj.mjOBJ_GEOM,
    "actuator": mujoco.mjtObj.mjOBJ_ACTUATOR,
    "eq": mujoco.mjtObj.mjOBJ_EQUALITY,
    "tendon": mujoco.mjtObj.mjOBJ_TENDON,
}


def _compared(name: str, value: Any) -> bool:
    if not isinstance(value, np.ndarray) or name.endswith("_user"):
        return False
    return value.dtype.kind == "f" or name in _INTEGERS


def _body(model: mujoco.MjModel, i: int) -> str:
    return (mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_BODY, i) or f"body {i}") if i >= 0 else "the robot"


def _body_extras(model: mujoco.MjModel, i: int) -> dict[str, Any]:
    return {"parent": _body(model, int(model.body_parentid[i]))}


def _joint_extras(model: mujoco.MjModel, i: int) -> dict[str, Any]:
    """Return fields of the joint's degrees of freedom, and its position."""
    following = int(model.jnt_dofadr[i + 1]) if i + 1 < model.njnt else model.nv
    dofs = slice(int(model.jnt_dofadr[i]), following)
    names = [name for name in dir(model) if name.startswith("dof_") and name not in _DERIVED]
    fields = {name: getattr(model, name) for name in names if _compared(name, getattr(model, name))}
    own = {name: _plain(array[dofs]) for name, array in fields.items()}
    return {"parent": _body(model, int(model.jnt_bodyid[i])), **own}


def _geom_extras(model: mujoco.MjModel, i: int) -> dict[str, Any]:
    """Return, for a mesh, the number of vertices, their mean and their spread."""
    own: dict[str, Any] = {"parent": _body(model, int(model.geom_bodyid[i]))}
    if model.geom_type[i] == mujoco.mjtGeom.mjGEOM_MESH:
        mesh = model.mesh(int(model.geom_dataid[i]))
        first = int(mesh.vertadr[0])
        vertices = np.asarray(model.mesh_vert[first : first + int(mesh.vertnum[0])], dtype=np.float64)
        own["mesh"] = [float(len(vertices)), *vertices.mean(0).tolist(), *vertices.std(0).tolist()]
    return own


_EXTRAS = {"body": _body_extras, "jnt": _joint_extras, "geom": _geom_extras}


def _plain(value: Any) -> Any:
    """Return ``value`` as JSON can hold it."""
    if isinstance(value, dict):
        return {str(name): _plain(entry) for name, entry in value.items()}
    if isinstance(value, np.ndarray | np.generic):
        return np.atleast_1d(value).reshape(-1).tolist() if np.ndim(value) else value.item()
    if isinstance(value, list | tuple | set | frozenset):
        return [_plain(entry) for entry in value]
    if callable(value):
        named = value if hasattr(value, "__qualname__") else type(value)
        return f"{named.__module__}.{named.__qualname__}"
    return str(value) if isinstance(value, Path) else value


def _same(one: Any, other: Any) -> bool:
    if isinstance(one, dict) and isinstance(other, dict):
        return all(_same(one[name], other[name]) for name in one.keys() & other.keys())
    if isinstance(one, list) and isinstance(other, list):
        return len(one) == len(other) and all(map(_same, one, other))
    if isinstance(one, int | float) and isinstance(other, int | float):
        return math.isclose(one, other, rel_tol=_TOLERANCE, abs_tol=1e-9) or (one != one and other != other)
    return bool(one == other)


def _changed(then: Any, now: Any) -> str:
    """Return the values that differ, of lists only the first pair."""
    while isinstance(then, list) and isinstance(now, list) and len(then) == len(now):
        then, now = next((pair for pair in zip(then, now) if not _same(*pair)), ("", ""))
    short = [f"{value:.6g}" if isinstance(value, float) else str(value)[:40] for value in (then, now)]
    return f"{short[0]} then, {short[1]} now"


def _rounded(value: Any) -> Any:
    if isinstance(value, dict):
        return {name: _rounded(entry) for name, entry in value.items()}
    if isinstance(value, list):
        return [_rounded(entry) for entry in value]
    return f"{value:.6g}" if isinstance(value, int | float) and not isinstance(value, bool) else value
