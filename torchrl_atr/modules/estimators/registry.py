"""Registry of estimators: factories by name, and construction with clear errors."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from typing import Any

from tensordict.nn import TensorDictModuleBase
from torch import nn

from torchrl_atr._errors import UserError, first_line
from torchrl_atr._registry import Registry
from torchrl_atr.modules.estimators.spec import EstimatorSpec

EstimatorFactory = Callable[..., nn.Module]
"""Factory of an estimator, in either form of :func:`register_estimator`."""
_ESTIMATORS: Registry[EstimatorFactory] = Registry(
    "estimator", hint="add yours with register_estimator(name, factory) in a module that is imported first"
)


def register_estimator(name: str, factory: EstimatorFactory | None = None) -> Any:
    """Make an estimator available by name, as a call or as a decorator.

    Args:
        name (str): the name that configurations and :func:`get_estimator` use.
        factory (callable, optional): ``factory(history_shape=(H, D), out_features, **kw) -> nn.Module``, or
            ``factory(spec, **kw) -> TensorDictModuleBase`` (docs/estimators.md); without it a decorator is returned.

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


def takes_spec(factory: EstimatorFactory) -> bool:
    """Return whether a factory has a parameter ``spec``: it then makes a TensorDict module.

    Example:
        >>> takes_spec(get_estimator("mlp"))
        False
    """
    try:
        return "spec" in inspect.signature(factory).parameters
    except ValueError:  # of a builtin
        return False


def build_estimator(factory: EstimatorFactory, spec: EstimatorSpec, **arguments: Any) -> nn.Module:
    """Build an estimator by its factory, with a clear error if that fails.

    Args:
        factory (callable): see :func:`register_estimator`.
        spec (EstimatorSpec): role and sizes; a factory without ``spec`` gets ``history_shape`` and ``out_features``.
        **arguments: the factory's others.

    Raises:
        EstimatorError: if the factory raises an error, or does not return a module.

    Example:
        >>> build_estimator(get_estimator("mlp"), EstimatorSpec("extrinsic", (4, 5), {"extrinsic": 3})).history_shape
        (4, 5)
    """
    own, kind = takes_spec(factory), "an nn.Module"
    sizes: dict[str, Any] = (
        {"spec": spec} if own else {"history_shape": spec.window_shape, "out_features": spec.out_features}
    )
    try:
        net = factory(**sizes, **arguments)
    except Exception as error:  # of the user's own code
        called = ", ".join(f"{name}={value!r}" for name, value in {**sizes, **arguments}.items())
        raise EstimatorError(
            f"Estimator check 'build' failed: the factory raised {type(error).__name__}: {first_line(error)}. It is "
            f"called with {called}."
        ) from error
    if own:
        kind = "a TensorDictModuleBase, as it takes a spec"
    if not isinstance(net, TensorDictModuleBase if own else nn.Module):
        raise EstimatorError(
            f"Estimator check 'module' failed: the factory returned a {type(net).__name__}; return {kind}."
        )
    return net


def available_estimators() -> tuple[str, ...]:
    """Return the registered names.

    Example:
        >>> {"cnn_gru", "mlp"} <= set(available_estimators())
        True
    """
    return _ESTIMATORS.names()


def failure(check: str, remedy: str) -> EstimatorError:
    """Return the error of a check that failed."""
    return EstimatorError(f"Estimator check {check!r} failed: {remedy}")


def require(condition: bool, check: str, remedy: str) -> None:
    """Raise the :func:`failure` of a check unless its condition holds."""
    if not condition:
        raise failure(check, remedy)
