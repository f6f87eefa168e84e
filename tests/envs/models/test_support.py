"""Supports: flat ground, and one of a user's own."""

from __future__ import annotations

import dataclasses

import mujoco
import numpy as np
import pytest
import torch

from torchrl_atr.envs.models import ROBOTS, FlatGround, RobotError, Scene, Support, build_scene
from torchrl_atr.envs.models.identity import describe
from torchrl_atr.envs.models.support import touch
from torchrl_atr.envs.physics import CONTROL_DT, Engine
from torchrl_atr.envs.physics.batch import BatchEngine

SECONDS = 2.0


@dataclasses.dataclass(frozen=True)
class Plate(Support):
    """A plate that is fixed to the world half a metre up."""

    name: str = "plate"
    size: tuple[float, float] = (2.0, 2.0)

    kind, height, geoms = "plate", 0.5, ("plate",)
    contact = mujoco.mjtObj.mjOBJ_GEOM, "plate"

    def build(self, spec, robot_mass):
        half = [self.size[0] / 2, self.size[1] / 2, 0.05]
        touch(spec.worldbody.add_geom(name="plate", type=mujoco.mjtGeom.mjGEOM_BOX, size=half, pos=[0, 0, 0.45]))


def made(physics: str, scene: Scene) -> Engine:
    if physics == "batch":
        return BatchEngine(scene, 2, num_threads=1)
    from torchrl_atr.envs.physics.dmc import DmControlEngine

    return DmControlEngine(scene)


def place(engine: Engine) -> torch.Tensor:
    """Where the trunks are in the world, m, (N, 3)."""
    root = engine.scene.layout.root_qpos
    here = engine.qpos[:, root : root + 3].clone()
    here[:, :2] += engine.world_offset
    return here


@pytest.mark.parametrize("physics", ["batch", "dm_control"])
@pytest.mark.parametrize("support", [FlatGround(), Plate()], ids=lambda support: support.name)
@pytest.mark.parametrize("robot", ["a1", "go1", "anymal_c", "spot"])
def test_a_robot_in_q0_stands_still(robot, support, physics):
    spec = ROBOTS.get(robot)
    engine = made(physics, build_scene(spec, support))
    before, targets = place(engine), torch.tensor([spec.q0] * engine.num_envs)
    for _ in range(round(SECONDS / CONTROL_DT)):
        engine.step(targets)
    assert not engine.diverged.any()
    assert (place(engine) - before).abs().max() < 0.05
    root, layout = engine.scene.layout.root_dof, engine.scene.layout
    assert engine.qvel[:, root : root + 3].abs().max() < 0.02
    # it is this support that carries it
    loads = -engine.sensordata[:, layout.sensors["foot_force"]].reshape(-1, 4, 3)
    weight = 9.81 * engine.scene.model.body_subtreemass[layout.trunk_body]
    np.testing.assert_allclose(loads[..., 2].sum(-1).abs(), weight, rtol=0.02)
    assert (before[:, 2] - support.height).min() > 0.2


def test_flat_ground_adds_no_freedom_and_has_no_end():
    scene = build_scene(ROBOTS.get("a1"), FlatGround())
    assert (scene.model.nv, scene.model.nu, scene.support_layout) == (18, 12, None)
    engine = BatchEngine(scene, 1, num_threads=1)
    root, targets = scene.layout.root_qpos, torch.tensor([scene.robot.q0])
    engine.qpos[:, root] += 1e6  # beyond any plane of a size
    engine.step(targets)
    assert engine.qpos[:, root].abs() < 1.0  # kept near the origin
    assert engine.world_offset[0, 0].item() == pytest.approx(1e6, abs=1.0)
    for _ in range(25):
        engine.step(targets)
    assert place(engine)[0, 2] > 0.2


def test_a_fixed_support_stays_where_it_is():
    """A robot that walks off is not moved back: the plate is no more below it."""
    scene = build_scene(ROBOTS.get("a1"), Plate())
    engine = BatchEngine(scene, 1, num_threads=1)
    root, targets = scene.layout.root_qpos, torch.tensor([scene.robot.q0])
    engine.qpos[:, root] += 2.0
    for _ in range(50):
        engine.step(targets)
    assert engine.world_offset.abs().max() == 0.0
    assert engine.qpos[0, root].item() == pytest.approx(2.0, abs=0.1)
    assert engine.qpos[0, root + 2] < 0.0  # through the floor, which touches nothing here


@pytest.mark.parametrize("size", [(0.2, 0.2), (2.0, 0.2), (0.3, 2.0)])
def test_a_support_too_small_for_the_robot_is_named(size):
    """The feet are 0.16 m beside the middle, 0.19 m ahead and 0.24 m behind: half a size counts, not the whole."""
    with pytest.raises(RobotError, match=rf"off the surface of 'stool' \({size[0]:g} x {size[1]:g} m\)"):
        build_scene(ROBOTS.get("a1"), Plate("stool", size))


def test_scenes_are_described_by_what_their_support_is_called():
    assert list(describe(build_scene(ROBOTS.get("a1"), FlatGround()))) == ["robot", "ground"]
    assert list(describe(build_scene(ROBOTS.get("a1"), Plate()))) == ["robot", "plate"]
