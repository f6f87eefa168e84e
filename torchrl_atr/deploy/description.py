"""Contents of a bundle's manifest: robot, sensors, observation, command, training."""

from __future__ import annotations

from collections.abc import Mapping
from importlib.metadata import version
from typing import Any

from torchrl_atr._errors import UserError
from torchrl_atr.deploy.manifest import SCHEMA, VERSION
from torchrl_atr.deploy.policy_step import CLOCK, SENSORS, target_limits
from torchrl_atr.envs.models import FlatGround, Scene, Transporter
from torchrl_atr.envs.models.boards import PLANAR_JOINTS
from torchrl_atr.envs.models.drives import tilt_drive
from torchrl_atr.envs.physics import CONTROL_DT, DECIMATION
from torchrl_atr.envs.tasks.dead_reckoning import METHODS, method_of
from torchrl_atr.envs.tasks.support_tilt import NAME
from torchrl_atr.modules import CommandRange
from torchrl_atr.runs.provenance import machine
from torchrl_atr.training import TrainConfig

_BODY = "body: x forward, y left, z up"
_ARGUMENTS = {
    "acceleration": "imu.acceleration",
    "angular_velocity": "imu.angular_velocity",
    "orientation": "imu.orientation",
    "joint_position": "joint_positions",
    "joint_velocity": "joint_velocities",
}
_FRAMES = {
    "angular_velocity": _BODY,
    "orientation": "roll and pitch of R = Rz(yaw) Ry(pitch) Rx(roll), body to world, z up",
    "joint_position": "about each joint's axis; zero as in the robot's MJCF file",
    "joint_velocity": "about each joint's axis",
    "action": "joint displacement from q0 / action scale, as the policy gave it",
    NAME: "computed in policy.onnx: tilt of the feet's plane against the horizontal; left side up, front down, twist",
    CLOCK: "computed in policy.onnx: sine and cosine of the gait's phase; zero while the command is to stand still",
    "command": "forward speed, and yaw rate to the left, of the transporter; of the trunk, if it walks",
}
_CLIPPING = "speed within {0} m/s, yaw rate within ±{1:g} rad/s; in policy.onnx, so the history holds clipped commands"
_LATERAL = "; where |v ω| exceeds {0:g} m/s², the yaw rate is reduced, to {1:g} rad/s at least, then the speed"


def describe_policy(
    config: TrainConfig, env: Any, limits: CommandRange, mastered: bool, provenance: Mapping[str, Any]
) -> dict[str, Any]:
    """Return a manifest, but for what is known when the files are written.

    Args:
        config: of the run.
        env: of it, below all transforms.
        limits: to which commands are clipped.
        mastered: whether those are the commands that were measured as mastered, or all that were trained.
        provenance: of the run.
    """
    task, scene, interpretation = env.task, env.scene, env.task.interpretation
    sizes = env.runner.terms.observations.sizes
    grid, gravity = config.grid, interpretation.gravity_in_acceleration
    frames = {**_FRAMES, "acceleration": f"{_BODY}; {'specific force' if gravity else 'gravity subtracted'}"}
    frames["acceleration"] += f", mean over the control period of {1e3 * CONTROL_DT:.0f} ms"
    command = {"names": list(task.command.names), "units": list(task.command.units)}
    parts = [(name, term, sizes["proprio"][name]) for name, term in task.observations["proprio"].items()]
    measured = [part for part in parts if part[0] in SENSORS]
    estimated = task.observations["privileged", "extrinsic"]
    reckoning = method_of(task.memory)
    speeds = f"[0, {limits.max_speed:g}]" if limits.forward_only else f"±{limits.max_speed:g}"
    clipping = _CLIPPING.format(speeds, limits.max_yaw_rate)
    if limits.max_lateral_acceleration is not None:
        clipping += _LATERAL.format(limits.max_lateral_acceleration, limits.least_yaw_rate)
    return {
        "schema": SCHEMA,
        "version": VERSION,
        "task": task.name,
        "robot": {
            "name": scene.robot.name,
            "action_scale": scene.robot.action_scale,
            "standing_height": scene.robot.standing_height,
        },
        "joints": _joints(scene),
        "transporter": _transporter(scene),
        "control": {
            "rate_hz": round(1.0 / CONTROL_DT, 6),
            "simulation_steps": DECIMATION,
            "law": "torque = kp (target - q) - kd q̇, at a kHz or more; target = q0 + action scale · action, in limits",
        },
        "imu": {"gravity_included": gravity},
        "sensors": [
            {
                "name": name,
                "argument": _ARGUMENTS[name],
                "size": size,
                "unit": term.unit,
                "parts": _parts(term, size),
                "frame": frames[name],
                "trained_with": {
                    "noise_std": term.noise,
                    "bias_std": term.bias,
                    "bias_time_s": term.bias_time if term.bias_time < float("inf") else None,
                    "max_delay_s": term.delay * CONTROL_DT,
                },
            }
            for name, term, size in sorted(measured, key=lambda part: SENSORS.index(part[0]))
        ],
        "observation": [
            *({"name": name, "size": size, "unit": term.unit, "frame": frames[name]} for name, term, size in parts),
            {"name": "command", "size": len(command["names"]), "unit": command["units"], "frame": frames["command"]},
        ],
        "history": {
            "length": config.env.history_length,
            "order": "oldest first",
            "ends_with": "o_t" if interpretation.current_in_history else "o_{t-1}",
            "start": "every row is the first observation of the episode; the first last action is zero",
        },
        "dead_reckoning": {
            "method": reckoning,
            "start": "the robot stands at rest",
            "output": METHODS[reckoning].output,
        },
        "command": {
            **command,
            "limits": vars(limits),
            "clipping": clipping,
            "slew_rates": list(config.curriculum.slew_rates) or None,
            "source": "mastered: `torchrl-atr evaluate --command-range record`" if mastered else "trained",
            "trained": None if grid is None else dict(zip(command["names"], grid.bounds)),
        },
        "estimates": [
            {"name": name, "size": size, "unit": estimated[name].unit, "parts": _parts(estimated[name], size)}
            for name, size in sizes["privileged", "extrinsic"].items()
            if "extrinsic" in config.roa.actor_reads
        ],
        "training": dict(provenance),
        "versions": {
            **machine()["versions"],
            **{name: version(name) for name in ("onnx", "onnxscript", "onnxruntime")},
        },
    }


def _joints(scene: Scene) -> list[dict[str, Any]]:
    robot, model, limits = scene.robot, scene.model, target_limits(scene)
    rows = []
    for i, name in enumerate(robot.joints):
        joint, targets = model.joint(name), [limits["low"][i], limits["high"][i]]
        rows.append(
            {
                "name": name,
                "axis": model.jnt_axis[joint.id].tolist(),
                "q0": robot.q0[i],
                "range": model.jnt_range[joint.id].tolist() if model.jnt_limited[joint.id] else targets,
                "target_limits": targets,
                "kp": robot.kp,
                "kd": robot.kd,
                "torque_limit": robot.torque_limits[i % len(robot.torque_limits)],
            }
        )
    return rows


def _parts(term: Any, size: int) -> list[str]:
    return [str(part) for part in term.parts][:size]


def _transporter(scene: Scene) -> dict[str, Any] | None:
    """Return the facts of the transporter and its drive law, for another simulation; None for flat ground."""
    support = scene.support
    if isinstance(support, FlatGround):
        return None
    if not isinstance(support, Transporter):
        raise UserError(
            f"a policy on {support.name!r} cannot be exported; the runtime knows transporters and the floor"
        )
    spec, interpretation = support.spec, support.interpretation
    return {
        "name": spec.name,
        "size": list(spec.size),
        "mass": spec.mass,
        "inertia_z": spec.inertia[2],
        "drive": "tilt_drive" if spec.design.drive is tilt_drive else "custom",
        "max_acceleration": spec.max_acceleration,
        "max_yaw_acceleration": spec.max_yaw_acceleration,
        "tilt_norm": spec.tilt_norm,
        "resistance": list(spec.resistance),
        "driving": [list(row) for row in spec.design.driving],
        "hinges": [hinge.name for hinge in spec.design.hinges],
        "boards": list(support.geoms),
        "planar_joints": list(PLANAR_JOINTS),
        "interpretation": {
            name: getattr(interpretation, name)
            for name in ("relative_mass", "odd_resistance", "coulomb_smoothing", "steering_smoothing")
        },
    }
