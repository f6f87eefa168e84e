"""The recipe: env -> collector -> learner -> log -> checkpoint, until frames or minutes run out."""

from __future__ import annotations

import shutil
import time
from collections.abc import Callable, Collection
from functools import cached_property, partial
from pathlib import Path
from typing import Any

import torch

from torchrl_atr._files import say, sweep, write_json
from torchrl_atr._interrupt import Interrupt
from torchrl_atr.envs.models.identity import PARTS, describe, digest
from torchrl_atr.modules import RidingNetworks, get_estimator
from torchrl_atr.training.assembly import check_run_estimator, make_run_networks
from torchrl_atr.training.checkpoint import BEST, NAME, PREVIOUS, load_checkpoint, save_checkpoint
from torchrl_atr.training.collection import CollectionError
from torchrl_atr.training.config import TrainConfig
from torchrl_atr.training.config_checks import ConfigError
from torchrl_atr.training.learner import Learner
from torchrl_atr.training.member import DUMPS, Member, assist, env_maker, make_member, torch_threads
from torchrl_atr.training.progress import Progress
from torchrl_atr.training.provenance import provenance
from torchrl_atr.training.restoring import check_model, check_parts, deployed_weights, load_networks
from torchrl_atr.training.run_files import keep_files, located_settings, stored_settings
from torchrl_atr.training.team import Team

_MEMORY = 0.05
"""Weight of an iteration in the running mean of the episode reward."""
_STOPPING = "stopping after this iteration; once more to stop at once"


class Trainer:
    """One run in one folder.

    Args:
        config: the recipe.
        run: folder for config, checkpoint, logs; made if missing.
        state: a checkpoint to go on from. With ``collector="direct"`` on the CPU, not compiled, with the same threads
            and no time limit, the run goes on bit for bit as if it had not stopped.
        start: folder of another run, with whose deployed networks, optimisers' moments and command grid a new one
            begins, at its policy's learning rate if that is lower; all else is new.
        replaced: ``"robot"`` or ``"transporter"`` if another one than that run's may be meant by the same name.

    A robot that is given by a file is copied into the folder with all that it reads, and the copy is what is trained.

    Attributes:
        config: the recipe, with the folder's own copies of the files that it names.
        threads: of torch.

    Raises:
        CheckpointError: if the networks of either do not fit the settings, or it was trained with another robot or
            transporter than there is here.
        ConfigError: if ``start`` is ``run`` itself.
        EstimatorError: if the estimator cannot be trained.
    """

    def __init__(
        self,
        config: TrainConfig,
        run: str | Path,
        state: dict[str, Any] | None = None,
        start: str | Path | None = None,
        replaced: Collection[str] = (),
    ) -> None:
        self.run = run = Path(run)
        get_estimator(config.estimator)
        other = None if start is None else _read_other(Path(start), run)
        torch.manual_seed(config.seed)
        share = config.share(0)
        self.threads = torch_threads(config)
        self.env = env_maker(share, run)()
        scene = self.env.base_env.scene
        if state is not None:
            check_model(state, scene, run)
        elif other is not None:
            check_model(other, scene, Path(other["run"]), {*replaced, *_other_parts(config, other)})
        check_run_estimator(share, self.env)
        networks = make_run_networks(share, self.env)
        if state is not None:
            load_networks(networks, state["learner"]["networks"], run)
        elif other is not None:
            load_networks(networks, deployed_weights(other["learner"]), Path(other["run"]))
        self._model = describe(scene)
        run.mkdir(parents=True, exist_ok=True)  # not before: what is refused has written and removed nothing
        sweep(run)
        self.config = keep_files(config, run, fresh=state is None)
        if state is None:
            _clear(run)
        if self.config != config:  # what the folder holds is what is trained
            self.env.close()
            share = self.config.share(0)
            self.env = env_maker(share, run)()
            check_model({"model": self._model}, self.env.base_env.scene, run)
        self.curriculum = self.env.curriculum
        if state is None and other is None:
            with self.threads:  # compiled steps are for that many
                self._acquaint(networks)
        self.learner = Learner(networks.to(config.device), share)
        self.frames, self.iteration, self.seconds = 0, 0, 0.0
        self.reward, self.best_reward = 0.0, float("-inf")  # of episodes: running mean, and the best at a checkpoint
        self._mark = time.monotonic()  # the end of the last iteration
        self._carried: list[dict[str, Any]] = []  # by member, what its next batch depends on besides the networks
        self._start: dict[str, Any] | None = None  # the run that this one began from
        if state is not None:
            self._restore(state)
        elif other is not None:
            self._begin_from(other)
        self.progress = Progress(run, config, resume_from=self.frames if state is not None else None)

    def train(self, on_iteration: Callable[[dict[str, float]], bool | None] | None = None) -> int | None:
        """Trains until ``total_frames`` or ``max_minutes``, saving a checkpoint first, now and then, and last.

        SIGINT and SIGTERM end it after the iteration at hand, with a checkpoint.

        Args:
            on_iteration: called with each iteration's metrics; its time is not part of the run's. If it returns True,
                the run ends.

        Returns:
            The signal that ended it early, or None.
        """
        write_json(self.run / "config.json", stored_settings(self.config, self.run))
        with Interrupt(partial(say, _STOPPING)) as interrupt, self.threads:
            try:
                _ = self.member  # other processes take a while: not part of the first iteration's time
                self.save()
                with self.progress:
                    self._loop(interrupt, on_iteration)
                self.save()
                self.member.team.dismiss()
            except CollectionError:
                self.save()  # what was learned is whole: it was the next batch that did not come
                if interrupt.signal is None:  # a whole process group may be asked to stop, workers included
                    raise
            finally:
                self._close()
        return None if self.finished else interrupt.signal

    @cached_property
    def member(self) -> Member:
        """This process's part; other processes start when it is first asked for, and end with :meth:`train`."""
        team = Team.form(self.config.learners, assist, self.config, self.run)
        try:
            team.share(
                {
                    "learner": self.learner.state_dict(),
                    "weights": self.curriculum.weights,
                    "iteration": self.iteration,
                    "members": self._carried,
                }
            )
            member = make_member(self.learner, self.env, team, self.run, self.threads, self.iteration)
            if self._carried:
                member.load_state(self._carried[0])
        except BaseException:
            team.disband()
            raise
        return member

    @torch.no_grad()
    def _acquaint(self, networks: RidingNetworks) -> None:
        """Means and scales of random actions to start from, a step at a time: a rollout would hold every history."""
        carrier, spec = self.env.reset(), self.env.action_spec
        for _ in range(self.config.rollout_steps):
            carrier["action"] = torch.randn(spec.shape, dtype=spec.dtype)  # whatever the bounds
            step, carrier = self.env.step_and_maybe_reset(carrier)
            networks.update_normalizers(step)

    def _close(self) -> None:
        if "member" in vars(self):
            self.member.collection.shutdown()
            self.member.team.disband()
            del self.member

    def _loop(self, interrupt: Interrupt, on_iteration: Callable[[dict[str, float]], bool | None] | None) -> None:
        saved = self._mark = time.monotonic()
        while not self.finished and interrupt.signal is None:
            metrics = self.iterate()
            self.progress.update(metrics)
            if on_iteration is not None:
                if on_iteration(metrics):
                    return
                self._mark = time.monotonic()
            if time.monotonic() - saved > self.config.checkpoint_seconds:
                self.save()
                saved = time.monotonic()

    @property
    def progress_made(self) -> float:
        """Share of the frames or of the minutes that is used up, whichever is larger; 1 or more ends the run."""
        by_frames, minutes = self.frames / self.config.total_frames, self.config.max_minutes
        return max(by_frames, self.seconds / 60 / minutes) if minutes > 0 else by_frames

    @property
    def finished(self) -> bool:
        """Whether frames or minutes have run out."""
        return self.progress_made >= 1

    def iterate(self) -> dict[str, float]:
        """Collects a batch and learns from it.

        Returns:
            Its metrics; frames a second and minutes are with logs and checkpoints.
        """
        metrics = self.member.lead("iterate", self.progress_made)
        now = time.monotonic()
        metrics["frames_per_second"] = self.config.frames_per_batch / (now - self._mark)
        self.frames += self.config.frames_per_batch
        self.iteration += 1
        self.seconds += now - self._mark
        self._mark = now
        if "episode_reward" in metrics:
            self.reward += max(_MEMORY, 1 / self.iteration) * (metrics["episode_reward"] - self.reward)
        metrics["frames"], metrics["iteration"], metrics["minutes"] = self.frames, self.iteration, self.seconds / 60
        return metrics

    def save(self) -> None:
        """Writes the checkpoint (config, learner, curriculum, collection, counters) and where it comes from."""
        origin = provenance(self.config, self.run, digest(self._model), self.frames, self.seconds, self._start)
        write_json(self.run / "run.json", origin)
        if "member" in vars(self):
            self._carried = self.member.lead("state")
        mine, *others = self._carried or [{"collection": {}, "rng": torch.get_rng_state()}]
        best = self.iteration > 1 / _MEMORY and self.reward > self.best_reward
        self.best_reward = self.reward if best else self.best_reward
        save_checkpoint(
            self.run / NAME,
            {
                "config": stored_settings(self.config, self.run),
                "model": self._model,
                "start": self._start,
                "learner": self.learner.state_dict(),
                "curriculum": {"weights": self.curriculum.weights, **self.curriculum.get_extra_state()},
                **mine,
                "members": others,
                "frames": self.frames,
                "iteration": self.iteration,
                "seconds": self.seconds,
                "reward": self.reward,
                "best_reward": self.best_reward,
                "provenance": origin,
            },
            best=best,
        )

    def _begin_from(self, other: dict[str, Any]) -> None:
        grid = self.curriculum.grid
        self.curriculum.load_weights(grid.merge(grid.fitted(other["curriculum"]["weights"]), grid.initial_weights()))
        self.learner.begin_from(other["learner"])
        self._start = {name: other[name] for name in ("run", "config", "provenance")}

    def _restore(self, state: dict[str, Any]) -> None:
        self.learner.load_state_dict(state["learner"])
        self.curriculum.load_weights(state["curriculum"]["weights"])
        self.curriculum.set_extra_state({k: v for k, v in state["curriculum"].items() if k != "weights"})
        self.frames, self.iteration = state["frames"], state["iteration"]
        self.seconds = state["seconds"]
        self._start = state.get("start")
        own = {"collection": state.get("collection", {}), "rng": state["rng"]}
        self._carried = [own, *state.get("members", [])]
        if len(self._carried) != self.config.learners:
            raise ConfigError(
                f"learners={self.config.learners}: the checkpoint is of {len(self._carried)}; go on with as many, or "
                "begin a new run with --from"
            )
        self.reward = state.get("reward", 0.0)
        self.best_reward = state.get("best_reward", float("-inf"))


def _read_other(start: Path, run: Path) -> dict[str, Any]:
    """The checkpoint of the run that a new one begins from, and its folder as ``run``."""
    if start.resolve() == run.resolve():
        raise ConfigError(f"{run}: a run cannot replace the one that it begins from; give another --output")
    state = load_checkpoint(start)
    check_parts(state, start)
    return {"run": str(start), **state}


def _other_parts(config: TrainConfig, other: dict[str, Any]) -> set[str]:
    """Robot or transporter, if the settings name another one than those of the run that a new one begins from."""
    theirs = located_settings(other["config"], Path(other["run"]))
    return {part for part in PARTS if getattr(config, part) != theirs.get(part)}


def _clear(run: Path) -> None:
    """Removes what an earlier run wrote to the folder: two runs' checkpoints and logs must not mix."""
    for name in (NAME, PREVIOUS, BEST, "progress.csv"):
        (run / name).unlink(missing_ok=True)
    for name in ("tensorboard", DUMPS):
        shutil.rmtree(run / name, ignore_errors=True)
