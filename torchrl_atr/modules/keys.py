"""The TensorDict keys that the networks read and write."""

from __future__ import annotations

from dataclasses import dataclass

from tensordict import NestedKey


@dataclass(frozen=True)
class NetworkKeys:
    """Names of the entries that networks and loss meet on; rename any of them for an env with its own names.

    Two are optional, and used where the env has them: ``odometry``, dead-reckoned velocities that the extrinsic
    estimator reads beside the history, and ``outlook``, whatever else the critic may see. None leaves them unused.

    Examples:
        >>> NetworkKeys(observation=("agent", "obs")).observation
        ('agent', 'obs')
    """

    observation: NestedKey = "observation"
    history: NestedKey = "history"
    odometry: NestedKey | None = "odometry"
    intrinsic: NestedKey = ("privileged", "intrinsic")
    extrinsic: NestedKey = ("privileged", "extrinsic")
    outlook: NestedKey | None = ("privileged", "outlook")
    latent: NestedKey = ("latent", "intrinsic")
    intrinsic_estimate: NestedKey = ("estimate", "intrinsic")
    extrinsic_estimate: NestedKey = ("estimate", "extrinsic")
    act_intrinsic: NestedKey = ("act", "intrinsic")
    act_extrinsic: NestedKey = ("act", "extrinsic")
    student: NestedKey = ("act", "student")
    action: NestedKey = "action"
    state_value: NestedKey = "state_value"

    def for_loss(self) -> dict[str, NestedKey]:
        """The same entries by the names that ``ROAClipPPOLoss.set_keys`` has for them.

        Examples:
            >>> NetworkKeys(extrinsic="truth").for_loss()["extrinsic"]
            'truth'
        """
        return {
            "latent": self.latent,
            "latent_estimate": self.intrinsic_estimate,
            "extrinsic": self.extrinsic,
            "extrinsic_estimate": self.extrinsic_estimate,
            "action": self.action,
            "value": self.state_value,
        }
