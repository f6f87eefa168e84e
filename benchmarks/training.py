"""Training iterations: frames per second, profile, and floating-point operations."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import torch
from torch import nn
from torch.utils.flop_counter import FlopCounterMode

from benchmarks.stopwatch import Stopwatch
from benchmarks.summary import TRAINED
from benchmarks.timing import Contender, Key
from torchrl_atr.config.nested import flat
from torchrl_atr.runs.restoring import checkpoint_config
from torchrl_atr.training import TrainConfig, Trainer, load_checkpoint, make_config

RIDE = Path(__file__).parents[1] / "results" / "a1-single_board"
"""Run whose robots rarely fall, as in most iterations of any run; untrained ones fall within seconds."""

_SIZES = ("env.num_envs", "ppo.rollout_steps", "ppo.minibatches", "compute.", "logging.")


class TrainingLoop:
    """Loop of the trainer's iterations, without its logs and checkpoints.

    Args:
        config: of the run.
        folder: for the trainer's files.
        riding: whether it begins with the networks of :data:`RIDE`, in its task, with the sizes of ``config``.
    """

    def __init__(self, config: TrainConfig, folder: Path, riding: bool = False) -> None:
        if riding:
            sizes = {path: value for path, value in flat(config.to_dict()).items() if path.startswith(_SIZES)}
            config = checkpoint_config(load_checkpoint(RIDE), RIDE, changed=sizes)
        self.config, self.riding = config, riding
        self.trainer = Trainer(config, folder, begin_from=RIDE if riding else None)
        self.learner, self.env = self.trainer.learner, self.trainer.env
        self.collection = self.trainer.collection

    def iterate(self) -> int:
        """Run one iteration of :meth:`Trainer.train`, collect and learn; return its frames."""
        self.trainer.iterate()
        return self.config.frames_per_batch

    def close(self) -> None:
        """Close collector and env."""
        self.collection.shutdown()
        self.env.close()

    def contender(self, threads: int) -> Contender:
        """Return this loop as a contender."""
        name = TRAINED["riding_" if self.riding else ""]
        return Contender(Key(name, self.config.env.num_envs, threads), self.iterate, self.close)


def flops_per_frame(config: TrainConfig, folder: Path) -> float:
    """Count the floating-point operations of one iteration's networks, forward and backward, per robot step.

    Args:
        config: of the run; it runs without compilation, since torch counts eager operations only.
        folder: for the trainer's files.
    """
    loop = TrainingLoop(make_config(config.to_dict(), {"compute.compiled": False}), folder)
    batch = loop.collection.collect()
    with torch.no_grad(), FlopCounterMode(display=False) as acting:
        loop.collection.policy(batch[:, 0].clone())
    with FlopCounterMode(display=False) as learning:
        loop.learner.update(batch)
    loop.close()
    return acting.get_total_flops() / batch.shape[0] + learning.get_total_flops() / batch.numel()


def matrix_products(loop: TrainingLoop, threads: int) -> Contender:
    """Return the contender of the compute limit: ``torch.mm`` in the shapes of actor and critic; it counts FLOPs.

    Each layer has its three products of training: forward, gradient of the input, gradient of the weights.
    """
    networks, rows = loop.learner.networks, loop.learner.minibatch_size
    modules = [*networks.backbone.modules(), *networks.critic.modules()]
    layers = [module for module in modules if isinstance(module, nn.Linear)]
    shapes = [(layer.in_features, layer.out_features) for layer in layers]
    operands = [(torch.randn(rows, i), torch.randn(i, o), torch.randn(rows, o)) for i, o in shapes]
    flops = sum(3 * 2 * rows * i * o for i, o in shapes)

    def step() -> int:
        for x, weight, gradient in operands:
            torch.mm(x, weight)
            torch.mm(gradient, weight.T)
            torch.mm(x.T, gradient)
        return flops

    return Contender(Key("matrix_products", rows, threads), step)


def profile(loop: TrainingLoop, iterations: int) -> dict[tuple[str, str], float]:
    """Measure the seconds of an iteration by stage and phase, each phase without those inside it.

    ``physics`` is MuJoCo's stepping; ``task`` sensors, observations, rewards, terminations; ``resets`` new episodes;
    ``transforms`` the transforms of :func:`~torchrl_atr.envs.make_riding_env` and TorchRL's stepping.
    """
    watch, parts = Stopwatch(), _parts(loop)
    for phase, (owner, name) in parts.items():
        watch.attach(owner, name, phase)
    try:
        for _ in range(iterations):
            loop.iterate()
    finally:
        watch.detach()
    return {phase: watch.seconds[phase] / iterations for phase in parts}


def _parts(loop: TrainingLoop) -> dict[tuple[str, str], tuple[Any, str]]:
    """Return the methods that make up an iteration, by stage and phase, in the order of the report."""
    base, learner = loop.env.base_env, loop.learner
    return {
        ("collect", "physics"): (base.engine, "_substep"),
        ("collect", "hook"): (base.engine, "advance"),
        ("collect", "task"): (base, "_step"),
        ("collect", "resets"): (base, "_reset"),
        ("collect", "transforms"): (loop.env, "step_and_maybe_reset"),
        ("collect", "policy"): (loop.collection.policy, "forward"),
        ("collect", "collector"): (loop.collection, "collect"),
        ("learn", "GAE"): (learner, "advantage"),
        ("learn", "PPO"): (learner, "_learn_policy"),
        ("learn", "estimators"): (learner, "_learn_estimators"),
        ("learn", "rest"): (learner, "update"),
        ("rest", "metrics, annealing"): (loop, "iterate"),
    }
