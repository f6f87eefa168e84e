"""What a profile changes in the recipe: the points of the paper that are not the env's (see ``envs.profiles``)."""

from __future__ import annotations

from typing import Any

from torchrl_atr.envs.profiles import Point

RECIPE_POINTS: dict[str, Point] = {
    "act_source": Point(
        "A24",
        "The paper's figure shows the privileged policy in training and the estimates in deployment.\n"
        "Half of the robots act on their estimates in training, so that estimators see what their errors lead to.",
        literal="privileged",
        ancestor="privileged",
    ),
    "dead_reckoning": Point(
        "ours",
        "The extrinsic estimator reads 0.2 s of history, which sees speed only through the resistance: 0.06 m/s²\n"
        "for each m/s. By default it also reads the integral of the measured acceleration.",
        literal=False,
        ancestor=False,
    ),
    "steering_cue": Point(
        "ours",
        "Table I's actor reads o_t, z and x_ext. The lean that turns changes sign with the speed command (Eq. 3),\n"
        "an exclusive-or that gradients find late; by default the actor also reads tanh(c_v) c_ω.",
        literal=False,
        ancestor=False,
    ),
    "normalize_targets": Point(
        "A25",
        "Eq. 16 sums squared errors of contacts (0 or 1), velocities (up to 15 m/s) and positions alike.\n"
        "Measured in standard deviations each counts.",
        literal=False,
    ),
    "privileged_critic": Point(
        "A20",
        "The paper does not describe its critic.\n"
        "It reads the privileged state, since only the actor is deployed; without, it reads o_t as a real robot could.",
    ),
    "tracking_forecast": Point(
        "ours",
        "The paper's privileged information is x_int and x_ext. By default the critic, which is not deployed, also\n"
        "reads what drives the board and what tracking will be if that lasts.",
        literal=False,
        ancestor=False,
    ),
    "roa_ramp": Point(
        "A23",
        "Whether λ = 0.2 is constant or the end of a ramp is open.\nConstant; the ancestors ramp it up.",
        ancestor=True,
    ),
    "count_own_twice": Point(
        "A4",
        "Whether the own cell is part of the neighbourhood that grows, or grows once more, is open.\n"
        "Once; the ancestors' code counts it twice.",
        ancestor=True,
    ),
    "symmetric": Point(
        "ours",
        "Table I's networks are plain: they have to find out twice what is right on the left and on the right.\n"
        "By default the weights of encoder, actor and critic are tied, so that a mirrored robot acts mirrored.",
        literal=False,
        ancestor=False,
    ),
    "smoothness_coeff": Point(
        "ours",
        "The paper's r11 and r12 weigh 1e-5 and 1e-7: nothing keeps a policy from chattering at 50 Hz, which lifts\n"
        "feet off the board. By default the loss pulls each mean action towards that of the step before.",
        literal=0.0,
        ancestor=0.0,
    ),
    "retry": Point(
        "ours",
        "Table II's intrinsics are drawn anew for every episode. Robots that are hard to keep up have short episodes\n"
        "and are hardly seen: by default half of those that fell try again with the intrinsics they fell with.",
        literal=0.0,
        ancestor=0.0,
    ),
    "init_std": Point(
        "A21",
        "The paper gives no PPO hyper-parameters. The ancestors explore with a standard deviation of 1:\n"
        "on a board, robots then fall within two seconds.",
        ancestor=1.0,
    ),
    "relative_std": Point("A21", "As init_std.\nLegs that pull against each other tilt nothing.", ancestor=1.0),
    "noise_correlation": Point(
        "A21",
        "White noise at 50 Hz averages out before a board has tilted.\nHere a deviation lasts for some ten steps.",
        ancestor=0.0,
    ),
    "anneal_from": Point(
        "A21",
        "Late in a run noise hides which way the board is tilted.\nBy default its ceiling sinks; not in the ancestors.",
        ancestor=0.99,
    ),
}
"""Fields of :class:`~torchrl_atr.training.TrainConfig` that a profile sets, unless the user does."""


TASK_SETTINGS: dict[str, dict[str, Any]] = {
    "walking": {
        "rollout_steps": 24,
        "gamma": 0.99,
        "gae_lambda": 0.95,
        "epochs": 3,
        "learning_rate": 1e-3,
        "max_learning_rate": 3e-3,
        "target_kl": 0.03,
        "entropy_coeff": 0.01,
        "init_std": 0.8,
        "relative_std": 0.8,
        "min_std": 0.05,
        "final_std": 0.12,
        "noise_correlation": 0.0,
        "smoothness_coeff": 0.0,
        "dead_reckoning": False,
        "steering_cue": False,
        "moving_start": 0.0,
        "episode_seconds": 20.0,
        "initial_speed": 0.0,
        "initial_yaw_rate": 0.0,
    },
}
"""Settings of tasks that differ from riding's, unless the user says otherwise; a task of your own may add its own."""


def recipe_of(profile: str, task: str = "riding") -> dict[str, Any]:
    """Return the settings of a profile and a task that differ from the defaults.

    Args:
        profile: name; one that is not ours changes nothing.
        task: name; likewise.

    Example:
        >>> recipe_of("literal")["act_source"], recipe_of("default", "walking")["noise_correlation"]
        ('privileged', 0.0)
    """
    own = dict(TASK_SETTINGS.get(task, {}))
    if profile not in ("literal", "ancestor"):
        return own
    values = {name: getattr(point, profile) for name, point in RECIPE_POINTS.items()}
    return {**own, **{name: value for name, value in values.items() if value is not None}}
