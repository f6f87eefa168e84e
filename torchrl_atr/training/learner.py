"""Learner of a run: epochs of PPO on each batch, then epochs of the estimators.

It replaces TorchRL's ``PPOTrainer`` and ``OptimizationStepper``, which minimise the sum of all losses with one
optimiser, without separate epochs for estimators, and wait for a GPU at each step.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any, cast

import numpy as np
import torch
from tensordict import NestedKey, TensorDict, TensorDictBase
from torch import Tensor, nn
from torch.optim.swa_utils import AveragedModel, get_ema_multi_avg_fn
from torchrl.objectives.value import GAE

from torchrl_atr._compilation import CudaGraph, compile_methods
from torchrl_atr.config import TrainConfig
from torchrl_atr.modules import ROANetworks
from torchrl_atr.modules.estimators import state_keys
from torchrl_atr.objectives import DeviceKLAdaptiveLR, LinearSchedule, ROAClipPPOLoss, previous_means
from torchrl_atr.objectives.schedules import kl_divergence
from torchrl_atr.objectives.smoothness import rms_change
from torchrl_atr.runs.restoring import deployed_weights
from torchrl_atr.training.assembly import make_run_loss
from torchrl_atr.training.callbacks import Callbacks, Phase
from torchrl_atr.training.guard import StepGuard
from torchrl_atr.training.optimizers import load_optimizers, make_optimizers, parameter_groups, take_moments
from torchrl_atr.training.recording import Teacher, record_output
from torchrl_atr.training.reward_schedule import RewardSchedule, factors_at, with_factors

EMA_WARMUP = 9
"""Early in a run the moving average covers a ninth of its iterations, the latest ones."""


class Learner:
    """Networks, loss, optimisers and schedules of one run.

    The policy (actor, encoder), the critic and the estimators have an optimiser each: only the policy's learning rate
    follows the KL divergence, and no gradient norm clips another's.

    What trains the policy is ``config.roa.policy_update``: PPO; imitation of the policy that the networks are now; or
    nothing, and then its normalisers stay as they are, too.

    Args:
        networks: from :func:`torchrl_atr.modules.make_networks`; trained in place.
        config: hyper-parameters.
        loss: what is minimised, see docs/own_parts.md; by default :func:`~torchrl_atr.training.make_run_loss`'s.
        reward_schedule: factors of reward terms over the run, in what is learned from.
        callbacks: whose ``on_minibatch`` and ``on_loss`` are called.
    """

    def __init__(
        self,
        networks: ROANetworks,
        config: TrainConfig,
        loss: ROAClipPPOLoss | None = None,
        reward_schedule: RewardSchedule | None = None,
        callbacks: Callbacks | None = None,
    ) -> None:
        self.networks, self.config = networks, config
        self._averaged = AveragedModel(networks, multi_avg_fn=self._average)
        self._averaged.eval()  # it is never trained
        self.loss: Any = make_run_loss(config, networks) if loss is None else loss
        self._has_own_loss = loss is not None
        self._update = config.roa.policy_update
        self.teacher = Teacher(networks) if self._update == "imitation" else None
        estimators = networks.intrinsic_estimator_module, networks.extrinsic_estimator_module
        self._on_sequences = any(state_keys(each) for each in estimators if each is not None)  # they learn from these
        self.reward_schedule, self.callbacks = dict(reward_schedule or {}), callbacks or Callbacks()
        critic = networks.critic_module
        self.advantage = GAE(
            gamma=config.ppo.gamma,
            lmbda=config.ppo.gae_lambda,
            value_network=critic,
            average_gae=True,
            shifted=True,
            shifted_budget=2,  # a row with a time limit within it keeps its last step, and the fall that may end it
            vectorized=False,  # over few steps a loop takes half as long
        )
        self.advantage.set_keys(value=critic.out_keys[0])
        if config.compiles_networks:
            compile_methods(self.loss, "policy_loss", *["adaptation_loss"] * (not self._on_sequences))
            compile_methods(critic, "forward")
        self._groups, ppo = parameter_groups(networks), config.ppo
        self.optimizers = make_optimizers(self._groups, config)
        self.schedule = DeviceKLAdaptiveLR(self.optimizers["policy"], ppo.target_kl, max_lr=ppo.max_learning_rate)
        self._first, self._too_far = torch.zeros(2, dtype=torch.bool, device=config.compute.device)
        self._steps = self._make_steps()
        self._roa_ramp = LinearSchedule(self.loss, "roa_coeff", 0.0, config.roa.coeff) if config.roa.ramp else None
        self._reward_factors = dict.fromkeys(self.reward_schedule, 1.0)
        self.guard = StepGuard()
        self.minibatch_size = -(-config.frames_per_batch // config.ppo.minibatches)

    def _make_steps(self) -> dict[str, Callable[[TensorDictBase], TensorDictBase]]:
        captured = CudaGraph if self.config.captures_graphs else (lambda step: step)
        estimators = self._adaptation_step if self._on_sequences else captured(self._adaptation_step)
        return {"policy": captured(self._policy_step), "estimators": estimators}

    @property
    def deployed(self) -> ROANetworks:
        """Networks with the moving average of the weights, in eval mode; it follows batch noise less than steps do."""
        return cast(ROANetworks, self._averaged.module)

    def _average(self, averaged: Any, current: Any, iterations: Tensor | int) -> None:
        share = max(1 / self.config.ppo.ema_horizon, EMA_WARMUP / (EMA_WARMUP + 1 + int(iterations)))
        get_ema_multi_avg_fn(1 - share)(averaged, current, iterations)

    def anneal(self, progress: float) -> None:
        """Lower the ceiling of the exploration and the KL target late in a run, ramp λ, schedule the reward terms.

        Noise hides the sign of the board's tilt, and steps that follow a batch's noise degrade the policy.

        Args:
            progress: share of the run that is over, in [0, 1].
        """
        explore, ppo = self.config.exploration, self.config.ppo
        if explore.anneal and self._update == "ppo":
            late = float(np.interp(progress, [explore.anneal_from, explore.anneal_until], [0.0, 1.0]))
            self.networks.exploration.cap_(explore.init_std * (explore.final_std / explore.init_std) ** late)
            self.schedule.target_kl = ppo.target_kl + late * (ppo.final_kl - ppo.target_kl)
        self._reward_factors = factors_at(self.reward_schedule, progress)
        if self._roa_ramp is not None:
            self._roa_ramp.step(progress)

    def update(self, batch: TensorDictBase) -> dict[str, float]:
        """Run one iteration on a batch of shape (N, T).

        Args:
            batch: from a collector that ran ``networks.rollout_policy(config.roa.act_source)``.

        Returns:
            Means over the iteration: losses, KL divergence, learning rate, estimator errors; ``action_rate_rms``, the
            root mean square of the mean actions' changes from step to step; ``skipped_steps``, the optimiser steps
            skipped so far because they were not finite.

        Raises:
            TrainingDiverged: if steps are no longer finite.
        """
        with torch.no_grad():
            # a copy: the caller's batch gets no new entries and no weighted reward
            device = self.config.compute.device  # to a GPU from pinned memory, without waiting
            batch = batch.copy().to(device, non_blocking_pin=device != "cpu")
            batch = with_factors(batch, self._reward_factors)
            batch = self.advantage(batch) if self._update == "ppo" else batch
            batch.set("previous_mean", previous_means(batch["loc"], batch["next", "done"]))
            action_rate = rms_change(batch["loc"], batch["next", "done"])
        flat = batch.reshape(-1)
        self._record(flat)
        shuffled = self._shuffled(flat)
        self._first.fill_(True)
        self._too_far.fill_(False)
        steps: dict[str, TensorDictBase] = {}
        if self._update != "none":
            steps["policy"] = self._learn_policy(shuffled)
        if self.config.estimator.epochs and "estimators" in self._groups:
            steps["estimators"] = self._learn_estimators(self._shuffled(batch) if self._on_sequences else shuffled)
        if self._update != "none":
            self.networks.update_normalizers(flat)
        self._averaged.update_parameters(self.networks)
        metrics = {key: value for phase, taken in steps.items() for key, value in self._means(phase, taken).items()}
        metrics |= {"learning_rate": self.schedule.get_last_lr()[0], "action_rate_rms": float(action_rate)}
        return {**metrics, "skipped_steps": float(self.guard.skipped)}

    def _record(self, flat: TensorDictBase) -> None:
        """Record what the policy's loss reads once an iteration, without gradient.

        That is the teacher's actions, or ẑ, the target of the encoder (Eq. 15's second term), unless the rollout did.
        """
        if self.teacher is not None:
            self.teacher.label(flat, self.minibatch_size)
        module: Any = self.networks.intrinsic_estimator_module
        recorded = self.config.roa.act_source != "privileged" or (module is not None and state_keys(module))
        if self._update == "ppo" and module is not None and not recorded:
            record_output(module, flat, self.minibatch_size, module.out_keys[0])

    def _shuffled(self, flat: TensorDictBase) -> TensorDictBase:
        """Return the entries that the losses read, shuffled; whole rows (steps or sequences), as indexing is slower."""
        read = flat.select(*self._read["policy"], *self._read["estimators"], strict=False)
        order = torch.randperm(len(flat), device=flat.device)
        return read.apply(lambda entry: entry.index_select(0, order))

    def _learn_policy(self, shuffled: TensorDictBase) -> TensorDictBase:
        return self._epochs("policy", shuffled, self.config.ppo.epochs)

    def _learn_estimators(self, shuffled: TensorDictBase) -> TensorDictBase:
        return self._epochs("estimators", shuffled, self.config.estimator.epochs)

    @property
    def _read(self) -> dict[Phase, list[NestedKey]]:
        """Batch entries that the steps of each phase read."""
        loss, more = self.loss, self.callbacks.in_keys
        return {"policy": [*loss.policy_in_keys, *more], "estimators": [*loss.adaptation_in_keys, *more]}

    def _epochs(self, phase: Phase, shuffled: TensorDictBase, epochs: int) -> TensorDictBase:
        """Step on the same minibatches in every epoch, views of data shuffled once: a frame is mostly history.

        Returns:
            The reports of the steps, (steps,), on the device that computed them: nothing waits for a GPU before all
            steps are launched.
        """
        size = self.minibatch_size if shuffled.ndim == 1 else -(-len(shuffled) // self.config.ppo.minibatches)
        minibatches = shuffled.select(*self._read[phase], strict=False).split(size)
        step, through = self._steps[phase], self.callbacks.through
        return torch.stack([step(through("on_minibatch", each, phase)) for _ in range(epochs) for each in minibatches])

    def _policy_step(self, minibatch: TensorDictBase) -> TensorDictBase:
        """Adapt the rate to the divergence from the policy that collected the batch; step unless it is too large.

        Before the first step the divergence is zero, which says nothing about the rate. Once it is too large, the
        remaining policy steps of the iteration are skipped. Imitation is regression, at a fixed rate.
        """
        terms = self.loss.policy_loss(minibatch)
        if self._update == "imitation":
            terms = self.callbacks.through("on_loss", terms, minibatch, "policy")
            return self._step(terms, ("policy",))
        divergence = terms["kl_divergence"] = kl_divergence(terms)
        self.schedule.step(divergence, hold=self._first | self._too_far)
        self._first.fill_(False)
        if self.config.ppo.kl_stop > 0:
            self._too_far.logical_or_(self.schedule.exceeded(divergence, self.config.ppo.kl_stop))
        terms = self.callbacks.through("on_loss", terms, minibatch, "policy")
        return self._step(terms, ("policy", "critic"), self._too_far)

    def _adaptation_step(self, minibatch: TensorDictBase) -> TensorDictBase:
        terms = self.callbacks.through("on_loss", self.loss.adaptation_loss(minibatch), minibatch, "estimators")
        return self._step(terms, ("estimators",))

    def _step(self, terms: TensorDictBase, names: tuple[str, ...], hold: Tensor | None = None) -> TensorDictBase:
        """Step, unless ``hold`` is true or a value is not finite; return detached terms, and which are finite."""
        total = torch.stack([value for key, value in terms.items() if key.startswith("loss_")]).sum()
        for name in names:
            self.optimizers[name].zero_grad(set_to_none=True)
        total.backward()
        norms = {name: nn.utils.clip_grad_norm_(self._groups[name], self.config.ppo.max_grad_norm) for name in names}
        finite = self.guard.finite(terms, norms)
        left_out = ~torch.stack(list(finite.values())).all()
        left_out = left_out if hold is None else left_out | hold
        for name in names:
            optimizer: Any = self.optimizers[name]
            optimizer.found_inf = left_out.float()  # a fused optimiser reads it on the device
            optimizer.step()
        return TensorDict({**terms.detach().apply(torch.mean).to_dict(), "finite": finite})

    def _means(self, name: str, steps: TensorDictBase) -> dict[str, float]:
        """Review an iteration's steps and return the means of its terms: here a GPU is waited for."""
        self.guard.review(name, steps["finite"])
        terms = steps.exclude("finite").mean(0)
        return dict(zip(map(str, terms.keys()), torch.stack(list(terms.values())).tolist()))

    def state_dict(self) -> dict[str, Any]:
        """Return everything that training changes here: networks, their moving average, optimisers, schedule."""
        return {
            "networks": self.networks.state_dict(),
            "deployed": self.deployed.state_dict(),
            "averaged": int(self._averaged.n_averaged),
            "optimizers": {name: optimizer.state_dict() for name, optimizer in self.optimizers.items()},
            "schedule": self.schedule.state_dict(),
            "roa_coeff": float(getattr(self.loss, "roa_coeff", 0.0)),
            "loss": dict(self._loss_buffers()),
            "skipped_steps": self.guard.skipped,
            **({} if self.teacher is None else {"teacher": self.teacher.networks.state_dict()}),
        }

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Restore :meth:`state_dict`."""
        self.networks.load_state_dict(state["networks"])
        self.deployed.load_state_dict(deployed_weights(state))
        self._averaged.n_averaged.fill_(state.get("averaged", 0))
        load_optimizers(self.optimizers, state["optimizers"], self.config)
        if self.teacher is not None:
            self.teacher.networks.load_state_dict(state["teacher"])
        self._steps = self._make_steps()  # graphs that were captured change tensors that are no longer read
        self.schedule.load_state_dict(state["schedule"])
        if hasattr(self.loss, "roa_coeff"):
            self.loss.roa_coeff = state["roa_coeff"]
        for name, buffer in self._loss_buffers():
            buffer.copy_(state["loss"][name])
        self.guard.skipped = state.get("skipped_steps", 0)

    def _loss_buffers(self) -> Iterator[tuple[str, Tensor]]:
        """Yield the buffers of a custom loss beside the networks'; the recipe's follow from the configuration."""
        theirs = {id(buffer) for buffer in self.networks.buffers()}
        if self._has_own_loss:
            yield from ((name, buffer) for name, buffer in self.loss.named_buffers() if id(buffer) not in theirs)

    def begin_from(self, state: dict[str, Any]) -> None:
        """Take the moments of another run's optimisers and its policy's rate, if lower; all else is new.

        Without moments the first steps move every weight by a whole rate: a robot that explores little falls.

        Args:
            state: a :meth:`state_dict` whose networks have been loaded.
        """
        take_moments(self.optimizers, state["optimizers"])
        if self._update == "ppo":
            rate = float(state["optimizers"]["policy"]["param_groups"][0]["lr"])
            self.schedule.set_rate(min(rate, self.config.ppo.learning_rate))
