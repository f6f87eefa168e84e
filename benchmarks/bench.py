"""The benchmark: in one run, all that has the same number of robots takes turns."""

from __future__ import annotations

import dataclasses
import os
import tempfile
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import Any

import torch

from benchmarks import contenders, report, summary
from benchmarks.memory import peak_memory
from benchmarks.peers import Peer, available
from benchmarks.timing import Contender, Key, Rates, interleave, medians
from benchmarks.training import TrainingLoop, flops_per_frame, matrix_products, profile
from torchrl_atr._files import say
from torchrl_atr.envs.task.compilation import compiler
from torchrl_atr.training import TrainConfig
from torchrl_atr.training.provenance import machine

Maker = Callable[[], Contender]


@dataclass(frozen=True)
class Plan:
    """What is measured, and how often.

    Attributes:
        cpus: threads and worker processes; 0 for the CPUs this process may use.
        compiled: whether our envs are compiled, where there is a compiler.
        num_envs: N of the layers; one of ``sizes``.
        sizes: N, for cost and peak memory.
        training_sizes: N that are trained, the recipe's first; each one of ``sizes``. Where there are several CPUs,
            they are also trained by as many learners, if they can be shared evenly.
        steps: control steps of a collector's batch, the recipe's.
        rounds: samples of each contender.
        seconds: least time of a sample.
        profiled: iterations that are profiled.
    """

    cpus: int = 0
    compiled: bool = True
    num_envs: int = 1024
    sizes: tuple[int, ...] = (64, 256, 512, 1024, 4096)
    training_sizes: tuple[int, ...] = (TrainConfig.num_envs, 256, 1024)
    steps: int = TrainConfig.rollout_steps
    rounds: int = 5
    seconds: float = 0.5
    profiled: int = 8


FULL = Plan()
QUICK = Plan(
    cpus=1,
    compiled=False,
    num_envs=8,
    sizes=(8,),
    training_sizes=(8,),
    steps=4,
    rounds=2,
    seconds=0.05,
    profiled=1,
)


def run(plan: Plan, folder: Path, command: str) -> dict[str, Any]:
    """Measures everything and writes ``bench.json`` and ``bench.md``.

    Args:
        plan: :data:`FULL` or :data:`QUICK`.
        folder: for the two files; made if missing.
        command: to be written beside the figures.

    Returns:
        What ``bench.json`` holds.
    """
    folder.mkdir(parents=True, exist_ok=True)  # a folder that cannot be written is found before, not after
    cpus, compiled = plan.cpus or len(os.sched_getaffinity(0)), plan.compiled and compiler() is not None
    plan = dataclasses.replace(plan, cpus=cpus, compiled=compiled)
    results = {"command": command, **_origin(), "plan": dataclasses.asdict(plan)}
    results["memory"] = _memory(plan)
    peers, results["skipped"] = available()
    rates: Rates = {}
    with tempfile.TemporaryDirectory() as scratch:
        for size in plan.sizes:
            say(f"{size} robots")
            rates |= _turns(plan, size, Path(scratch), peers, results)
    results |= _figures(plan, rates, results["profile"].pop("flops"))
    results["machine"]["load_after"] = os.getloadavg()[0]
    report.write(results, folder)
    return results


def _origin() -> dict[str, Any]:
    """When, where and with what."""
    origin = machine()
    hardware = {**origin["hardware"], "torch_threads": torch.get_num_threads(), "load_before": os.getloadavg()[0]}
    return {"date": f"{datetime.now(UTC):%Y-%m-%d %H:%M} UTC", "machine": hardware, "versions": origin["versions"]}


def _memory(plan: Plan) -> list[dict[str, float]]:
    rows = []
    for size in plan.sizes:
        say(f"peak memory of {size} robots")
        rows.append(peak_memory(size, plan.steps))
    return rows


def _turns(plan: Plan, size: int, scratch: Path, peers: Sequence[Peer], results: dict[str, Any]) -> Rates:
    """Rates of all that has ``size`` robots: what is compared takes turns, and nothing else is in memory meanwhile."""
    with ExitStack() as stack:
        loops = [_loop(plan, size, scratch, learners) for learners in _learners(plan, size)]
        makers: list[Maker] = [partial(loop.contender, plan.cpus) for loop in loops]
        makers += _layers(plan, size)
        if size == plan.training_sizes[0]:
            makers.append(partial(matrix_products, loops[0], plan.cpus))
        if size == plan.num_envs:
            makers += [partial(peer, plan.cpus) for peer in peers]
        threads = torch.get_num_threads()
        opened = [_opened(make, stack) for make in makers]
        torch.set_num_threads(threads)  # TorchRL's ParallelEnv lowered it when it started
        rates = interleave(opened, plan.rounds, plan.seconds, say)
        if size == plan.training_sizes[0]:
            say("profiling")
            results["profile"] = _profile(plan, loops[0])
    return rates


def _profile(plan: Plan, loop: TrainingLoop) -> dict[str, Any]:
    flops, phases = flops_per_frame(loop), profile(loop, plan.profiled)
    return {
        "num_envs": loop.config.num_envs,
        "flops": flops,
        "phases": [{"stage": stage, "name": name, "seconds": value} for (stage, name), value in phases.items()],
    }


def _learners(plan: Plan, size: int) -> list[int]:
    """How many learners train that many robots, one run each."""
    if size not in plan.training_sizes:
        return []
    return [1, plan.cpus] if plan.cpus > 1 and size % plan.cpus == 0 else [1]


def _loop(plan: Plan, size: int, scratch: Path, learners: int) -> TrainingLoop:
    config = TrainConfig(num_envs=size, rollout_steps=plan.steps, compiled=plan.compiled, learners=learners)
    return TrainingLoop(config, scratch / f"{size} {learners}")


def _layers(plan: Plan, size: int) -> list[Maker]:
    """Ours: the lower layers at every size, all of them once and also with fewer threads."""
    cpus, steps, compiled = plan.cpus, plan.steps, plan.compiled
    main = size == plan.num_envs
    fewer = [2**k for k in range(cpus.bit_length()) if 2**k < cpus] if main else []
    makers: list[Maker] = []
    for threads in [cpus, *fewer]:
        makers += [partial(contenders.physics, size, threads), partial(contenders.bare, size, threads, compiled)]
        makers.append(partial(contenders.free, size, threads, steps, compiled))
    if not main:
        return makers
    if compiled:
        makers.append(partial(contenders.bare, size, cpus, name="bare_eager"))
        makers.append(partial(contenders.free, size, cpus, steps, name="free_eager"))
    return [
        *makers,
        partial(contenders.transformed, size, cpus, compiled),
        partial(contenders.deployed, size, cpus, steps, compiled),
        partial(contenders.training_policy, size, cpus, steps, compiled),
    ]


def _opened(make: Maker, stack: ExitStack) -> Contender:
    contender = make()
    stack.callback(contender.close)
    return contender


def _figures(plan: Plan, rates: Rates, flops: float) -> dict[str, Any]:
    median = medians(rates)
    (products,) = (key for key in rates if key.name == "matrix_products")
    return {
        "rates": summary.rate_records(rates),
        "ladder": summary.ladder(median, plan.num_envs, plan.cpus),
        "compute": {"flops_per_frame": flops, "flops_per_second": median[products], "rows": products.num_envs},
        "training": summary.training(median, flops),
        "peers": summary.peers(median, Key("free", plan.num_envs, plan.cpus)),
        "scaling": summary.scaling(median),
    }
