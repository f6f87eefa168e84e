"""Files of the benchmark, ``bench.json`` and ``bench.md``, with the machine, the versions, the date and the command."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from benchmarks.summary import TRAINED, shares
from torchrl_atr._files import whole, write_json

LABELS = {
    "bare": "`RidingEnv`, zero action",
    "bare_eager": "`RidingEnv`, not compiled",
    "free_eager": "`Collector`, zero action, not compiled",
    "transformed": "`make_riding_env`, zero action",
    "free": "`Collector`, zero action",
    "deployed": "`Collector`, deployed policy",
    "training_policy": "`Collector`, training policy",
    "dm_control": "`ParallelEnv(DMControlWrapper(suite.load(...)))`: the same task",
    "torchrl_ant": '`MujocoEnv(backend="mujoco")`: TorchRL\'s ant',
    "gymnasium_ant": "`AsyncVectorEnv`: Gymnasium's `Ant-v5`",
    "mjbatch": "`mjbatch`: our scene",
}


def write(results: dict[str, Any], folder: Path) -> None:
    """Write both files, or neither."""
    with whole(folder) as temporary:
        write_json(temporary / "bench.json", results)
        (temporary / "bench.md").write_text(markdown(results), encoding="utf-8")


def markdown(results: dict[str, Any]) -> str:
    """Return the report as Markdown."""
    parts = [_head, _ladder, _training, _peers, _scaling, _memory, _profile]
    return "\n\n".join(part(results) for part in parts) + "\n"


def table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Return a Markdown table.

    Example:
        >>> print(table(["N", "steps/s"], [["64", "9,000"]]))
        | N | steps/s |
        | --- | --- |
        | 64 | 9,000 |
    """
    return "\n".join(f"| {' | '.join(cells)} |" for cells in (header, ["---"] * len(header), *rows))


def _head(results: dict[str, Any]) -> str:
    machine, plan = results["machine"], results["plan"]
    versions = ", ".join(f"{name} {version}" for name, version in results["versions"].items())
    before, after = machine["load_before"], machine["load_after"]
    return (
        f"# Benchmark\n\n`{results['command']}`, {results['date']}: {machine['processor']}, CPUs for this process: "
        f"{machine['cpus']}, torch threads: {machine['torch_threads']}; load average {before:.1f} before, "
        f"{after:.1f} after. {versions}.\n\n"
        f"Rates are medians of {plan['rounds']} rounds in which all contenders took turns, {plan['seconds']:g} s or "
        "more each, after a step that is not timed; ratios are of medians. A step is a robot's control step, 0.02 s. "
        "Networks are untrained where it does not say that they ride."
        + " Our envs are compiled (`compiled=True`) where it does not say otherwise; memory is without."
        * plan["compiled"]
    )


def _ladder(results: dict[str, Any]) -> str:
    size, threads = results["plan"]["num_envs"], results["plan"]["cpus"]
    rates = {(r["name"], r["num_envs"], r["threads"]): r["median"] for r in results["rates"]}
    rows = [["physics limit: `mujoco.batch`, standing", _number(rates["physics", size, threads]), "1"]]
    for name, share in results["ladder"].items():
        rows.append([LABELS[name], _number(rates[name, size, threads]), _ratio(share)])
    return f"## Layers, N = {size}, threads: {threads}\n\n" + table(["", "steps/s", "of the physics limit"], rows)


def _training(results: dict[str, Any]) -> str:
    compute, rows = results["compute"], []
    for row in results["training"]:
        cells = [_number(row[name]) for name in ("physics", "compute", "bound")]
        for kind in TRAINED:
            cells += [_number(row[f"{kind}frames_per_second"]), _ratio(row[f"{kind}efficiency"])]
        rows.append([f"{row['num_envs']}", *cells])
    measured = ["frames/s, untrained", "efficiency", "frames/s, riding", "efficiency"]
    return (
        "## Training\n\n"
        f"{compute['flops_per_frame'] / 1e6:.2f} MFLOP per frame (rollout policy and learner) at "
        f"{compute['flops_per_second'] / 1e9:.1f} GFLOP/s (`torch.mm` in the shapes of actor and critic, forward and "
        f"backward, {compute['rows']} rows) is the compute limit; the bound is 1/(1/physics + 1/compute). "
        "Untrained robots fall within seconds; those that ride begin with the networks of results/a1-single_board and "
        "fall as seldom as in most of a run.\n\n"
    ) + table(["N", "physics limit", "compute limit", "bound", *measured], rows)


def _peers(results: dict[str, Any]) -> str:
    rows = [
        [LABELS[name], _number(peer["steps_per_second"]), f"{peer['ours_over_it']:.1f} ×"]
        for name, peer in results["peers"].items()
    ]
    rows += [[LABELS[name], "skipped", reason] for name, reason in results["skipped"].items()]
    header = ["", "steps/s", f"{LABELS['free']}, N = {results['plan']['num_envs']}, makes"]
    return f"## Peers, processes: {results['plan']['cpus']}\n\n" + table(header, rows)


def _scaling(results: dict[str, Any]) -> str:
    rows = []
    for row in results["scaling"]:
        rates = (row[name] for name in ("physics", "bare", "free"))
        ratios = (row[f"{name}_of_physics"] for name in ("bare", "free"))
        rows.append([f"{row['num_envs']}", f"{row['threads']}", *map(_number, rates), *map(_ratio, ratios)])
    header = ["N", "threads", "physics limit, steps/s", LABELS["bare"], LABELS["free"], "env/physics", "free/physics"]
    return "## Robots and threads\n\n" + table(header, rows)


def _memory(results: dict[str, Any]) -> str:
    rows = [[f"{r['num_envs']}", f"{r['imported']:,.0f}", f"{r['peak']:,.0f}"] for r in results["memory"]]
    return "## Memory of training, MB\n\n" + table(["N", "imports alone", "peak"], rows)


def _profile(results: dict[str, Any]) -> str:
    profile = results["profile"]
    seconds = [phase["seconds"] for phase in profile["phases"]]
    rows = [
        [phase["stage"], phase["name"], f"{1000 * phase['seconds']:.1f}", f"{share:.1%}"]
        for phase, share in zip(profile["phases"], shares(seconds))
    ]
    rows.append(["", "all", f"{1000 * sum(seconds):.1f}", "100%"])
    title = f"## Where a training iteration goes, N = {profile['num_envs']}, riding"
    return f"{title}\n\n" + table(["", "", "ms", "share"], rows)


def _number(value: float) -> str:
    return f"{value:,.0f}"


def _ratio(value: float) -> str:
    return f"{value:.2f}"
