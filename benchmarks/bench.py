"""Benchmark of the library's speed: all compared configurations are measured in turns in one run."""

from __future__ import annotations

import dataclasses
import os
import tempfile
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import Any

import torch

from benchmarks import contenders, report, summary
from benchmarks.memory import peak_memory
from benchmarks.peers import available
from benchmarks.timing import Contender, Key, Rates, interleave, medians
from benchmarks.training import TrainingLoop, flops_per_frame, matrix_products, profile
from torchrl_atr._compilation import compiler
from torchrl_atr._cpus import available_cpus
from torchrl_atr._files import say
from torchrl_atr._interrupt import end_children
from torchrl_atr.runs.provenance import machine
from torchrl_atr.training import TrainConfig, make_config

Maker = Callable[[], Contender]


@dataclass(frozen=True)
class Plan:
    """Plan of a benchmark: sizes and numbers of samples.

    Attributes:
        cpus: threads and worker processes; 0 for the CPUs this process may use.
        compiled: whether our envs are compiled, if there is a compiler.
        num_envs: N of the layers; one of ``sizes``.
        sizes: values of N for rates and peak memory.
        training_sizes: values of N for training, the default recipe's first; each one of ``sizes``.
        steps: control steps of a collector's batch, the recipe's.
        rounds: samples of each contender.
        seconds: least time of a sample.
        profiled: number of profiled iterations, with a trained policy.
    """

    cpus: int = 0
    compiled: bool = True
    num_envs: int = 1024
    sizes: tuple[int, ...] = (64, 256, 512, 1024, 4096)
    training_sizes: tuple[int, ...] = (TrainConfig().env.num_envs, 256, 1024)
    steps: int = TrainConfig().ppo.rollout_steps
    rounds: int = 7
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
    """Measure everything and write ``bench.json`` and ``bench.md``.

    Args:
        plan: :data:`FULL` or :data:`QUICK`.
        folder: for the two files; created if missing.
        command: to be written beside the figures.

    Returns:
        The contents of ``bench.json``.
    """
    folder.mkdir(parents=True, exist_ok=True)  # fail before the measurements if it cannot be written
    cpus, compiled = plan.cpus or available_cpus(), plan.compiled and compiler() is not None
    torch._dynamo.config.recompile_limit = 64  # each number of threads is one compilation
    plan = dataclasses.replace(plan, cpus=cpus, compiled=compiled)
    results = {"command": command, **_origin(), "plan": dataclasses.asdict(plan)}
    results["memory"] = _memory(plan)
    peers, results["skipped"] = available()
    with ExitStack() as stack, _workers_end_first():
        scratch = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        loops = [_loop(plan, size, scratch, riding) for size in plan.training_sizes for riding in (True, False)]
        makers: list[Maker] = [partial(loop.contender, plan.cpus) for loop in loops]
        makers += [partial(matrix_products, loops[0], plan.cpus), *_layers(plan)]
        makers += [partial(peer, plan.cpus) for peer in peers]
        threads = torch.get_num_threads()
        opened = [_opened(make, stack) for make in makers]
        torch.set_num_threads(threads)  # TorchRL's ParallelEnv lowered it when it started
        rates = interleave(opened, plan.rounds, plan.seconds, say)
        say("profiling")
        phases = profile(loops[0], plan.profiled)
        flops = flops_per_frame(loops[0].config, scratch / "counted")
    results |= _figures(plan, rates, flops)
    results["profile"] = {
        "num_envs": plan.training_sizes[0],
        "phases": [{"stage": stage, "name": name, "seconds": value} for (stage, name), value in phases.items()],
    }
    results["machine"]["load_after"] = os.getloadavg()[0]
    report.write(results, folder)
    return results


@contextmanager
def _workers_end_first() -> Iterator[None]:
    """Kill the workers on an interrupt: ``ParallelEnv.close`` would wait for answers that do not come."""
    try:
        yield
    except KeyboardInterrupt:
        end_children()
        raise


def _origin() -> dict[str, Any]:
    """Return the date, the machine and the versions."""
    origin = machine()
    hardware = {**origin["hardware"], "torch_threads": torch.get_num_threads(), "load_before": os.getloadavg()[0]}
    return {"date": f"{datetime.now(UTC):%Y-%m-%d %H:%M} UTC", "machine": hardware, "versions": origin["versions"]}


def _memory(plan: Plan) -> list[dict[str, float]]:
    rows = []
    for size in plan.sizes:
        say(f"peak memory of {size} robots")
        rows.append(peak_memory(size, plan.steps))
    return rows


def _loop(plan: Plan, size: int, scratch: Path, riding: bool) -> TrainingLoop:
    config = make_config({"env.num_envs": size, "ppo.rollout_steps": plan.steps, "compute.compiled": plan.compiled})
    return TrainingLoop(config, scratch / f"{size}-{riding}", riding)


def _layers(plan: Plan) -> list[Maker]:
    """Return the contenders of this library: all layers once, the lower ones at every size and number of threads."""
    size, cpus, steps, compiled = plan.num_envs, plan.cpus, plan.steps, plan.compiled
    fewer = [2**k for k in range(cpus.bit_length()) if 2**k < cpus]
    makers: list[Maker] = []
    for n, threads in [(n, cpus) for n in plan.sizes] + [(size, threads) for threads in fewer]:
        makers += [partial(contenders.physics, n, threads), partial(contenders.bare, n, threads, compiled=compiled)]
        makers.append(partial(contenders.free, n, threads, steps=steps, compiled=compiled))
    if compiled:
        makers.append(partial(contenders.bare, size, cpus, name="bare_eager"))
        makers.append(partial(contenders.free, size, cpus, steps=steps, name="free_eager"))
    return [
        *makers,
        partial(contenders.transformed, size, cpus, compiled=compiled),
        partial(contenders.deployed, size, cpus, steps=steps, compiled=compiled),
        partial(contenders.training_policy, size, cpus, steps=steps, compiled=compiled),
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
