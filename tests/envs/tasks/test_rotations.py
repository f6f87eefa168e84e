"""Rotations against MuJoCo's and against each other."""

from __future__ import annotations

import math

import mujoco
import numpy as np
import torch

from torchrl_atr.envs.tasks.rotations import (
    euler_from_matrix,
    matrix_from_euler,
    matrix_from_quaternion,
    rotate,
    rotate_about,
    rotate_back,
    wrap,
)


def quaternions(n: int) -> torch.Tensor:
    values = torch.randn(n, 4, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    return values / values.norm(dim=-1, keepdim=True)


def test_quaternion_matrices_are_mujocos():
    for quaternion in quaternions(20):
        expected = np.zeros(9)
        mujoco.mju_quat2Mat(expected, quaternion.numpy())
        np.testing.assert_allclose(matrix_from_quaternion(quaternion), expected.reshape(3, 3), atol=1e-12)


def test_euler_angles_are_roll_pitch_yaw_about_x_y_z():
    quarter = torch.tensor(math.pi / 2)
    zero = torch.zeros(())
    x, y, z = torch.eye(3)
    torch.testing.assert_close(rotate(matrix_from_euler(quarter, zero, zero), y), z)
    torch.testing.assert_close(rotate(matrix_from_euler(zero, quarter, zero), z), x)
    torch.testing.assert_close(rotate(matrix_from_euler(zero, zero, quarter), x), y)


def test_euler_angles_survive_the_round_trip():
    generator = torch.Generator().manual_seed(1)
    angles = (torch.rand(100, 3, generator=generator, dtype=torch.float64) - 0.5) * torch.tensor([6.0, 3.0, 6.0])
    torch.testing.assert_close(euler_from_matrix(matrix_from_euler(*angles.unbind(-1))), angles)


def test_matrices_are_rotations_and_their_inverse_is_the_transpose():
    rotation = matrix_from_quaternion(quaternions(50))
    torch.testing.assert_close(rotation @ rotation.mT, torch.eye(3, dtype=torch.float64).expand(50, 3, 3))
    torch.testing.assert_close(torch.linalg.det(rotation), torch.ones(50, dtype=torch.float64))
    vector = torch.randn(50, 3, dtype=torch.float64)
    torch.testing.assert_close(rotate(rotation, vector), torch.einsum("nij,nj->ni", rotation, vector))
    torch.testing.assert_close(rotate_back(rotation, rotate(rotation, vector)), vector)


def test_wrap_keeps_the_direction_within_half_a_turn():
    angles = torch.tensor([0.3, 2 * math.pi + 0.3, -2 * math.pi - 0.3, 6.2, math.pi - 1e-3])
    expected = torch.tensor([0.3, 0.3, -0.3, 6.2 - 2 * math.pi, math.pi - 1e-3])
    torch.testing.assert_close(wrap(angles), expected, atol=1e-5, rtol=0)


def test_rotation_about_a_vector_is_mujocos():
    axes = torch.randn(10, 3, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    vectors = torch.randn(10, 3, generator=torch.Generator().manual_seed(1), dtype=torch.float64)
    for turned, axis, vector in zip(rotate_about(vectors, axes), axes, vectors):
        quaternion, expected = np.zeros(4), np.zeros(3)
        mujoco.mju_axisAngle2Quat(quaternion, (axis / axis.norm()).numpy(), float(axis.norm()))
        mujoco.mju_rotVecQuat(expected, vector.numpy(), quaternion)
        np.testing.assert_allclose(turned, expected, atol=1e-12)
    torch.testing.assert_close(rotate_about(vectors, torch.zeros_like(axes)), vectors)
