"""Riding session: robots, a policy and their controls, step by step, without a page and without a clock."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torchrl.envs import EnvBase
from torchrl.envs.utils import ExplorationType, set_exploration_type

from torchrl_atr._errors import InputError
from torchrl_atr.envs.access import base_env
from torchrl_atr.envs.physics import CONTROL_DT
from torchrl_atr.envs.tasks.rotations import euler_from_matrix, matrix_from_quaternion
from torchrl_atr.evaluation.access import command_limits, command_owner, extrinsic_components
from torchrl_atr.modules import NetworkKeys
from torchrl_atr.modules.estimators import with_state
from torchrl_atr.runs.checkpoint import CHOICES, LAST
from torchrl_atr.runs.restoring import deployed_weights, load_networks
from torchrl_atr.training import DEPLOYMENT_OVERRIDES, load_checkpoint, load_run
from torchrl_atr.viewer.area import CommandArea, mastered_area
from torchrl_atr.viewer.parameters import Parameters
from torchrl_atr.viewer.poses import PoseReader
from torchrl_atr.viewer.readings import Reading, Record
from torchrl_atr.viewer.sensing import Sensing
from torchrl_atr.viewer.sources import stamp

Source = Literal["estimated", "privileged"]
RECORD_SECONDS = 10.0
_KEYS = NetworkKeys()
_FEW = 4
"""Robots up to which one physics thread is faster than several."""


@contextmanager
def _acting() -> Iterator[None]:
    """Run a block without gradients and exploration; loaded networks are in eval mode."""
    with torch.no_grad(), set_exploration_type(ExplorationType.DETERMINISTIC):
        yield


@dataclass(frozen=True)
class Setup:
    """Setup of a session: policy, robot and conditions.

    Attributes:
        policy: folder of a run or of a policy bundle.
        checkpoint: ``"last"`` or ``"best"``.
        robots: number of robots; one has the nominal intrinsics, several have those of the training range.
        sensors: sensor set; None for the run's.
        source: what the policy acts on: its estimates, or the truth.
        seed: of intrinsics, initial states and sensor errors.
        imports: modules to import first.
    """

    policy: Path
    checkpoint: str = LAST
    robots: int = 1
    sensors: str | None = None
    source: Source = "estimated"
    seed: int = 0
    imports: tuple[str, ...] = ()


class Session:
    """Robots that ride as they are told: commands, pushes, other parameters, another policy, between two steps.

    Not thread-safe: all calls come from one thread, see :class:`~torchrl_atr.viewer.Loop`.

    Args:
        setup: what to ride.

    Attributes:
        setup: in force.
        config, env, networks: of the policy that is ridden.
        area: commands that the policy has mastered, if that is known.
        command: asked of all robots, m/s and rad/s.
        followed: index of the robot that the readings are of.
        reading: of the last step; None before the first.
        record: of the last seconds.
        falls: of the followed robot.
        lowest, highest: commands that the task can ask for, (2,) each.
        frames: robot steps that the policy was trained for.
        builds: how often env and networks were made anew; a page compares it with what it shows.
        views: how often another robot was followed, likewise.

    Raises:
        CheckpointError, BundleError: for a policy that cannot be loaded.

    Example:
        >>> from torchrl_atr.training import Trainer, make_config
        >>> import tempfile
        >>> tiny = {"env.num_envs": 2, "total_frames": 8, "ppo.rollout_steps": 2, "ppo.minibatches": 1}
        >>> run = Path(tempfile.mkdtemp())
        >>> Trainer(make_config(tiny), run).save()
        >>> session = Session(Setup(run))
        >>> session.steer(0.5, 0.1)
        >>> [session.step().command.round(3).tolist() for _ in range(3)]  # approached after a step
        [[0.0, 0.0], [0.03, 0.01], [0.06, 0.02]]
    """

    setup: Setup
    env: EnvBase
    reading: Reading | None
    record: Record
    _td: TensorDictBase
    _policy: TensorDictModuleBase

    def __init__(self, setup: Setup) -> None:
        self.followed = 0
        self.command = (0.0, 0.0)
        self.builds = self.views = 0
        self._build(setup)

    def change(self, **changes: Any) -> None:
        """Replace parts of the setup; if that fails, everything stays as it was.

        Raises:
            CheckpointError, BundleError: for a policy that cannot be loaded.
            InputError: for an unknown sensor set, or one that the task does not have.
        """
        setup = dataclasses.replace(self.setup, **changes)
        if setup == self.setup:
            return
        if setup == dataclasses.replace(self.setup, source=setup.source):
            policy = self.networks.deployed_policy(setup.source)
            self.setup = setup
            self._use(policy)
            if any(self._td.get(key, None) is None for key in self._policy.in_keys):  # a memory begins with an episode
                self._td = self._begin()
            return
        self._build(setup)

    def _build(self, setup: Setup) -> None:
        overrides: dict[str, Any] = {**DEPLOYMENT_OVERRIDES, "num_envs": setup.robots, "seed": setup.seed}
        overrides["randomization"] = "off" if setup.robots == 1 else "train"
        overrides["num_threads"] = 1 if setup.robots <= _FEW else None
        if setup.sensors is not None:
            overrides["sensors"] = setup.sensors
        written = stamp(setup.policy, setup.checkpoint)
        checkpoint = CHOICES[setup.checkpoint]
        config, env, networks, state = load_run(setup.policy, checkpoint, setup.imports, **overrides)
        policy = networks.deployed_policy(setup.source)  # a teacher has none that acts on estimates
        self.setup, self.config, self.networks, self._stamp = setup, config, networks, written
        self.frames = int(state.get("frames", 0))
        self.area: CommandArea | None = mastered_area(setup.policy, networks.command_range)
        self.env = env
        self._base = base_env(env)
        self._owner = command_owner(env)
        self._sensing = Sensing(env)
        self.poses = PoseReader(env)
        size = self._base.observation_spec[_KEYS.extrinsic].shape[-1]
        self.components = extrinsic_components(env, size)
        self.terms = tuple(self._base.runner.terms.rewards.terms)
        self._parameters = Parameters(env)
        self.followed = min(self.followed, setup.robots - 1)
        self.lowest, self.highest = command_limits(env, tuple(self._owner.grid.bounds))
        self.builds += 1
        most = self.limits  # a command of before may be beyond them
        self.command = tuple(max(-end, min(end, asked)) for asked, end in zip(self.command, most))  # type: ignore[assignment]
        self._use(policy)
        self.reset()

    def _use(self, policy: TensorDictModuleBase) -> None:
        self._policy = policy  # commands are clipped to its range in either case
        truth = self.setup.source == "privileged"
        self._estimator = self.networks.extrinsic_estimator_module if truth else None
        self.env = with_state(self.env, self._policy)

    @property
    def limits(self) -> tuple[float, float]:
        """Largest |c_v| (m/s) and |c_ω| (rad/s) that a joystick offers: those of the evaluation, where there is one."""
        if self.area is not None:
            speed, yaw_rate = self.area.limits
        else:
            speed, yaw_rate = command_limits(self.env)[1].tolist()
        return min(speed, float(self.highest[0])), min(yaw_rate, float(self.highest[1]))

    @property
    def sensors(self) -> str:
        """Sensor set in force."""
        return self.setup.sensors or str(getattr(self.config.task, "sensors", "ideal"))

    @property
    def parameters(self) -> dict[str, tuple[float, float, float]]:
        """Lowest, highest and present value of the followed robot's payload (kg) and friction, where it has them."""
        return self._parameters.values(self.followed)

    def steer(self, speed: float, yaw_rate: float) -> None:
        """Ask all robots for a speed (m/s) and a yaw rate (rad/s), clipped to what the task can ask for."""
        clipped = np.clip([speed, yaw_rate], self.lowest, self.highest)
        self.command = float(clipped[0]), float(clipped[1])
        self._owner.pin(self.command)

    def follow(self, row: int) -> None:
        """Read another robot, with an empty record.

        Raises:
            InputError: for one that is not there.
        """
        if not 0 <= row < self.setup.robots:
            raise InputError(f"there is no robot {row + 1}; choose one of 1 to {self.setup.robots}")
        self.followed, self.falls, self.reading = row, 0, None
        self.record = self._new_record()
        self.views += 1

    def _new_record(self) -> Record:
        return Record(round(RECORD_SECONDS / CONTROL_DT), len(self.components), self.terms)

    def reset(self) -> None:
        """Start new episodes of all robots: from rest, at the origin, with an empty record."""
        self.time, self.falls = 0.0, 0
        self.reading = None
        self.record = self._new_record()
        self._td = self._begin()

    def _begin(self) -> TensorDictBase:
        self.steer(*self.command)
        with _acting():
            td = self.env.reset()
        self._parameters.apply(range(self.setup.robots), td)
        return td

    def step(self) -> Reading:
        """Make one control step of all robots; those that fall start anew.

        Returns:
            The reading of the followed robot.
        """
        row = self.followed
        self._owner.pin(self.command)  # observed after this step
        with _acting():
            observed = self._policy(self._td)
            if self._estimator is not None and observed.get(_KEYS.extrinsic_estimate, None) is None:
                observed = self._estimator(observed)
            stepped, self._td = self.env.step_and_maybe_reset(observed)
        down = stepped["next", "terminated"].reshape(-1)
        self.time += CONTROL_DT
        self.falls += int(down[row])
        reading = self._sensing.read(stepped, row, self.time, bool(down[row]))
        self.reading = reading
        self.record.add(reading)
        self._parameters.apply(down.nonzero().squeeze(-1).tolist(), self._td)
        return reading

    def push(self, forward: float, left: float) -> None:
        """Change the followed robot's velocity at once, along and across its heading, m/s."""
        engine, row = self._base.engine, self.followed
        dof, place = engine.scene.layout.root_dof, engine.scene.layout.root_qpos
        rotation = matrix_from_quaternion(engine.qpos[row : row + 1, place + 3 : place + 7])
        yaw = euler_from_matrix(rotation)[0, 2]
        cosine, sine = torch.cos(yaw), torch.sin(yaw)
        engine.qvel[row, dof] += cosine * forward - sine * left
        engine.qvel[row, dof + 1] += sine * forward + cosine * left

    def set_parameter(self, name: str, value: float) -> None:
        """Set an intrinsic parameter of the followed robot, such as ``payload`` in kg, now and after falls.

        Raises:
            InputError: for a parameter that the task does not have, or that has several components.
        """
        self._parameters.choose(self.followed, name, value, self._td)

    def refresh(self) -> bool:
        """Load the checkpoint's weights if the run has written a new one; return whether it had.

        Raises:
            CheckpointError: if it cannot be read, or is of other networks; the present weights stay.
        """
        setup, written = self.setup, stamp(self.setup.policy, self.setup.checkpoint)
        if written is None or written == self._stamp:
            return False
        self._stamp = written
        file = CHOICES[setup.checkpoint]
        state = load_checkpoint(setup.policy if file is None else setup.policy / file)
        load_networks(self.networks, deployed_weights(state["learner"]), setup.policy)
        self.frames = int(state.get("frames", 0))
        return True
