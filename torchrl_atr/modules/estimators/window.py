"""Estimators that read a window of past observations: MLP, CNN-GRU, TCN and Transformer.

Each is ``factory(history_shape=(H, D), out_features, **kw) -> nn.Module`` whose module maps a history (*B, H, D),
oldest first and normalised, to (*B, out_features).
"""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor, nn
from torchrl.modules import GRU, MLP

from torchrl_atr._checks import check_whole
from torchrl_atr.modules.estimators.registry import register_estimator


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


@register_estimator("tcn")
class TCNEstimator(nn.Module):
    """Causal dilated convolutions over the window, with residual connections; the newest step makes the estimate.

    Every level doubles the dilation, until the newest step depends on the whole window.

    Args:
        history_shape (tuple of int): ``(H, D)``.
        out_features (int): size of the estimate.
        channels (int): of every level. Defaults to 64.
        kernel (int): of every convolution, 2 or more. Defaults to 3.

    Example:
        >>> import torch
        >>> TCNEstimator((10, 46), 16)(torch.zeros(4, 10, 46)).shape
        torch.Size([4, 16])
    """

    def __init__(self, history_shape: tuple[int, int], out_features: int, channels: int = 64, kernel: int = 3) -> None:
        super().__init__()
        kernel = check_whole("kernel", kernel, low=2)
        self.history_shape = (int(history_shape[0]), int(history_shape[1]))
        self.embed = nn.Conv1d(self.history_shape[1], channels, 1)
        self.levels, self.past, seen = nn.ModuleList(), [], 1
        while seen < self.history_shape[0]:
            self.past.append((kernel - 1) * 2 ** len(self.levels))
            self.levels.append(nn.Conv1d(channels, channels, kernel, dilation=2 ** len(self.levels)))
            seen += self.past[-1]
        self.head = nn.Linear(channels, out_features)

    def forward(self, history: Tensor) -> Tensor:
        """Map (*B, H, D), oldest first, to (*B, out_features)."""
        _check_history(history, self.history_shape)
        x = self.embed(history.reshape(-1, *self.history_shape).transpose(1, 2))
        for level, past in zip(self.levels, self.past):
            x = x + nn.functional.elu(level(nn.functional.pad(x, (past, 0))))
        out = self.head(nn.functional.elu(x[..., -1]))
        return out.reshape(*history.shape[:-2], out.shape[-1])


@register_estimator("transformer")
class TransformerEstimator(nn.Module):
    """Transformer encoder over the window, with learned positions; its mean over time makes the estimate.

    Args:
        history_shape (tuple of int): ``(H, D)``.
        out_features (int): size of the estimate.
        features (int): width. Defaults to 64.
        heads (int): of attention; a divisor of the width. Defaults to 4.
        layers (int): number of them. Defaults to 2.

    Example:
        >>> import torch
        >>> TransformerEstimator((10, 46), 16)(torch.zeros(4, 10, 46)).shape
        torch.Size([4, 16])
    """

    def __init__(
        self, history_shape: tuple[int, int], out_features: int, features: int = 64, heads: int = 4, layers: int = 2
    ) -> None:
        super().__init__()
        self.history_shape = (int(history_shape[0]), int(history_shape[1]))
        self.embed = nn.Linear(self.history_shape[1], features)
        self.positions = nn.Parameter(0.02 * torch.randn(self.history_shape[0], features))
        # no dropout: the policy would be another at every pass; norm_first trains without a warm-up
        layer = nn.TransformerEncoderLayer(
            features, heads, 2 * features, dropout=0.0, batch_first=True, norm_first=True
        )
        self.encoder = nn.TransformerEncoder(layer, layers, enable_nested_tensor=False)
        self.head = nn.Sequential(nn.LayerNorm(features), nn.Linear(features, out_features))

    def forward(self, history: Tensor) -> Tensor:
        """Map (*B, H, D), oldest first, to (*B, out_features)."""
        _check_history(history, self.history_shape)
        x = self.embed(history.reshape(-1, *self.history_shape)) + self.positions
        out = self.head(self.encoder(x).mean(1))
        return out.reshape(*history.shape[:-2], out.shape[-1])
