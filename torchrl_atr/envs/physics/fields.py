"""Fields of the compiled model that differ between simulations."""

from __future__ import annotations

from collections.abc import Callable

from torch import Tensor

from torchrl_atr._errors import InputError


class ModelFields(dict[str, Tensor]):
    """Mapping of fields of the compiled model, such as ``body_mass``, of several simulations, (N, ...) each.

    A field is created at its first access; values assigned to it are written in place.

    Args:
        expand: makes a field one per simulation, by name.

    Raises:
        InputError: for a name that is not a field which can differ between simulations, or values of another shape.
    """

    def __init__(self, expand: Callable[[str], Tensor]) -> None:
        super().__init__()
        self._expand = expand

    def __missing__(self, name: str) -> Tensor:
        try:
            super().__setitem__(name, self._expand(name))
        except (ValueError, AttributeError, TypeError) as error:
            raise InputError(
                f"{name!r} is no field of the compiled model that can differ between simulations; see mujoco.MjModel, "
                "such as 'body_mass' or 'geom_friction'"
            ) from error
        return self[name]

    def __setitem__(self, name: str, value: Tensor) -> None:
        field = self[name]
        if tuple(value.shape) != tuple(field.shape):
            raise InputError(f"the field {name!r} is of {tuple(field.shape)}, not {tuple(value.shape)}")
        if value is not field:  # the same after an operation in place
            field.copy_(value)
