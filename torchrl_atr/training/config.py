"""The recipe as one flat, validated, serialisable configuration."""

from __future__ import annotations

import dataclasses
import inspect
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from torchrl_atr._cpus import available_cpus
from torchrl_atr._registry import import_modules
from torchrl_atr.envs.models.files import COPIES
from torchrl_atr.envs.models.spec_file import is_spec_file
from torchrl_atr.envs.tasks import TASKS, Task, make_task
from torchrl_atr.envs.transforms import CommandGrid
from torchrl_atr.modules import Source
from torchrl_atr.training.config_checks import ConfigError, check_settings
from torchrl_atr.training.ranges import plain, wrong_kind

SEED_STRIDE = 1000
"""Between the seeds of two processes that share a run."""


_OF_THE_TASK = ("robot", "transporter", "profile", "sensors", "moving_start", "displaced_start")


@dataclass(frozen=True)
class TrainConfig:
    """Everything a run depends on besides the code.

    The defaults are riding's. :func:`make_config` also takes the settings of the ``task`` and the ``profile`` that
    differ from them, as the command line does; this class does not.

    Attributes:
        task: name from the registry: ``riding``, ``walking`` or one of your own.
        robot: name from the registry, or path of a ``.toml`` file that describes one (kept as an absolute path; a run
            copies the file and all that it needs, and stores the copy's path in the run folder).
        transporter: ``single_board`` or ``two_board`` in the robot's size, another registered name, or likewise a file.
            Of a task without one it stays at its default; another value is refused.
        sensors: name of a set of sensor errors, ``ideal`` or ``realistic``.
        profile: name from the registry.
        estimator: name of a registered estimator, used for the intrinsic and the extrinsic one.
        imports: modules imported first, so that they can register tasks, estimators, robots and transporters.
        num_envs: robots simulated at once.
        rollout_steps: control steps per robot and iteration.
        total_frames: robot steps after which training ends.
        max_minutes: wall-clock minutes after which it ends, whichever comes first; 0 for no limit.
        seed: of everything.
        device: of the learner; physics stays on the CPU.
        num_threads: physics threads; 0 for the CPUs this process may use.
        torch_threads: threads of torch; 0 for the CPUs this process may use, and fewer while others use them.
        compiled: whether ``torch.compile`` makes few loops of what the task computes at every step and, where the
            learner is on the CPU, of policy and losses, and on a GPU makes CUDA graphs of policy and optimiser steps; a
            resumed run is then the uninterrupted one to rounding.
        collector: where the robots are simulated: ``direct`` in this process, or in ``workers`` others by TorchRL's
            engine ``process``, ``ray`` or ``distributed``.
        workers: processes that share the robots and the CPUs.
        gamma, gae_lambda: discount and GAE's λ.
        epochs, minibatches: PPO passes over a batch, and into how many parts each is cut.
        learning_rate, max_learning_rate, target_kl: of the policy; adapted to the measured KL divergence. A run that
            begins with another's networks begins at that one's last rate if it is lower.
        final_kl: what ``target_kl`` sinks to while the exploration is annealed, so that the policy settles.
        critic_learning_rate, estimator_learning_rate: fixed.
        clip_epsilon, entropy_coeff, max_grad_norm: PPO.
        average_over: iterations that the running mean of the weights, which is what is deployed, goes over; 1 for the
            last weights alone.
        init_std: exploration of what all legs do alike (lean, shift, lift), in units of the action; in a run that
            begins with another's networks, the ceiling at first.
        relative_std: exploration of what legs do against each other.
        min_std: floor of both.
        noise_correlation: of the exploration from one control step to the next, in [0, 1).
        final_std: ceiling of the exploration from ``anneal_until`` of the run on, lowered geometrically from
            ``init_std`` after ``anneal_from`` of it.
        anneal_from, anneal_until: shares of the run, in [0, 1].
        smoothness_coeff: pull of the mean action towards that of the step before.
        roa_coeff: λ of Eq. 15.
        roa_ramp: whether λ grows linearly from 0 over the run (A23).
        adaptation_epochs: passes of the estimators over a batch.
        act_source: what the actor acts on in training: ``privileged``, ``estimated`` or ``mixed`` (A24).
        dead_reckoning: whether the extrinsic estimator reads the dead_reckoned_velocity beside the history.
        symmetric: whether encoder, actor and critic treat left and right alike by construction.
        normalize_targets: whether the extrinsic estimator's errors are measured in standard deviations (A25).
        steering_cue: whether the actor also reads tanh(c_v) c_ω, which has the sign of the lean that turns.
        privileged_critic: whether the critic reads more than the observation (A20).
        tracking_forecast: whether a privileged critic also reads the outlook: what drives the board, and what tracking
            will be if that lasts.
        student_fraction: share of the robots that act on the estimates under ``mixed``.
        history_length: H.
        critic_cells: hidden widths of the critic; the actor's are Table I's.
        moving_start: share of the episodes whose transporter starts at part of the commanded speeds.
        displaced_start: share of the episodes whose robot starts shifted and turned on the boards.
        retry: share of the falls after which the same robot tries again: those that fall often are seen too little.
        episode_seconds, command_seconds: time limit, and how long a command lasts.
        steering_weight_peak: factor of r1 in what is learned from, at its peak: it rises from 1 until ``anneal_until``
            of the run; 1 leaves the rewards alone. What it adds is not part of what the profile ``ancestor`` clips.
        steering_weight_end: what it sinks to from there until the run ends; with ``anneal_until=1`` it only rises.
        tracking_threshold: γ_v = γ_ω, the share of perfect tracking that grows the command grid.
        count_own_twice: whether a succeeding cell of the command grid grows twice (A4).
        score_from_seconds: part of a command's time that the score leaves out (A6).
        initial_speed, initial_yaw_rate: half widths of the first command box, m/s and rad/s; 0 for all of it.
        max_speed, max_yaw_rate: half widths of the box that commands never leave, m/s and rad/s, multiples of the
            task's bins (riding: 0.2); 0 for the task's own.
        runaway_speed, runaway_yaw_rate: how much faster than any command a transporter may get before its episode ends.
        checkpoint_seconds: longest time between checkpoints.
        logger: beside ``progress.csv``: ``tensorboard``, ``wandb``, ``mlflow``, or ``csv`` for that file alone.
    """

    task: str = "riding"
    robot: str = "a1"
    transporter: str = "single_board"
    sensors: str = "realistic"
    profile: str = "default"
    estimator: str = "cnn_gru"
    imports: tuple[str, ...] = ()
    num_envs: int = 512
    rollout_steps: int = 12
    total_frames: int = 50_000_000
    max_minutes: float = 0.0
    seed: int = 0
    device: str = "cpu"
    num_threads: int = 0
    torch_threads: int = 0
    compiled: bool = False
    collector: str = "direct"
    workers: int = 2
    gamma: float = 0.995
    gae_lambda: float = 0.8
    epochs: int = 2
    minibatches: int = 4
    learning_rate: float = 3e-4
    max_learning_rate: float = 2e-3
    target_kl: float = 0.03
    final_kl: float = 0.01
    critic_learning_rate: float = 1e-3
    estimator_learning_rate: float = 1e-3
    clip_epsilon: float = 0.2
    entropy_coeff: float = 0.0
    max_grad_norm: float = 1.0
    average_over: int = 100
    init_std: float = 0.3
    relative_std: float = 0.1
    min_std: float = 0.03
    noise_correlation: float = 0.9
    final_std: float = 0.1
    anneal_from: float = 0.35
    anneal_until: float = 1.0
    smoothness_coeff: float = 0.3
    roa_coeff: float = 0.2
    roa_ramp: bool = False
    adaptation_epochs: int = 1
    act_source: Source = "mixed"
    dead_reckoning: bool = True
    steering_cue: bool = True
    symmetric: bool = True
    normalize_targets: bool = True
    privileged_critic: bool = True
    tracking_forecast: bool = True
    student_fraction: float = 0.5
    history_length: int = 10
    critic_cells: tuple[int, ...] = (256, 128, 64)
    moving_start: float = 0.8
    displaced_start: float = 0.3
    retry: float = 0.5
    episode_seconds: float = 5.0
    command_seconds: float = 5.0
    steering_weight_peak: float = 1.0
    steering_weight_end: float = 1.0
    tracking_threshold: float = 0.6
    score_from_seconds: float = 1.0
    count_own_twice: bool = False
    initial_speed: float = 1.0
    initial_yaw_rate: float = 0.3
    max_speed: float = 0.0
    max_yaw_rate: float = 0.0
    runaway_speed: float = 2.0
    runaway_yaw_rate: float = 2.0
    checkpoint_seconds: float = 60.0
    logger: str = "tensorboard"

    def __post_init__(self) -> None:
        for field in dataclasses.fields(self):
            if problem := wrong_kind(field.name, getattr(self, field.name), field.default):
                raise ConfigError(problem)
            object.__setattr__(self, field.name, plain(getattr(self, field.name)))
        import_modules(self.imports)  # first: they register the names that are checked
        check_settings(self)
        for name in COPIES:
            if is_spec_file(value := getattr(self, name)):  # workers must find it from wherever they run
                object.__setattr__(self, name, str(Path(value).resolve()))

    @property
    def compiles_networks(self) -> bool:
        """Whether policy and losses are compiled too: for a CPU alone, where it was measured."""
        return self.compiled and self.device == "cpu"

    @property
    def captures_graphs(self) -> bool:
        """Whether optimiser steps are captured as CUDA graphs: what ``compiled`` is for a learner on a GPU."""
        return self.compiled and self.device != "cpu"

    def threads_each(self, processes: int) -> int:
        """Physics threads of each of so many processes that share the CPUs."""
        return max(1, (self.num_threads or available_cpus()) // processes)

    def make_task(self, **overrides: Any) -> Task:
        """Return the task, with some arguments of its function replaced.

        Raises:
            UnknownNameError: for an unknown task, robot, transporter or profile.
        """
        settings = {name: getattr(self, name) for name in _OF_THE_TASK}
        settings |= {name: getattr(self, name) for name in ("steering_weight_peak", "steering_weight_end")}
        settings["steering_weight_peak_at"] = self.anneal_until
        known = inspect.signature(TASKS.get(self.task)).parameters
        own = {name: value for name, value in settings.items() if name in known}
        return make_task(self.task, **{**own, **overrides})

    @property
    def title(self) -> str:
        """What is trained, in a few words."""
        return f"{self.robot} on {self.transporter}" if self.task == "riding" else f"{self.robot} {self.task}"

    @property
    def grid(self) -> CommandGrid | None:
        """The curriculum's cells and its rule."""
        grid = self.make_task().command.grid
        if grid is None:
            return None
        bounds = self.max_speed or grid.bounds[0], self.max_yaw_rate or grid.bounds[1]
        return dataclasses.replace(
            grid,
            bounds=bounds,
            initial=(self.initial_speed or bounds[0], self.initial_yaw_rate or bounds[1]),
            count_own_twice=self.count_own_twice,
        )

    @property
    def frames_per_batch(self) -> int:
        """Robot steps in one iteration."""
        return self.num_envs * self.rollout_steps

    def to_dict(self) -> dict[str, Any]:
        """As plain JSON values."""
        return json.loads(json.dumps(dataclasses.asdict(self)))
