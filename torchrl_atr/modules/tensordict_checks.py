"""Conformance check for estimators that are TensorDict modules: entries, memory, losses of their own, scales."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from copy import deepcopy
from typing import Any

import torch
from tensordict import NestedKey, TensorDict, TensorDictBase, unravel_key
from tensordict.nn import TensorDictModuleBase
from torch import Tensor, nn
from torchrl.modules import set_recurrent_mode

from torchrl_atr._errors import first_line
from torchrl_atr.modules.estimators import (
    IS_INIT,
    EstimatorModule,
    EstimatorSpec,
    failure,
    require,
    state_shapes,
)
from torchrl_atr.modules.normalization import RunningNormalizer


def check_module(net: TensorDictModuleBase, twin: TensorDictModuleBase, spec: EstimatorSpec) -> None:
    """Check an estimator of a spec, and another one of the same.

    Args:
        net (TensorDictModuleBase): made by a factory that takes a spec.
        twin (TensorDictModuleBase): made by the same factory.
        spec (EstimatorSpec): role and sizes.

    Raises:
        EstimatorError: naming the property that fails and the remedy.
    """
    module, other = (_between_normalizers(each, spec).eval() for each in (net, twin))
    samples = _Samples(module, spec)
    for batch in ((3,), (2, 3)):
        _check_outputs(module, samples(batch), spec)
    _check_behaviour(module, samples((6,)))
    if module.state_keys:
        _check_memory(module, samples((3, 5)))
    _check_losses(module, samples)
    data = samples((6,))
    other.load_state_dict(module.state_dict())
    require(
        _same(_estimates(other, data), _estimates(module, data)),
        "state_dict",
        "a second instance with the same state_dict gives other outputs; register all state as parameters or buffers.",
    )
    check_copy(module, lambda each: _estimates(each, data), _same)


def _between_normalizers(net: TensorDictModuleBase, spec: EstimatorSpec) -> EstimatorModule:
    sides = {key: RunningNormalizer(size) for key, size in spec.inputs.items()}
    extrinsic = RunningNormalizer(spec.targets.get("extrinsic", 1))
    return EstimatorModule(net, spec, RunningNormalizer(spec.observation_features), extrinsic, sides)


class _Samples:
    """Random inputs of an estimator; ``samples(batch)`` returns them as a TensorDict of that batch size."""

    def __init__(self, module: EstimatorModule, spec: EstimatorSpec) -> None:
        features = spec.observation_features
        self.shapes: dict[Any, Sequence[int]] = {
            unravel_key(spec.keys.observation): (features,),
            unravel_key(spec.next_observation_key): (features,),
            unravel_key(spec.keys.history): spec.history_shape,
            **{unravel_key(key): (size,) for key, size in spec.inputs.items()},
            **state_shapes(module),
            IS_INIT: (1,),
        }
        if "extrinsic" in spec.targets:
            self.shapes[unravel_key(spec.keys.extrinsic)] = (spec.targets["extrinsic"],)
        unknown = [key for key in module.in_keys if unravel_key(key) not in self.shapes]
        require(
            not unknown,
            "in_keys",
            f"{unknown[:1]} is none of spec.keys.observation, spec.keys.history, spec.inputs, {IS_INIT!r} and the "
            "states of a primer (make_tensordict_primer); name further entries in estimator_inputs.",
        )
        self.in_keys = module.in_keys
        # of other entries, such as rewards, the sizes are not known here
        self.complete = all(unravel_key(key) in self.shapes for key in module.loss_in_keys)
        self.loss_in_keys: list[NestedKey] = module.loss_in_keys if self.complete else []

    def __call__(self, batch: tuple[int, ...]) -> TensorDict:
        data = TensorDict(batch_size=batch)
        for key in [*self.in_keys, *self.loss_in_keys]:
            value = torch.randn(*batch, *self.shapes[unravel_key(key)])
            data.set(key, torch.zeros_like(value, dtype=torch.bool) if key == IS_INIT else value)
        return data


def _estimates(module: EstimatorModule, data: TensorDictBase) -> TensorDictBase:
    return module(data.copy()).select(*module.out_keys)


def _same(one: TensorDictBase, other: TensorDictBase) -> bool:
    return bool((one == other).all())


def _check_outputs(module: EstimatorModule, data: TensorDictBase, spec: EstimatorSpec) -> None:
    out = _estimates(module, data)
    sizes = dict(zip(spec.estimate_keys, spec.targets.values())) | dict(zip(spec.scale_keys, spec.targets.values()))
    for key in module.out_keys:
        value = out.get(key)
        if key in sizes:
            expected = (*data.batch_size, sizes[key])
            require(tuple(value.shape) == expected, "shape", f"{key!r} is {tuple(value.shape)}; write {expected}.")
        require(value.dtype == torch.get_default_dtype(), "dtype", f"{key!r} is {value.dtype}; keep the inputs' dtype.")
        require(bool(value.isfinite().all()), "finite", f"a standard normal input gave a non-finite output, {key!r}.")
        if key in spec.scale_keys:
            require(
                bool((value > 0).all()), "scale", f"{key!r} is not positive; use NormalParamExtractor, or softplus."
            )


def _check_behaviour(module: EstimatorModule, data: TensorDictBase) -> None:
    before, out = data.clone(), _estimates(module, data)
    require(_same(data, before), "input unchanged", "forward modified its input in place; work on a copy.")
    require(
        _same(_estimates(module, data), out),
        "deterministic",
        "two calls in eval mode differ; keep no state between calls but in entries, and no noise in eval mode.",
    )
    changed = _random_like(data)
    changed[0] = data[0]
    for key, value in _estimates(module, changed).items(True, True):
        require(
            torch.allclose(value[0], out.get(key)[0], rtol=1e-4, atol=1e-5),
            "independent rows",
            "a row's output depends on other rows; normalise over features, not over the batch.",
        )


def _random_like(data: TensorDictBase) -> TensorDictBase:
    return data.apply(lambda value: value.clone() if value.dtype == torch.bool else torch.randn_like(value))


def _check_memory(module: EstimatorModule, data: TensorDictBase) -> None:
    """Check that sequences give what steps give, with an episode that begins within one."""
    if IS_INIT not in data:
        raise failure("memory", f"it has a hidden state and does not read {IS_INIT!r}; add it to in_keys.")
    begins = torch.zeros_like(data[IS_INIT])
    begins[0, 0] = begins[2, 0] = begins[1, 3] = True
    data[IS_INIT], steps = begins, []
    state = {key: data.get(key)[:, 0] for key in module.state_keys}
    for index in range(data.shape[1]):
        step = data[:, index].clone()
        for key in module.state_keys:  # as a TensorDictPrimer does at a reset
            mask = begins[:, index].reshape(-1, *[1] * (state[key].ndim - 1))
            step.set(key, state[key].masked_fill(mask, 0.0))
            data.get(key)[:, index] = step.get(key).detach()
        out = module(step)
        state = {key: out.get(("next", *([key] if isinstance(key, str) else key))) for key in module.state_keys}
        steps.append(out.select(*module.spec.estimate_keys))
    with set_recurrent_mode(True):
        whole = module(data.copy())
    for key in module.spec.estimate_keys:
        one, other = whole.get(key), torch.stack([step.get(key) for step in steps], 1)
        require(
            torch.allclose(one, other, rtol=1e-3, atol=1e-4),
            "memory",
            "a sequence (n, T) under set_recurrent_mode(True) gives other estimates than its steps one by one; begin "
            f"anew where {IS_INIT!r} is true, from the state stored at the first step, as torchrl.modules.GRUModule.",
        )


def _check_losses(module: EstimatorModule, samples: _Samples) -> None:
    """Check gradients of two training passes, the module's own losses included; then restore its buffers."""
    before = {name: value.detach().clone() for name, value in module.state_dict().items()}
    totals: list[Tensor] = []
    data = samples((3, 4))
    if not samples.complete:
        module.loss_in_keys, module.net.losses = [], lambda tensordict: {}  # type: ignore[assignment]
    module.train()
    for _ in range(2):
        torch.manual_seed(1)
        with set_recurrent_mode(bool(module.state_keys)):
            out, losses = module.estimate_and_losses(data.copy())
        _check_terms(losses, data.batch_size)
        terms = [out.get(key).square().mean() for key in out.keys(True, True) if key[0] != "next"]
        total = torch.stack([*terms, *(loss.mean() for loss in losses.values())]).sum()
        text = "the output carries no gradient; do not detach or run under no_grad, and have a trainable parameter."
        require(total.requires_grad, "gradients", text)
        try:
            module.zero_grad()
            total.backward()
        except RuntimeError as error:
            raise failure(
                "training",
                f"the backward pass of step {len(totals) + 1} raised {type(error).__name__}: {first_line(error)}. Keep "
                "no state between calls but in entries, and modify nothing in place that a gradient needs.",
            ) from error
        totals.append(total)
    require(
        torch.allclose(totals[0], totals[1], rtol=1e-4, atol=1e-5),
        "training",
        "two passes in training mode with the same input and random seed differ; keep no state between calls.",
    )
    if samples.complete:
        _check_gradients(module)
    module.load_state_dict(before)
    if not samples.complete:
        del module.net.losses
        module.loss_in_keys = list(module.net.loss_in_keys)
    module.zero_grad()
    module.eval()


def _check_terms(losses: Any, batch: torch.Size) -> None:
    require(isinstance(losses, dict), "losses", f"losses returned a {type(losses).__name__}; return a dict by name.")
    for name, loss in losses.items():
        require(
            isinstance(loss, Tensor) and loss.shape == batch,
            "losses",
            f"{name!r} is {tuple(getattr(loss, 'shape', ()))}; return one number for each sample, {tuple(batch)}.",
        )
        require(bool(loss.isfinite().all()), "losses", f"{name!r} is not finite for a standard normal input.")


def _check_gradients(module: EstimatorModule) -> None:
    parameters = {name: each for name, each in module.net.named_parameters() if each.requires_grad}
    dead = [name for name, each in parameters.items() if each.grad is None or not each.grad.isfinite().all()]
    require(
        not dead, "gradients", f"no finite gradient reaches {', '.join(dead)}; use these parameters or remove them."
    )
    require(
        any(bool(each.grad.abs().sum() > 0) for each in parameters.values() if each.grad is not None),
        "gradients",
        "no parameter gets a non-zero gradient; do not detach or run under no_grad.",
    )


def check_copy(module: nn.Module, compute: Callable[[Any], Any], same: Callable[[Any, Any], bool]) -> None:
    """Check that a copy of an estimator has weights of its own.

    Args:
        module: the estimator.
        compute: returns what it, or a copy, writes.
        same: compares two such outputs.

    Raises:
        EstimatorError: if it cannot be copied, or a copy computes with the original's weights.
    """
    out = compute(module)
    try:
        copied = deepcopy(module)
    except Exception as error:
        raise failure(
            "copy",
            f"copy.deepcopy raised {type(error).__name__}: {first_line(error)}. Keep nothing that cannot be copied, "
            "such as outputs of an earlier call with their graph.",
        ) from error
    with torch.no_grad():
        for parameter in copied.parameters():
            parameter.add_(1.0)
    require(
        same(compute(module), out) and not same(compute(copied), out),
        "copy",
        "a copy.deepcopy computes with the weights of the original; reach them through self alone.",
    )
