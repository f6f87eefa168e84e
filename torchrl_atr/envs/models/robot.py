"""Robots: an MJCF file of our own plus the few facts about it that the task needs."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from torchrl_atr._registry import Registry

_MODELS = Path(__file__).parent / "robots"

LEGS = ("FR", "RR", "FL", "RL")
"""Legs in the order of the paper's two-board equations (right first), used everywhere outside the MJCF."""


@dataclass(frozen=True)
class RobotSpec:
    """What the task knows of a robot beyond its MJCF file.

    Joints and feet are listed leg by leg in the order of :data:`LEGS`, three joints a leg (abduction, thigh,
    calf); the MJCF file may order them as it likes, since every address is looked up by name.

    Attributes:
        name: registry name.
        mjcf: path of the MJCF file; its root body carries a free joint.
        trunk: name of the root body.
        joints: the twelve leg joints; each is driven by one position actuator.
        feet: the four foot geoms; a site of the same name marks each foot.
        q0: nominal standing joint angles, rad, in the order of ``joints``.
        kp: nominal PD stiffness, N m/rad (Table II randomises it as a ratio).
        kd: nominal PD damping, N m s/rad.
        action_scale: joint displacement for a unit action, rad.
        standing_height: h_des above the deck's top, m (reward r7).
        min_height: base height above the deck's top below which the robot has fallen, m.
        group: transporter size class of Table IV, ``"G1"`` or ``"G2"``.
    """

    name: str
    mjcf: Path
    trunk: str
    joints: tuple[str, ...]
    feet: tuple[str, ...]
    q0: tuple[float, ...]
    kp: float
    kd: float
    action_scale: float
    standing_height: float
    min_height: float
    group: str


def _unitree_joints() -> tuple[str, ...]:
    return tuple(f"{leg}_{joint}_joint" for leg in LEGS for joint in ("hip", "thigh", "calf"))


ROBOTS: Registry[RobotSpec] = Registry("robot")

ROBOTS.register(
    "a1",
    RobotSpec(
        name="a1",
        mjcf=_MODELS / "a1.xml",
        trunk="trunk",
        joints=_unitree_joints(),
        feet=tuple(f"{leg}_foot" for leg in LEGS),
        # front thighs 0.8, rear thighs 1.0: the pose that the paper's ancestors stand in (reading A35)
        q0=(-0.1, 0.8, -1.5, -0.1, 1.0, -1.5, 0.1, 0.8, -1.5, 0.1, 1.0, -1.5),
        kp=40.0,
        kd=1.0,
        action_scale=0.25,
        standing_height=0.28,
        min_height=0.14,
        group="G1",
    ),
)
