"""Estimator of one entry of recorded data, without the other networks."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

from tensordict import NestedKey, TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor

from torchrl_atr._checks import check_key, check_keys, check_kind
from torchrl_atr._errors import InputError
from torchrl_atr._registry import nearest_entry
from torchrl_atr.modules.dtype import default_dtype
from torchrl_atr.modules.estimators import EstimatorModule, EstimatorSpec, WindowModule, build_estimator, get_estimator
from torchrl_atr.modules.keys import NetworkKeys
from torchrl_atr.modules.normalization import RunningNormalizer


def make_estimator(
    data: TensorDictBase,
    name: str = "cnn_gru",
    *,
    target: NestedKey | None = None,
    inputs: Sequence[NestedKey] = (),
    keys: NetworkKeys | None = None,
    **arguments: Any,
) -> EstimatorModule:
    """Return an estimator of one entry of recorded data, with normalisers that are fitted to them.

    It needs no env, actor or encoder: train it on any data that hold histories and the target, by
    :meth:`EstimatorModule.estimate_and_losses` and :func:`torchrl_atr.objectives.regression`.

    Args:
        data (TensorDictBase): steps, (*B,), with the history (*B, H, D), the target (*B, E) and the further inputs.
        name (str): a registered name. Defaults to ``cnn_gru``.
        target (NestedKey, optional): entry to estimate. Defaults to the extrinsic state.
        inputs (sequence of NestedKey): entries that are read beside the history. Defaults to none.
        keys (NetworkKeys, optional): names of the entries, if the data have their own.
        **arguments: of the estimator's factory.

    Returns:
        EstimatorModule: its role is ``extrinsic``; the estimate is in ``keys.extrinsic_estimate``, in the target's
        units, and ``output_norm`` holds the target's mean and standard deviation.

    Raises:
        KeyError: if the data lack an entry. ValueError: if an entry has another number of dimensions, or the estimator
            is unknown. EstimatorError: if its factory fails.

    Example:
        >>> import torch
        >>> from tensordict import TensorDict
        >>> data = TensorDict(history=torch.randn(50, 4, 5), mass=torch.rand(50, 1), batch_size=[50])
        >>> estimator = make_estimator(data, "mlp", target="mass")
        >>> estimator(data[:3])["estimate", "extrinsic"].shape
        torch.Size([3, 1])
    """
    check_kind("data", data, TensorDictBase, "a TensorDict of recorded steps")
    keys = keys or NetworkKeys()
    if target is not None:
        keys = dataclasses.replace(keys, extrinsic=check_key("target", target))
    rank = len(data.batch_size)
    history, truth = _entry(data, keys.history, rank + 2), _entry(data, keys.extrinsic, rank + 1)
    beside = {key: _entry(data, key, rank + 1) for key in check_keys("inputs", inputs)}
    spec = EstimatorSpec(
        "extrinsic",
        (history.shape[-2], history.shape[-1]),
        {"extrinsic": truth.shape[-1]},
        {key: value.shape[-1] for key, value in beside.items()},
        keys,
    )
    with default_dtype(history.dtype):
        net = build_estimator(get_estimator(name), spec, **arguments)
        module = net if isinstance(net, TensorDictModuleBase) else WindowModule(net, spec)
        norms = [_fitted(value) for value in (history, truth, *beside.values())]
    return EstimatorModule(module, spec, norms[0], norms[1], dict(zip(beside, norms[2:])))


def _entry(data: TensorDictBase, key: NestedKey, ndim: int) -> Tensor:
    value = data.get(key, None)
    if value is None:
        raise KeyError(f"the data lack {key!r}; {nearest_entry(key, data)}")
    if value.ndim != ndim:
        raise InputError(
            f"{key!r} of the data has shape {tuple(value.shape)}; {ndim} dimensions are needed, of which the first "
            f"{len(data.batch_size)} are the data's batch size"
        )
    return value


def _fitted(values: Tensor) -> RunningNormalizer:
    norm = RunningNormalizer(values.shape[-1])
    norm.update(values)
    return norm
