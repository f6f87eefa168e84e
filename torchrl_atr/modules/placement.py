"""Bridge between a policy on a GPU and an env on the CPU."""

from __future__ import annotations

from collections.abc import Callable

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase

from torchrl_atr._compilation import CudaGraph


class DeviceBridge(TensorDictModuleBase):
    """Wrapper that runs a module on its own device for data on the CPU, e.g. a policy for TorchRL's ``Collector``.

    Only the module's inputs are copied there, from pinned memory and asynchronously; only its outputs are copied back,
    synchronously. A collector with a ``policy_device`` copies all of a step there and back, and moves the module's
    parameters: give it no ``policy_device``, or ``forward`` alone.

    Args:
        module (TensorDictModuleBase): its parameters are on ``device``.
        device (torch.device or str): where it runs.
        captured (bool): as a CUDA graph, for batches of one shape and one exploration type. Defaults to False.

    Example:
        >>> from tensordict import TensorDict
        >>> from tensordict.nn import TensorDictModule
        >>> policy = DeviceBridge(TensorDictModule(torch.nn.Linear(3, 2), ["observation"], ["action"]), "cpu")
        >>> policy(TensorDict(observation=torch.zeros(4, 3), batch_size=[4]))["action"].shape
        torch.Size([4, 2])
    """

    def __init__(self, module: TensorDictModuleBase, device: torch.device | str, captured: bool = False) -> None:
        super().__init__()
        self.module, self.device = module, torch.device(device)
        self.in_keys, self.out_keys = list(module.in_keys), list(module.out_keys)
        self._run: Callable[[TensorDictBase], TensorDictBase] = CudaGraph(self._written) if captured else self._written
        self._pinned: TensorDictBase | None = None

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Write the module's outputs into ``tensordict``, on the CPU, and return it."""
        outputs = self._run(self._sent(tensordict.select(*self.in_keys)))
        return tensordict.update(outputs.to(torch.device("cpu")))  # synchronous

    def _written(self, inputs: TensorDictBase) -> TensorDictBase:
        return self.module(inputs).select(*self.out_keys)

    def _sent(self, inputs: TensorDictBase) -> TensorDictBase:
        if self.device.type != "cuda":
            return inputs.to(self.device)
        if self._pinned is None or self._pinned.shape != inputs.shape:
            self._pinned = inputs.pin_memory()
        # the previous copy is complete: its step's outputs were synchronised
        return self._pinned.update_(inputs).to(self.device, non_blocking=True)
