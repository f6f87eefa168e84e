"""Named sets of sensor errors of the proprioception."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from typing import Any

from torchrl_atr._registry import Registry
from torchrl_atr.envs.tasks.observation_terms import Group, ObservationError

SensorSet = Mapping[str, Mapping[str, Any]]
"""Fields noise, bias, bias_time and delay to set, by the name of an observation term of ``proprio``."""
_FIELDS = "give a mapping with noise, bias, bias_time and delay"
_ATTITUDE = math.radians(0.5)
SENSORS: Registry[SensorSet] = Registry("sensor set")
SENSORS.register("ideal", {})
SENSORS.register(
    "realistic",
    {
        "acceleration": {"noise": 0.1, "bias": 0.05, "bias_time": 100.0, "delay": 1.0},
        "angular_velocity": {"noise": 0.02, "bias": 0.01, "bias_time": 100.0, "delay": 1.0},
        "orientation": {"bias": _ATTITUDE, "bias_time": 10.0, "delay": 1.0},
        "joint_position": {"noise": 0.005, "delay": 1.0},
        "joint_velocity": {"noise": 0.1, "delay": 1.0},
    },
)
"""``ideal``: the paper states no errors. ``realistic``: IMU and encoders of a robot, up to a control step late."""


def exact(group: Group) -> Group:
    """Return a group of observation terms without errors.

    Example:
        >>> from torchrl_atr.envs.tasks.proprioception import PROPRIO
        >>> exact(with_sensors(PROPRIO, "realistic"))["joint_position"].noise
        0.0
    """
    none: dict[str, Any] = {"noise": 0.0, "bias": 0.0, "bias_time": math.inf, "delay": 0.0}
    return {name: dataclasses.replace(term, **none) for name, term in group.items()}


def with_sensors(group: Group, sensors: str | SensorSet) -> Group:
    """Return a group of observation terms with the errors of a sensor set in place of its own.

    Args:
        group: such as :data:`~torchrl_atr.envs.tasks.proprioception.PROPRIO`.
        sensors: name of a registered set, or your own.

    Raises:
        UnknownNameError: for an unknown name.
        ObservationError: for a term that the group does not have, or a number out of range.

    Example:
        >>> from torchrl_atr.envs.tasks.proprioception import PROPRIO
        >>> with_sensors(PROPRIO, "realistic")["joint_position"].noise
        0.005
    """
    chosen = SENSORS.get(sensors) if isinstance(sensors, str) else sensors
    changed = {}
    for name, errors in chosen.items():
        if name not in group:
            raise ObservationError(f"the sensor set names {name!r}; the observation terms are {', '.join(group)}")
        try:
            changed[name] = dataclasses.replace(group[name], **errors)
        except TypeError as error:
            raise ObservationError(f"the sensor set gives {name!r} the errors {errors!r}; {_FIELDS}") from error
    return {**group, **changed}
