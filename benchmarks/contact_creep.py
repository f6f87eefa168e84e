"""Creep of feet on the board, and cost of the contact models: ``python -m benchmarks.contact_creep``.

Each robot holds q0 on a board that is kept level (stiff, heavy hinges), since a robot without a policy would fall long
before its feet have crept measurably. The board stands still, accelerates steadily, or turns steadily; creep is the
displacement of a foot's centre in the board's frame, of the foot that moved most, over the time after settling.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import mujoco
import torch
from torch import Tensor

from benchmarks import results
from benchmarks.timing import Contender, Key, interleave, medians
from torchrl_atr._cpus import available_cpus
from torchrl_atr._files import say
from torchrl_atr.envs import ROBOTS
from torchrl_atr.envs.models import TRANSPORTER_DESIGNS, Scene, build_scene
from torchrl_atr.envs.models.contacts import CONTACTS, ContactModel
from torchrl_atr.envs.physics import CONTROL_DT, DECIMATION
from torchrl_atr.envs.physics.batch import BatchEngine
from torchrl_atr.envs.tasks import riding
from torchrl_atr.envs.tasks.riding.drive_law import DriveHook
from torchrl_atr.runs.provenance import machine

PYRAMIDAL, ELLIPTIC = mujoco.mjtCone.mjCONE_PYRAMIDAL, mujoco.mjtCone.mjCONE_ELLIPTIC
SOFT = ContactModel(PYRAMIDAL, impratio=1.0, noslip_iterations=0)
"""MuJoCo's defaults; costs are relative to this model."""
MODELS = (
    SOFT,
    *(ContactModel(PYRAMIDAL, impratio, noslip) for impratio, noslip in ((10, 0), (100, 0), (1, 3), (10, 3))),
    *(ContactModel(ELLIPTIC, impratio, noslip) for impratio, noslip in ((10, 0), (30, 0), (50, 0), (10, 2))),
    CONTACTS,
)
MOTIONS = ("standing", "accelerating", "turning")
LIMITS = {"standing": 0.05, "accelerating": 0.2, "turning": 0.2}
"""Largest acceptable creep, mm/s: 3 and 12 mm per minute."""
RAMP = 2.0
"""Time in which the motion becomes steady, s."""
TURN = (3.0, 1.0)
"""Speed and yaw rate of the steady turn, m/s and rad/s."""
SLOWER_TURN = {"spot": (2.0, 1.0)}
"""Turns of robots that would tip over in :data:`TURN` while holding q0, whatever their feet do."""
NOISE = {"riding": 0.02, "thrashing": 0.1}
"""Noise of the joint targets while physics is timed, rad: about that of a trained policy, and of an untrained one."""


@dataclass
class Prescribed:
    """Drive law with the motions of :data:`MOTIONS` for any tilt; accelerations are ramped up.

    Attributes:
        acceleration: of the second transporter, m/s².
        turn: speed and yaw rate of the third, m/s and rad/s.
        time: since the start, s.
    """

    acceleration: float
    turn: tuple[float, float]
    time: float = 0.0

    def __call__(self, speeds: Tensor, tilt: Tensor, scale: Tensor, dt: float) -> Tensor:
        """Compute the next speeds; see :class:`~torchrl_atr.envs.tasks.riding.drive_law.DriveLaw`."""
        self.time += dt
        share = min(self.time / RAMP, 1.0)
        moved = speeds.clone()
        moved[1, 0] += share * self.acceleration * dt
        moved[2] = share * torch.tensor(self.turn, dtype=speeds.dtype)
        return moved


def level_scene(robot: str, transporter: str, contacts: ContactModel) -> Scene:
    """Return a scene with the given contacts, whose board stays within 0.01 rad of level."""
    task = riding(robot, transporter)
    scene = build_scene(task.robot, task.support)
    model, support = scene.model, scene.support_layout
    model.dof_armature[support.tilt_dof] = 10.0  # kg m²
    model.jnt_stiffness[support.tilt_joints] = 1e4  # N m/rad
    model.dof_damping[support.tilt_dof] = 632.0  # N m s/rad: critical
    contacts.write(model.opt)
    return scene


def creep(
    robot: str,
    transporter: str,
    contacts: ContactModel = CONTACTS,
    *,
    acceleration: float = 3.0,
    seconds: float = 60.0,
    settle: float = 10.0,
) -> dict[str, float | None]:
    """Measure the creep of the feet, mm/s, by motion; None where the robot fell.

    Args:
        robot: name of the robot.
        transporter: name of the transporter.
        contacts: contact model.
        acceleration: of the accelerating transporter, m/s²; the turning one moves at :data:`TURN`.
        seconds: length of a trial.
        settle: seconds at its start that do not count.
    """
    scene = level_scene(robot, transporter, contacts)
    engine = BatchEngine(scene, len(MOTIONS), DriveHook, num_threads=1)
    engine.hook.law = Prescribed(acceleration, SLOWER_TURN.get(robot, TURN))  # type: ignore[attr-defined]
    targets = torch.tensor(scene.robot.q0, dtype=torch.float64).expand(len(MOTIONS), -1)

    def hold(time: float) -> Tensor:
        for _ in range(round(time / CONTROL_DT)):
            engine.step(targets)
        return _feet(engine)

    before = hold(settle)
    moved = (hold(seconds - settle) - before).norm(dim=-1).amax(-1)
    height = engine.qpos[:, scene.layout.root_qpos + 2] - scene.support.height
    up = (height > scene.robot.min_height) & ~engine.diverged
    speeds = (1e3 * moved / (seconds - settle)).tolist()
    return {motion: speed if stands else None for motion, speed, stands in zip(MOTIONS, speeds, up.tolist())}


def _feet(engine: BatchEngine) -> Tensor:
    """Return the position of each foot's first geom in the yawing frame of the board, m, (3, 4, 2)."""
    layout, support = engine.scene.layout, engine.scene.support_layout
    engine.forward()
    places = engine.sensordata[:, layout.sensors["foot_position"]].unflatten(-1, (-1, 3))
    firsts = torch.tensor(layout.foot_sizes).cumsum(0) - torch.tensor(layout.foot_sizes)
    x, y, yaw = engine.qpos[:, support.planar_qpos].T[:, :, None]
    dx, dy = places[:, firsts, 0] - x, places[:, firsts, 1] - y
    return torch.stack([dx * yaw.cos() + dy * yaw.sin(), dy * yaw.cos() - dx * yaw.sin()], -1)


def costs(models: Sequence[ContactModel], noise: float, robots: int, rounds: int, seconds: float = 0.2) -> list[float]:
    """Measure the time of a substep, ms, of A1s with noisy joint targets on the single board, by model, in turns.

    Args:
        models: contact models.
        noise: standard deviation of the joint targets about q0 in every control step, rad.
        robots: number of robots.
        rounds: samples of each model, of which the median counts.
        seconds: least time of a sample.
    """
    threads = available_cpus()
    contenders = []
    for number, model in enumerate(models):
        scene = level_scene("a1", "single_board", model)
        engine = BatchEngine(scene, robots, DriveHook, threads)
        step = partial(_fidget, engine, noise, torch.Generator().manual_seed(0))
        contenders.append(Contender(Key(str(number), robots, threads), step))
    found = medians(interleave(contenders, rounds, seconds, say))
    return [1e3 / found[contender.key] for contender in contenders]


def _fidget(engine: BatchEngine, noise: float, generator: torch.Generator) -> int:
    """Make one control step with targets about q0, and return the number of substeps."""
    q0 = torch.tensor(engine.scene.robot.q0, dtype=torch.float64)
    engine.step(q0 + noise * torch.randn(engine.num_envs, len(q0), dtype=torch.float64, generator=generator))
    return DECIMATION


def _name(contacts: dict[str, Any]) -> str:
    noslip = contacts["noslip_iterations"]
    return f"{contacts['cone']}, impratio {contacts['impratio']:g}" + (f", {noslip} no-slip" if noslip else "")


def describe(contacts: ContactModel) -> dict[str, Any]:
    """Return a contact model as plain values."""
    return {
        "cone": "elliptic" if contacts.cone == ELLIPTIC else "pyramidal",
        "impratio": float(contacts.impratio),
        "noslip_iterations": contacts.noslip_iterations,
    }


def table(report: dict[str, Any]) -> str:
    """Return the report as Markdown."""
    pairs = list(dict.fromkeys((row["robot"], row["transporter"]) for row in report["creep"]))
    found = {
        (_name(row["contacts"]), row["robot"], row["transporter"]): row["mm_per_second"] for row in report["creep"]
    }
    lines = [
        "# Feet that creep, by contact model",
        "",
        results.origin(report),
        "",
        f"Each robot holds q0 for {report['seconds']:g} s on a level board (stiff hinges) that stands still, "
        f"accelerates at {report['acceleration']:g} m/s² or turns at {TURN[0]:g} m/s and {TURN[1]:g} rad/s"
        + "".join(
            f" ({name}: {v:g} m/s and {w:g} rad/s, since it would tip over)" for name, (v, w) in SLOWER_TURN.items()
        )
        + f". Creep of the foot that moves most in the board's frame after {report['settle']:g} s, mm/s. Friction 1, "
        "no randomness. Small enough: "
        + ", ".join(f"{name} {limit:g}" for name, limit in LIMITS.items())
        + f". Cost: time of a substep of {report['robots']} A1s on the single board, models taking turns, "
        f"median of {report['rounds']} samples (seed 0), whose joint targets fidget by "
        + " and ".join(f"{noise:g} rad ({name})" for name, noise in NOISE.items())
        + ". The last model is every scene's.",
        "",
        "| contact model | "
        + " | ".join(f"{name}, worst pair" for name in MOTIONS)
        + " | "
        + " | ".join(f"ms a substep, {name}" for name in NOISE)
        + " |",
        "| --- |" + " --- |" * (len(MOTIONS) + len(NOISE)),
    ]
    least = report["cost"][0]
    for row in report["cost"]:
        name, cost = _name(row["contacts"]), row["ms_per_substep"]
        worst = [_worst([found[name, *pair][motion] for pair in pairs]) for motion in MOTIONS]
        times = [f"{ms:.2f} ({ms / least['ms_per_substep'][kind]:.2f})" for kind, ms in cost.items()]
        lines.append(f"| {name} | {' | '.join(map(_figure, worst))} | {' | '.join(times)} |")
    lines += ["", "Standing / accelerating / turning of each pair:", ""]
    lines += [
        "| contact model | " + " | ".join(" on ".join(pair) for pair in pairs) + " |",
        "| --- |" + " --- |" * len(pairs),
    ]
    for row in report["cost"]:
        name = _name(row["contacts"])
        cells = (" / ".join(_figure(found[name, *pair][motion]) for motion in MOTIONS) for pair in pairs)
        lines.append(f"| {name} | {' | '.join(cells)} |")
    return "\n".join([*lines, ""])


def _worst(speeds: Sequence[float | None]) -> float | None:
    return None if None in speeds else max(speed for speed in speeds if speed is not None)


def _figure(speed: float | None) -> str:
    return "fell" if speed is None else f"{speed:.3f}" if speed < 10 else f"{speed:.0f}"


def main(argv: Sequence[str] | None = None) -> int:
    """Measure all models on all pairs and write ``contact_creep.json`` and ``README.md``."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.contact_creep", description=__doc__)
    parser.add_argument("--output", type=Path, default=Path("results/contact_creep"), metavar="FOLDER")
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--settle", type=float, default=10.0)
    parser.add_argument("--acceleration", type=float, default=3.0)
    parser.add_argument("--robots", type=int, default=512)
    parser.add_argument("--rounds", type=int, default=7)
    arguments = parser.parse_args(argv)
    trial = {name: getattr(arguments, name) for name in ("acceleration", "seconds", "settle")}
    setup = {**trial, "robots": arguments.robots, "rounds": arguments.rounds}
    started, rows = time.monotonic(), []
    for robot in ROBOTS.names():
        for transporter in TRANSPORTER_DESIGNS:
            for contacts in MODELS:
                found = creep(robot, transporter, contacts, **trial)
                model = describe(contacts)
                rows.append({"robot": robot, "transporter": transporter, "contacts": model, "mm_per_second": found})
                say(f"{robot}, {transporter}, {_name(model)}: {', '.join(map(_figure, found.values()))}")
    cost = {name: costs(MODELS, noise, arguments.robots, arguments.rounds) for name, noise in NOISE.items()}
    report = {
        "command": "python -m benchmarks.contact_creep"
        + "".join(f" --{name} {value:g}" for name, value in setup.items()),
        **setup,
        "wall_seconds": round(time.monotonic() - started, 1),
        "creep": rows,
        "cost": [
            {"contacts": describe(model), "ms_per_substep": {name: ms[i] for name, ms in cost.items()}}
            for i, model in enumerate(MODELS)
        ],
        **machine(),
    }
    results.write(arguments.output, "contact_creep", report, table(report))
    return 0


if __name__ == "__main__":
    sys.exit(main())
