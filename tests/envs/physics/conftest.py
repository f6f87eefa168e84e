"""A rigid block on four ball feet in the robot's place: our deck and engine, a rider of known mechanics."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
import torch

from torchrl_atr.envs.models import TRANSPORTERS, RobotSpec, Scene, Transporter, build_scene
from torchrl_atr.envs.physics import ModelFields
from torchrl_atr.envs.physics.batch import BatchEngine
from torchrl_atr.envs.tasks.parameters import friction as set_friction
from torchrl_atr.envs.tasks.riding.drive_law import DriveHook

MASS = 12.0
CENTRE = 0.05
"""Height of the block's centre of mass above its soles, m."""
FEET = {"FR": (0.1, -0.1), "RR": (-0.1, -0.1), "FL": (0.1, 0.1), "RL": (-0.1, 0.1)}
_FOOT = """
  <geom name="{name}" type="sphere" size="0.02" pos="{x} {y} {z}" mass="0" conaffinity="0"/>
  <site name="{name}" pos="{x} {y} {z}"/>
"""
_BLOCK = f"""
<mujoco model="block"><worldbody><body name="trunk"><freejoint/>
  <inertial pos="0 0 0" mass="{MASS}" diaginertia="0.2 0.2 0.2"/>
  {"".join(_FOOT.format(name=name, x=x, y=y, z=0.02 - CENTRE) for name, (x, y) in FEET.items())}
</body></worldbody></mujoco>
"""


class LeglessSpec(RobotSpec):
    """A rider of no joints, which a real spec would refuse."""

    def __post_init__(self) -> None:
        pass


@pytest.fixture
def block_scene(tmp_path: Path, request: pytest.FixtureRequest) -> Scene:
    """The block on the single board, or on the transporter that the test is parametrized with."""
    path = tmp_path / "block.xml"
    path.write_text(_BLOCK)
    robot = LeglessSpec(
        name="block",
        mjcf=path,
        trunk="trunk",
        joints=(),
        feet=tuple(FEET),
        q0=(),
        kp=0.0,
        kd=0.0,
        torque_limits=(),
        action_scale=1.0,
        standing_height=CENTRE,
        min_height=0.0,
        group="G1",
    )
    return build_scene(robot, Transporter(TRANSPORTERS.get(getattr(request, "param", "single_board_g1"))))


BlockEngine = Callable[..., BatchEngine]


@pytest.fixture
def block_engine(block_scene: Scene) -> BlockEngine:
    """``make(xy=(0, 0), friction=1.0, level=False)``: one block standing still at ``xy`` on the deck.

    ``level`` makes the tilt hinges so heavy and so stiff that the deck stays level.
    """

    def make(xy: tuple[float, float] = (0.0, 0.0), friction: float = 1.0, level: bool = False) -> BatchEngine:
        model, layout, support = block_scene.model, block_scene.layout, block_scene.support_layout
        if level:
            model.dof_armature[support.tilt_dof] = 1e3
            model.jnt_stiffness[support.tilt_joints], model.dof_damping[support.tilt_dof] = 1e5, 2e4
        engine = BatchEngine(block_scene, 1, DriveHook, num_threads=1)
        qpos = torch.tensor(model.key_qpos[:1])
        qpos[0, layout.root_qpos : layout.root_qpos + 2] = torch.tensor(xy)
        rows = torch.arange(1)

        def write(fields: ModelFields) -> None:
            set_friction(fields, torch.full((1, 1), friction, dtype=torch.float64), block_scene)

        engine.reset(rows, qpos, torch.zeros(1, model.nv, dtype=torch.float64), write)
        return engine

    return make
