"""Rewrites a run whose symmetric layers held half of a plain one's weights for layers of even and odd parts.

``python scripts/convert_symmetric.py RUN OUTPUT`` writes ``OUTPUT/checkpoint.pt``: the same networks as functions.
Adam's moments belong to the old weights and start anew.
"""

from __future__ import annotations

import sys
from pathlib import Path

import torch
from torch import Tensor

from torchrl_atr.modules import SymmetricLinear
from torchrl_atr.training import load_checkpoint, make_config, make_env, make_run_networks
from torchrl_atr.training.checkpoint import NAME, save_checkpoint

_OLD = ("weight", "bias", "order", "signs", "out_order", "out_signs")


def plain(old: dict[str, Tensor], features: tuple[int, int]) -> tuple[Tensor, Tensor]:
    """Weight (out, in) and bias of the plain layer that an old symmetric one stands for."""
    weight, bias, order, signs, out_order, out_signs = (old[name] for name in _OLD)
    if weight.shape[0] == features[0]:
        weight = torch.cat([weight, weight.index_select(0, order) * signs[:, None]], 1)
    else:
        weight = torch.cat([weight, weight.index_select(1, order) * signs], 0)
    return weight, (bias + out_signs * bias[out_order]) / 2


@torch.no_grad()
def fill(layer: SymmetricLinear, weight: Tensor, bias: Tensor) -> None:
    """Gives ``layer`` the weights of a plain layer that commutes with its reflections."""
    # what each side makes of a unit vector, part by part: its basis, times its gain
    even_in, odd_in = layer.inputs.split(torch.eye(layer.in_features))
    even_out, odd_out = layer.outputs.split(torch.eye(layer.out_features))
    scale = layer.inputs.gain**2 * layer.outputs.gain**2
    layer.even.weight.copy_(even_out.T @ weight @ even_in / scale)
    layer.even.bias.copy_(even_out.T @ bias / layer.outputs.gain**2)
    if layer.odd is not None:
        layer.odd.weight.copy_(odd_out.T @ weight @ odd_in / scale)
    x = torch.randn(64, layer.in_features)
    torch.testing.assert_close(layer(x), x @ weight.T + bias, atol=1e-4, rtol=1e-4)


def main(run: Path, output: Path) -> None:
    """Converts one run."""
    state = load_checkpoint(run)
    config = make_config(state["config"])
    networks = make_run_networks(config, make_env(config, num_envs=1, compiled=False))
    old, new = state["learner"]["networks"], networks.state_dict()
    for name, layer in networks.named_modules():
        if isinstance(layer, SymmetricLinear):
            parts = {part: old[f"{name}.{part}"] for part in _OLD}
            fill(layer, *plain(parts, (layer.out_features, layer.in_features)))
    state["learner"]["networks"] = {**networks.state_dict(), **{name: old[name] for name in old if name in new}}
    for optimizer in state["learner"]["optimizers"].values():
        optimizer["state"] = {}
    save_checkpoint(output / NAME, state, best=False)


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
