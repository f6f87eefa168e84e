"""Film policies side by side: ``python scripts/film_policies.py OUTPUT.gif [NAME ...]``; by default all that ride."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))  # the policies of this clone, whatever is installed

from torchrl_atr._errors import UserError
from torchrl_atr.deploy.manifest import policies, read_manifest
from torchrl_atr.evaluation.mosaic import record_mosaic
from torchrl_atr.training import DEPLOYMENT_OVERRIDES, load_run


def main(arguments: list[str] | None = None) -> int:
    """Film the policies that the command line names; return 2 if that fails."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("output", type=Path, metavar="OUTPUT", help=".gif or .mp4")
    parser.add_argument("names", nargs="*", metavar="NAME", help="runs, or names of installed policies")
    given = parser.parse_args(arguments)
    riders = {}
    try:
        for name in given.names or [name for name in policies() if read_manifest(name)["task"] == "riding"]:
            config, env, networks, _ = load_run(name, num_envs=1, **DEPLOYMENT_OVERRIDES)
            riders[f"{config.task.robot} {config.task.transporter}"] = networks.deployed_policy(), env
        record_mosaic(riders, given.output)
    except (UserError, OSError) as error:
        print(f"film_policies: {error}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
