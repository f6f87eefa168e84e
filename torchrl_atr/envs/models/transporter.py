"""Transporters: geometry, mass, self-balancing gains and drive limits."""

from __future__ import annotations

from dataclasses import dataclass

from torchrl_atr._registry import Registry


@dataclass(frozen=True)
class TransporterSpec:
    """A tilt-driven transporter (Table IV and the paper's "Configuration of Transporters").

    Attributes:
        name: registry name.
        kind: which tilt drives it; a key of :data:`torchrl_atr.envs.physics.law.DRIVING_TILTS`.
        size: deck length, width and thickness, m.
        mass: nominal mass, kg.
        max_acceleration: v̇max, m/s² at a pitch of ``tilt_norm``.
        max_yaw_acceleration: αmax, rad/s² at a roll of ``tilt_norm``.
        tilt_norm: θnp, rad.
        resistance: the coefficients (c0, c1, c2) of R(x) = c0 + c1 x + c2 x².
        sb_stiffness: nominal self-balancing stiffness (roll, pitch) as printed in Table II (its unit is
            reading A12).
        sb_damping: nominal self-balancing damping (roll, pitch) as printed in Table II.
    """

    name: str
    kind: str
    size: tuple[float, float, float]
    mass: float
    max_acceleration: float = 12.0
    max_yaw_acceleration: float = 3.0
    tilt_norm: float = 0.78
    resistance: tuple[float, float, float] = (0.2, 0.05, 0.005)
    sb_stiffness: tuple[float, float] = (1.15, 1.15)
    sb_damping: tuple[float, float] = (0.025, 0.025)

    @property
    def inertia(self) -> tuple[float, float, float]:
        """Moments of inertia (Ixx, Iyy, Izz) of the uniform deck about its centre, kg m²."""
        length, width, height = self.size
        scale = self.mass / 12.0
        return (
            scale * (width**2 + height**2),
            scale * (length**2 + height**2),
            scale * (length**2 + width**2),
        )


TRANSPORTERS: Registry[TransporterSpec] = Registry("transporter")

TRANSPORTERS.register(
    "single_board",
    TransporterSpec(name="single_board", kind="single_board", size=(0.9, 0.7, 0.05), mass=11.5),
)
