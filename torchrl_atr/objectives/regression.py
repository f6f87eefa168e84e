"""Regression of estimates on their targets: squared errors, or a likelihood where the estimate is a distribution."""

from __future__ import annotations

from torch import Tensor, nn


def regression(
    estimate: Tensor, target: Tensor, unit: Tensor | None = None, scale: Tensor | None = None
) -> tuple[Tensor, Tensor, Tensor | None]:
    """Return the loss of each sample, summed over features, and detached diagnostics.

    Args:
        estimate: (*B, E); the mean of a Gaussian if there is a scale.
        target: (*B, E), detached.
        unit: that errors are measured in, (E,); None for 1.
        scale: standard deviation that the estimator gives, (*B, E), in the units of the estimate: the loss is then the
            negative log-likelihood without its constant, in these units.

    Returns:
        The loss (*B,), the errors (*B, E), and with a scale their root mean square in standard deviations: 1 if these
        are right, above 1 if the estimator is too sure.

    Example:
        >>> import torch
        >>> loss, error, _ = regression(torch.ones(2, 3), torch.zeros(2, 3))
        >>> loss.tolist()
        [3.0, 3.0]
    """
    error = estimate - target
    error = error if unit is None else error / unit
    if scale is None:
        return error.square().sum(-1), error.detach(), None
    scale = scale if unit is None else scale / unit
    deviation = error / scale
    loss = (0.5 * deviation.square() + scale.log()).sum(-1)  # torch's gaussian_nll_loss waits for a GPU
    return loss, error.detach(), deviation.detach().square().mean().sqrt()


def check_scale(scale: Tensor | nn.Module | None) -> tuple[nn.Module | None, Tensor | None]:
    """Return a scale of errors as a module that has ``std``, or as a tensor; both None for no scale.

    Raises:
        ValueError: for anything else, or a tensor that is not positive.

    Example:
        >>> import torch
        >>> check_scale(torch.ones(2))
        (None, tensor([1., 1.]))
    """
    std = scale.std if isinstance(scale, nn.Module) and hasattr(scale, "std") else scale
    if std is not None and not isinstance(std, Tensor):
        raise ValueError("extrinsic_scale must be a Tensor, a RunningNormalizer (a module with std) or None.")
    if isinstance(scale, Tensor) and not bool((scale > 0).all()):
        raise ValueError(f"extrinsic_scale must be positive, got {scale.tolist()}.")
    return (scale, None) if isinstance(scale, nn.Module) else (None, scale)
