"""Peak memory of training, in a separate process: ``python -m benchmarks.memory ROBOTS STEPS FOLDER``."""

from __future__ import annotations

import json
import resource
import subprocess
import sys
import tempfile
from pathlib import Path

from benchmarks.training import TrainingLoop
from torchrl_atr._interrupt import signals_held
from torchrl_atr.training import make_config

ROOT = Path(__file__).parents[1]


def peak_memory(num_envs: int, steps: int) -> dict[str, float]:
    """Measure the memory of training N robots, MB: ``imported`` after imports alone, ``peak`` after two iterations."""
    with tempfile.TemporaryDirectory() as scratch:
        command = [sys.executable, "-m", "benchmarks.memory", str(num_envs), str(steps), scratch]
        child = None
        try:
            with signals_held():  # a signal that was held is raised where this ends: the child is known by then
                child = subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, encoding="utf-8")
            output, _ = child.communicate()
        finally:
            if child is not None:
                child.kill()  # if this was interrupted
                child.wait()
    if child.returncode:
        raise subprocess.CalledProcessError(child.returncode, command)
    return {"num_envs": num_envs, **json.loads(output.splitlines()[-1])}


def _resident() -> float:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024  # kB on Linux


def _main(num_envs: int, steps: int, scratch: Path) -> None:
    imported = _resident()
    loop = TrainingLoop(make_config({"env.num_envs": num_envs, "ppo.rollout_steps": steps}), scratch)
    for _ in range(2):  # the second batch is collected while memory of the first is still held
        loop.iterate()
    loop.close()
    sys.stdout.write(json.dumps({"imported": round(imported, 1), "peak": round(_resident(), 1)}) + "\n")


if __name__ == "__main__":
    _main(int(sys.argv[1]), int(sys.argv[2]), Path(sys.argv[3]))
