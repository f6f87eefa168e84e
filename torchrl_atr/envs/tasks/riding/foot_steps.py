"""Scripted steps that put feet which have drifted over the boards back to their places."""

from __future__ import annotations

import math
from collections.abc import Mapping

import mujoco
import torch
from torch import Tensor
from torch.nn.functional import pad

from torchrl_atr.envs.models import Scene
from torchrl_atr.envs.models.feet import find_feet, foot_positions
from torchrl_atr.envs.models.leg_kinematics import LegKinematics, leg_kinematics
from torchrl_atr.envs.models.robot import JOINTS_PER_LEG, LEGS
from torchrl_atr.envs.models.scene import STAND
from torchrl_atr.envs.tasks.rotations import matrix_from_euler, rotate, rotate_back
from torchrl_atr.envs.tasks.sensor_errors import columns_of

SWING, BLEND, REST = 5, 5, 50
"""Control steps that two feet are in the air, that their legs take back to the policy's targets, and that all four then
stay down at least."""
LIFT = 0.012
"""Highest point of a swing above the board, m. Swings of 2 cm in 6 control steps fell 0.6 % of the robots."""
SETTLING = 10
"""Control steps after the start of an episode in which no foot is lifted: the estimates begin without a history."""
SHARE = 0.03
"""Weight of a step in the running mean of the feet's places: a time constant of 0.7 s. Single estimates are off by
centimetres, and each that crosses the threshold would cost a step."""
CALM_TILT, CALM_TURNING = 0.15, 0.6
"""Largest roll and pitch, rad, and rates of both, rad/s, at which feet are lifted. Two of five robots that fell
after steps without these limits had begun to tip before."""
PAIRS = torch.tensor([[1.0, 0.0, 0.0, 1.0], [0.0, 1.0, 1.0, 0.0]])
"""Diagonal feet of :data:`~torchrl_atr.envs.models.robot.LEGS`, which are lifted together."""
PLACE_COMPONENTS = ("relative_position", "relative_yaw")
"""Components of x_ext that tell where feet are on the board."""
_CYCLE = SWING + BLEND + REST
_EASE = 1.3
"""The feet are over their places before they land: the horizontal part of a swing ends that much sooner."""
_SIZES = (1, 1, 2 * len(LEGS), JOINTS_PER_LEG * len(LEGS), JOINTS_PER_LEG * len(LEGS))
STATE_SIZE = sum(_SIZES)
"""Size of a robot's state: progress, pair, feet's places, joint displacements at lift-off and up to the landing."""


class FootSteps:
    """Change of a policy's action by scripted steps, a function of what a robot senses and estimates.

    Where the mean place of two diagonal feet on the board, by the encoders and the estimated pose of the trunk, is
    further than a threshold from where they stood, their legs leave the policy's targets, swing to these places and
    return to the targets. The other legs are the policy's throughout. Pushes move feet over a board, and riding
    policies do not step back: without such steps, feet are 8 cm off after some minutes, and at the boards' edges.

    Args:
        scene: of the robot, standing with its feet in their places in the keyframe ``stand``.
        proprio: sizes of the components of ``proprio``, in order; must hold angular velocity, orientation and joint
            positions.
        extrinsic: the same of x_ext; must hold the relative position and yaw.
        threshold: mean distance of two feet from their places at which they step, once the robot is calm, m.

    Example:
        >>> from torchrl_atr.envs import make_riding_env
        >>> base = make_riding_env(num_envs=2, seed=0).base_env
        >>> sizes = base.runner.terms.observations.sizes
        >>> steps = FootSteps(base.scene, sizes["proprio"], sizes["privileged", "extrinsic"], threshold=0.06)
        >>> td = base.reset()
        >>> seen = td["proprio"], td["privileged", "extrinsic"]
        >>> action, state = steps(torch.zeros(2, 12), *seen, steps.start(2))
        >>> action.abs().max().item(), state.shape
        (0.0, torch.Size([2, 34]))
    """

    def __init__(
        self, scene: Scene, proprio: Mapping[str, int], extrinsic: Mapping[str, int], threshold: float
    ) -> None:
        self.threshold, self._scale = threshold, scene.robot.action_scale
        self._legs, self._q0 = leg_kinematics(scene.robot), torch.tensor(scene.robot.q0, dtype=torch.float32)
        self._joints = _joints_per_metre(self._legs, self._q0)
        self._home = _standing_feet(scene)
        sensed, estimated = columns_of(proprio), columns_of(extrinsic)
        self._orientation, self._angles = sensed["orientation"], sensed["joint_position"]
        self._turning = sensed["angular_velocity"]
        self._position, self._yaw = estimated["relative_position"], estimated["relative_yaw"]

    def start(self, robots: int) -> Tensor:
        """Return the state at the start of an episode, (N, :data:`STATE_SIZE`)."""
        state = torch.zeros(robots, STATE_SIZE)
        state[:, 0] = -1.0
        return state

    def __call__(self, action: Tensor, proprio: Tensor, extrinsic: Tensor, state: Tensor) -> tuple[Tensor, Tensor]:
        """Return the action that is carried out, and the state after it.

        Args:
            action: of the policy, joint displacement / action scale, (N, 12).
            proprio: what the robot senses, (N, D).
            extrinsic: x_ext that the policy acts on, (N, E).
            state: before, (N, :data:`STATE_SIZE`).
        """
        progress, pair, mean, origin, shift = state.split(_SIZES, -1)
        angles, mean = proprio[:, self._angles], mean.unflatten(-1, (len(LEGS), 2))
        roll, pitch, yaw = torch.cat([proprio[:, self._orientation], extrinsic[:, self._yaw]], -1).unbind(-1)
        to_board = matrix_from_euler(roll, pitch, yaw).unsqueeze(-3)  # from the trunk's frame
        feet = rotate(to_board, self._legs(angles))[..., :2] + extrinsic[:, None, self._position]
        mean = self._remember(feet, mean, progress, pair)
        progress = torch.where(progress < 0, float(_CYCLE - SETTLING), progress)
        offset = mean - self._home
        far, furthest = (offset.norm(dim=-1) @ PAIRS.T.to(offset) / 2.0).max(-1, keepdim=True)
        tilt, turning = proprio[:, self._orientation].abs(), proprio[:, self._turning][:, :2].abs()
        calm = ((tilt < CALM_TILT) & (turning < CALM_TURNING)).all(-1, keepdim=True)
        begins = (progress == 0) & (far > self.threshold) & calm
        pair = torch.where(begins, furthest.to(pair), pair)
        progress = torch.where(begins | (progress > 0), progress + 1, progress)
        progress = torch.where(progress > _CYCLE, 0.0, progress)
        moved = rotate(self._joints, rotate_back(to_board, pad(-offset, (0, 1)))).flatten(-2)
        origin, shift = torch.where(begins, angles - self._q0, origin), torch.where(begins, moved, shift)
        carried_out = self._blend(action, progress, pair, origin, shift)
        return carried_out, torch.cat([progress, pair, mean.flatten(-2), origin, shift], -1)

    def _remember(self, feet: Tensor, mean: Tensor, progress: Tensor, pair: Tensor) -> Tensor:
        """Return the running mean of the feet's places; feet that have just landed are in theirs."""
        landed = (progress == SWING + 1).unsqueeze(-1) & (_of_pair(pair) > 0).unsqueeze(-1)
        mean = torch.where(landed, self._home, mean + SHARE * (feet - mean))
        return torch.where((progress < 0).unsqueeze(-1), feet, mean)

    def _blend(self, action: Tensor, progress: Tensor, pair: Tensor, origin: Tensor, shift: Tensor) -> Tensor:
        phase = (progress / SWING).clamp(max=1.0)
        swings = (progress > 0) & (progress <= SWING)
        eased = (1.0 - torch.cos(math.pi * (_EASE * phase).clamp(max=1.0))) / 2.0
        lift = torch.where(swings, LIFT * torch.sin(math.pi * phase), 0.0)
        target = origin + eased * shift + lift * self._joints[..., 2].flatten()
        fades = (progress > SWING) & (progress <= SWING + BLEND)
        weight = torch.where(swings, 1.0, torch.where(fades, 1.0 - (progress - SWING) / BLEND, 0.0))
        weight = (weight * _of_pair(pair)).unsqueeze(-1).expand(-1, -1, JOINTS_PER_LEG).flatten(-2)
        return action + weight * (target / self._scale - action)


def _of_pair(pair: Tensor) -> Tensor:
    """Return which feet belong to the pair of that index, 0 or 1, (N, 4)."""
    return torch.where(pair > 0.5, PAIRS[1].to(pair), PAIRS[0].to(pair))


def _joints_per_metre(legs: LegKinematics, q0: Tensor) -> Tensor:
    """Return the inverse Jacobian of each leg in q0, rad/m, (4, 3, 3): from the trunk's frame to joints."""
    jacobian = torch.autograd.functional.jacobian(legs, q0)
    own = [jacobian[leg][:, JOINTS_PER_LEG * leg : JOINTS_PER_LEG * (leg + 1)] for leg in range(len(LEGS))]
    return torch.linalg.inv(torch.stack(own))


def _standing_feet(scene: Scene) -> Tensor:
    """Return the feet's horizontal places relative to the pivot in the keyframe ``stand``, m, (4, 2)."""
    data = mujoco.MjData(scene.model)
    mujoco.mj_resetDataKeyframe(scene.model, data, scene.model.key(STAND).id)
    mujoco.mj_kinematics(scene.model, data)
    feet = foot_positions(data, find_feet(scene.model, scene.robot))
    return torch.tensor(feet[:, :2], dtype=torch.float32)
