"""Example of a custom task: riding with one more reward, one more observation and one more hidden parameter.

Run it:  torchrl-atr train --import examples.own_task --task careful_riding --total-frames 100000
"""

from functools import wraps

from torchrl_atr.envs.tasks import TASKS, IntrinsicParameter, ObservationTerm, RewardTerm, mirrors, riding


def leaning(c):
    """Compute the horizontal acceleration of the body, m/s²: a reward term returns (N,)."""
    return c.state.acceleration[:, :2].norm(dim=-1)


def foot_loads(c):
    """Compute the feet's contact forces in quarters of their sum: an observation term returns (N, D)."""
    return c.state.foot_load / c.state.foot_load.sum(-1, keepdim=True).clamp_min(1.0) * 4.0


def friction_loss(fields, value, scene):
    """Set the joints' dry friction, N m: a parameter writes its values (n, size) into fields of n MuJoCo models."""
    fields["dof_frictionloss"][:, scene.layout.joint_dof] = value


@wraps(riding, assigned=())
def careful_riding(*arguments, **settings):
    """Return the task; the settings of a run (robot, sensors, pushes and so on) are its arguments, those of riding."""
    task = riding(*arguments, **settings)
    loads = ObservationTerm(foot_loads, mirror=mirrors.legs, noise=0.05)
    return task.with_observation("proprio", foot_loads=loads).replace(
        name="careful_riding",
        rewards={**task.rewards, "leaning": RewardTerm(leaning, weight=-0.2)},
        intrinsics={
            **task.intrinsics,
            "friction_loss": IntrinsicParameter(
                friction_loss, train=(0.0, 0.4), test=(0.0, 0.6), size="joints", mirror=mirrors.joint_gains
            ),
        },
    )


TASKS.register("careful_riding", careful_riding)
