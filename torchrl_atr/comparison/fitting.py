"""Other estimators in a run's networks: construction, training on a recording, and their estimates on it."""

from __future__ import annotations

import dataclasses
import pickle
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import torch
from tensordict import NestedKey, TensorDictBase
from torch import Tensor, nn
from torchrl.envs import EnvBase
from torchrl.modules import set_recurrent_mode

from torchrl_atr._files import atomic
from torchrl_atr.comparison.options import CompareOptions, ComparisonError
from torchrl_atr.comparison.recording import AGE, Recording, Window, take
from torchrl_atr.modules import ROANetworks
from torchrl_atr.modules.estimators import state_keys, state_shapes
from torchrl_atr.training import TrainConfig, make_run_loss, make_run_networks

_PARTS = ("intrinsic_estimator.", "extrinsic_estimator.")
_CHUNK = 8192
"""Steps that estimates are made of at once, as long as that is one robot or more."""


def config_with(config: TrainConfig, name: str, history_length: int | None = None) -> TrainConfig:
    """Return a run's settings with another estimator, whose arguments are its defaults; the run's own keeps its own.

    Args:
        config: of the run.
        name: of the estimator.
        history_length: H, of its histories; None for the run's.
    """
    arguments = config.estimator.arguments if name == config.estimator.name else {}
    length = config.env.history_length if history_length is None else history_length
    return dataclasses.replace(
        config,
        env=dataclasses.replace(config.env, history_length=length),
        estimator=dataclasses.replace(config.estimator, name=name, arguments=arguments),
    )


def networks_with(config: TrainConfig, env: EnvBase, networks: ROANetworks) -> ROANetworks:
    """Return a copy of a run's networks with the new estimators that ``config`` names, in eval mode.

    Encoder, actor, critic and normalisers are the run's, so what changes in the policy is the estimates alone.
    """
    swapped = make_run_networks(config, env)  # type: ignore[arg-type]
    rest = {name: value for name, value in networks.state_dict().items() if not name.startswith(_PARTS)}
    swapped.load_state_dict(rest, strict=False)
    old, new = (each.extrinsic_estimator.side_norms for each in (networks, swapped))  # type: ignore[union-attr]
    new.load_state_dict(old.state_dict())  # type: ignore[union-attr]
    swapped.command_range = networks.command_range
    return swapped.eval()


def entries_read(networks: ROANetworks) -> list[NestedKey]:
    """Return the entries that a training of the estimators reads from a recording; hidden states are not there."""
    encoder = networks.encoder_module
    keys: list[NestedKey] = [networks.keys.extrinsic, *(encoder.in_keys if encoder is not None else ())]
    for module in networks.estimator_modules:
        own = set(state_keys(module))
        keys += [key for key in [*module.in_keys, *getattr(module, "loss_in_keys", ())] if key not in own]
    return list(dict.fromkeys(keys))


def fit(
    networks: ROANetworks,
    config: TrainConfig,
    recording: Recording,
    options: CompareOptions,
    seed: int,
    tick: Callable[[], None] = lambda: None,
    window: Window | None = None,
) -> None:
    """Train the estimators on a recording by the run's own loss and optimiser; the rate falls to zero by a cosine.

    Estimators with a hidden state learn from sequences that begin at any step, with a state of zeros, others from
    shuffled steps; the number of steps in a batch is the same.

    Args:
        networks: of :func:`networks_with`; all but the estimators stay as they are.
        config: of the run, with the estimator.
        recording: to train on.
        options: updates, batch and length of a sequence.
        seed: of the batches.
        tick: called after every update.
        window: what they read of the recording as history; None for the recorded one.
    """
    loss: Any = make_run_loss(config, networks)
    parameters = list(networks.estimator_parameters())
    optimizer = torch.optim.Adam(parameters, lr=config.estimator.learning_rate, fused=True)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, options.updates)
    networks.train()
    read = [*entries_read(networks), *(() if window is None else (AGE, window.observation))]
    for batch in _batches(networks, recording.train.select(*read), options, seed, window):
        terms = loss.adaptation_loss(batch)
        optimizer.zero_grad()
        torch.stack([value for key, value in terms.items() if key.startswith("loss_")]).sum().backward()
        nn.utils.clip_grad_norm_(parameters, config.ppo.max_grad_norm)
        optimizer.step()
        schedule.step()
        tick()
    networks.eval()


def _batches(
    networks: ROANetworks, data: TensorDictBase, options: CompareOptions, seed: int, window: Window | None
) -> Iterator[TensorDictBase]:
    """Yield batches of random steps, (batch,), or of random sequences, (batch / sequence, sequence)."""
    draw = torch.Generator().manual_seed(seed)
    robots, steps = data.shape
    recurrent = any(map(state_keys, networks.estimator_modules))
    length = min(options.sequence, steps) if recurrent else 1
    count = max(1, options.batch // length)
    for _ in range(options.updates):
        rows = torch.randint(robots, (count,), generator=draw)
        first = torch.randint(steps - length + 1, (count,), generator=draw)
        if recurrent:
            sequence = first.unsqueeze(1) + torch.arange(length)
            yield with_first_state(networks, take(data, rows.unsqueeze(1), sequence, window))
        else:
            yield take(data, rows, first, window)


def with_first_state(networks: ROANetworks, data: TensorDictBase) -> TensorDictBase:
    """Return the data with hidden states of zeros, where an estimator has one."""
    data = data.copy()
    for module in networks.estimator_modules:
        for key, shape in state_shapes(module).items():
            data.set(key, torch.zeros(*data.batch_size, *shape))
    return data


@torch.no_grad()
def estimates(
    networks: ROANetworks, data: TensorDictBase, window: Window | None = None, every: int = 1
) -> Iterator[tuple[TensorDictBase, TensorDictBase]]:
    """Yield steps of a recording, robots in order, and the estimates there, (n, T) each.

    Hidden states are carried from the beginning of the recording, and forgotten where a ride begins.

    Args:
        networks: with the estimators.
        data: (N, T), of a recording.
        window: what they read of it as history; None for the recorded one.
        every: control steps from one that is estimated to the next; above 1 for estimators without a hidden state.
    """
    steps = torch.arange(0, data.shape[1], every)
    rows = max(1, _CHUNK // len(steps))
    for begin in range(0, data.shape[0], rows):
        part = data[begin : begin + rows]
        robots = torch.arange(len(part)).unsqueeze(1)
        part = part[:, ::every] if window is None else window.take(part, robots, steps)  # a slice copies nothing
        estimator_input = with_first_state(networks, part)
        written = part.empty()
        with set_recurrent_mode(True):
            for module in networks.estimator_modules:
                written.update(module(estimator_input.select(*module.in_keys)).exclude(*module.in_keys))
        yield part, written


def estimator_weights(networks: ROANetworks) -> dict[str, Tensor]:
    """Return the weights of the estimators, by their names among the networks'."""
    return {name: value for name, value in networks.state_dict().items() if name.startswith(_PARTS)}


def save_estimators(networks: ROANetworks, path: Path) -> None:
    """Write the estimators' weights."""
    with atomic(path) as file:
        torch.save(estimator_weights(networks), file)


def load_estimators(networks: ROANetworks, path: Path) -> None:
    """Read the estimators' weights.

    Raises:
        ComparisonError: if they are of another estimator, or not readable.
    """
    try:
        weights = torch.load(path, weights_only=True)
        if weights.keys() != estimator_weights(networks).keys():
            raise RuntimeError("other parameters")
        networks.load_state_dict(weights, strict=False)
    except (RuntimeError, EOFError, pickle.UnpicklingError, AttributeError) as error:
        raise ComparisonError(
            f"{path} holds no weights of this estimator, which may have changed since; remove {path.parent} to "
            "train it again"
        ) from error
