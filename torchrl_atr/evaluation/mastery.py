"""Range of commands that a policy has mastered, from an evaluation."""

from __future__ import annotations

import numpy as np

from torchrl_atr.evaluation.metrics import mastered_commands
from torchrl_atr.evaluation.tracking import TrackingResult
from torchrl_atr.modules import CommandRange

_TOLERANCE = 1e-9


def mastered_range(result: TrackingResult, share: float = 0.95) -> CommandRange | None:
    """Return the range with the most mastered commands in which at least ``share`` of the commands are mastered.

    A command is mastered if most robots stay up and settle within 0.5 m/s and 0.3 rad/s. Bounds are taken among the
    evaluated speeds, yaw rates and their products, so nothing beyond the evaluated commands is ever in the range: no
    negative speed either, if none was evaluated.

    Args:
        result: of :func:`~torchrl_atr.evaluation.evaluate_tracking`, of a policy that is not clipped.
        share: least share of mastered commands among the evaluated ones in the range.

    Returns:
        The range, the smallest of several with as many commands; None if no range has that share.

    Example:
        >>> from torchrl_atr.evaluation import load_tracking
        >>> mastered_range(load_tracking("run/tracking.npz")).save("run")  # doctest: +SKIP
    """
    mastered = mastered_commands(result)
    speeds, yaw_rates = np.abs(result.speed_commands)[:, None], np.abs(result.yaw_commands)[None]
    lateral = speeds * yaw_rates
    forward_only = bool((result.speed_commands >= 0.0).all())
    best, found = 0, None
    for max_speed in np.unique(speeds):
        for max_yaw_rate in np.unique(yaw_rates):
            inside = (speeds <= max_speed) & (yaw_rates <= max_yaw_rate)
            order = np.argsort(lateral[inside], kind="stable")
            sorted_lateral, good = lateral[inside][order], np.cumsum(mastered[inside][order])
            last = np.append(np.diff(sorted_lateral) > _TOLERANCE, True)  # commands of one product go together
            fits = last & (good >= share * np.arange(1, len(good) + 1))
            if fits.any() and good[fits].max() > best:
                best = int(good[fits].max())
                bound = sorted_lateral[fits & (good == best)][0]
                found = CommandRange(float(max_speed), float(max_yaw_rate), float(bound), forward_only=forward_only)
    return found
