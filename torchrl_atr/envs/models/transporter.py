"""Transporters: their boards and hinges, drive and dimensions."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from torchrl_atr._errors import UserError
from torchrl_atr._registry import Registry, unknown
from torchrl_atr.envs.interpretation import Interpretation
from torchrl_atr.envs.models.drives import Drive, tilt_drive
from torchrl_atr.envs.models.robot import GROUPS, RobotSpec
from torchrl_atr.envs.models.spec_file import (
    LARGEST,
    SMALLEST,
    check_list,
    check_names,
    check_positive,
    check_text,
    is_spec_file,
    read_spec,
)

Matrix = tuple[tuple[float, ...], tuple[float, ...]]


class TransporterError(UserError, ValueError):
    """Error of an invalid transporter; the message names the cause and the remedy."""


@dataclass(frozen=True)
class Hinge:
    """Self-balancing hinge between a board and the pivot P.

    Attributes:
        name: of the joint.
        axis: x (roll) or y (pitch) in the frame of P.
        gain: index of its self-balancing gain among Table II's two, 0 or 1.
    """

    name: str
    axis: tuple[float, float, float]
    gain: int


@dataclass(frozen=True)
class Board:
    """Board of a transporter.

    Attributes:
        name: of its geom.
        offset: of its centre to the left of P, as a share of the transporter's width.
        share: of the transporter's width and mass.
        hinges: from P outwards.
    """

    name: str
    offset: float
    share: float
    hinges: tuple[Hinge, ...]


@dataclass(frozen=True)
class TransporterDesign:
    """Type of transporter: its boards, the meaning of their hinge angles, and its drive.

    Attributes:
        boards: of equal length and thickness, side by side.
        driving: the forward and the steering tilt (rows) as combinations of the hinge angles, in the boards' order.
        attitude: pitch and roll (rows) of the frame P, likewise.
        drive: tilt and speeds to propulsion; :func:`~torchrl_atr.envs.models.drives.tilt_drive` by default.

    Raises:
        TransporterError: if there is no hinge, a matrix has another number of columns than there are hinges, or
            ``drive`` cannot be called.

    Example:
        >>> roll = Hinge("truck_roll", (1.0, 0.0, 0.0), gain=0)
        >>> boards = (Board("plank", 0.0, 1.0, (roll,)),)
        >>> TransporterDesign(boards, driving=((0.0,), (1.0,)), attitude=((0.0,), (1.0,))).hinges
        (Hinge(name='truck_roll', axis=(1.0, 0.0, 0.0), gain=0),)
    """

    boards: tuple[Board, ...]
    driving: Matrix
    attitude: Matrix
    drive: Drive = tilt_drive

    def __post_init__(self) -> None:
        count = len(self.hinges)
        if not count:
            raise TransporterError("a design needs a hinge: without one, no robot can tilt it")
        for name in ("driving", "attitude"):
            shape = np.shape(getattr(self, name))
            if shape != (2, count):
                raise TransporterError(
                    f"{name} of a design has shape {shape}; with {count} hinges it needs (2, {count})"
                )
        if not callable(self.drive):
            raise TransporterError(
                f"drive={self.drive!r} of a design cannot be called; give a function like tilt_drive"
            )

    @property
    def hinges(self) -> tuple[Hinge, ...]:
        """All hinges, in the boards' order."""
        return tuple(hinge for board in self.boards for hinge in board.hinges)


_POSITIVE = f"must be positive (a number in SI units, {SMALLEST:g} to {LARGEST:g})"
_X, _Y = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0)
SINGLE_BOARD = TransporterDesign(
    boards=(Board("deck", 0.0, 1.0, (Hinge("platform_pitch", _Y, 1), Hinge("platform_roll", _X, 0))),),
    driving=((1.0, 0.0), (0.0, 1.0)),
    attitude=((1.0, 0.0), (0.0, 1.0)),
)
"""Type 1 (Eqs. 1-6): pitch θ_y drives forward, roll θ_x steers."""
TWO_BOARD = TransporterDesign(
    boards=(
        Board("deck_right", -0.25, 0.5, (Hinge("platform_pitch_right", _Y, 0),)),
        Board("deck_left", 0.25, 0.5, (Hinge("platform_pitch_left", _Y, 1),)),
    ),
    driving=((0.5, 0.5), (0.5, -0.5)),
    attitude=((0.5, 0.5), (0.0, 0.0)),
)
"""Type 2 (Eqs. 7-14): θ_avg drives forward, θ_dif steers; P pitches with the average and does not roll."""


@dataclass(frozen=True)
class TransporterSpec:
    """Spec of a tilt-driven transporter (Table IV and the paper's "Configuration of Transporters").

    Attributes:
        name: its name in messages and models.
        design: its boards and hinges.
        size: length, width and thickness of all boards together, m.
        mass: nominal, of all boards together, kg (A14).
        max_acceleration: v̇max, m/s² at a forward tilt of ``tilt_norm``.
        max_yaw_acceleration: αmax, rad/s² at a steering tilt of ``tilt_norm``.
        tilt_norm: θnp, rad.
        resistance: the coefficients (c0, c1, c2) of R(x) = c0 + c1 x + c2 x².
        sb_stiffness: nominal self-balancing stiffness as printed in Table II (its unit is question A12): roll and
            pitch of a single board, right and left of two.
        sb_damping: nominal self-balancing damping, likewise.
        spring_scale: factor of both if ``scaled_springs`` is set (A12).

    Raises:
        TransporterError: for a size, mass or limit that is not a positive number, a negative resistance, stiffness or
            damping, a wrong number of values, or an invalid design.
    """

    name: str
    design: TransporterDesign
    size: tuple[float, float, float]
    mass: float
    max_acceleration: float = 12.0
    max_yaw_acceleration: float = 3.0
    tilt_norm: float = 0.78
    resistance: tuple[float, float, float] = (0.2, 0.05, 0.005)
    sb_stiffness: tuple[float, float] = (1.15, 1.15)
    sb_damping: tuple[float, float] = (0.025, 0.025)
    spring_scale: float = 1.0

    def __post_init__(self) -> None:
        check_text(self, "name")
        if not isinstance(self.design, TransporterDesign):
            raise self.error(f"design={self.design!r} is none; choose one of {', '.join(TRANSPORTER_DESIGNS)}")
        check_list(self, "size", float, 3, "give length, width and thickness in m")
        for side in self.size:
            check_positive(self, "size", side, _POSITIVE)
        for name in ("mass", "max_acceleration", "max_yaw_acceleration", "tilt_norm", "spring_scale"):
            check_positive(self, name, getattr(self, name), _POSITIVE)
        if self.tilt_norm > np.pi:
            raise self.error(f"tilt_norm={self.tilt_norm:g}: degrees? give radians")
        check_list(self, "resistance", float, 3, "give the coefficients c0, c1 and c2")
        for name in ("sb_stiffness", "sb_damping"):
            check_list(self, name, float, 2, "give those of roll and pitch, or of the right and the left board")
        for name in ("resistance", "sb_stiffness", "sb_damping"):
            for value in getattr(self, name):
                if value < 0:
                    raise self.error(f"{name} holds {value!r}; it would drive the transporter: give 0 or more")

    def error(self, message: str) -> TransporterError:
        """Return a :class:`TransporterError` that names the transporter."""
        return TransporterError(f"transporter {self.name!r}: {message}")

    def board_size(self, board: Board) -> tuple[float, float, float]:
        """Return length, width and thickness of one of the boards, m."""
        length, width, thickness = self.size
        return length, board.share * width, thickness

    @property
    def inertia(self) -> tuple[float, float, float]:
        """Moments of inertia (Ixx, Iyy, Izz) of the level boards about P, kg m²; I*_P by the parallel-axis theorem."""
        total = np.zeros(3)
        for board in self.design.boards:
            mass, (length, width, height) = board.share * self.mass, self.board_size(board)
            own = np.array([width**2 + height**2, length**2 + height**2, length**2 + width**2]) / 12.0
            total += mass * (own + np.array([1.0, 0.0, 1.0]) * (board.offset * self.size[1]) ** 2)
        return float(total[0]), float(total[1]), float(total[2])

    def springs(self, interpretation: Interpretation) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return nominal stiffness, N m/rad, and damping, N m s/rad, of the hinges in Table II's order, (2,) (A12)."""
        unit = interpretation.sb_unit * (self.spring_scale if interpretation.scaled_springs else 1.0)
        return unit * np.array(self.sb_stiffness), unit * np.array(self.sb_damping)


TRANSPORTERS: Registry[TransporterSpec] = Registry("transporter", hint="or a .toml file that describes one")
"""Transporters by name."""
TRANSPORTER_DESIGNS: Registry[TransporterDesign] = Registry("design")
"""Designs by the name that a TOML file gives."""
_SIZES = {"G1": ((0.9, 0.7, 0.05), 11.5), "G2": ((1.5, 1.1, 0.05), 30.0)}
_SPRING_SCALES = {"G2": {"single_board": 5.0, "two_board": 2.5}}  # two boards share the robot, each with a spring
for _kind, _design in {"single_board": SINGLE_BOARD, "two_board": TWO_BOARD}.items():
    TRANSPORTER_DESIGNS.register(_kind, _design)
    for _group in GROUPS:
        _size, _mass = _SIZES[_group]
        _name, _scale = f"{_kind}_{_group.lower()}", _SPRING_SCALES.get(_group, {}).get(_kind, 1.0)
        TRANSPORTERS.register(_name, TransporterSpec(_name, _design, _size, _mass, spring_scale=_scale))


def get_transporter(transporter: str | Path | Mapping[str, Any] | TransporterSpec, robot: RobotSpec) -> TransporterSpec:
    """Return the spec of a transporter given by name, by file or as a spec.

    Args:
        transporter: a registered name; ``single_board`` or ``two_board`` for the one of the robot's size class; path of
            a ``.toml`` file (see :func:`read_transporter`), or its values; or a spec of your own.
        robot: spec of the robot.

    Raises:
        UnknownNameError: for an unknown name.
        TransporterError: for a file that does not describe a transporter.

    Example:
        >>> from torchrl_atr.envs.models import ROBOTS
        >>> get_transporter("two_board", ROBOTS.get("spot")).name
        'two_board_g2'
    """
    if isinstance(transporter, TransporterSpec):
        return transporter
    if isinstance(transporter, Mapping):
        values = dict(transporter)
        check_names(values, TransporterSpec, "transporter", TransporterError)
        _convert(values)
        return TransporterSpec(**values)
    if is_spec_file(transporter):
        return read_transporter(transporter)
    group = robot.group.lower()
    sized = [design for design in TRANSPORTER_DESIGNS if f"{design}_{group}" in TRANSPORTERS]
    known = [*sized, *TRANSPORTERS]
    if not isinstance(transporter, str) or transporter not in known:
        raise unknown("transporter", transporter, known, TRANSPORTERS.hint)
    return TRANSPORTERS.get(f"{transporter}_{group}" if transporter in sized else transporter)


def read_transporter(path: str | Path) -> TransporterSpec:
    """Read a transporter from a TOML file, whose keys are the fields of :class:`TransporterSpec`.

    Args:
        path: of the file; ``design`` in it is ``"single_board"``, ``"two_board"`` or another registered
            one. Fields with a default may be left out.

    Raises:
        TransporterError: if the file is missing, malformed, lacks a key, has one too many, or holds an impossible
            value.

    Example:
        >>> read_transporter("nowhere.toml")
        Traceback (most recent call last):
        ...
        torchrl_atr.envs.models.transporter.TransporterError: there is no transporter file nowhere.toml; check its path
    """
    return read_spec(path, TransporterSpec, "transporter", TransporterError, lambda values, _: _convert(values))


def _convert(values: dict[str, Any]) -> None:
    """Replace the name of a design by the design; an unknown name stays, and is rejected by name."""
    if isinstance(values["design"], str):
        name = values["design"]
        values["design"] = TRANSPORTER_DESIGNS.get(name) if name in TRANSPORTER_DESIGNS else name


def describe_transporter(transporter: TransporterSpec) -> str | dict[str, Any]:
    """Return the argument from which :func:`get_transporter` makes the same transporter, as plain values.

    Its name if it is registered, or has custom boards; otherwise the values of a file of it.
    """
    if transporter.name in TRANSPORTERS.names() and TRANSPORTERS.get(transporter.name) == transporter:
        return transporter.name
    design = next((name for name in TRANSPORTER_DESIGNS if TRANSPORTER_DESIGNS.get(name) == transporter.design), None)
    if design is None:
        return transporter.name
    values = {field.name: getattr(transporter, field.name) for field in dataclasses.fields(transporter)}
    return {**values, "design": design}
