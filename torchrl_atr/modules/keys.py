"""TensorDict keys that the networks read and write."""

from __future__ import annotations

from dataclasses import dataclass

from tensordict import NestedKey


@dataclass(frozen=True)
class NetworkKeys:
    """Names of the entries that networks and loss share; rename any of them for an env with its own names.

    ``dead_reckoned_velocity`` and ``tracking_forecast`` (predicted tracking) are read only if they are inputs in
    :func:`~torchrl_atr.modules.make_networks`: ``estimator_inputs=[keys.dead_reckoned_velocity]`` and
    ``critic_inputs=[keys.tracking_forecast]``. Scales are the standard deviations of estimates that have one.

    Example:
        >>> NetworkKeys(observation=("agent", "obs")).observation
        ('agent', 'obs')
    """

    observation: NestedKey = "observation"
    history: NestedKey = "history"
    dead_reckoned_velocity: NestedKey = "dead_reckoned_velocity"
    intrinsic: NestedKey = ("privileged", "intrinsic")
    extrinsic: NestedKey = ("privileged", "extrinsic")
    tracking_forecast: NestedKey = ("privileged", "tracking_forecast")
    latent: NestedKey = ("latent", "intrinsic")
    intrinsic_estimate: NestedKey = ("estimate", "intrinsic")
    extrinsic_estimate: NestedKey = ("estimate", "extrinsic")
    intrinsic_scale: NestedKey = ("estimate", "intrinsic_scale")
    extrinsic_scale: NestedKey = ("estimate", "extrinsic_scale")
    act_intrinsic: NestedKey = ("act", "intrinsic")
    act_extrinsic: NestedKey = ("act", "extrinsic")
    act_intrinsic_scale: NestedKey = ("act", "intrinsic_scale")
    act_extrinsic_scale: NestedKey = ("act", "extrinsic_scale")
    student: NestedKey = ("act", "student")
    action: NestedKey = "action"
    state_value: NestedKey = "state_value"

    def for_loss(self) -> dict[str, NestedKey]:
        """Return the same entries by the names that ``ROAClipPPOLoss.set_keys`` has for them.

        Example:
            >>> NetworkKeys(extrinsic="truth").for_loss()["extrinsic"]
            'truth'
        """
        return {
            "latent": self.latent,
            "latent_estimate": self.intrinsic_estimate,
            "extrinsic": self.extrinsic,
            "extrinsic_estimate": self.extrinsic_estimate,
            "latent_estimate_scale": self.intrinsic_scale,
            "extrinsic_estimate_scale": self.extrinsic_scale,
            "action": self.action,
            "sample_log_prob": log_prob_key(self.action),
            "value": self.state_value,
        }


def log_prob_key(action: NestedKey) -> NestedKey:
    """Return the key of an action's log-probability, as TorchRL names it.

    Example:
        >>> log_prob_key("action"), log_prob_key(("agent", "action"))
        ('action_log_prob', ('agent', 'action_log_prob'))
    """
    return f"{action}_log_prob" if isinstance(action, str) else (*action[:-1], f"{action[-1]}_log_prob")
