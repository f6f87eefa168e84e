"""A conformance check for estimators, for ours and for yours."""

from __future__ import annotations

from copy import deepcopy
from typing import Any

import torch
from torch import Tensor, nn

from torchrl_atr.modules.estimators import EstimatorFactory


def check_estimator(
    factory: EstimatorFactory,
    history_shape: tuple[int, int] = (10, 46),
    out_features: int = 16,
    **kwargs: Any,
) -> None:
    """Check that an estimator keeps the contract that policies, losses and exports rely on.

    It builds two estimators and checks: output shape, dtype and finiteness for several leading shapes; the
    same output for the same input in eval mode; no row of a batch depends on another; the input is left as
    it is; gradients reach every trainable parameter; a ``state_dict`` round trip gives the same outputs; a
    ``copy.deepcopy`` works on weights of its own, as the running mean that is deployed does.

    Args:
        factory (callable): ``factory(history_shape=(H, D), out_features, **kwargs) -> nn.Module``.
        history_shape (tuple of int): ``(H, D)``. Defaults to ``(10, 46)``.
        out_features (int): size of the estimate. Defaults to 16.
        **kwargs: passed to the factory.

    Raises:
        AssertionError: naming the property that fails and what to do about it.

    Examples:
        >>> from torchrl_atr.modules import CNNGRUEstimator
        >>> check_estimator(CNNGRUEstimator, history_shape=(5, 7), out_features=3)
    """
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(0)
        build = dict(history_shape=history_shape, out_features=out_features, **kwargs)
        net, twin = factory(**build), factory(**build)
        _require(
            isinstance(net, nn.Module),
            "module",
            f"the factory returned a {type(net).__name__}; return an nn.Module.",
        )
        net.eval()
        twin.eval()
        _check_outputs(net, history_shape, out_features)
        history = torch.randn(6, *history_shape)
        _check_behaviour(net, history)
        _check_gradients(net, history)
        _check_state_dict(net, twin, history)
        _check_copy(net, history)


def _failure(name: str, remedy: str) -> AssertionError:
    return AssertionError(f"Estimator check {name!r} failed: {remedy}")


def _require(condition: bool, name: str, remedy: str) -> None:
    if not condition:
        raise _failure(name, remedy)


def _check_outputs(net: nn.Module, history_shape: tuple[int, int], out_features: int) -> None:
    for batch in ((), (3,), (2, 3)):
        history = torch.randn(*batch, *history_shape)
        try:
            out = net(history)
        except Exception as error:
            raise _failure(
                "leading dimensions",
                f"a history of shape {tuple(history.shape)} raised {type(error).__name__}: {error}. Accept any number "
                "of leading dimensions (flatten them, restore them on the output).",
            ) from error
        _require(isinstance(out, Tensor), "output", f"forward returned a {type(out).__name__}; return one Tensor.")
        expected = (*batch, out_features)
        _require(
            tuple(out.shape) == expected,
            "shape",
            f"a history of shape {tuple(history.shape)} gave {tuple(out.shape)}; return {expected}.",
        )
        _require(
            out.dtype == history.dtype,
            "dtype",
            f"{history.dtype} in, {out.dtype} out; keep the dtype of the input.",
        )
        _require(bool(out.isfinite().all()), "finite", "a standard normal history gave a non-finite output.")


def _check_behaviour(net: nn.Module, history: Tensor) -> None:
    before = history.clone()
    out = net(history)
    _require(
        torch.equal(history, before),
        "input unchanged",
        "forward modified its input in place; work on a copy.",
    )
    _require(
        torch.equal(net(history), out),
        "deterministic",
        "two calls in eval mode differ; keep no state between calls and no noise in eval mode.",
    )
    changed = history.clone()
    changed[1:] = torch.randn_like(changed[1:])
    _require(
        torch.allclose(net(changed)[0], out[0], rtol=1e-4, atol=1e-5),
        "independent rows",
        "a row's output depends on other rows; normalise over features, not over the batch.",
    )


def _check_gradients(net: nn.Module, history: Tensor) -> None:
    net.zero_grad()
    net(history).square().sum().backward()
    dead = [
        name
        for name, parameter in net.named_parameters()
        if parameter.requires_grad and (parameter.grad is None or not parameter.grad.isfinite().all())
    ]
    _require(
        not dead,
        "gradients",
        f"no finite gradient reaches {', '.join(dead)}; use these parameters or remove them.",
    )
    trainable = [parameter.grad for parameter in net.parameters() if parameter.requires_grad]
    _require(
        any(bool(grad.abs().sum() > 0) for grad in trainable if grad is not None),
        "gradients",
        "no parameter gets a non-zero gradient; do not detach or run under no_grad.",
    )
    net.zero_grad()


def _check_state_dict(net: nn.Module, twin: nn.Module, history: Tensor) -> None:
    twin.load_state_dict(net.state_dict())
    _require(
        torch.equal(twin(history), net(history)),
        "state_dict",
        "a second instance with the same state_dict gives other outputs; register all state as parameters or buffers.",
    )


def _check_copy(net: nn.Module, history: Tensor) -> None:
    out = net(history)
    try:
        copied = deepcopy(net)
    except Exception as error:
        raise _failure(
            "copy",
            f"copy.deepcopy raised {type(error).__name__}: {error}. Keep nothing that cannot be copied, such as "
            "outputs of an earlier call with their graph.",
        ) from error
    with torch.no_grad():
        for parameter in copied.parameters():
            parameter.add_(1.0)
    _require(
        torch.equal(net(history), out) and not torch.equal(copied(history), out),
        "copy",
        "a copy.deepcopy computes with the weights of the original; reach them through self alone.",
    )
