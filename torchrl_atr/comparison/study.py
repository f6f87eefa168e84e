"""Comparison of estimators in one policy: its parts, each made once and kept on disk, in the order they are needed."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import partial
from itertools import product
from pathlib import Path
from urllib.parse import quote

import torch
from tensordict import NestedKey
from tensordict.nn import TensorDictModuleBase
from torchrl.envs import EnvBase

from torchrl_atr._files import write_json
from torchrl_atr.comparison.fitting import (
    config_with,
    entries_read,
    fit,
    load_estimators,
    networks_with,
    save_estimators,
)
from torchrl_atr.comparison.options import SETTINGS, CompareOptions, ComparisonError, check_settings
from torchrl_atr.comparison.recording import Recording, Window, load_recording, record
from torchrl_atr.comparison.rides import ride
from torchrl_atr.comparison.scores import Scores, score
from torchrl_atr.evaluation import EnduranceResult, load_endurance, save_endurance
from torchrl_atr.modules import CommandClippedPolicy, ROANetworks, fingerprint
from torchrl_atr.modules.estimators import state_keys
from torchrl_atr.training import DEPLOYMENT_OVERRIDES, TrainConfig, make_env
from torchrl_atr.training.assembly import check_run_estimator

TRUTH, AS_TRAINED = "truth", "as trained"
"""References: the policy on privileged information, and on the estimators that it was trained with."""


@dataclass
class Outcome:
    """Outcome of one estimator, or a reference: one entry of each list for each training.

    Attributes:
        scores: on the recording; empty for the truth.
        rides: of the policy on its estimates.
        estimator: its registered name; None for a reference.
        history_length: H, of the histories that it read.
    """

    scores: list[Scores] = field(default_factory=list)
    rides: list[EnduranceResult] = field(default_factory=list)
    estimator: str | None = None
    history_length: int | None = None


class Study:
    """Comparison of estimators in the policy of a run; what a folder holds of it is not made again.

    Args:
        config, env, networks: of :func:`torchrl_atr.training.load_run`.
        folder: where the parts are kept.
        options: sizes and ranges.
        announce: called with a line after each part.
        tick: called often, while parts are made.

    Raises:
        ComparisonError: if the networks have no encoder or no extrinsic estimator, or the folder holds a comparison
            with other settings.
    """

    def __init__(
        self,
        config: TrainConfig,
        env: EnvBase,
        networks: ROANetworks,
        folder: Path,
        options: CompareOptions,
        announce: Callable[[str], object] = lambda line: None,
        tick: Callable[[], None] = lambda: None,
    ) -> None:
        for part, what in (("encoder", "latent"), ("extrinsic_estimator", "extrinsic state")):
            if getattr(networks, part, None) is None:
                raise ComparisonError(
                    f"this run has no {part.replace('_', ' ')}: its actor does not read the {what} that the estimators "
                    "are to infer; compare them in a run with roa.actor_reads=latent,extrinsic, such as the preset "
                    "default's"
                )
        self.config, self.env, self.networks = config, env, networks
        self.folder, self.options = folder, options
        self._envs = {config.env.history_length: env}
        self._announce, self._tick = announce, tick
        # more seeds are added to what is there
        asked = {**dataclasses.asdict(options), "policy": fingerprint(networks)}
        self._settings = {name: value for name, value in asked.items() if name != "seeds"}
        check_settings(folder, self._settings)

    def run(
        self, estimators: Sequence[str], sensors: str, history_lengths: Sequence[int] = ()
    ) -> tuple[Recording, dict[str, Outcome]]:
        """Make what is missing for some estimators and a set of sensors, and return it all by name, references first.

        Args:
            estimators: registered names.
            sensors: of the recording and the rides.
            history_lengths: further lengths of the history, control steps, to train those of a window on; such an
                outcome is named ``"cnn_gru, 20 steps"``. Estimators with a hidden state have no window.

        Raises:
            UnknownNameError: for an unregistered estimator. EstimatorError: for one that cannot be trained, or that the
            actor cannot read. ComparisonError: for one that reads what was not recorded, and for a policy that reads
            the history itself.
        """
        further = self._further(history_lengths)
        chosen = {name: self._config_with(name) for name in dict.fromkeys(estimators)}
        fresh = {name: self._fresh(config) for name, config in chosen.items()}
        for name, length in product([*fresh], further):
            if not any(map(state_keys, fresh[name].estimator_modules)):
                chosen[f"{name}, {length} steps"] = config = self._config_with(name, length)
                fresh[f"{name}, {length} steps"] = self._fresh(config)
        self._keep_settings()
        home = self.folder / quote(sensors, safe="")
        read = [key for each in fresh.values() for key in entries_read(each)]
        recording = self._recording(home / "data", sensors, read)
        for name, networks in fresh.items():
            recording.check_holds(entries_read(networks), name, home / "data")
        outcomes = {TRUTH: Outcome(), AS_TRAINED: Outcome()}
        references = home / "references"
        for seed in self._seeds:
            for name, policy in ((TRUTH, self._on_the_truth()), (AS_TRAINED, self.networks.deployed_policy())):
                part = references / name.replace(" ", "_")
                label = f"the policy, {name}"
                outcomes[name].rides.append(self._ride(part, label, seed, sensors, policy, self.config))
        part, seed = references / "as_trained", self.options.seed
        own = self._score(part, AS_TRAINED, seed, self.networks, recording, self.config)
        outcomes[AS_TRAINED].scores.append(own)
        for name, config in chosen.items():
            part = home / "estimators" / quote(name, safe="")
            outcomes[name] = self._estimator(part, name, config, recording, sensors)
        return recording, outcomes

    def check_sensors(self, sensors: str) -> None:
        """Check that there is an env with a set of sensors; what its absence raises names those that there are."""
        self._make_env(sensors, self.config)(num_envs=1, seed=0).close()

    def close(self) -> None:
        """Close the envs, the given one included."""
        for env in self._envs.values():
            env.close(raise_if_closed=False)

    def _further(self, lengths: Sequence[int]) -> list[int]:
        """Return the lengths that are not the run's own."""
        further = [length for length in dict.fromkeys(lengths) if length != self.config.env.history_length]
        if further and "history" in self.config.roa.actor_reads:
            raise ComparisonError(
                f"history_lengths={list(lengths)}: this run's actor reads the history itself, of "
                f"{self.config.env.history_length} steps; leave them out"
            )
        return further

    def _fresh(self, config: TrainConfig) -> ROANetworks:
        """Return the run's networks with new estimators, sized by an env with histories of their length."""
        return networks_with(config, self._env(config.env.history_length), self.networks)

    def _window(self, config: TrainConfig) -> Window | None:
        """Return the histories that estimators of ``config`` read; None if those are the recorded ones."""
        keys, length = self.networks.keys, config.env.history_length
        if length == self.config.env.history_length:
            return None
        return Window(length, config.task.interpretation.current_in_history, keys.observation, keys.history)

    def _env(self, history_length: int) -> EnvBase:
        if history_length not in self._envs:
            config = config_with(self.config, self.config.estimator.name, history_length)
            self._envs[history_length] = make_env(config, num_envs=1, **DEPLOYMENT_OVERRIDES)
        return self._envs[history_length]

    def _keep_settings(self) -> None:
        write_json(self.folder / SETTINGS, self._settings)

    def _on_the_truth(self) -> TensorDictModuleBase:
        networks, policy = self.networks, self.networks.rollout_policy("privileged")
        limits = networks.command_range
        return policy if limits is None else CommandClippedPolicy(policy, limits, networks.keys)

    @property
    def _seeds(self) -> range:
        return range(self.options.seed, self.options.seed + self.options.seeds)

    def _config_with(self, name: str, history_length: int | None = None) -> TrainConfig:
        if name in (TRUTH, AS_TRAINED):
            raise ComparisonError(f"{name!r} is a reference of the comparison; register the estimator by another name")
        config = config_with(self.config, name, history_length)
        check_run_estimator(config, self._env(config.env.history_length))  # type: ignore[arg-type]
        return config

    def _recording(self, folder: Path, sensors: str, further: list[NestedKey]) -> Recording:
        if not folder.exists():
            with self._timed(f"recorded {self.options.robots} robots, {self.options.seconds:g} s, {sensors} sensors"):
                margin = self.config.env.overspeed_margin or None
                make = partial(self._make_env(sensors, self.config), overspeed_margin=margin)
                record(self.networks, make, self.options, folder, further, self._tick)
        return load_recording(folder)

    def _make_env(self, sensors: str, config: TrainConfig) -> Callable[..., EnvBase]:
        own = sensors == self.config.task.sensors  # not every task has any
        chosen = {"randomization": self.options.randomization, "pushes": True, **({} if own else {"sensors": sensors})}
        return partial(make_env, config, **{**DEPLOYMENT_OVERRIDES, **chosen})

    def _estimator(self, part: Path, name: str, config: TrainConfig, recording: Recording, sensors: str) -> Outcome:
        outcome = Outcome(estimator=config.estimator.name, history_length=config.env.history_length)
        for seed in self._seeds:
            with torch.random.fork_rng(devices=[]):
                torch.manual_seed(seed)
                networks = self._fresh(config)
                weights = part / f"weights_{seed}.pt"
                if not weights.is_file():
                    with self._timed(f"{name}, seed {seed}: trained"):
                        fit(networks, config, recording, self.options, seed, self._tick, self._window(config))
                    save_estimators(networks, weights)
            load_estimators(networks, weights)
            label, policy = f"{name}, seed {seed}", networks.deployed_policy()
            outcome.scores.append(self._score(part, label, seed, networks, recording, config))
            outcome.rides.append(self._ride(part, label, seed, sensors, policy, config))
        return outcome

    def _score(
        self, part: Path, label: str, seed: int, networks: ROANetworks, recording: Recording, config: TrainConfig
    ) -> Scores:
        path = part / f"scores_{seed}.npz"
        if not path.is_file():
            with self._timed(f"{label}: measured on the recording"):
                score(networks, recording, self._window(config)).save(path)
        return Scores.load(path)

    def _ride(
        self, part: Path, label: str, seed: int, sensors: str, policy: TensorDictModuleBase, config: TrainConfig
    ) -> EnduranceResult:
        path, make = part / f"rides_{seed}.npz", self._make_env(sensors, config)
        if not path.is_file():
            with self._timed(f"{label}: rode for {self.options.seconds:g} s"):
                result = ride(policy, make, config, self.options, seed, self.networks.encoder_module, self._tick)
            path.parent.mkdir(parents=True, exist_ok=True)
            save_endurance(result, path)
        return load_endurance(path)

    @contextmanager
    def _timed(self, text: str) -> Iterator[None]:
        begin = time.monotonic()
        yield
        self._announce(f"{text} in {time.monotonic() - begin:.1f} s")
