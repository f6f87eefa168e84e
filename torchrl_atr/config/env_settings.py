"""Settings of a run by group: robots and episodes, their task, and the commands that they are given."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

from torchrl_atr._settings import Settings, setting
from torchrl_atr.envs.interpretation import Interpretation
from torchrl_atr.envs.tasks.events import Pushes
from torchrl_atr.envs.tasks.overrides import Ranges
from torchrl_atr.envs.transforms import CommandGrid

MAX_SPEED, MAX_YAW_RATE = CommandGrid().bounds
"""Largest command of the paper: m/s and rad/s."""
TINY = 1e-12
"""Lower bound of what must be positive."""


@dataclass(frozen=True)
class EnvConfig(Settings):
    """Number of simulated robots, and their episodes."""

    group = "env"

    num_envs: int = setting(512, within=(1, 1e6), alias="num-envs", paper=4096)
    """Robots simulated at once. 512 robots of 12 steps learn as much from a frame as 256 of 24, and collect faster."""
    episode_seconds: float = setting(20.0, within=(0.1, 1e6), unit="s", paper=10.0)
    """Time limit of an episode. In 20 s commands change three times and pushes come often, as in a long ride."""
    first_episode_seconds: float = setting(
        5.0, within=(0, 1e6), unit="s", off=0.0, addition="episodes that become longer during training"
    )
    """Time limit of episodes at first; 0 for episode_seconds throughout. Short episodes begin often, at every speed,
    and teach tracking sooner. Without staggered_starts it has no effect."""
    short_episodes: float = setting(0.0, within=(0, 1))
    """Share of the episodes that keep the first time limit. Short ones teach tracking, long ones lasting; with 0.8, at
    a quarter of the length, half of the steps are of each, and fewer robots last a minute."""
    episodes_grow_from: float = setting(0.03, within=(0, 1))
    """Share of the run after which the time limit grows geometrically. Robots stay up for a few seconds by then."""
    episodes_grow_until: float = setting(0.1, within=(0, 1))
    """Share of the run from which on it is episode_seconds. With half of the run, fewer robots last a minute."""
    history_length: int = setting(10, within=(1, 1000))
    """H, control steps of history that the estimators read. 0.2 s, as in the paper."""
    staggered_starts: bool = setting(True, off=False, addition="episodes out of step")
    """Let first episodes end at different times. Otherwise every batch holds the same twentieth of all episodes, and
    metrics oscillate."""
    overspeed_margin: tuple[float, ...] = setting(
        (2.0, 2.0), within=(TINY, 1e6), off=(), addition="termination of boards that run away"
    )
    """Excess over any command (m/s, rad/s) at which the episode of a transporter ends; empty for no such limit. A board
    that ran away is where tracking rewards have no slope."""
    reposition_feet: float = setting(
        0.16, within=(0, 10), off=0.0, addition="scripted steps that put drifted feet back"
    )
    """Mean distance of two diagonal feet from their places on the board, in standing heights, at which a scripted step
    puts them back: 4 cm for an A1; 0 for no such steps. Pushes move feet, no reward has taught a riding robot to step,
    and robots fall at the boards' edges within minutes."""
    failed_episode_replay: float = setting(0.5, within=(0, 1), off=0.0, addition="failed-episode replay")
    """Share of the falls after which the same robot tries again. Robots that fall easily have short episodes and give
    few samples."""


@dataclass(frozen=True)
class TrainingPushes(Pushes):
    """Pushes of a training; an evaluation has those of :class:`~torchrl_atr.envs.tasks.events.Pushes`."""

    interval: float = setting(1.0, within=(0, 1e6), unit="s", off=3.0, addition="more frequent pushes")
    """Time between two pushes; 0 for none. Recovery is what falls are about, and a push in 3 s shows little of it."""


@dataclass(frozen=True)
class TaskConfig(Settings):
    """Task, robot and transporter, and answers to the paper's open questions about them.

    A field of the name of an argument of the task's function is passed to it.
    """

    group = "task"

    name: str = setting("riding", alias="task")
    """A registered task: riding, walking, or a custom one."""
    robot: str = setting("a1", alias="robot")
    """A registered robot, or a .toml file that describes one."""
    transporter: str = setting("single_board", alias="transporter")
    """Riding only: a registered transporter, or a .toml file that describes one."""
    sensors: str = setting("realistic", off="ideal", addition="sensor errors", alias="sensors")
    """A registered sensor set: ideal, as the paper states no errors, or realistic, IMU and encoders as robots have."""
    velocity_filter: str = setting("kalman_filter")
    """Riding only: how the dead-reckoned velocity is computed: integral, leaky_integral, kalman_filter or
    aligned_kalman_filter. Of these the Kalman filters stay within 0.2 m/s for minutes with realistic sensors; the
    aligned one also estimates how far pushes have turned the robot on its boards, and is nearer to the truth; the one
    run that was trained with it lasted no longer."""
    observe_tilt: bool = setting(True, off=False, addition="tilt of the board by leg kinematics")
    """Riding only: let the robot observe the tilt of its feet's plane, by its legs' angles and its IMU. A third of a
    degree, 2 mm at a foot, drives a board at 0.2 m/s, and the sign of its pitch decides how roll turns it."""
    kp: float = setting(0.0, within=(0, 1e5), unit="N m/rad")
    """Nominal stiffness of the joints' PD controllers; 0 for the robot's own."""
    kd: float = setting(0.0, within=(0, 1e5), unit="N m s/rad")
    """Nominal damping of the joints' PD controllers; 0 for the robot's own."""
    stance: tuple[float, ...] = setting((0.15, 0.1, 0.1), within=(-0.5, 0.5), off=(), addition="a wide, low stance")
    """Riding only: how much wider, longer and lower the robot stands than in its own q0, as shares of its height; empty
    for its own. Falls are to the side, and of top-heavy robots."""
    moving_start: float = setting(0.5, within=(0, 1), off=0.0, addition="moving starts")
    """Share of the episodes whose transporter starts at part of the commanded speeds. A lean changes the yaw rate only
    seconds later: a robot that starts in a turn is rewarded at once for the lean that keeps it."""
    displaced_start: float = setting(0.3, within=(0, 1), off=0.0, addition="displaced starts")
    """Share of the episodes whose robot starts shifted and turned on the boards, as after a minute of pushes."""
    steering_weight_peak: float = setting(
        2.0, within=(0, 100), off=1.0, addition="schedule of the steering reward's weight"
    )
    """Factor of r1 in what is learned from, at its peak: it rises from 1 until exploration.anneal_until of the run; 1
    leaves it alone. Turns are rewarded later and with more noise than speeds. With 3, yaw rates are followed better
    and three times as many robots fall."""
    steering_weight_end: float = setting(1.5, within=(0, 100), off=1.0)
    """Value that this factor falls to from there until the run ends. Fewer robots fall at the end."""
    steadiness: float = setting(1.0, within=(0, 1e3), off=0.0, addition="rides that do not sway")
    """Strength of what keeps the body steady, in what is learned from: 1 multiplies r7, r9, r10 and r13 by 10, 5, 500
    and 20; 0 leaves them. As printed, robots sway by a quarter of a radian on average, and roll over."""
    fall_weight: float = setting(100.0, within=(0, 1e6), off=1.0)
    """Factor of r17, early termination, in what is learned from. As printed, times dt, a fall costs less than a step of
    tracking earns."""
    slip_weight: float = setting(60.0, within=(0, 1e6), off=0.0, addition="penalty on feet that slide")
    """Riding only: weight of a penalty that Table III lacks, the sum of the speeds at which feet slide over the boards;
    0 for none. Pushes move feet, and robots fall at the boards' edges within minutes."""
    rewards: dict[str, float] = setting({}, within=(-1e6, 1e6))
    """Weights of reward terms, by name, in place of the task's own: `list rewards`."""
    randomization: dict[str, Ranges] = setting({}, within=(-1e6, 1e6))
    """Ranges of intrinsic parameters, by name, in place of the task's own."""
    pushes: TrainingPushes = field(default_factory=TrainingPushes)
    interpretation: Interpretation = field(default_factory=Interpretation)


@dataclass(frozen=True)
class CurriculumConfig(Settings):
    """Range and duration of the commands, and the rule by which the range grows."""

    group = "curriculum"

    command_seconds: float = setting(5.0, within=(0.1, 1e6), unit="s")
    """Duration of a command. As in the paper."""
    slew_rates: tuple[float, ...] = setting(
        (1.5, 0.5), within=(1e-12, 1e6), off=(), addition="commands that change at a limited rate"
    )
    """Largest change of the command per second (m/s², rad/s²); empty for jumps. Two of three falls of a policy that was
    trained with jumps come within two seconds of one. A command that outruns what a lean can drive leaves errors at
    which tracking rewards have no slope: with 3 and 1.5, a third fewer commands were mastered."""
    tracking_threshold: float = setting(0.6, within=(0.01, 1), paper=0.8)
    """Share γ_v = γ_ω of perfect tracking that lets the command grid grow. 0.8 was too slow for runs of an hour."""
    score_from_seconds: float = setting(
        1.0, within=(0, 1e6), question="A6", unit="s", off=0.0, addition="scores without the first second of a command"
    )
    """Part of a command's time that is not scored. Reaching a command takes time that says nothing about holding it."""
    count_own_twice: bool = setting(False, question="A4", legged_gym=True)
    """Let a succeeding cell of the command grid grow twice. Open whether the own cell is part of the neighbourhood that
    grows, or grows once more. Once; the code of rapid-locomotion-rl counts it twice."""
    initial_speed: float = setting(1.0, within=(0, MAX_SPEED), unit="m/s", paper=0.5)
    """Half width of the first command box; 0 for all of it. A wider first box, for runs of an hour."""
    initial_yaw_rate: float = setting(0.3, within=(0, MAX_YAW_RATE), unit="rad/s", paper=0.3)
    """Half width of the first command box; 0 for all of it. As in the paper."""
    max_speed: float = setting(2.2, within=(0, MAX_SPEED), unit="m/s", off=0.0, addition="a box of commands")
    """Half width of the box that commands never leave, a multiple of the task's bins (riding: 0.2); 0 for the task's
    own. A run of half an hour learns ±2 m/s; give 5 to one of two hours."""
    max_yaw_rate: float = setting(1.2, within=(0, MAX_YAW_RATE), unit="rad/s", off=0.0)
    """Half width of the box that commands never leave, likewise."""

    def bound(self, grid: CommandGrid | None) -> CommandGrid | None:
        """Return a task's command grid with these bounds and first box; None for a task without one.

        Raises:
            ValueError: if the first box is larger than the bounds, or either is no multiple of the bins.
        """
        if grid is None:
            return None
        bounds = self.max_speed or grid.bounds[0], self.max_yaw_rate or grid.bounds[1]
        initial = self.initial_speed or bounds[0], self.initial_yaw_rate or bounds[1]
        return replace(grid, bounds=bounds, initial=initial, count_own_twice=self.count_own_twice)
