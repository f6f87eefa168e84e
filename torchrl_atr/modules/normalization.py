"""Running normalisation as a module inside the networks, saved, exported and frozen with them."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from torchrl_atr.modules.symmetry import check_reflection


class RunningNormalizer(nn.Module):
    """Normaliser of the trailing dimensions by running statistics that change only in :meth:`update`.

    ``forward`` never updates, so a rollout and every epoch on its batch see the same statistics and the
    importance ratio of the first minibatch is one. Updates are in place: every module and every functional
    copy of the parameters (:class:`~tensordict.nn.TensorDictParams`) that shares the buffers sees them.

    Args:
        shape (int or tuple of int): shape of one sample, e.g. the last dimension of an observation.
        clip (float): normalised values are clipped to ``[-clip, clip]``. Defaults to 10.
        eps (float): added to the variance, so that a constant component does not divide by zero.
            Defaults to 1e-5.
        reflection (Tensor, optional): R, (D, D), of a sample of D components: the statistics are then those of the
            samples and of their mirror images, so that normalising commutes with R.

    Attributes:
        mean (Tensor): running mean, ``shape``, default float dtype; zeros before the first update.
        var (Tensor): running (population) variance, ``shape``; ones before the first update.
        count (Tensor): number of samples seen, a float64 scalar.
        reflection (Tensor or None): as given.

    Raises:
        ValueError: if ``clip`` or ``eps`` is not positive, or a tensor does not end with ``shape``.

    Example:
        >>> import torch
        >>> norm = RunningNormalizer(1)
        >>> norm.update(torch.tensor([[1.0], [3.0]]))
        >>> norm.mean.item(), norm.var.item()
        (2.0, 1.0)
        >>> round(norm(torch.tensor([3.0])).item(), 3)
        1.0
    """

    mean: Tensor
    var: Tensor
    count: Tensor
    reflection: Tensor | None

    def __init__(
        self,
        shape: int | tuple[int, ...],
        clip: float = 10.0,
        eps: float = 1e-5,
        reflection: Tensor | None = None,
    ) -> None:
        super().__init__()
        if clip <= 0 or eps <= 0:
            raise ValueError(f"clip and eps must be positive, got clip={clip}, eps={eps}.")
        self.shape = torch.Size((shape,) if isinstance(shape, int) else shape)
        self.clip = float(clip)
        self.eps = float(eps)
        self.register_buffer("mean", torch.zeros(self.shape))
        self.register_buffer("var", torch.ones(self.shape))
        self.register_buffer("count", torch.zeros((), dtype=torch.float64))
        matrix = None if reflection is None else check_reflection(reflection, self.shape.numel())
        self.register_buffer("reflection", matrix, persistent=False)

    @property
    def std(self) -> Tensor:
        """Standard deviation ``sqrt(var + eps)``, shape ``shape``, in the units of the data."""
        return (self.var + self.eps).sqrt()

    def forward(self, x: Tensor) -> Tensor:
        """Return ``(x - mean) / std`` clipped, same shape as ``x`` (``*B, *shape``)."""
        self._check(x)
        return ((x - self.mean) / self.std).clamp(-self.clip, self.clip)

    def inverse(self, x: Tensor) -> Tensor:
        """Undo ``forward`` (within the clip): ``*B, *shape``, back in the units of the data."""
        self._check(x)
        return x * self.std + self.mean

    @torch.no_grad()
    def update(self, x: Tensor) -> None:
        """Merge a batch into the statistics (parallel variance formula of Chan et al.).

        Args:
            x (Tensor): samples, ``*B, *shape``; a sample with a non-finite entry is ignored.
        """
        self._check(x)
        rows = x.detach().reshape(-1, max(self.shape.numel(), 1)).to(torch.float64)
        finite = rows.isfinite().all(-1, keepdim=True)  # a mask, not an index: no GPU synchronisation
        samples = finite.sum()
        number = samples.clamp(min=1)
        batch_mean = rows.where(finite, 0.0).sum(0) / number
        batch_var = (rows - batch_mean).where(finite, 0.0).square().sum(0) / number
        mean, var = self.mean.to(torch.float64), self.var.to(torch.float64)
        if self.reflection is not None:
            matrix = self.reflection.to(torch.float64)
            spread = (batch_mean - matrix @ batch_mean) / 2
            batch_mean, batch_var = batch_mean - spread, (batch_var + matrix.abs() @ batch_var) / 2 + spread.square()
        total = self.count + samples
        weight = samples / total.clamp(min=1)
        delta = batch_mean.reshape(self.shape) - mean
        merged = (1 - weight) * var + weight * batch_var.reshape(self.shape) + weight * (1 - weight) * delta**2
        self.mean.copy_(mean + weight * delta)
        self.var.copy_(merged)
        self.count.copy_(total)

    def extra_repr(self) -> str:
        """Return the constructor arguments for ``repr``."""
        return f"shape={tuple(self.shape)}, clip={self.clip:g}, eps={self.eps:g}"

    def _check(self, x: Tensor) -> None:
        if x.shape[x.ndim - len(self.shape) :] != self.shape:
            raise ValueError(
                f"RunningNormalizer expects a tensor of shape (*, {', '.join(map(str, self.shape))}), "
                f"got {tuple(x.shape)}. Build it with the size of the last dimension of the data."
            )
