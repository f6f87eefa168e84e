"""State estimators, which infer unobserved quantities from a history of observations.

An estimator is ``factory(history_shape=(H, D), out_features, **kw) -> nn.Module`` whose module maps a history
``(*B, H, D)``, oldest first, to ``(*B, out_features)``. Two are registered here: ``"cnn_gru"`` (Table I) and
``"mlp"``; :func:`register_estimator` adds yours, :func:`torchrl_atr.modules.check_estimator` tests it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import torch
from torch import Tensor, nn
from torchrl.modules import GRU, MLP

from torchrl_atr._errors import UserError, first_line
from torchrl_atr._registry import Registry
from torchrl_atr.modules.normalization import RunningNormalizer

EstimatorFactory = Callable[..., nn.Module]
_ESTIMATORS: Registry[EstimatorFactory] = Registry(
    "estimator", hint="add yours with register_estimator(name, factory) in a module that is imported first"
)


def register_estimator(name: str, factory: EstimatorFactory | None = None) -> Any:
    """Make an estimator available by name, as a call or as a decorator.

    Args:
        name (str): the name that configurations and :func:`get_estimator` use.
        factory (callable, optional): ``factory(history_shape=(H, D), out_features, **kw) -> nn.Module``;
            without it a decorator is returned.

    Returns:
        The factory unchanged, or the decorator.

    Raises:
        ValueError: if the name is empty or is taken.
        TypeError: if the factory is not callable.

    Example:
        >>> from torch import nn
        >>> @register_estimator("newest_only")
        ... class NewestOnly(nn.Module):
        ...     def __init__(self, history_shape, out_features):
        ...         super().__init__()
        ...         self.head = nn.Linear(history_shape[-1], out_features)
        ...
        ...     def forward(self, history):
        ...         return self.head(history[..., -1, :])
        >>> "newest_only" in available_estimators()
        True
    """
    if factory is None:
        return lambda decorated: register_estimator(name, decorated)
    if not isinstance(name, str) or not name:
        raise ValueError(f"An estimator name must be a non-empty string, got {name!r}.")
    if not callable(factory):
        raise TypeError(f"The factory of estimator {name!r} must be callable, got {type(factory).__name__}.")
    return _ESTIMATORS.register(name, factory)


def get_estimator(name: str) -> EstimatorFactory:
    """Return the factory registered under ``name``.

    Raises:
        UnknownNameError: (a ``ValueError`` and a ``KeyError``) for an unknown name; the message lists the
            registered ones.

    Example:
        >>> get_estimator("cnn_gru").__name__
        'CNNGRUEstimator'
    """
    return _ESTIMATORS.get(name)


class EstimatorError(UserError, AssertionError):
    """Error of an estimator that cannot be built or fails a check; the message names the remedy."""


def build_estimator(factory: EstimatorFactory, **arguments: Any) -> nn.Module:
    """Build an estimator by its factory, with a clear error if that fails.

    Args:
        factory (callable): see :func:`register_estimator`.
        **arguments: ``history_shape``, ``out_features`` and the factory's others.

    Raises:
        EstimatorError: if the factory raises an error, or does not return a module.

    Example:
        >>> build_estimator(get_estimator("mlp"), history_shape=(4, 5), out_features=3).history_shape
        (4, 5)
    """
    try:
        net = factory(**arguments)
    except Exception as error:  # of the user's own code
        raise EstimatorError(
            f"Estimator check 'build' failed: the factory raised {type(error).__name__}: {first_line(error)}. It is "
            f"called with {', '.join(f'{name}={value!r}' for name, value in arguments.items())}."
        ) from error
    if not isinstance(net, nn.Module):
        raise EstimatorError(
            f"Estimator check 'module' failed: the factory returned a {type(net).__name__}; return an nn.Module."
        )
    return net


def available_estimators() -> tuple[str, ...]:
    """Return the registered names.

    Example:
        >>> {"cnn_gru", "mlp"} <= set(available_estimators())
        True
    """
    return _ESTIMATORS.names()


def _check_history(history: Tensor, history_shape: tuple[int, int]) -> None:
    if tuple(history.shape[-2:]) != history_shape:
        raise ValueError(
            f"This estimator was built for a history of shape (*, {history_shape[0]}, {history_shape[1]}), "
            f"oldest first; got {tuple(history.shape)}."
        )


class TimeConvolution(nn.Linear):
    """Convolution over time as a linear map of overlapping windows: an ``nn.Conv1d`` that is faster for small T.

    Args:
        in_features (int): of every time step.
        out_features (int): channels.
        kernel (int): time steps in a window.
        stride (int): time steps from one window to the next. Defaults to 1.

    Example:
        >>> TimeConvolution(3, 8, kernel=4, stride=2)(torch.zeros(5, 10, 3)).shape
        torch.Size([5, 4, 8])
    """

    def __init__(self, in_features: int, out_features: int, kernel: int, stride: int = 1) -> None:
        super().__init__(kernel * in_features, out_features)
        self.step = stride * in_features

    def forward(self, x: Tensor) -> Tensor:
        """Map (B, T, in_features) to (B, (T - kernel) // stride + 1, out_features)."""
        return super().forward(x.flatten(1).unfold(1, self.in_features, self.step))


@register_estimator("cnn_gru")
class CNNGRUEstimator(nn.Module):
    """CNN-GRU + MLP estimator of Table I (question A26), stateless on the history window.

    Two convolutions over time shorten the window, a GRU reads the few steps that are left, an MLP maps its
    last state to the estimate. The first convolution has stride ``round(H / 5)`` and twice that as kernel:
    with H = 10 the GRU sees 3 steps, and a longer window costs no more. A window that the stride does not
    divide is padded at its oldest end with the oldest sample, so every sample counts.

    Args:
        history_shape (tuple of int): ``(H, D)``, any ``H >= 1``.
        out_features (int): size of the estimate.
        channels (int): channels of both convolutions. Defaults to 32.
        gru_features (int): width of the GRU. Defaults to 64.
        mlp_cells (sequence of int): hidden widths of the head. Defaults to ``(128,)``.

    Example:
        >>> import torch
        >>> CNNGRUEstimator((10, 46), 16)(torch.zeros(2, 3, 10, 46)).shape
        torch.Size([2, 3, 16])
    """

    def __init__(
        self,
        history_shape: tuple[int, int],
        out_features: int,
        channels: int = 32,
        gru_features: int = 64,
        mlp_cells: Sequence[int] = (128,),
    ) -> None:
        super().__init__()
        length, features = self.history_shape = (int(history_shape[0]), int(history_shape[1]))
        if length < 1:
            raise ValueError(f"history_shape must be (H, D) with H >= 1, got {tuple(history_shape)}.")
        stride = max(1, round(length / 5))
        kernel = min(2 * stride, length)
        self.padding = (kernel - length) % stride
        steps = (length + self.padding - kernel) // stride + 1
        self.convolutions = nn.Sequential(
            TimeConvolution(features, channels, kernel, stride),
            nn.ELU(),
            TimeConvolution(channels, channels, min(2, steps)),
            nn.ELU(),
        )
        self.gru = GRU(channels, gru_features, batch_first=True)
        self.head = MLP(gru_features, out_features, num_cells=list(mlp_cells), activation_class=nn.ELU)

    def forward(self, history: Tensor) -> Tensor:
        """Map (*B, H, D), oldest first, to (*B, out_features)."""
        _check_history(history, self.history_shape)
        x = history.reshape(-1, *self.history_shape)
        if self.padding:
            x = torch.cat([x[:, :1].expand(-1, self.padding, -1), x], 1)
        out = self.head(self.gru(self.convolutions(x))[1][0])
        return out.reshape(*history.shape[:-2], out.shape[-1])


@register_estimator("mlp")
class MLPEstimator(nn.Module):
    """MLP on the flattened history: the simplest estimator, and a baseline for the others.

    Args:
        history_shape (tuple of int): ``(H, D)``.
        out_features (int): size of the estimate.
        cells (sequence of int): hidden widths. Defaults to ``(256, 128)``.

    Example:
        >>> import torch
        >>> MLPEstimator((10, 46), 16)(torch.zeros(4, 10, 46)).shape
        torch.Size([4, 16])
    """

    def __init__(self, history_shape: tuple[int, int], out_features: int, cells: Sequence[int] = (256, 128)) -> None:
        super().__init__()
        self.history_shape = (int(history_shape[0]), int(history_shape[1]))
        size = self.history_shape[0] * self.history_shape[1]
        self.net = MLP(size, out_features, num_cells=list(cells), activation_class=nn.ELU)

    def forward(self, history: Tensor) -> Tensor:
        """Map (*B, H, D) to (*B, out_features)."""
        _check_history(history, self.history_shape)
        return self.net(torch.flatten(history, -2))


class NormalizedEstimator(nn.Module):
    """Estimator between normalisers: from a raw history to an estimate in the units of its target.

    Args:
        net (nn.Module): maps (*B, H, D) to (*B, out_features), both normalised; (*B, H, D + S) with side inputs of S
            components in all.
        input_norm (RunningNormalizer): of one observation, (D,); applied to every step of the history.
        output_norm (RunningNormalizer, optional): of the target; its inverse is applied to the output.
            Without it the output is returned as it is.
        side_norms (sequence of RunningNormalizer): of side inputs, one for each, which are appended to every step of
            the history, so that any estimator of histories can read them. Defaults to none.

    Example:
        >>> import torch
        >>> estimator = NormalizedEstimator(get_estimator("mlp")((4, 5), 3), RunningNormalizer(5))
        >>> estimator(torch.zeros(2, 4, 5)).shape
        torch.Size([2, 3])
    """

    def __init__(
        self,
        net: nn.Module,
        input_norm: RunningNormalizer,
        output_norm: RunningNormalizer | None = None,
        side_norms: Sequence[RunningNormalizer] = (),
    ) -> None:
        super().__init__()
        self.net = net
        self.input_norm = input_norm
        self.output_norm = output_norm
        self.side_norms = nn.ModuleList(side_norms)

    def forward(self, history: Tensor, *side: Tensor) -> Tensor:
        """Map a raw history (*B, H, D), and side inputs (*B, S_i) if any, to the estimate (*B, out_features)."""
        x = self.input_norm(history)
        if self.side_norms:
            values = [norm(value) for norm, value in zip(self.side_norms, side)]
            x = torch.cat([x, *(value.unsqueeze(-2).expand(*x.shape[:-1], -1) for value in values)], -1)
        out = self.net(x)
        return out if self.output_norm is None else self.output_norm.inverse(out)
