"""Example of a third task in one file: stand at a commanded position on a plate that tilts by itself.

Run it:  torchrl-atr train --import examples.balance --task balance --total-frames 200000
"""

import math
from functools import partial

import mujoco
import torch

from torchrl_atr.envs.interpretation import get_interpretation
from torchrl_atr.envs.models import Support, get_robot
from torchrl_atr.envs.models.support import touch
from torchrl_atr.envs.physics import SubstepHook
from torchrl_atr.envs.tasks import TASKS, CommandSpace, ObservationTerm, RewardTerm, Task
from torchrl_atr.envs.tasks.common_rewards import tracking_kernel
from torchrl_atr.envs.tasks.events import tilted, too_low
from torchrl_atr.envs.tasks.parameters import robot_parameters
from torchrl_atr.envs.tasks.proprioception import BODY, PROPRIO
from torchrl_atr.envs.transforms import CommandGrid
from torchrl_atr.training import TASK_SETTINGS

SIDE, HEIGHT = 1.6, 0.3
STIFFNESS, DAMPING = 4000.0, 400.0


class Plate(Support):
    """Plate on two hinges that roll and pitch."""

    name, kind, size, height, geoms, bodies = "plate", "plate", (SIDE, SIDE), HEIGHT, ("plate",), ("plate",)
    contact = mujoco.mjtObj.mjOBJ_GEOM, "plate"

    def build(self, spec, robot_mass):
        """Add the plate with its two hinges."""
        body = spec.worldbody.add_body(name="plate", pos=[0, 0, HEIGHT - 0.02])
        for name, axis in (("plate_roll", [1, 0, 0]), ("plate_pitch", [0, 1, 0])):
            body.add_joint(name=name, type=mujoco.mjtJoint.mjJNT_HINGE, axis=axis, armature=robot_mass)
        box = body.add_geom(name="plate", type=mujoco.mjtGeom.mjGEOM_BOX, size=[SIDE / 2, SIDE / 2, 0.02], mass=20.0)
        touch(box)

    def locate(self, model):
        """Return the addresses of the hinges in qpos and qvel."""
        joints = [model.joint(name) for name in ("plate_roll", "plate_pitch")]
        return [int(joint.qposadr[0]) for joint in joints], [int(joint.dofadr[0]) for joint in joints]


class Rocking(SubstepHook):
    """Hook that tilts the plate along a slow figure of eight of 0.1 rad, by torques; its clock is part of the state."""

    def __init__(self, engine):
        """Start every simulation's clock at zero."""
        super().__init__(engine)
        self.time = torch.zeros(engine.num_envs, 1, dtype=torch.float64)
        self.state = {"rocking_time": self.time}

    def start(self, rows):
        """Reset the clock of new episodes."""
        self.time[rows] = 0.0

    def apply(self, dt):
        """Apply PD torques to the hinges towards their targets."""
        (qpos, qvel), engine = self.engine.scene.support_layout, self.engine
        self.time += dt
        target = 0.1 * torch.sin(2.0 * math.pi * self.time * torch.tensor([0.2, 0.4], dtype=torch.float64))
        torque = STIFFNESS * (target - engine.qpos[:, qpos]) - DAMPING * engine.qvel[:, qvel]
        engine.qfrc_applied[:, qvel] = torque


def place(c):
    """Return the body's position on the plate, m, (N, 2)."""
    return c.state.position[:, :2]


def plate_tilt(c):
    """Compute roll and pitch of the plate under the feet, as slopes, (N, 2)."""
    feet = c.state.foot_position
    side = feet[:, 2:, 2].mean(1) - feet[:, :2, 2].mean(1)
    ends = feet[:, [0, 2], 2].mean(1) - feet[:, [1, 3], 2].mean(1)
    return torch.stack([side, ends], -1)


def balance(robot="a1", profile="default"):
    """Return the task."""
    walker, interpretation = get_robot(robot), get_interpretation(profile)
    grid = CommandGrid((0.2, 0.1), (0.1, 0.1), (0.1, 0.1), (0.1, 0.1))
    told = {f"at_{axis}": RewardTerm(partial(near, i), 4.0) for i, axis in enumerate("xy")}
    return Task(
        name="balance",
        robot=walker,
        support=Plate(),
        substep_hook=Rocking,
        command=CommandSpace(("x", "y"), ("m", "m"), grid, mirror=(1.0, -1.0)),
        observations={
            "proprio": {**PROPRIO, "place": ObservationTerm(place, mirror=(1.0, -1.0))},
            "speeds": {"place": ObservationTerm(place, mirror=(1.0, -1.0))},
            ("privileged", "extrinsic"): {
                **BODY,
                "plate_tilt": ObservationTerm(plate_tilt, mirror=(-1.0, 1.0), parts=("roll", "pitch")),
            },
        },
        rewards={
            **told,
            "upright": RewardTerm(leaning, -2.0),
            "effort": RewardTerm(effort, -1e-4),
            "termination": RewardTerm(fallen, -10.0),
        },
        intrinsics=robot_parameters(walker, interpretation),
        terminations={"tilted": tilted, "too_low": too_low},
        tracking_rewards=tuple(told),
        interpretation=interpretation,
        arguments={"robot": walker.name},
    )


def near(axis, c):
    """Compute the tracking kernel of the commanded position along one axis, (N,)."""
    return tracking_kernel(c.state.position[:, axis] - c.command[:, axis], width=0.1)


def leaning(c):
    """Compute the norm of the body's roll and pitch, (N,)."""
    return c.state.euler[:, :2].norm(dim=-1)


def effort(c):
    """Compute the sum of the squared torques, (N,)."""
    return c.state.torque.square().sum(-1)


def fallen(c):
    """Return early terminations, (N,)."""
    return c.terminated.float()


TASKS.register("balance", balance)
TASK_SETTINGS["balance"] = {
    "estimator.dead_reckoning": False,
    "ppo.tracking_forecast": False,
    "ppo.command_interaction": False,
    "task.moving_start": 0.0,
    "curriculum.initial_speed": 0.1,
    "curriculum.initial_yaw_rate": 0.1,
    "curriculum.max_speed": 0.2,
    "curriculum.max_yaw_rate": 0.1,
    "env.overspeed_margin": (1.0, 1.0),
    "env.reposition_feet": 0.0,
}
