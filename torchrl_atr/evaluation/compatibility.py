"""Policies on robots and transporters that they were not trained on (Table IV's groups)."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any, NamedTuple

import mujoco
import numpy as np
from tensordict.nn import TensorDictModuleBase
from torchrl.envs import EnvBase

from torchrl_atr._errors import InputError, UserError
from torchrl_atr.envs.access import base_env
from torchrl_atr.envs.models import ROBOTS, TRANSPORTER_DESIGNS, TRANSPORTERS, Scene
from torchrl_atr.envs.physics import CONTROL_DT
from torchrl_atr.evaluation.endurance import EnduranceResult, evaluate_endurance
from torchrl_atr.evaluation.endurance_metrics import endurance_metrics
from torchrl_atr.evaluation.intervals import share_text
from torchrl_atr.evaluation.ride import MAX_ROBOTS, build_env, key_name
from torchrl_atr.evaluation.robustness import row_of, shifted


class CompatibilityError(InputError):
    """Error of a policy that cannot act for a robot; the message says what differs."""


class Pair(NamedTuple):
    """Names of a robot and a transporter.

    Example:
        >>> Pair.of("go1/two_board")
        Pair(robot='go1', transporter='two_board')
    """

    robot: str
    transporter: str

    @classmethod
    def of(cls, text: str) -> Pair:
        """Return a pair from ``ROBOT/TRANSPORTER``.

        Raises:
            InputError: for another form.
        """
        robot, slash, transporter = text.partition("/")
        if not (robot and slash and transporter) or "/" in transporter:
            raise InputError(f"{text!r} is no pair; give ROBOT/TRANSPORTER, such as go1/two_board")
        return cls(robot, transporter)

    def __str__(self) -> str:
        return f"{self.robot}/{self.transporter}"


def group_pairs(scene: Scene) -> list[Pair]:
    """Return all pairs of a scene's size class, its own robot first: each robot on each transporter.

    Example:
        >>> from torchrl_atr.envs.models import FlatGround, build_scene
        >>> [str(pair) for pair in group_pairs(build_scene(ROBOTS.get("go1"), FlatGround()))][:3]
        ['go1/single_board_g1', 'go1/two_board_g1', 'a1/single_board_g1']
    """
    own = scene.robot
    mates = [name for name in ROBOTS.names() if ROBOTS.get(name).group == own.group and name != own.name]
    transporters = [name for design in TRANSPORTER_DESIGNS if (name := f"{design}_{own.group.lower()}") in TRANSPORTERS]
    return [Pair(robot, transporter) for robot in [own.name, *mates] for transporter in transporters]


def check_fit(policy: TensorDictModuleBase, own: EnvBase, other: EnvBase) -> None:
    """Check that a policy can act in another env: the same sizes, and joints that turn the same way.

    Args:
        policy: trained in ``own``.
        own: env of a :class:`~torchrl_atr.envs.QuadrupedEnv`.
        other: likewise.

    Raises:
        CompatibilityError: says what differs.
    """
    scenes = [base_env(env).scene for env in (own, other)]
    names = [f"{scene.robot.name} on {scene.support.name}" for scene in scenes]
    for key in policy.in_keys:
        sizes = [_size(env, key) for env in (own, other)]
        if sizes[0] != sizes[1]:
            raise CompatibilityError(
                f"the policy of {names[0]} reads {key_name(key)!r} of size {sizes[0]}; {names[1]} has {sizes[1]}: it "
                "cannot act there; train one for it"
            )
    turns, others = (_turns(scene) for scene in scenes)
    for joint, one, two in zip(scenes[1].robot.joints, turns, others, strict=True):
        if one != two:
            raise CompatibilityError(
                f"joint {joint} of {names[1]} turns the other way, or about another axis, than that of {names[0]}: the "
                "policy of one cannot act for the other; turn it in the robot's model"
            )


def _size(env: EnvBase, key: Any) -> tuple[int, ...]:
    keys = env.observation_spec.keys(True, True)
    return tuple(env.observation_spec[key].shape[len(env.batch_size) :]) if key in keys else ()


def _turns(scene: Scene) -> list[tuple[int, int]]:
    """Return the axis of the trunk, 0 to 2, that each joint turns about in the stand, and the sign.

    The order of legs and joints is the same for all robots: a scene is refused otherwise.
    """
    model, data = scene.model, mujoco.MjData(scene.model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    mujoco.mj_kinematics(model, data)
    axes = data.xaxis[[model.joint(name).id for name in scene.robot.joints]]
    along = np.abs(axes).argmax(1)
    return [(int(axis), int(np.sign(axes[i, axis]))) for i, axis in enumerate(along)]


def ride_on(
    policy: TensorDictModuleBase,
    make_env: Callable[..., EnvBase],
    pair: Pair,
    robots: int = 100,
    seconds: float = 20.0,
    **ride: Any,
) -> EnduranceResult:
    """Ride with a policy's robot replaced by another one, or on another transporter.

    Args:
        policy: writes the action.
        make_env: called as ``make_env(num_envs=n, seed=s)`` for the env that it was trained in, and with ``robot`` and
            ``transporter`` for another.
        pair: what to ride.
        robots: number of robots.
        seconds: length of the ride.
        **ride: further arguments of :func:`~torchrl_atr.evaluation.evaluate_endurance`.

    Raises:
        CompatibilityError: if the policy cannot act there. UnknownNameError: for an unknown robot or transporter.

    Example:
        >>> from torchrl_atr.envs import make_riding_env
        >>> from torchrl_atr.modules import make_networks
        >>> make_env = partial(make_riding_env, num_threads=1)
        >>> env = make_env(num_envs=1, seed=0)
        >>> policy = make_networks(env.observation_spec, env.action_spec).deployed_policy()
        >>> short = {"command_seconds": 0.1, "settle": 0.0}
        >>> ride_on(policy, make_env, Pair("go1", "two_board"), 2, 0.2, **short).survived.tolist()
        [True, True]
    """
    own = build_env(make_env, 1, 0)
    scene: Scene = base_env(own).scene
    names = Pair(scene.robot.name, scene.support.name)
    # what stays need not be registered: a robot of the user's own
    replaced = {part: name for part, name in pair._asdict().items() if name != getattr(names, part)}
    there = partial(make_env, **replaced)
    other = build_env(there, 1, 0)
    try:
        check_fit(policy, own, other)
    finally:
        for env in (own, other):
            env.close(raise_if_closed=False)
    return evaluate_endurance(policy, there, robots, seconds, **ride)


def evaluate_compatibility(
    policy: TensorDictModuleBase,
    make_env: Callable[..., EnvBase],
    pairs: Sequence[str] | None = None,
    robots: int = 100,
    seconds: float = 20.0,
    *,
    progress: Callable[[int, int], None] | None = None,
    **ride: Any,
) -> dict[str, Any]:
    """Ride with a policy on several pairs of robot and transporter.

    Args:
        policy: writes the action.
        make_env: see :func:`ride_on`.
        pairs: texts ``ROBOT/TRANSPORTER``; None for :func:`group_pairs`, of which those that cannot work are named in
            the report.
        robots: number of robots in each ride.
        seconds: length of a ride.
        progress: called with (steps done, steps in total).
        **ride: see :func:`ride_on`.

    Returns:
        Contents of ``metrics.json``: the protocol, ``trained_on``, and for each pair a cell of ``robot``,
        ``transporter``, and the figures of :func:`~torchrl_atr.evaluation.robustness.row_of`, or ``refused``, why not.

    Raises:
        CompatibilityError: if the policy cannot act for one of the ``pairs``.
    """
    first = build_env(make_env, 1, 0)
    scene: Scene = base_env(first).scene
    first.close(raise_if_closed=False)
    chosen = group_pairs(scene) if pairs is None else [Pair.of(text) for text in pairs]
    steps, cells = round(seconds / CONTROL_DT) * -(-robots // MAX_ROBOTS), []
    protocol: dict[str, Any] = {}
    for number, pair in enumerate(chosen):
        pair_progress = shifted(progress, number * steps, len(chosen) * steps)
        cell: dict[str, Any] = pair._asdict()
        try:
            result = ride_on(policy, make_env, pair, robots, seconds, progress=pair_progress, **ride)
        except UserError as error:
            if pairs is not None or not isinstance(error, CompatibilityError):
                raise
            cell["refused"] = str(error)
        else:
            protocol = {"seconds": result.seconds, "command_seconds": result.command_seconds}
            cell |= row_of(endurance_metrics(result))
        cells.append(cell)
    own = {"robot": scene.robot.name, "transporter": scene.support.name}
    return {"protocol": "compatibility", "n": robots, **protocol, "trained_on": own, "cells": cells}


def compatibility_table(metrics: Mapping[str, Any]) -> list[str]:
    """Return a Markdown table of a compatibility evaluation: share up with its interval, and errors."""
    lines = [
        f"{metrics['n']} robots of the training range in every ride of {metrics['seconds']:g} s, a new command every "
        f"{metrics['command_seconds']:g} s; intervals are of 95 %.",
        "",
        "| robot | transporter | up at the end | speed error, m/s | yaw error, rad/s |",
        "| --- | --- | --- | --- | --- |",
    ]
    for cell in metrics["cells"]:
        named = [cell["robot"], cell["transporter"]]
        if named == list(metrics["trained_on"].values()):
            named[1] += " (trained on)"
        if "refused" in cell:
            lines.append(f"| {' | '.join(named)} | cannot: {cell['refused']} | - | - |")
            continue
        errors = [cell["settled_speed_error"], cell["settled_yaw_error"]]
        figures = [
            share_text(cell["survival"], cell["survival_interval"]),
            *("-" if e is None else f"{e:.2f}" for e in errors),
        ]
        lines.append(f"| {' | '.join([*named, *figures])} |")
    return lines
