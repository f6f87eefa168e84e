"""Halves of a robot that are mirror images, and those that are not: parts of one's inertia, and springs of two legs."""

from __future__ import annotations

import math

import mujoco
import numpy as np
import pytest

from torchrl_atr.envs.models import ROBOTS, FlatGround, build_scene
from torchrl_atr.envs.models.mirror import find_asymmetry

A1 = ROBOTS.get("a1")
SIGNS = np.array([-1.0, 1.0, 1.0] * 4)
"""An abduction turns round in the mirror, thigh and calf do not."""


@pytest.fixture
def model() -> mujoco.MjModel:
    """A1 of its own, to be changed."""
    return build_scene(A1, FlatGround()).model


def test_a1_is_its_own_mirror_image(model):
    assert find_asymmetry(model, A1, SIGNS) is None


@pytest.mark.parametrize(
    ("axis", "products"),
    [((1, 0, 0), "[0, -0.02823]"), ((0, 1, 0), None), ((0, 0, 1), "[-0.02823, 0]")],
    ids=["Iyz", "Ixz", "Ixy"],
)
def test_a_trunk_may_have_the_product_of_inertia_that_a_mirror_keeps(model, axis, products):
    """Unequal moments, turned about one axis by 0.3 rad: (0.1 - 0.2) sin 0.3 cos 0.3 = -0.02823 in the other two."""
    trunk = model.body(A1.trunk).id
    model.body_inertia[trunk] = np.roll([0.05, 0.1, 0.2], axis.index(1))
    model.body_iquat[trunk] = [math.cos(0.15), *(math.sin(0.15) * np.array(axis))]
    found = find_asymmetry(model, A1, SIGNS)
    assert (found and found.what) == (products and f"its products of inertia Ixy and Iyz are {products} kg m²")


@pytest.mark.parametrize("part", ["hip", "thigh", "calf"])
def test_springs_of_both_legs_rest_at_mirrored_angles(model, part):
    left, right = (model.joint(f"F{side}_{part}_joint") for side in "LR")
    sign = -1.0 if part == "hip" else 1.0
    left.stiffness = right.stiffness = 2.0
    left.qpos_spring, right.qpos_spring = 0.5, sign * 0.5
    assert find_asymmetry(model, A1, SIGNS) is None
    right.qpos_spring = -sign * 0.5
    found = find_asymmetry(model, A1, SIGNS)
    assert found is not None
    assert (found.left, found.what) == (f"FL_{part}_joint", f"springref 0.5 and {-sign * 0.5:g} rad")
