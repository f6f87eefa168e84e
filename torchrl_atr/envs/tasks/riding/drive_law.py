"""Drive law: propulsion of a transporter by its boards' tilt (Eqs. 1-3 and 7-10), before every substep."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import torch
from torch import Tensor

from torchrl_atr._errors import InputError
from torchrl_atr._threads import one_torch_thread
from torchrl_atr.envs.interpretation import Interpretation
from torchrl_atr.envs.models.boards import TransporterLayout
from torchrl_atr.envs.models.scene import columns
from torchrl_atr.envs.models.transporter import Matrix, TransporterSpec
from torchrl_atr.envs.physics.engine import Engine
from torchrl_atr.envs.physics.hook import SubstepHook


def resistance(x: Tensor, coefficients: tuple[float, float, float], interpretation: Interpretation) -> Tensor:
    """Compute the generalised resistance R(x) = c0 + c1 x + c2 x², signed (question A10).

    Args:
        x: forward speed (m/s) or yaw rate (rad/s), any shape.
        coefficients: (c0, c1, c2).
        interpretation: ``odd_resistance`` and ``coulomb_smoothing``.

    Returns:
        R(x), same shape as ``x``; to be subtracted from the drive.

    Example:
        >>> round(float(resistance(torch.tensor(-1.0), (0.2, 0.05, 0.005), Interpretation(coulomb_smoothing=0.0))), 3)
        -0.255
    """
    c0, c1, c2 = coefficients
    if not interpretation.odd_resistance:
        return c0 + c1 * x + c2 * x * x
    speed = x.abs()
    magnitude = (speed * c2).add_(c1).mul_(speed).add_(c0)
    smoothing = interpretation.coulomb_smoothing
    return magnitude * (torch.tanh(x / smoothing) if smoothing else torch.sign(x))


def advance(
    x: Tensor,
    push: Tensor,
    coefficients: tuple[float, float, float],
    scale: Tensor,
    dt: float,
    interpretation: Interpretation,
) -> Tensor:
    """Compute the speed after ``dt`` under ẋ = scale (push - R(x)).

    With the jump of sgn in R the resistance may stop the motion within the step but never reverse it (A10).

    Args:
        x: speed, m/s or rad/s, any shape.
        push: propulsion, same shape.
        coefficients: of R.
        scale: 1 / m_P or 1 / I_zz, or relative to nominal (A9), same shape or scalar.
        dt: s.
        interpretation: how R is read (A10).
    """
    if interpretation.odd_resistance and not interpretation.coulomb_smoothing:
        free = x + dt * scale * push
        opposing = resistance(x.abs(), coefficients, interpretation)
        opposing = torch.where(x == 0.0, coefficients[0], opposing)
        return torch.sign(free) * (free.abs() - dt * scale * opposing).clamp_min(0.0)
    return torch.addcmul(x, scale, push - resistance(x, coefficients, interpretation), value=dt)


Combination = tuple[Tensor, ...] | None
"""Factors of hinge angles in :func:`combine`: the rows of a matrix (hinges, 2); None for the identity."""


def combination(matrix: Matrix, dtype: torch.dtype) -> Combination:
    """Return the factors that map hinge angles to forward and steering tilt, or pitch and roll.

    Args:
        matrix: of a :class:`~torchrl_atr.envs.models.transporter.TransporterDesign`, (2, hinges).
        dtype: of the angles.
    """
    rows = torch.tensor(matrix, dtype=dtype).T
    return None if torch.equal(rows, torch.eye(2, dtype=dtype)) else rows.unbind()


def combine(angles: Tensor, rows: Combination) -> Tensor:
    """Return ``angles @ matrix`` of (N, hinges) and (hinges, 2), written out, in new memory.

    A matrix product wakes torch's threads, which then spin on the CPUs that physics needs, and ends a compiled loop.

    Example:
        >>> combine(torch.tensor([[0.1, 0.3]]), combination(((0.5, 0.5), (0.5, -0.5)), torch.float32))
        tensor([[ 0.2000, -0.1000]])
    """
    if rows is None:
        return angles.clone()
    mixed = angles[:, :1] * rows[0]
    for i in range(1, len(rows)):
        mixed = torch.addcmul(mixed, angles[:, i : i + 1], rows[i])
    return mixed


@dataclass(frozen=True)
class DriveLaw:
    """Drive law, Eqs. 1-3 (or 7-10), of N transporters: from tilt and speeds to speeds one substep later; float64.

    Attributes:
        transporter: geometry, mass, limits, and the design's own ``drive``.
        interpretation: answers to the paper's open questions.

    Example:
        >>> from torchrl_atr.envs.models import TRANSPORTERS
        >>> law = DriveLaw(TRANSPORTERS.get("single_board_g1"), Interpretation(coulomb_smoothing=0.0))
        >>> rest, tilt = torch.zeros(1, 2, dtype=torch.float64), torch.tensor([[0.78, 0.0]], dtype=torch.float64)
        >>> speed = law(rest, tilt, torch.ones(1, 2, dtype=torch.float64), dt=0.005)
        >>> torch.allclose(speed, torch.tensor([[0.005 * (12 - 0.2), 0.0]], dtype=torch.float64))
        True
    """

    transporter: TransporterSpec
    interpretation: Interpretation

    def __post_init__(self) -> None:
        object.__setattr__(self, "_driving", combination(self.transporter.design.driving, torch.float64))

    def mass_scale(self, mass: Tensor) -> Tensor:
        """Compute the factors of (drive - R): 1/m_P and 1/I_zz, or relative to the nominal transporter (A9).

        Args:
            mass: mass of all boards, kg, shape (N,).

        Returns:
            Shape (N, 2): forward, yaw. The boards are uniform boxes, so I_zz (or I*_zz) follows their mass.
        """
        inertia = self.planar_inertia(mass)[:, 1:]
        return (self._per_mass[1:] * self.transporter.mass if self.interpretation.relative_mass else 1.0) / inertia

    def planar_inertia(self, mass: Tensor) -> Tensor:
        """Compute the inertia along x, along y and about z, kg, kg and kg m², (N, 3), for masses, kg, (N,)."""
        return mass.unsqueeze(-1) * self._per_mass

    @cached_property
    def _per_mass(self) -> Tensor:
        return torch.tensor([1.0, 1.0, self.transporter.inertia[2] / self.transporter.mass], dtype=torch.float64)

    def __call__(self, speeds: Tensor, tilt: Tensor, scale: Tensor, dt: float) -> Tensor:
        """Compute the speeds (v_f, ω_z) after one substep.

        Args:
            speeds: v_f (m/s) and ω_z (rad/s), shape (N, 2).
            tilt: the hinge angles in the design's order (pitch, roll; or right, left), rad, shape (N, hinges).
            scale: from :meth:`mass_scale`, shape (N, 2).
            dt: substep, s.
        """
        driving: Combination = vars(self)["_driving"]
        pushes = self.transporter.design.drive(combine(tilt, driving), speeds, self.transporter, self.interpretation)
        return advance(speeds, pushes, self.transporter.resistance, scale, dt, self.interpretation)


class DriveHook(SubstepHook):
    """Hook that evaluates the drive law before every substep and applies the planar force that realises it.

    Writing velocities instead would hide the boards' acceleration from the contact solver and let the feet slip.

    Args:
        engine: of a scene whose support is a :class:`~torchrl_atr.envs.models.boards.Transporter`.

    Attributes:
        law: the drive law.
        speeds: v_f, m/s, and ω_z, rad/s: the law's own state, (N, 2).
    """

    def __init__(self, engine: Engine) -> None:
        super().__init__(engine)
        support, layout = engine.scene.support, engine.scene.support_layout
        if not isinstance(layout, TransporterLayout):
            raise InputError(f"riding needs a Transporter to stand on, not {support.name!r}; give one as the support")
        self.law = DriveLaw(support.spec, support.interpretation)
        self._tilt, self._planar = columns(layout.tilt_qpos), columns(layout.planar_dof)
        self._heading, self._boards = int(layout.planar_qpos[2]), columns(layout.board_bodies)
        self._armature = engine.nominal("dof_armature")[layout.planar_dof]
        n = engine.num_envs
        self.speeds = torch.zeros(n, 2, dtype=torch.float64)
        self._scale, self._inertia, self._force = (torch.empty(n, size, dtype=torch.float64) for size in (2, 3, 3))
        self.state = {"speeds": self.speeds}
        self.refresh(torch.arange(n))

    def start(self, rows: Tensor) -> None:
        """Start episodes of ``rows``; transporters initially head along x."""
        self.refresh(rows)
        self.speeds[rows] = self.engine.qvel[rows][:, self._planar][:, ::2]  # along x and about z

    def refresh(self, rows: Tensor) -> None:
        """Recompute the factors and inertia of ``rows`` from the boards' masses in the engine's fields."""
        mass = self.engine.fields["body_mass"][rows][:, self._boards].sum(-1)
        self._scale[rows] = self.law.mass_scale(mass)
        self._inertia[rows] = self._armature + self.law.planar_inertia(mass)

    def apply(self, dt: float) -> None:
        """Evaluate the law at the current tilt and apply the force that realises it in one substep."""
        engine, force = self.engine, self._force
        self.speeds.copy_(self.law(self.speeds, engine.qpos[:, self._tilt], self._scale, dt))
        speed, yaw_rate = self.speeds.unbind(-1)
        heading = torch.add(engine.qpos[:, self._heading], yaw_rate, alpha=dt)
        x, y, about_z = force.unbind(-1)  # Eq. 2: first the desired velocity
        torch.mul(speed, torch.cos(heading), out=x)
        torch.mul(speed, torch.sin(heading), out=y)
        about_z.copy_(yaw_rate)
        engine.qfrc_applied[:, self._planar] = force.sub_(engine.qvel[:, self._planar]).mul_(self._inertia).div_(dt)

    def reset_diverged(self, rows: Tensor) -> None:
        """Set the speeds of simulations that diverged to zero."""
        self.speeds[rows] = 0.0

    def power(self) -> Tensor:
        """Compute the mechanical power of the propulsion now, W, (N,).

        It accelerates the transporter and all that stands on it along the heading, turns the transporter, and overcomes
        the transporter's resistance.
        """
        masses = self.engine.fields["body_mass"]
        inertia = self.law.planar_inertia(masses[:, self._boards].sum(-1))[:, ::2]
        resisted = self._scale * resistance(self.speeds, self.law.transporter.resistance, self.law.interpretation)
        power = inertia * resisted * self.speeds
        inertia[:, 0] = masses.sum(-1)
        return (power + inertia * self.acceleration() * self.speeds).sum(-1)

    def acceleration(self, rows: Tensor | slice = slice(None)) -> Tensor:
        """Compute v̇ and α of the law for ``rows`` at their present tilt and speeds, m/s² and rad/s², (n, 2)."""
        speeds, tilt = self.speeds[rows], self.engine.qpos[rows][:, self._tilt]
        with one_torch_thread():
            return (self.law(speeds, tilt, self._scale[rows], self.engine.timestep) - speeds) / self.engine.timestep
