"""Per-row state of the command curriculum."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor, nn

from torchrl_atr._errors import InputError
from torchrl_atr._inference import keeps_normal_tensors
from torchrl_atr.envs.transforms.grid import CommandGrid

_FIELDS = ("command", "cells", "elapsed", "sums", "pinned")


class CommandRows(nn.Module):
    """State of the environment's rows: their commands, the commands' cells, the state of their windows, their pins.

    A ``tensordict.TensorClass`` would hold the same fields; its ``load_state_dict`` takes no other batch size, and it
    does not move with a module. Everything is None until :meth:`allocate`. The fields move with ``.to()`` and travel
    as extra state, so that a ``state_dict`` from before the first reset, or of another batch size, can be loaded.

    Attributes:
        batch: The environment's batch size ``B``; ``n`` is its number of rows.
        command: ``(n, 2)``, m/s and rad/s.
        cells: int64 ``(n,)``: the cell that the command was drawn from; -1 if it was not drawn, and is not
            counted.
        elapsed: int64 ``(n,)``: steps since the window began.
        sums: ``(n, scores)``: the sum of each tracking score over the window.
        pinned: bool ``(n,)``.
    """

    command: Tensor
    cells: Tensor
    elapsed: Tensor
    sums: Tensor
    pinned: Tensor

    def __init__(self) -> None:
        super().__init__()
        self.batch: torch.Size | None = None
        for name in _FIELDS:
            self.register_buffer(name, None, persistent=False)

    def allocate(self, batch: torch.Size, axes: int, scores: int, dtype: torch.dtype, device: Any) -> None:
        """Allocate rows for batch size ``batch``: commands of ``axes`` numbers at 0, no cell, no pin."""
        n = batch.numel()
        self.batch = batch
        self.command = torch.zeros(n, axes, dtype=dtype, device=device)
        self.cells = torch.full((n,), -1, device=device)
        self.elapsed = torch.zeros(n, dtype=torch.long, device=device)
        self.sums = torch.zeros(n, scores, dtype=torch.float32, device=device)
        self.pinned = torch.zeros(n, dtype=torch.bool, device=device)

    def mask(self, mask: Tensor | None) -> Tensor:
        """Return ``mask``, bool ``(*B,)`` or ``(*B, 1)``, as bool ``(n,)``; None is all rows.

        Raises:
            ValueError: Another dtype or shape.
        """
        if mask is None:
            return torch.ones_like(self.pinned)
        assert self.batch is not None
        if mask.dtype != torch.bool or mask.shape not in (self.batch, (*self.batch, 1)):
            raise ValueError(f"mask must be bool {tuple(self.batch)}, got {mask.dtype} {tuple(mask.shape)}")
        return mask.reshape(-1).to(self.pinned.device)

    def pin(self, command: Tensor | Sequence[float], grid: CommandGrid, mask: Tensor | None) -> None:
        """Set the command of the rows in ``mask``, ``(2,)`` or ``(*B, 2)``, and exempt them from resampling.

        Raises:
            ValueError: Wrong shape, not finite, beyond the grid's bounds, or backwards where that is never drawn.
        """
        assert self.batch is not None
        command = torch.as_tensor(command, dtype=self.command.dtype, device=self.command.device)
        axes = self.command.shape[-1]
        if command.shape not in ((axes,), (*self.batch, axes)):
            allowed = f"({axes},) or {(*self.batch, axes)}"
            raise ValueError(f"command must have shape {allowed}, got {tuple(command.shape)}")
        given = command.reshape(-1, axes)
        fits = (given.abs() <= given.new_tensor(grid.bounds)).all(-1)
        if not bool(fits.all()):
            raise InputError(
                f"command {given[~fits][0].tolist()} must be finite and within ±{grid.bounds} (m/s, rad/s), the grid's "
                "bounds"
            )
        backwards = given[:, 0] < 0.0
        if grid.forward_only and bool(backwards.any()):
            raise InputError(
                f"command {given[backwards][0].tolist()} asks for a negative speed, and the grid is forward_only; give "
                f"a speed within [0, {grid.bounds[0]:g}] m/s"
            )
        rows = self.mask(mask)
        self.command = torch.where(rows[:, None], given, self.command)
        self.cells = self.cells.masked_fill(rows, -1)
        self.pinned = self.pinned | rows

    def restart(self, rows: Tensor) -> None:
        """Begin a new window in ``rows``, bool ``(n,)``."""
        self.elapsed.masked_fill_(rows, 0)
        self.sums.masked_fill_(rows[:, None], 0)  # not a product: NaN and infinity must be reset too

    def get_extra_state(self) -> dict[str, Any]:
        """Return the batch size and copies of the fields; all None before :meth:`allocate`."""
        if self.batch is None:
            return dict.fromkeys(("batch", *_FIELDS))
        return {"batch": list(self.batch), **{name: getattr(self, name).clone() for name in _FIELDS}}

    @keeps_normal_tensors
    def set_extra_state(self, state: dict[str, Any]) -> None:
        """Restore :meth:`get_extra_state`, on the device where the rows were last."""
        device = None if self.batch is None else self.pinned.device
        self.batch = None if state["batch"] is None else torch.Size(state["batch"])
        for name in _FIELDS:
            value = state[name]
            setattr(self, name, None if value is None else value.to(device or value.device, copy=True))
