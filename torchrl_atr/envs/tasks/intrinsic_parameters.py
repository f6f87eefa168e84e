"""Intrinsic parameters as data: distributions of per-episode parameters, and functions that write them to the model."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import torch
from torch import Tensor

from torchrl_atr._checks import check_choice, check_number
from torchrl_atr._errors import InputError
from torchrl_atr._registry import nearest
from torchrl_atr.envs.models.scene import Scene
from torchrl_atr.envs.physics.engine import ModelFields
from torchrl_atr.envs.tasks import mirrors
from torchrl_atr.envs.tasks.mirrors import Mirror

Randomization = Literal["train", "test", "off"]
RANDOMIZATIONS: tuple[Randomization, ...] = ("train", "test", "off")
Apply = Callable[[ModelFields, Tensor, Scene], None]
"""Function that writes a parameter's values (n, size) into fields of n models; see :class:`IntrinsicParameter`."""


class IntrinsicError(InputError):
    """Error of an intrinsic parameter that cannot be used; the message names it."""


@dataclass(frozen=True)
class IntrinsicParameter:
    """Parameter of robot or support that is drawn for every episode and hidden from the policy.

    Attributes:
        apply: ``apply(fields, value, scene)`` writes the values (n, size), float64, into the fields of n models,
            (n, ...) each, which hold the nominal values, with the changes of earlier parameters.
        train: training range, of every component.
        test: testing range; the training range by default.
        nominal: the value without randomisation; the middle of the training range by default.
        size: number of components; ``"joints"`` for one per leg joint.
        mirror: its mirror image, for symmetric networks, as of an ``ObservationTerm``; unchanged by default.

    Raises:
        IntrinsicError: if ``apply`` cannot be called, a range is invalid, or ``size`` or ``nominal`` is not a number.

    Example:
        >>> def friction_loss(fields, value, scene):
        ...     fields["dof_frictionloss"][:, scene.layout.joint_dof] = value
        >>> parameter = IntrinsicParameter(friction_loss, train=(0.0, 0.4), size="joints", mirror=mirrors.joint_gains)
        >>> parameter.nominal
        0.2
    """

    apply: Apply
    train: tuple[float, float]
    test: tuple[float, float] = ()  # type: ignore[assignment]
    nominal: float = None  # type: ignore[assignment]
    size: int | Literal["joints"] = 1
    mirror: Mirror | None = None

    def __post_init__(self) -> None:
        if not callable(self.apply):
            raise IntrinsicError(f"apply={self.apply!r} of an intrinsic parameter cannot be called; give a function")
        object.__setattr__(self, "test", self.test or self.train)
        for name in ("train", "test"):
            if not _is_range(ends := getattr(self, name)):
                raise IntrinsicError(f"{name}={ends} of an intrinsic parameter is no range; give two finite numbers")
        if self.size != "joints" and (type(self.size) is not int or self.size < 1):
            raise IntrinsicError(f"size={self.size!r} of an intrinsic parameter; give a whole number or 'joints'")
        nominal = sum(self.train) / 2 if self.nominal is None else self.nominal
        try:
            object.__setattr__(self, "nominal", check_number("nominal", nominal))
        except InputError as error:
            raise IntrinsicError(f"{error} (of an intrinsic parameter)") from None

    def scaled(self, value: float) -> float:
        """Return a value scaled so that the training range is [-1, 1]."""
        low, high = self.train
        return (2.0 * value - low - high) / (high - low)


def _is_range(ends: Any, above: bool = True) -> bool:
    try:
        low, high = (check_number("end", end) for end in ends)
    except (TypeError, ValueError):
        return False
    return low < high or (not above and low == high)


class Intrinsics:
    """Intrinsic parameters of an env: x_int.

    Args:
        parameters: by name.
        scene: robot and support.

    Attributes:
        slices: columns of x_int by parameter.
        size: of x_int.

    Raises:
        IntrinsicError: names what is not an :class:`IntrinsicParameter`, or has a mirror image of another size.

    Example:
        >>> from torchrl_atr.envs.models import ROBOTS, FlatGround, build_scene
        >>> from torchrl_atr.envs.tasks.parameters import payload
        >>> scene = build_scene(ROBOTS.get("a1"), FlatGround())
        >>> intrinsics = Intrinsics({"payload": IntrinsicParameter(payload, (0.0, 1.0), nominal=0.0)}, scene)
        >>> intrinsics.sample(2, "off", torch.Generator()).tolist()
        [[-1.0], [-1.0]]
    """

    def __init__(self, parameters: Mapping[str, IntrinsicParameter], scene: Scene) -> None:
        self.parameters, self.scene, self.slices = dict(parameters), scene, {}
        self.size = 0
        for name, parameter in self.parameters.items():
            if not isinstance(parameter, IntrinsicParameter):
                raise IntrinsicError(f"the intrinsic parameter {name!r} is {parameter!r}; give an IntrinsicParameter")
            size = len(scene.robot.joints) if parameter.size == "joints" else int(parameter.size)
            self.slices[name] = slice(self.size, self.size + size)
            self.size += size
            if parameter.mirror is not None and not callable(parameter.mirror):
                self._mirror(name)
        sizes = torch.tensor([part.stop - part.start for part in self.slices.values()], dtype=torch.long)
        ranges = torch.tensor([p.train for p in self.parameters.values()], dtype=torch.float64).reshape(-1, 2)
        self._train = ranges.repeat_interleave(sizes, 0).T  # (2, size)
        self._scaled = {kind: self._ends(kind, sizes) for kind in RANDOMIZATIONS}

    def _ends(self, randomization: Randomization, sizes: Tensor) -> Tensor:
        """Return the scaled ends of a range, (2, size) float32."""
        ends = [
            (p.nominal,) * 2 if randomization == "off" else getattr(p, randomization) for p in self.parameters.values()
        ]
        scaled = [[p.scaled(end) for end in pair] for p, pair in zip(self.parameters.values(), ends)]
        return torch.tensor(scaled, dtype=torch.float32).reshape(-1, 2).repeat_interleave(sizes, 0).T

    def sample(self, n: int, randomization: Randomization, generator: torch.Generator) -> Tensor:
        """Draw x_int for n robots, (n, size) float32, each component scaled so that its training range is [-1, 1].

        Args:
            n: number of robots.
            randomization: ``"train"`` or ``"test"`` range, or ``"off"`` for the nominal values.
            generator: source of randomness.

        Raises:
            ValueError: for another ``randomization``.
        """
        return self.draw(n, self.ends(randomization), generator)

    def draw(self, n: int, ends: Tensor, generator: torch.Generator) -> Tensor:
        """Draw x_int for n robots between scaled ends of :meth:`ends`, (n, size) float32."""
        low, high = ends
        return low + (high - low) * torch.rand(n, self.size, generator=generator, dtype=torch.float32)

    def ends(self, ranges: Randomization | Mapping[str, Sequence[float]], others: Tensor | None = None) -> Tensor:
        """Return the scaled ends of ranges, (2, size) float32.

        Args:
            ranges: ``"train"``, ``"test"`` or ``"off"``; or lowest and highest value, which may be equal, of some
                parameters by name, or of a component such as ``"com_shift[0]"``, in their own units.
            others: ends of the parameters that are not named; those of the training range by default.

        Raises:
            InputError: for another name of a set. IntrinsicError: for an unknown parameter, or an invalid range.
        """
        if not isinstance(ranges, Mapping):
            check_choice("randomization", ranges, RANDOMIZATIONS)
            return self._scaled[ranges]
        scaled = (self._scaled["train"] if others is None else others).clone()
        for given, pair in ranges.items():
            name, part = self._part(str(given))
            if not _is_range(pair, above=False):
                raise IntrinsicError(f"{given}={pair!r} is no range; give two finite numbers, the lower one first")
            values = [self.parameters[name].scaled(float(end)) for end in pair]
            scaled[:, part] = torch.tensor(values, dtype=torch.float32).unsqueeze(-1)
        return scaled

    def _part(self, given: str) -> tuple[str, slice]:
        """Return name and columns of a parameter, or of one component of it."""
        name, bracket, number = given.removesuffix("]").partition("[")
        if name not in self.parameters:
            raise IntrinsicError(f"there is no intrinsic parameter {given!r}; {nearest(given, self.parameters)}")
        part = self.slices[name]
        if not bracket:
            return name, part
        size = part.stop - part.start
        if not number.isdecimal() or int(number) >= size:
            raise IntrinsicError(f"{given!r} is no component of {name!r}; give {name}[0] to {name}[{size - 1}]")
        return name, slice(part.start + int(number), part.start + int(number) + 1)

    def values(self, x_int: Tensor) -> dict[str, Tensor]:
        """Return the values of x_int, (n, size), by name, (n, size of each) float64: the inverse of the scaling."""
        low, high = self._train
        values = low + (x_int.double() + 1.0) * (high - low) / 2.0
        return {name: values[:, part] for name, part in self.slices.items()}

    def apply(self, fields: ModelFields, x_int: Tensor) -> None:
        """Write x_int (n, size) into the fields of n models, which hold the nominal model's.

        Raises:
            IntrinsicError: names the parameter whose ``apply`` failed.
        """
        for name, value in self.values(x_int).items():
            try:
                self.parameters[name].apply(fields, value, self.scene)
            except Exception as error:  # of the user's function
                reason = f"{type(error).__name__}: {error}"
                raise IntrinsicError(f"the intrinsic parameter {name!r} could not be applied: {reason}") from error

    @property
    def reflection(self) -> Tensor:
        """Reflection matrix R of x_int, (size, size)."""
        return torch.block_diag(*(self._mirror(name) for name in self.parameters)) if self.size else torch.zeros(0, 0)

    def _mirror(self, name: str) -> Tensor:
        part, mirror = self.slices[name], self.parameters[name].mirror
        size = part.stop - part.start
        if mirror is None:
            return torch.eye(size, dtype=torch.float32)
        return mirrors.matrix(mirror, self.scene, size, f"the intrinsic parameter {name!r}", IntrinsicError)
