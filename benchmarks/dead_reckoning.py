"""Errors of the extrinsic estimator's speed by its inputs: ``python -m benchmarks.dead_reckoning RUN``.

Rides of a policy, under each sensor set, record every method of dead reckoning side by side. On the same rides one
estimator is trained for each input: the history alone, as in the paper, or history and dead-reckoned velocity. Errors
are of robots that the estimators were not trained on, early and late in a ride of a minute.
"""

from __future__ import annotations

import argparse
import dataclasses
import sys
import time
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from benchmarks import results
from torchrl_atr import envs
from torchrl_atr._files import say
from torchrl_atr.envs.physics import CONTROL_DT
from torchrl_atr.envs.tasks import Task
from torchrl_atr.envs.tasks.dead_reckoning import METHODS, dead_reckoning
from torchrl_atr.envs.tasks.sensors import SENSORS
from torchrl_atr.evaluation.access import deterministic
from torchrl_atr.evaluation.ride import RideStep, ride
from torchrl_atr.modules import RunningNormalizer, get_estimator
from torchrl_atr.modules.estimators import NormalizedEstimator
from torchrl_atr.runs.provenance import machine
from torchrl_atr.training import load_run

COMMAND_SECONDS = 5.0
BATCH = 512
HISTORY = 10
SPEED = 7
"""Index of v_P,x in x_ext."""
WINDOWS = {"first": (0.0, 10.0), "last": (50.0, 60.0)}
"""Parts of a ride over which errors are averaged, s."""


@dataclasses.dataclass
class Rides:
    """Record of T steps of N robots.

    Attributes:
        observation: o_t, (T, N, O).
        extrinsic: x_ext, (T, N, E).
        reckoned: dead-reckoned velocity by method, (T, N, 3).
        up: mask of the robots that were up, (T, N) bool.
    """

    observation: Tensor
    extrinsic: Tensor
    reckoned: dict[str, Tensor]
    up: Tensor

    def history(self, step: Tensor, robot: Tensor) -> Tensor:
        """Return the observations before ``step`` (n,), (n, H, O); at the start, the first one is repeated."""
        steps = (step.unsqueeze(-1) + torch.arange(-HISTORY, 0)).clamp_min(0)
        return self.observation[steps, robot.unsqueeze(-1)]


def with_every_method(task: Task) -> Task:
    """Return the task with each method of dead reckoning observed under its own name."""
    for name in METHODS:
        group, memory = dead_reckoning(name, name)
        task = task.replace(memory={**task.memory, name: memory}).with_observation(name, **group)
    return task


def record(run: Path, sensors: str, robots: int, seconds: float, seed: int) -> Rides:
    """Ride commands within ±2 m/s and ±1 rad/s that change every 5 s, with pushes, and record the observations."""
    config, loaded, networks, _ = load_run(run, num_envs=1)
    loaded.close()
    task = with_every_method(config.make_task(sensors=sensors, moving_start=0.0, displaced_start=0.0, pushes=True))
    env = envs.make_env(task, robots, max_steps=2**31 - 1, seed=seed)
    generator = torch.Generator().manual_seed(seed)
    count = round(seconds / COMMAND_SECONDS)
    commands = (2.0 * torch.rand(count, robots, 2, generator=generator) - 1.0) * torch.tensor([2.0, 1.0])
    kept: list[tuple[Tensor, ...]] = []

    def keep(step: RideStep) -> None:
        td = step.observed
        seen = (td["observation"], td["privileged", "extrinsic"], *(td[name] for name in METHODS), step.up)
        kept.append(tuple(value.clone() for value in seen))

    policy, total = networks.deployed_policy(), round(seconds / CONTROL_DT)
    with deterministic(policy):
        ride(policy, env, commands, total, keep, command_steps=round(COMMAND_SECONDS / CONTROL_DT))
    env.close(raise_if_closed=False)
    observation, extrinsic, *reckoned, up = (torch.stack(values) for values in zip(*kept))
    return Rides(observation, extrinsic, dict(zip(METHODS, reckoned)), up)


def train_estimator(rides: Rides, method: str | None, robots: Tensor, updates: int, seed: int) -> NormalizedEstimator:
    """Train a CNN-GRU on the rides of some robots, (n,), to estimate x_ext; ``method`` None for the history alone."""
    torch.manual_seed(seed)
    size, states = rides.observation.shape[-1], rides.extrinsic.shape[-1]
    norms = [RunningNormalizer(size), RunningNormalizer(states)]
    sides = [RunningNormalizer(3)] if method else []
    net = get_estimator("cnn_gru")(history_shape=(HISTORY, size + 3 * len(sides)), out_features=states)
    steps, chosen = rides.up[:, robots].nonzero().unbind(-1)
    chosen = robots[chosen]
    values = [rides.observation, rides.extrinsic, *([rides.reckoned[method]] if method else [])]
    for norm, value in zip([*norms, *sides], values):
        norm.update(value[steps, chosen])
    estimator = NormalizedEstimator(net, norms[0], norms[1], sides)
    optimizer = torch.optim.Adam(net.parameters(), 1e-3)
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimizer, 2e-3, updates)
    scale = rides.extrinsic[steps, chosen].std(0).clamp_min(1e-3)
    for _ in range(updates):
        rows = torch.randint(len(steps), (BATCH,))
        error = estimate(estimator, rides, method, steps[rows], chosen[rows])
        loss = ((error - rides.extrinsic[steps[rows], chosen[rows]]) / scale).square().mean()
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        schedule.step()
    return estimator.eval()


def estimate(estimator: NormalizedEstimator, rides: Rides, method: str | None, steps: Tensor, robots: Tensor) -> Tensor:
    """Compute x̂_ext at some steps of some robots, (n, E)."""
    side = [rides.reckoned[method][steps, robots]] if method else []
    return estimator(rides.history(steps, robots), *side)


@torch.no_grad()
def errors(
    estimator: NormalizedEstimator, rides: Rides, method: str | None, robots: Tensor, stride: int = 10
) -> dict[str, float]:
    """Compute the mean |v̂_P,x - v_P,x| in each of :data:`WINDOWS`, m/s, over robots that are up."""
    figures = {}
    for name, (begin, end) in WINDOWS.items():
        steps = torch.arange(round(begin / CONTROL_DT), round(end / CONTROL_DT), stride)
        when, who = rides.up[steps][:, robots].nonzero().unbind(-1)
        when, who = steps[when], robots[who]
        estimated = torch.cat(
            [estimate(estimator, rides, method, *rows) for rows in zip(when.split(4096), who.split(4096))]
        )
        figures[name] = (estimated - rides.extrinsic[when, who])[:, SPEED].abs().mean().item()
    return figures


def measure(arguments: argparse.Namespace) -> dict[str, Any]:
    """Measure every sensor set and method; return a row for each, with the share of robots that stayed up."""
    started, rows = time.perf_counter(), []
    for sensors in SENSORS.names():
        rides = record(arguments.run, sensors, arguments.robots, WINDOWS["last"][1], arguments.seed)
        half = arguments.robots // 2
        learned, held = torch.arange(half), torch.arange(half, arguments.robots)
        for method in (None, *METHODS):
            estimator = train_estimator(rides, method, learned, arguments.updates, arguments.seed)
            row = {"sensors": sensors, "reads": method or "history alone", **errors(estimator, rides, method, held)}
            rows.append({**row, "up": rides.up[-1].float().mean().item()})
            say(str(rows[-1]))
    command = f"python -m benchmarks.dead_reckoning {arguments.run} --robots {arguments.robots} "
    command += f"--updates {arguments.updates} --seed {arguments.seed}"
    return {"command": command, "wall_seconds": time.perf_counter() - started, **machine(), "rows": rows}


def page(report: dict[str, Any]) -> str:
    """Return the report as Markdown."""
    lines = [
        "# What the extrinsic estimator reads, and what it knows of the transporter's speed",
        "",
        f"{results.origin(report)} Commands within ±2 m/s and ±1 rad/s change every 5 s, pushes come every 3 s. Mean "
        "absolute error of v_P,x over robots that are up and that the estimator was not trained on; one seed.",
        "",
        "| sensors | the estimator reads | error in the first 10 s, m/s | in the last 10 s of 60, m/s |",
        "| --- | --- | --- | --- |",
    ]
    for row in report["rows"]:
        lines.append(f"| {row['sensors']} | {row['reads']} | {row['first']:.3f} | {row['last']:.3f} |")
    shares = {row["sensors"]: row["up"] for row in report["rows"]}
    lines += [
        "",
        "Up after a minute: " + ", ".join(f"{share:.0%} ({name})" for name, share in shares.items()) + ".",
        "",
    ]
    return "\n".join(lines)


def main(argv: Sequence[str] | None = None) -> int:
    """Measure, and write ``dead_reckoning.json`` and ``README.md``."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.dead_reckoning", description=__doc__)
    parser.add_argument("run", type=Path, metavar="RUN", help="run of the policy")
    parser.add_argument("--output", type=Path, default=Path("results/dead_reckoning"), metavar="FOLDER")
    parser.add_argument("--robots", type=int, default=200, help="half of them for training")
    parser.add_argument("--updates", type=int, default=1500, help="minibatches of each estimator")
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args(argv)
    return results.exit_code("dead_reckoning", partial(_write, arguments))


def _write(arguments: argparse.Namespace) -> None:
    report = measure(arguments)
    results.write(arguments.output, "dead_reckoning", report, page(report))
    say(page(report))


if __name__ == "__main__":
    sys.exit(main())
