"""The drive law: how the deck's tilt drives the transporter (Eqs. 1-3 and 7-10), over NumPy arrays."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from torchrl_atr.envs.models.transporter import TransporterSpec
from torchrl_atr.envs.profiles import Readings

Array = NDArray[np.float64]


def resistance(x: Array, coefficients: tuple[float, float, float], readings: Readings) -> Array:
    """Generalised resistance R(x) = c0 + c1 x + c2 x², signed (reading A10).

    Args:
        x: forward speed (m/s) or yaw rate (rad/s), any shape.
        coefficients: (c0, c1, c2).
        readings: ``odd_resistance`` and ``coulomb_smoothing``.

    Returns:
        R(x), same shape as ``x``; to be subtracted from the drive.

    Example:
        >>> float(resistance(np.array(-1.0), (0.2, 0.05, 0.005), Readings(coulomb_smoothing=0.0)).round(3))
        -0.255
    """
    c0, c1, c2 = coefficients
    if not readings.odd_resistance:
        return c0 + c1 * x + c2 * x * x
    speed = np.abs(x)
    magnitude = c0 + speed * (c1 + c2 * speed)
    smoothing = readings.coulomb_smoothing
    return magnitude * (np.tanh(x / smoothing) if smoothing else np.sign(x))


def drive(tilt: Array, deck: TransporterSpec, readings: Readings) -> Array:
    """The propulsion of Eqs. 1 and 3 before resistance: (m/s², rad/s²) for a deck of unit relative mass.

    Args:
        tilt: forward tilt θ_y (or θ_avg) and steering tilt θ_x (or θ_dif), rad, (N, 2).
        deck: its drive limits.
        readings: ``steering_smoothing`` (A11).

    Returns:
        Forward drive v̇max clip(θ_y/θnp) and yaw drive αmax sgn(θ_y) clip(-θ_x/θnp), with sgn(0) = 1 as the
        paper says, (N, 2).
    """
    smoothing = readings.steering_smoothing
    forward = tilt[..., 0]
    sign = np.tanh(forward / smoothing) if smoothing else np.copysign(1.0, forward + 0.0)  # sgn(-0) = 1, too
    pushes = np.maximum(np.minimum(tilt / deck.tilt_norm, 1.0), -1.0)  # np.clip takes longer
    pushes *= (deck.max_acceleration, -deck.max_yaw_acceleration)
    pushes[..., 1] *= sign
    return pushes


def advance(
    x: Array,
    push: Array,
    coefficients: tuple[float, float, float],
    scale: Array,
    dt: float,
    readings: Readings,
) -> Array:
    """Speed after ``dt`` under ẋ = scale (push - R(x)).

    With the jump of sgn in R the resistance may stop the motion within the step but never reverse it (A10).

    Args:
        x: speed, m/s or rad/s, any shape.
        push: propulsion, same shape.
        coefficients: of R.
        scale: 1 / m_P or 1 / I_zz, or relative to nominal (A9), same shape or scalar.
        dt: s.
        readings: how R is read.
    """
    if readings.odd_resistance and not readings.coulomb_smoothing:
        free = x + dt * scale * push
        opposing = resistance(np.abs(x), coefficients, readings)
        opposing = np.where(x == 0.0, coefficients[0], opposing)
        return np.sign(free) * np.maximum(np.abs(free) - dt * scale * opposing, 0.0)
    return x + dt * scale * (push - resistance(x, coefficients, readings))


@dataclass(frozen=True)
class DriveLaw:
    """Eqs. 1-3 (or 7-10) for N transporters: tilt and speeds in, speeds one substep later out.

    Attributes:
        deck: geometry, mass and limits.
        readings: the paper's open points.

    Example:
        >>> from torchrl_atr.envs.models import TRANSPORTERS
        >>> law = DriveLaw(TRANSPORTERS.get("single_board_g1"), Readings(coulomb_smoothing=0.0))
        >>> speed = law(np.zeros((1, 2)), np.array([[0.78, 0.0]]), np.ones((1, 2)), dt=0.005)
        >>> bool(np.allclose(speed, [[0.005 * (12 - 0.2), 0.0]]))
        True
    """

    deck: TransporterSpec
    readings: Readings

    @cached_property
    def _driving(self) -> Array:
        """From the hinge angles, a row, to forward and steering tilt."""
        return np.array(self.deck.design.driving).T

    def mass_scale(self, mass: Array) -> Array:
        """What multiplies (drive - R): 1/m_P and 1/I_zz, or relative to the nominal deck (A9).

        Args:
            mass: platform mass, kg, shape (N,).

        Returns:
            Shape (N, 2): forward, yaw. The boards are uniform boxes, so I_zz (or I*_zz) follows their mass.
        """
        inertia = mass / self.deck.mass * self.deck.inertia[2]
        reference = (self.deck.mass, self.deck.inertia[2]) if self.readings.relative_mass else (1.0, 1.0)
        return np.stack([reference[0] / mass, reference[1] / inertia], axis=-1)

    def __call__(self, speeds: Array, tilt: Array, scale: Array, dt: float) -> Array:
        """Speeds (v_f, ω_z) after one substep.

        Args:
            speeds: v_f (m/s) and ω_z (rad/s), shape (N, 2).
            tilt: the two hinge angles in the design's order (pitch, roll; or right, left), rad, shape (N, 2).
            scale: from :meth:`mass_scale`, shape (N, 2).
            dt: substep, s.
        """
        pushes = drive(tilt @ self._driving, self.deck, self.readings)
        return advance(speeds, pushes, self.deck.resistance, scale, dt, self.readings)
