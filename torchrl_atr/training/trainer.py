"""Training loop: env -> collector -> learner -> log -> checkpoint, until frames or minutes run out."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Sequence
from functools import cached_property, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import torch
from torchrl.envs import EnvBase

from torchrl_atr._files import atomic, say, sweep, write_json
from torchrl_atr._interrupt import Interrupt
from torchrl_atr._threads import TorchThreads
from torchrl_atr.config import TrainConfig
from torchrl_atr.config.files import to_toml
from torchrl_atr.envs.access import base_env
from torchrl_atr.envs.models.identity import describe, digest
from torchrl_atr.runs.checkpoint import NAME, load_rng_state, rng_state, save_checkpoint
from torchrl_atr.runs.files import CONFIG, ORIGIN, clear, keep_files, stored_settings
from torchrl_atr.runs.provenance import provenance
from torchrl_atr.runs.restoring import check_model
from torchrl_atr.training import env_access
from torchrl_atr.training.assembly import make_policy, make_reward_schedule
from torchrl_atr.training.callbacks import Callback, Callbacks
from torchrl_atr.training.collection import Collection, CollectionError
from torchrl_atr.training.learner import Learner
from torchrl_atr.training.metrics import batch_metrics
from torchrl_atr.training.parts import EnvFactory, LossFactory, NetworksFactory, Parts
from torchrl_atr.training.preparation import check_given, init_normalizers, trained_networks
from torchrl_atr.training.progress import Progress
from torchrl_atr.training.reward_schedule import check_reward_terms

if TYPE_CHECKING:
    from torchrl.record.loggers import Logger

_MEMORY = 0.05
"""Weight of an iteration in the running mean of the episode reward."""
_STOPPING = "stopping after this iteration; once more to stop at once"


class Trainer:
    """Training run in a folder.

    Parts that are not given are made from the configuration; docs/own_parts.md lists what each must have.

    Args:
        config: the recipe; settings of a part that is given in its place are not read.
        run: folder for config, checkpoint, logs; made if missing.
        state: a checkpoint to continue from. With ``collector="direct"`` on the CPU, not compiled, with the same
            threads and no time limit, the run continues bit for bit as if it had not stopped.
        begin_from: folder of another run, with whose deployed networks, optimisers' moments and command grid a new one
            begins, at its policy's learning rate if that is lower; all else is new.
        replaced: ``"robot"`` or ``"transporter"`` if another one than that run's may be meant by the same name.
        make_env: ``make_env(num_envs=, seed=, num_threads=)`` makes an env. A run resumes bit for bit if the env below
            all transforms has ``get_state()`` and ``set_state(state)``; else episodes begin anew.
        make_networks: ``make_networks(env)`` makes the networks, like :class:`~torchrl_atr.modules.ROANetworks`.
        make_loss: ``make_loss(networks)`` makes the loss, like :class:`~torchrl_atr.objectives.ROAClipPPOLoss`.
        logger: of ``torchrl.record.loggers``, which takes TensorBoard's place; it stays open.
        callbacks: called at fixed points of the run.

    A robot that is given by a file is copied into the folder with all that it reads, and the copy is what is trained.
    With workers, ``make_env`` must be picklable.

    Attributes:
        config: the recipe, with the folder's own copies of the files that it names.
        parts: custom parts.
        env, learner, curriculum: of this process; an env without ``curriculum`` has None.
        threads: of torch.

    Raises:
        CheckpointError: if the networks of either do not fit the settings, it was trained with another robot or
            transporter than there is here, or with custom parts that are not given.
        ConfigError: if ``begin_from`` is ``run`` itself, or a part cannot be used.
        EstimatorError: if the estimator cannot be trained.

    Example:
        >>> from functools import partial
        >>> from tempfile import TemporaryDirectory
        >>> from torchrl_atr.envs import make_riding_env
        >>> from torchrl_atr.training import make_config
        >>> config = make_config({"env.num_envs": 4, "ppo.rollout_steps": 4, "ppo.minibatches": 1, "total_frames": 16})
        >>> with TemporaryDirectory() as run:
        ...     trainer = Trainer(config, run, make_env=partial(make_riding_env, "go1", "two_board"))
        ...     # trainer.train()
        >>> trainer.finished, trainer.parts.names
        (False, {'make_env': 'torchrl_atr.envs.factory.make_riding_env'})
    """

    def __init__(
        self,
        config: TrainConfig,
        run: str | Path,
        state: dict[str, Any] | None = None,
        begin_from: str | Path | None = None,
        replaced: Iterable[str] = (),
        *,
        make_env: EnvFactory | None = None,
        make_networks: NetworksFactory | None = None,
        make_loss: LossFactory | None = None,
        logger: Logger | None = None,
        callbacks: Sequence[Callback] = (),
    ) -> None:
        self.run, self.config = Path(run), config
        self.parts = Parts(make_env, make_networks, make_loss, Callbacks(callbacks))
        other = check_given(
            config, self.run, self.parts, state, None if begin_from is None else Path(begin_from), logger
        )
        torch.manual_seed(config.seed)
        self.threads = TorchThreads(config.compute.torch_threads, adaptive=config.compute.torch_threads == 0)
        self.env = self._env_maker()
        networks = trained_networks(config, self.run, self.env, self.parts, state, other, replaced)
        scene = env_access.attribute(self.env, "scene")
        self._model = None if scene is None else describe(scene)
        loss, schedule = self.parts.loss(config, networks), make_reward_schedule(self.env)
        # of the env below all transforms: one of them may leave the terms out of what is stored
        emitted = base_env(self.env).full_observation_spec.get("reward_terms", {})
        check_reward_terms(schedule, emitted.keys())
        self._prepare_folder(fresh=state is None)
        self.curriculum = env_access.curriculum_of(self.env)
        if state is None and other is None:
            with self.threads:  # compiled steps are specialised to their number
                init_normalizers(networks, self.env, self.config.ppo.rollout_steps, self.config.compute.device)
        self.learner = Learner(networks, self.config, loss, schedule, self.parts.callbacks)
        self.frames, self.iteration, self.seconds = 0, 0, 0.0
        self.reward, self.best_reward = 0.0, float("-inf")  # of episodes: running mean, and the best at a checkpoint
        self._mark = time.monotonic()  # the end of the last iteration
        self._carried: dict[str, Any] = {}  # what the next batch depends on besides the networks
        self._start: dict[str, Any] | None = None  # the run that this one began from
        if state is not None:
            self._restore(state)
        elif other is not None:
            self._begin_from(other)
        title = self.parts.names.get("make_env", config.title)
        self.progress = Progress(self.run, config, None if state is None else self.frames, logger, title)

    @property
    def _env_maker(self) -> Callable[..., EnvBase]:
        return self.parts.env_maker(self.config, self.run)

    def _prepare_folder(self, fresh: bool) -> None:
        """Make the run folder, after all checks: a run that is refused writes and removes nothing."""
        self.run.mkdir(parents=True, exist_ok=True)
        sweep(self.run)
        given, self.config = self.config, keep_files(self.config, self.run, fresh)
        if fresh:
            clear(self.run)
        if self.config != given and self.parts.make_env is None:  # train the folder's copy
            self.env.close()
            self.env = self._env_maker()
            check_model({"model": self._model}, env_access.attribute(self.env, "scene"), self.run)

    def train(self, on_iteration: Callable[[dict[str, float]], bool | None] | None = None) -> int | None:
        """Train until ``total_frames`` or ``max_minutes``, with a checkpoint at the start, at intervals and at the end.

        SIGINT and SIGTERM end it after the iteration at hand, with a checkpoint.

        ``on_iteration`` is called with each iteration's metrics, after they are logged; its time is not part of the
        run's. If it returns True, the run ends.

        Returns:
            The signal that ended it early, or None.
        """
        with atomic(self.run / CONFIG) as file:
            file.write_text(to_toml(TrainConfig, stored_settings(self.config, self.run)), encoding="utf-8")
        with Interrupt(partial(say, _STOPPING)) as interrupt, self.threads:
            try:
                _ = self.collection  # workers take a while to start: not part of the first iteration's time
                self.parts.callbacks.call("on_train_begin", self)
                self.save()
                with self.progress:
                    self._loop(interrupt, on_iteration)
                self.save()
            except CollectionError:
                self.save()  # the learner is intact: only the next batch is missing
                if interrupt.signal is None:  # a whole process group may be asked to stop, workers included
                    raise
            finally:
                self._close()
                self.parts.callbacks.call("on_train_end")
        return None if self.finished else interrupt.signal

    @cached_property
    def collection(self) -> Collection:
        """Source of batches; workers start when it is first used, and end with :meth:`train`."""
        self.learner.anneal(self.progress_made)
        policy = make_policy(self.config, self.learner.networks)
        collection = Collection(self.config, self.env, self._env_maker, policy, self.iteration)
        if self._carried:
            collection.load_state_dict(self._carried["collection"])
            load_rng_state(self._carried["rng"])  # last: construction draws random numbers
        return collection

    def _close(self) -> None:
        if "collection" in vars(self):
            self.collection.shutdown()
            del self.collection

    def _loop(self, interrupt: Interrupt, on_iteration: Callable[[dict[str, float]], bool | None] | None) -> None:
        saved = self._mark = time.monotonic()
        while not self.finished and interrupt.signal is None:
            metrics = self.iterate()
            ended = any(self.parts.callbacks.call("on_iteration", metrics))
            self.progress.update(metrics)
            if on_iteration is not None:
                ended |= bool(on_iteration(metrics))
            if ended:
                return
            if on_iteration is not None or self.parts.callbacks.calling("on_iteration"):
                self._mark = time.monotonic()
            if time.monotonic() - saved > self.config.logging.checkpoint_seconds:
                self.save()
                saved = time.monotonic()

    @property
    def progress_made(self) -> float:
        """Share of the frames or of the minutes that is used up, whichever is larger; 1 or more ends the run."""
        by_frames, minutes = self.frames / self.config.total_frames, self.config.max_minutes
        return max(by_frames, self.seconds / 60 / minutes) if minutes > 0 else by_frames

    @property
    def finished(self) -> bool:
        """True if frames or minutes have run out."""
        return self.progress_made >= 1

    def iterate(self) -> dict[str, float]:
        """Collect a batch, learn from it and return metrics; rate and minutes include logs and checkpoints."""
        self.threads.update()
        started = time.monotonic()
        batch = self.parts.callbacks.through("on_batch", self.collection.collect())
        collected = time.monotonic()
        metrics = {**batch_metrics(batch), **self.learner.update(batch)}
        metrics["std"] = float(self.learner.networks.exploration.std().detach().mean())
        metrics["torch_threads"] = self.threads.count
        now = time.monotonic()
        metrics["collect_seconds"], metrics["learn_seconds"] = collected - started, now - collected
        metrics["frames_per_second"] = self.config.frames_per_batch / (now - self._mark)
        self.frames += self.config.frames_per_batch
        self.iteration += 1
        self.seconds += now - self._mark
        self._mark = now
        self.learner.anneal(self.progress_made)  # before workers get what they explore with
        self.collection.exchange()
        metrics |= self.collection.metrics()
        if "episode_reward" in metrics:
            self.reward += max(_MEMORY, 1 / self.iteration) * (metrics["episode_reward"] - self.reward)
        metrics["frames"], metrics["iteration"], metrics["minutes"] = self.frames, self.iteration, self.seconds / 60
        return metrics

    def save(self) -> None:
        """Write the checkpoint (config, learner, curriculum, collection, counters) and its provenance."""
        model, parts = None if self._model is None else digest(self._model), self.parts.names
        origin = provenance(self.config, self.run, model, self.frames, self.seconds, self._start, parts)
        write_json(self.run / ORIGIN, origin)
        known = self.iteration > 1 / _MEMORY and self.reward != 0.0  # it is 0 for an env without episode rewards
        best = known and self.reward > self.best_reward
        self.best_reward = self.reward if best else self.best_reward
        state = self._state(origin)
        self.parts.callbacks.checkpoint(state)
        save_checkpoint(self.run / NAME, state, best=best)

    def _state(self, origin: dict[str, Any]) -> dict[str, Any]:
        """Return all that a resumed run depends on."""
        if "collection" in vars(self):
            self._carried = {"collection": self.collection.state_dict(), "rng": rng_state()}
        carried = self._carried or {"collection": {}, "rng": rng_state()}
        return {
            "config": stored_settings(self.config, self.run),
            "model": self._model,
            "parts": self.parts.names,
            "start": self._start,
            "learner": self.learner.state_dict(),
            "curriculum": env_access.curriculum_state(self.curriculum),
            **carried,
            "callbacks": self.parts.callbacks.state_dict(),
            "frames": self.frames,
            "iteration": self.iteration,
            "seconds": self.seconds,
            "reward": self.reward,
            "best_reward": self.best_reward,
            "provenance": origin,
        }

    def _begin_from(self, other: dict[str, Any]) -> None:
        env_access.widen_curriculum(self.curriculum, other["curriculum"])
        self.learner.begin_from(other["learner"])
        self._start = {name: other[name] for name in ("run", "config", "provenance")}

    def _restore(self, state: dict[str, Any]) -> None:
        self.learner.load_state_dict(state["learner"])
        env_access.load_curriculum(self.curriculum, state["curriculum"])
        self.frames, self.iteration, self.seconds = (state[name] for name in ("frames", "iteration", "seconds"))
        self._start = state.get("start")
        self._carried = {"collection": state.get("collection", {}), "rng": state["rng"]}
        self.reward = state.get("reward", 0.0)
        self.best_reward = state.get("best_reward", float("-inf"))
        self.parts.callbacks.load_state_dict(state.get("callbacks", {}))
        self.parts.callbacks.call("on_resume", state)
