"""Settings of a run by group: exploration, learning, networks, computation and logs."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from torchrl_atr._settings import Settings, setting
from torchrl_atr.config.env_settings import TINY
from torchrl_atr.modules import ActorInput, ActSourceName


@dataclass(frozen=True)
class ExplorationConfig(Settings):
    """Exploration of the Gaussian policy."""

    group = "exploration"

    leg_patterns: bool = setting(True, off=False, addition="exploration along patterns of the legs")
    """Explore along what all legs do alike and against each other, with actor outputs that move these directions; else
    joint by joint. Only what all legs do alike tilts a board; independent noise strains legs against each other."""
    init_std: float = setting(0.3, within=(1e-3, 10), question="A21", legged_gym=1.0)
    """Standard deviation at first, in units of the action; in a run that begins with another's networks, the ceiling at
    first. legged_gym explores with 1: on a board, robots then fall within two seconds."""
    relative_std: float = setting(0.1, within=(1e-3, 10), question="A21", legged_gym=1.0)
    """With leg_patterns, standard deviation at first of what legs do against each other, in units of the action; no
    ratio to init_std, which is then that of what all legs do alike. Legs that pull against each other tilt nothing."""
    min_std: float = setting(0.03, within=(0, 10), off=0.0, addition="a floor of the exploration")
    """Floor of the standard deviations. They can grow again from there."""
    noise_correlation: float = setting(0.9, within=(0, 0.999), question="A21", off=0.0, addition="noise that lasts")
    """Correlation of the noise from one control step to the next. White noise at 50 Hz averages out before a board has
    tilted; here a deviation lasts for some ten steps."""
    anneal: bool = setting(True, question="A21", off=False, addition="annealed exploration and KL target")
    """Lower a ceiling of the exploration, and ppo.target_kl to final_kl, late in the run. Noise hides the tilt."""
    anneal_from: float = setting(0.4, within=(0, 0.99))
    """Share of the run after which the ceiling falls geometrically from init_std. Turns are better with less noise."""
    anneal_until: float = setting(0.85, within=(0.01, 1))
    """Share of the run from which on that ceiling is final_std."""
    final_std: float = setting(0.06, within=(1e-3, 10))
    """Ceiling of the standard deviations at the end. More noise hides the sign of a board's pitch."""


@dataclass(frozen=True)
class PPOConfig(Settings):
    """PPO, and the networks of actor and critic.

    The paper gives no hyper-parameters of PPO; the preset `paper` takes those of Extreme Parkour, which it builds on.
    """

    group = "ppo"

    rollout_steps: int = setting(12, within=(2, 1e5), paper=24)
    """Control steps per robot and iteration."""
    gamma: float = setting(0.995, within=(0, 0.99999), paper=0.99)
    """Discount. The reward of a turn comes seconds after the lean."""
    gae_lambda: float = setting(0.8, within=(0, 1), paper=0.95)
    """GAE's λ. Advantages of the lean that turns have less noise than with 0.9 or 0.95."""
    epochs: int = setting(2, within=(1, 1000), paper=5)
    """Passes over a batch."""
    minibatches: int = setting(4, within=(1, 1e5))
    """Minibatches that each pass is cut into."""
    learning_rate: float = setting(3e-4, within=(TINY, 1), paper=2e-4)
    """Learning rate of the policy at first; then adapted to the measured KL divergence. A run that begins with
    another's networks begins at that one's last rate if it is lower."""
    max_learning_rate: float = setting(2e-3, within=(TINY, 1), paper=1e-2)
    """Upper bound of the policy's learning rate."""
    target_kl: float = setting(0.03, within=(TINY, 10), paper=0.01)
    """Divergence of an update that the rate is adapted to."""
    final_kl: float = setting(0.01, within=(TINY, 10))
    """Value that target_kl falls to with exploration.anneal. The policy settles."""
    kl_stop: float = setting(5.0, within=(0, 1e6), off=0.0, addition="policy steps that stop at too large a divergence")
    """Multiples of target_kl at which the rest of an iteration's policy steps is skipped; 0 for never. A batch of a
    policy that different is no longer informative."""
    critic_learning_rate: float = setting(1e-3, within=(TINY, 1))
    """Learning rate of the critic, fixed."""
    clip_epsilon: float = setting(0.2, within=(TINY, 1))
    """Clip range of the importance ratio."""
    entropy_coeff: float = setting(0.0, within=(0, 10), paper=0.01)
    """Weight of the entropy bonus."""
    max_grad_norm: float = setting(1.0, within=(TINY, 1e9))
    """Norm to which each optimiser's gradient is clipped."""
    smoothness_coeff: float = setting(0.3, within=(0, 1e3), off=0.0, addition="smoothness loss")
    """Pull of the mean action towards that of the step before. r11 weighs 1e-5, r12's joint acceleration 1e-7: nothing
    keeps a policy from chattering at 50 Hz, which lifts feet off the board."""
    ema_horizon: int = setting(100, within=(1, 1e6), off=1, addition="averaged weights")
    """Iterations of the exponential moving average of the weights, which is what is deployed; 1 for the last weights.
    Averaged weights follow a batch's noise less."""
    symmetric: bool = setting(True, off=False, addition="left-right symmetric networks")
    """Make encoder, actor and critic treat left and right alike by construction. Plain networks have to find out twice
    what is right on the left and on the right."""
    command_interaction: bool = setting(True, off=False, addition="product of the commands as an input")
    """Let the actor also read tanh(c_v) c_ω. The lean that turns changes sign with the speed command (Eq. 3), an
    exclusive-or that gradients find late."""
    tracking_errors: bool = setting(True, off=False, addition="tracking errors as inputs of the actor")
    """Let the actor also read tanh(e / 0.5) of both tracking errors, by its estimates, and tanh(c_v) times the yaw
    rate's. Networks that read speeds and commands over metres a second find a difference of 0.3 m/s late."""
    actor_cells: tuple[int, ...] = setting((512, 256, 128), within=(1, 1e5))
    """Hidden widths of the actor. Table I."""
    critic_cells: tuple[int, ...] = setting((256, 128, 64), within=(1, 1e5), paper=(512, 256, 128))
    """Hidden widths of the critic. 38 % less arithmetic in a PPO pass than the actor's widths, for the same figures."""
    privileged_critic: bool = setting(True, question="A20")
    """Let the critic also read x_int and x_ext. The paper does not describe its critic. Only the actor is deployed;
    without, it reads o_t as a real robot could."""
    tracking_forecast: bool = setting(True, off=False, addition="tracking forecast for the critic")
    """Let the critic also read what drives the board, and what tracking will be if that lasts. The paper's privileged
    information is x_int and x_ext."""


@dataclass(frozen=True)
class ROAConfig(Settings):
    """Way of adaptation, by default regularised online adaptation: inputs of the actor, encoder, training of both."""

    group = "roa"

    coeff: float = setting(0.2, within=(0, 1e3))
    """Weight λ of Eq. 15. As in the paper."""
    ramp: bool = setting(False, question="A23", legged_gym=True)
    """Grow λ linearly from 0 over the run. Open whether λ = 0.2 is constant or the end of a ramp. Constant; Extreme
    Parkour ramps it up."""
    actor_reads: tuple[ActorInput, ...] = setting(("latent", "extrinsic"))
    """Inputs of the actor beside o_t: history, latent (z), extrinsic (x_ext), or some of these. There is an encoder,
    and an estimator, of what it reads alone; docs/adaptation.md. As in the paper."""
    policy_update: Literal["ppo", "imitation", "none"] = setting("ppo")
    """Update of the policy: ppo; imitation of the actions that the policy of --from takes on privileged information;
    or nothing: then that policy stays as it is, and estimators learn in it. As in the paper."""
    act_source: ActSourceName = setting(
        "mixed", question="A24", off="privileged", addition="acting on estimates in training"
    )
    """Inputs of the actor in training; mixed: half of the robots act on their estimates. The paper's figure shows the
    privileged policy in training; acting on estimates, estimators also learn on states that their errors lead to."""
    latent_features: int = setting(16, within=(1, 1e5))
    """Size of z. Table I."""
    encoder_cells: tuple[int, ...] = setting((128, 64), within=(1, 1e5))
    """Hidden widths of the encoder. Table I."""


@dataclass(frozen=True)
class ComputeConfig(Settings):
    """Device, threads and processes of a run."""

    group = "compute"

    device: str = setting("cpu", alias="device")
    """Device of the learner, cpu or cuda; physics stays on the CPU."""
    num_threads: int = setting(0, within=(0, 4096))
    """Physics threads; 0 for the CPUs that this process may use."""
    torch_threads: int = setting(0, within=(0, 4096))
    """Threads of torch; 0 for the CPUs that this process may use, and fewer while others use them."""
    compiled: bool = setting(False)
    """Use torch.compile for what the task computes at every step and, where the learner is on the CPU, of policy and
    losses; on a GPU, CUDA graphs of policy and optimiser steps. A resumed run then equals the uninterrupted one
    up to rounding. It needs a C++ compiler and half a minute."""
    collector: Literal["direct", "process", "ray", "distributed"] = setting("direct", alias="collector")
    """Collector of batches: direct in this process, or in `workers` others by TorchRL's engine."""
    workers: int = setting(2, within=(1, 4096), alias="workers")
    """Processes that share the robots and the CPUs, unless direct."""


@dataclass(frozen=True)
class LoggingConfig(Settings):
    """Checkpoints and logs of a run."""

    group = "logging"

    checkpoint_seconds: float = setting(60.0, within=(0, 1e6), unit="s")
    """Longest time between two checkpoints."""
    logger: Literal["tensorboard", "wandb", "mlflow", "csv"] = setting("tensorboard", alias="logger")
    """TorchRL's logger beside progress.csv, which is always written; csv for that alone. wandb and mlflow read their
    variables, such as WANDB_PROJECT and MLFLOW_TRACKING_URI."""
