"""Training of every robot on every transporter for some minutes, and comparison with the zero action.

``python -m benchmarks.every_pair`` trains pairs without a ``comparison.json`` and continues from checkpoints: it can be
stopped and started again, and ``--pairs`` splits the work. The figure and the table are of all pairs that have been
compared.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

import torch
from tensordict.nn import TensorDictModule, TensorDictModuleBase
from torch import Tensor
from torchrl.envs import EnvBase
from torchrl.envs.utils import ExplorationType, set_exploration_type, step_mdp

from benchmarks.results import exit_code, refuse_other_settings
from torchrl_atr._files import atomic, write_json
from torchrl_atr.envs import ROBOTS
from torchrl_atr.envs.models import TRANSPORTER_DESIGNS
from torchrl_atr.envs.physics import CONTROL_DT
from torchrl_atr.evaluation.access import command_owner
from torchrl_atr.evaluation.tracking import MakeEnv
from torchrl_atr.training import (
    DEPLOYMENT_OVERRIDES,
    TrainConfig,
    Trainer,
    load_checkpoint,
    load_run,
    make_config,
    make_env,
)
from torchrl_atr.training.checkpoint import NAME as CHECKPOINT
from torchrl_atr.training.provenance import cores

PAIRS = tuple(f"{robot}:{transporter}" for robot in ROBOTS.names() for transporter in TRANSPORTER_DESIGNS)
COMPARISON = "comparison.json"
ROBOTS_COMPARED, SECONDS = 256, 10.0


def zero_action(joints: int) -> TensorDictModule:
    """Return the policy that holds q0: it writes (N, ``joints``) zeros."""
    return TensorDictModule(lambda o: o.new_zeros(*o.shape[:-1], joints), ["observation"], ["action"])


@torch.no_grad()
def first_episodes(policy: TensorDictModuleBase, env: EnvBase, commands: Tensor, steps: int) -> dict[str, float]:
    """Ride pinned commands from a reset; a robot that falls stays down, and its return ends there.

    Args:
        policy: gets its own ``in_keys`` and nothing else.
        env: of N robots, without a time limit.
        commands: m/s and rad/s, (N, 2).
        steps: control steps.

    Returns:
        ``mean_return`` of the robots' first episodes, and ``survival``, the share still up at the end.
    """
    command_owner(env).pin(commands)
    policy.eval()
    up, returns = torch.ones(len(commands), dtype=torch.bool), torch.zeros(len(commands))
    with set_exploration_type(ExplorationType.DETERMINISTIC):
        td = env.reset()
        for _ in range(steps):
            td.update(policy(td.select(*policy.in_keys)))
            td["action"] = td["action"].where(up.unsqueeze(-1), torch.zeros(()))
            td = env.step(td)
            returns += td["next", "reward"].squeeze(-1) * up
            up &= ~td["next", "terminated"].squeeze(-1)
            td = step_mdp(td)
    return {"mean_return": float(returns.mean()), "survival": float(up.float().mean())}


def compare(
    policy: TensorDictModuleBase,
    make_env: MakeEnv,
    box: tuple[float, float],
    robots: int,
    seconds: float,
    seed: int,
) -> dict[str, dict[str, float]]:
    """Compare a policy with the zero action on the same robots, intrinsic parameters, initial states and commands.

    Args:
        policy: to compare.
        make_env: called as ``make_env(num_envs=n, seed=s)``, once for each of the two.
        box: half widths of the box from which commands are drawn uniformly, m/s and rad/s.
        robots: N.
        seconds: length of the ride.
        seed: of robots and commands.

    Returns:
        :func:`first_episodes` of ``deployed`` and ``zero_action``.
    """
    uniforms = torch.rand(robots, 2, generator=torch.Generator().manual_seed(seed))
    commands, steps = (2.0 * uniforms - 1.0) * torch.tensor(box), round(seconds / CONTROL_DT)
    figures = {}
    for name in ("deployed", "zero_action"):
        env = make_env(num_envs=robots, seed=seed)
        rider = policy if name == "deployed" else zero_action(env.action_spec.shape[-1])
        figures[name] = first_episodes(rider, env, commands, steps)
        env.close(raise_if_closed=False)
    return figures


def train(config: TrainConfig, folder: Path) -> None:
    """Train until the minutes are used up, from the checkpoint if there is one.

    Raises:
        KeyboardInterrupt: if training was stopped.
    """
    state = load_checkpoint(folder) if (folder / CHECKPOINT).is_file() else None
    trainer = Trainer(config, folder, state)
    if not trainer.finished:
        trainer.train()
    if not trainer.finished:
        raise KeyboardInterrupt


def compare_run(folder: Path) -> dict[str, Any]:
    """Return the contents of a trained pair's ``comparison.json``: figures and their provenance."""
    config, env, networks, state = load_run(folder, num_envs=1)
    env.close()
    policy, seed = networks.deployed_policy(), config.seed + 1  # other robots than at the start of training
    box = (config.curriculum.initial_speed, config.curriculum.initial_yaw_rate)
    return {
        "command": f"python -m benchmarks.every_pair --minutes {config.max_minutes:g} --seed {config.seed} "
        f"--pairs {config.task.robot}:{config.task.transporter}",
        "run": state["provenance"],
        "comparison": {"robots": ROBOTS_COMPARED, "seconds": SECONDS, "seed": seed, "command_box": box},
        "policy_reads": sorted(policy.in_keys),
        **compare(policy, partial(make_env, config, **DEPLOYMENT_OVERRIDES), box, ROBOTS_COMPARED, SECONDS, seed),
    }


def summarise(output: Path) -> None:
    """Write ``learning_curves.png`` and ``README.md`` of all pairs that have been compared.

    Args:
        output: folder with the pairs' folders.
    """
    from torchrl_atr.evaluation import run_figures  # imports matplotlib

    folders = {pair: output / pair.replace(":", "-") for pair in PAIRS}
    done = {pair: folder for pair, folder in folders.items() if (folder / COMPARISON).is_file()}
    curves: dict[str, dict[str, Path]] = {}
    for pair, folder in done.items():
        robot, transporter = pair.split(":")
        curves.setdefault(robot, {})[transporter] = folder / "progress.csv"
    run_figures.plot_runs(curves, output / "learning_curves.png")
    records = {pair: json.loads((folder / COMPARISON).read_text(encoding="utf-8")) for pair, folder in done.items()}
    with atomic(output / "README.md") as file:
        file.write_text(table(records), encoding="utf-8")


def table(records: dict[str, dict[str, Any]]) -> str:
    """Return the comparisons as Markdown, with the command, the machine and the protocol.

    Args:
        records: ``comparison.json`` by pair.
    """
    first = next(iter(records.values()))
    setup, command = first["comparison"], first["command"].split(" --pairs")[0]
    speed, yaw_rate = setup["command_box"]
    machines = sorted({cores(record["run"]["hardware"]) for record in records.values()})
    beaten = sum(_beats(record) for record in records.values())
    lines = [
        "# Every robot on every transporter",
        "",
        f"`{command}` on {'; '.join(machines)}. {beaten} of {len(records)} policies beat the zero action on both "
        "figures.",
        "",
        f"{setup['robots']} robots, {setup['seconds']:g} s from rest without pushes, intrinsics of Table II's training "
        f"range, commands drawn uniformly from |c_v| <= {speed:g} m/s and |c_ω| <= {yaw_rate:g} rad/s. The policy is "
        "the deployed one: it reads proprioception only. The zero action has the same robots, initial states and "
        "commands. A return is the sum of an episode's rewards up to the fall, if there is one. Where "
        "nobody falls without acting either, a tie at 100% counts.",
        "",
        "| robot | transporter | minutes | robot steps | return | zero action's | still up | zero action's |",
        "| --- | --- | --- | --- | --- | --- | --- | --- |",
    ]
    for pair, record in records.items():
        run, ours, still = record["run"], record["deployed"], record["zero_action"]
        cells = [*pair.split(":"), f"{run['minutes']:.1f}", f"{run['frames']:,}"]
        cells += [f"{figures['mean_return']:.2f}" for figures in (ours, still)]
        cells += [f"{figures['survival']:.1%}" for figures in (ours, still)]
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join([*lines, "", "![learning curves](learning_curves.png)", ""])


def _beats(record: dict[str, Any]) -> bool:
    ours, still = record["deployed"], record["zero_action"]
    survives = ours["survival"] > still["survival"] or ours["survival"] == 1.0
    return ours["mean_return"] > still["mean_return"] and survives


def main(argv: Sequence[str] | None = None) -> int:
    """Train, compare and summarise; bad input ends with one message and exit code 2."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.every_pair", description=__doc__)
    parser.add_argument("--output", type=Path, default=Path("runs/pairs"), metavar="FOLDER")
    parser.add_argument("--minutes", type=float, default=10.0, help="of training for each pair")
    parser.add_argument("--pairs", nargs="+", choices=PAIRS, default=PAIRS, metavar="ROBOT:TRANSPORTER")
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args(argv)
    return exit_code("every_pair", partial(_compare_all, arguments))


def _compare_all(arguments: argparse.Namespace) -> None:
    configs = {}
    for pair in arguments.pairs:
        robot, transporter = pair.split(":")
        values = {"task.robot": robot, "task.transporter": transporter, "seed": arguments.seed}
        configs[arguments.output / f"{robot}-{transporter}"] = make_config({**values, "max_minutes": arguments.minutes})
    for folder, config in configs.items():
        refuse_other_settings(config, folder)
    for folder, config in configs.items():
        if not (folder / COMPARISON).is_file():
            train(config, folder)
            write_json(folder / COMPARISON, compare_run(folder))
    summarise(arguments.output)


if __name__ == "__main__":
    sys.exit(main())
