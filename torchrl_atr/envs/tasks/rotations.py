"""Rotations over batches of tensors: quaternions (w, x, y, z), rotation matrices, XYZ Euler angles."""

from __future__ import annotations

import torch
from torch import Tensor

# rows: the products ww, wx, wy, wz, xw, xx, ... of w, x, y, z; columns: the nine entries of R
_FROM_PRODUCTS = torch.tensor(
    [
        # R00 R01 R02 R10 R11 R12 R20 R21 R22
        [1, 0, 0, 0, 1, 0, 0, 0, 1],  # ww
        [0, 0, 0, 0, 0, -2, 0, 2, 0],  # wx
        [0, 0, 2, 0, 0, 0, -2, 0, 0],  # wy
        [0, -2, 0, 2, 0, 0, 0, 0, 0],  # wz
        [0, 0, 0, 0, 0, 0, 0, 0, 0],  # xw
        [1, 0, 0, 0, -1, 0, 0, 0, -1],  # xx
        [0, 2, 0, 2, 0, 0, 0, 0, 0],  # xy
        [0, 0, 2, 0, 0, 0, 2, 0, 0],  # xz
        [0, 0, 0, 0, 0, 0, 0, 0, 0],  # yw
        [0, 0, 0, 0, 0, 0, 0, 0, 0],  # yx
        [-1, 0, 0, 0, 1, 0, 0, 0, -1],  # yy
        [0, 0, 0, 0, 0, 2, 0, 2, 0],  # yz
        [0, 0, 0, 0, 0, 0, 0, 0, 0],  # zw
        [0, 0, 0, 0, 0, 0, 0, 0, 0],  # zx
        [0, 0, 0, 0, 0, 0, 0, 0, 0],  # zy
        [-1, 0, 0, 0, -1, 0, 0, 0, 1],  # zz
    ],
    dtype=torch.float32,  # the state's: not converted at every step
)


def matrix_from_quaternion(quaternion: Tensor) -> Tensor:
    """Compute the rotation matrices of unit quaternions (w, x, y, z).

    Args:
        quaternion: (*B, 4).

    Returns:
        (*B, 3, 3), body to world.
    """
    products = (quaternion.unsqueeze(-1) * quaternion.unsqueeze(-2)).flatten(-2)
    return (products @ _FROM_PRODUCTS.to(quaternion)).unflatten(-1, (3, 3))


def euler_from_matrix(rotation: Tensor) -> Tensor:
    """Compute roll, pitch and yaw of R = Rz(yaw) Ry(pitch) Rx(roll), rad.

    Args:
        rotation: (*B, 3, 3).

    Returns:
        (*B, 3).
    """
    roll = torch.atan2(rotation[..., 2, 1], rotation[..., 2, 2])
    pitch = torch.asin(rotation[..., 2, 0].neg().clamp(-1.0, 1.0))
    yaw = torch.atan2(rotation[..., 1, 0], rotation[..., 0, 0])
    return torch.stack([roll, pitch, yaw], -1)


def matrix_from_euler(roll: Tensor, pitch: Tensor, yaw: Tensor) -> Tensor:
    """Compute Rz(yaw) Ry(pitch) Rx(roll), (*B, 3, 3), from angles in rad of shape (*B,)."""
    (cr, sr), (cp, sp), (cy, sy) = ((torch.cos(a), torch.sin(a)) for a in (roll, pitch, yaw))
    rows = [
        cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr,
        sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr,
        -sp, cp * sr, cp * cr,
    ]  # fmt: skip
    return torch.stack(rows, -1).unflatten(-1, (3, 3))


def angular_velocity(euler: Tensor, rates: Tensor) -> Tensor:
    """Compute ω in the world frame from the rates of roll, pitch and yaw, rad/s.

    Args:
        euler: roll, pitch, yaw, rad, (*B, 3).
        rates: their derivatives, rad/s, (*B, 3).
    """
    (_, sp, sy), (_, cp, cy) = torch.sin(euler).unbind(-1), torch.cos(euler).unbind(-1)
    roll, pitch, yaw = rates.unbind(-1)
    level = cp * roll  # along the heading
    return torch.stack([cy * level - sy * pitch, sy * level + cy * pitch, yaw - sp * roll], -1)


def rotate(rotation: Tensor, vector: Tensor) -> Tensor:
    """Compute R v: body to world for (*B, 3, 3) and (*B, 3)."""
    return (rotation * vector.unsqueeze(-2)).sum(-1)


def rotate_back(rotation: Tensor, vector: Tensor) -> Tensor:
    """Compute Rᵀ v: world to body for (*B, 3, 3) and (*B, 3)."""
    return (rotation * vector.unsqueeze(-1)).sum(-2)


def rotate_about(vector: Tensor, rotation_vector: Tensor) -> Tensor:
    """Rotate ``vector`` about the axis of ``rotation_vector`` by its length (Rodrigues' formula).

    Args:
        vector: (N, 3).
        rotation_vector: axis times angle, rad, (N, 3).
    """
    angle = rotation_vector.norm(dim=-1, keepdim=True)
    axis = rotation_vector / angle.clamp_min(1e-12)
    along = (axis * vector).sum(-1, keepdim=True) * axis
    return along + torch.cos(angle) * (vector - along) + torch.sin(angle) * torch.linalg.cross(axis, vector)


def wrap(angle: Tensor) -> Tensor:
    """Wrap an angle to (-π, π]."""
    return torch.atan2(torch.sin(angle), torch.cos(angle))
