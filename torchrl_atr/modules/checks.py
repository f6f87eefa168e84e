"""Conformance check for estimators, for registered and custom ones."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import torch
from tensordict.nn import TensorDictModuleBase
from torch import Tensor, nn
from torch.nn.parameter import is_lazy

from torchrl_atr._errors import first_line
from torchrl_atr.modules.estimators import (
    EstimatorError,
    EstimatorFactory,
    EstimatorSpec,
    Role,
    build_estimator,
    failure,
    get_estimator,
    require,
)
from torchrl_atr.modules.estimators.tensordict_module import WindowModule
from torchrl_atr.modules.tensordict_checks import check_module


def check_estimator(
    factory: EstimatorFactory,
    history_shape: tuple[int, int] = (10, 46),
    out_features: int = 16,
    role: Role = "extrinsic",
    **kwargs: Any,
) -> None:
    """Check that an estimator meets the requirements of policies, losses and exports.

    It builds two estimators and checks: output shape, dtype and finiteness for several leading shapes; the
    same output for the same input in eval mode; no row of a batch depends on another; the input is left as
    it is; gradients reach every trainable parameter; in training mode two steps can follow each other, and the
    second does not depend on the first; a ``state_dict`` round trip gives the same outputs; a
    ``copy.deepcopy`` uses its own weights, as the exponential moving average that is deployed does.

    Of one that takes a ``spec`` it also checks that it declares what it reads and writes; that a hidden state gives the
    same estimates over sequences as step by step, and is forgotten where an episode begins; that its own losses are one
    finite number for each sample; that standard deviations are positive.

    Args:
        factory (callable): ``factory(history_shape=(H, D), out_features, **kwargs) -> nn.Module`` or
            ``factory(spec, **kwargs) -> TensorDictModuleBase``.
        history_shape (tuple of int): ``(H, D)``. Defaults to ``(10, 46)``.
        out_features (int): size of each estimate. Defaults to 16.
        role (str): ``intrinsic``, ``extrinsic`` or ``both``. Defaults to ``extrinsic``.
        **kwargs: passed to the factory.

    Raises:
        EstimatorError: (an ``AssertionError``) naming the property that fails and the remedy; it also wraps
            errors of the factory or its module.

    Example:
        >>> from torchrl_atr.modules import CNNGRUEstimator
        >>> check_estimator(CNNGRUEstimator, history_shape=(5, 7), out_features=3)
    """
    targets = ["intrinsic", "extrinsic"] if role == "both" else [role]
    check_for(factory, EstimatorSpec(role, history_shape, dict.fromkeys(targets, out_features)), **kwargs)


def check_for(factory: EstimatorFactory, spec: EstimatorSpec, **kwargs: Any) -> None:
    """Run :func:`check_estimator` for a role and sizes.

    Args:
        factory (callable): of the estimator.
        spec (EstimatorSpec): role and sizes.
        **kwargs: passed to the factory.

    Raises:
        EstimatorError: naming the property that fails.
    """
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(0)
        net, twin = (build_estimator(factory, spec, **kwargs) for _ in range(2))
        try:
            _require_shapes(net)
            if not isinstance(net, TensorDictModuleBase):
                _check_window(net, spec.window_shape, spec.out_features)
            check_module(_as_module(net, spec), _as_module(twin, spec), spec)
        except EstimatorError:
            raise
        except Exception as error:  # of the user's own code
            raise failure(
                "run",
                f"it raised {type(error).__name__}: {first_line(error)}. Correct its forward pass.",
            ) from error


def check_registered(name: str, specs: Iterable[EstimatorSpec], **kwargs: Any) -> None:
    """Run :func:`check_estimator` on a registered estimator for its uses.

    Args:
        name (str): as registered.
        specs (iterable of EstimatorSpec): role and sizes of each use.
        **kwargs: passed to the factory.

    Raises:
        UnknownNameError: if there is none of that name.
        EstimatorError: naming the estimator and the property that fails.

    Example:
        >>> check_registered("mlp", [EstimatorSpec("intrinsic", (10, 46), {"intrinsic": 16})])
    """
    factory = get_estimator(name)
    for spec in specs:
        try:
            check_for(factory, spec, **kwargs)
        except EstimatorError as error:
            raise EstimatorError(f"estimator {name!r} cannot be trained. {error}") from error


def _require_shapes(net: nn.Module) -> None:
    lazy = [name for name, parameter in net.named_parameters() if is_lazy(parameter)]
    require(not lazy, "module", f"{', '.join(lazy[:2])} has no shape until it is used; give all sizes in the factory.")


def _as_module(net: nn.Module, spec: EstimatorSpec) -> TensorDictModuleBase:
    return net if isinstance(net, TensorDictModuleBase) else WindowModule(net, spec)


def _check_window(net: nn.Module, history_shape: tuple[int, int], out_features: int) -> None:
    """Check what a network of histories alone must do; the rest is checked as of any TensorDict module."""
    net.eval()
    for batch in ((), (3,), (2, 3)):
        history = torch.randn(*batch, *history_shape)
        before = history.clone()
        try:
            out = net(history)
        except Exception as error:
            raise failure(
                "leading dimensions",
                f"a history of shape {tuple(history.shape)} raised {type(error).__name__}: {first_line(error)}. Accept "
                "any number of leading dimensions (flatten them, restore them on the output).",
            ) from error
        require(isinstance(out, Tensor), "output", f"forward returned a {type(out).__name__}; return one Tensor.")
        expected = (*batch, out_features)
        require(
            tuple(out.shape) == expected,
            "shape",
            f"a history of shape {tuple(history.shape)} gave {tuple(out.shape)}; return {expected}.",
        )
        unchanged = torch.equal(history, before)
        require(unchanged, "input unchanged", "forward modified its input in place; work on a copy.")
    another = torch.randn(6, *history_shape)
    try:
        net(another)
    except Exception as error:  # another batch with the same number of dimensions has passed
        raise failure(
            "deterministic",
            f"after other batches a history of shape {tuple(another.shape)} raised {type(error).__name__}: "
            f"{first_line(error)}. Keep no state between calls, and count on no size of the batch.",
        ) from error
