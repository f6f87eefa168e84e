"""A policy that runs elsewhere; on a GPU: tests/training/test_cuda.py."""

from __future__ import annotations

import torch
from tensordict import TensorDict
from tensordict.nn import TensorDictModule

from torchrl_atr.modules import DeviceBridge


def test_only_what_the_module_reads_goes_and_only_what_it_writes_comes_back():
    seen = []

    class Double(torch.nn.Module):
        def forward(self, x):
            return 2 * x

    module = TensorDictModule(Double(), in_keys=[("nested", "x")], out_keys=["y"])
    module.register_forward_pre_hook(lambda _, arguments: seen.append(set(arguments[0].keys(True, True))))
    data = TensorDict(nested={"x": torch.ones(3, 1), "other": torch.zeros(3)}, more=torch.zeros(3), batch_size=[3])
    policy = DeviceBridge(module, "cpu")
    assert policy(data) is data
    assert seen == [{("nested", "x")}]
    assert data["y"].tolist() == [[2.0], [2.0], [2.0]]
    assert set(data.keys(True, True)) == {("nested", "x"), ("nested", "other"), "more", "y"}
    assert (policy.in_keys, policy.out_keys) == ([("nested", "x")], ["y"])
