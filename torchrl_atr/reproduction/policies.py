"""Policies of a reproduction: runs, bundles or installed policies, by the pair that they ride."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from tensordict.nn import TensorDictModuleBase

from torchrl_atr._errors import InputError
from torchrl_atr._text import split_label
from torchrl_atr.deploy.manifest import find_policy, policies, read_manifest
from torchrl_atr.evaluation.ride import MakeEnv
from torchrl_atr.modules import ROANetworks, fingerprint
from torchrl_atr.reproduction.paper import PAIRS, did_you_mean
from torchrl_atr.training import DEPLOYMENT_OVERRIDES, TrainConfig, load_run, make_env


@dataclass(frozen=True)
class RiderPolicy:
    """Deployed policy of a run or bundle.

    Attributes:
        name: ``ROBOT-TRANSPORTER``, or ``ROBOT-TASK`` of another task than riding; of files their names alone.
        folder: of the run or bundle.
        config: settings of the run.
        networks: in eval mode.
        provenance: of the run.
        fingerprint: hash of the weights and the command range.
    """

    name: str
    folder: Path
    config: TrainConfig
    networks: ROANetworks
    provenance: dict[str, Any]
    fingerprint: str

    @property
    def rides(self) -> bool:
        """True if its task is riding."""
        return self.config.task.name == "riding"

    @property
    def policy(self) -> TensorDictModuleBase:
        """Policy that reads what a robot senses, its commands clipped to its range, if it has one."""
        return self.networks.deployed_policy()

    def envs(self, **overrides: Any) -> MakeEnv:
        """Return a factory of envs: rides from rest without pushes that only a fall ends.

        Args:
            **overrides: of :func:`torchrl_atr.training.make_env`, such as ``sensors`` and ``randomization``.
        """
        return partial(make_env, self.config, **{**DEPLOYMENT_OVERRIDES, **overrides})

    def described(self) -> dict[str, Any]:
        """Return what identifies the policy in a report."""
        limits = self.networks.command_range
        return {
            "folder": self.folder.as_posix(),
            "fingerprint": self.fingerprint,
            "frames": self.provenance.get("frames"),
            "command": self.provenance.get("command"),
            "sensors": self.config.task.sensors,
            "command_range": None if limits is None else vars(limits),
        }


def load_rider(folder: str | Path, imports: Sequence[str] = ()) -> RiderPolicy:
    """Load the deployed policy of a run, a bundle or an installed policy.

    Raises:
        CheckpointError, BundleError: see :func:`torchrl_atr.training.load_run`.
    """
    folder = find_policy(folder)
    config, env, networks, state = load_run(folder, imports=imports, num_envs=1)
    env.close()
    task = config.task
    second = task.transporter if task.name == "riding" else task.name
    name = "-".join(Path(part).stem for part in (task.robot, second))  # each may be a file
    return RiderPolicy(name, folder, config, networks, dict(state["provenance"]), fingerprint(networks))


def load_policies(given: Iterable[str], imports: Sequence[str] = (), option: str = "--policies") -> list[RiderPolicy]:
    """Load policies from texts ``RUN`` or ``PAIR=RUN``.

    Args:
        given: runs, bundles or names of installed policies; a pair is checked against the run's own.
        imports: modules to import besides those that the runs remember.
        option: of the command line, for messages.

    Raises:
        InputError: for a pair that the run is not of, and two policies of one pair.
    """
    found: dict[str, RiderPolicy] = {}
    for text in given:
        pair, folder = split_label(text, policies())
        policy = load_rider(folder, imports)
        if pair and pair != policy.name:
            known = "" if pair in PAIRS else f" ({did_you_mean(pair)})"
            raise InputError(f"{option} {text}: the run is of {policy.name}, not of {pair}{known}; leave the name out")
        if policy.name in found:
            raise InputError(
                f"{option} {text}: {found[policy.name].folder} is of {policy.name}, too; give one policy for each pair"
            )
        found[policy.name] = policy
    return _in_order(found.values())


def _in_order(found: Iterable[RiderPolicy]) -> list[RiderPolicy]:
    """Return policies in the order of the paper's pairs, others by name behind them."""
    order = {name: number for number, name in enumerate(PAIRS)}
    return sorted(found, key=lambda each: (order.get(each.name, len(order)), each.name))


def installed_policies(imports: Sequence[str] = (), task: str = "riding") -> list[RiderPolicy]:
    """Load the installed policies of a task, the first of each pair."""
    found: dict[str, RiderPolicy] = {}
    for name in policies():
        if read_manifest(name)["task"] == task:
            policy = load_rider(name, imports)
            found.setdefault(policy.name, policy)
    return _in_order(found.values())
