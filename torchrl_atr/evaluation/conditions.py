"""Conditions of a robustness sweep: one parameter at a time, and all together, from training to beyond the test range.

The values of an intrinsic parameter follow from its own ranges: the ends of the training and of the test range, and one
and three times as far beyond the latter as it is from the former.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

from torchrl_atr._errors import InputError
from torchrl_atr._registry import nearest
from torchrl_atr.envs import Simulation, Task
from torchrl_atr.envs.models.scene import TIMESTEP
from torchrl_atr.envs.physics import CONTROL_DT
from torchrl_atr.envs.tasks.intrinsic_parameters import IntrinsicParameter
from torchrl_atr.envs.tasks.sensors import SENSORS, SensorSet

Region = Literal["training", "test", "beyond"]
REGIONS: tuple[Region, ...] = ("training", "test", "beyond")
BASELINE, TOGETHER = "baseline", "together"
BEYOND = (1.0, 3.0)
"""Steps beyond the test range; a step is its distance from the training range."""
SENSOR_FACTORS = (0.0, 1.0, 2.0, 4.0)
SENSOR_DELAYS = (1.0, 2.0, 3.0, 4.0)
"""Largest delays of sensors, control steps; every robot has its own."""
ACTION_DELAYS = (0.005, 0.01, 0.02, 0.04)
TIMESTEPS = (0.01, 0.004, 0.002)
"""Time steps of the simulation beside that of training, s."""
SOLVERS: Mapping[str, Simulation] = {
    "newton, 100 iterations": Simulation(iterations=100),
    "cg": Simulation(solver="cg", iterations=100),
    "pgs": Simulation(solver="pgs", iterations=100),
    "pyramidal cone": Simulation(cone="pyramidal"),
    "without no-slip": Simulation(noslip_iterations=0),
    "euler": Simulation(integrator="euler"),
}
UNITS = {"payload": "kg", "com_shift": "m", "platform_mass": "kg"}
"""Units of intrinsic parameters; others are ratios to a nominal value, or have no unit."""
_VECTOR = 3
"""Components of a vector in space, which is varied axis by axis."""


@dataclass(frozen=True)
class Condition:
    """Condition of a ride: what differs from training.

    Attributes:
        parameter: name of what is varied.
        value: of it, in its unit; a name for what has no number.
        region: where the value is: in the training range, in the test range, or beyond.
        ranges: of intrinsic parameters, see ``env.reconfigure(randomization=...)``.
        sensors: errors of sensors; None for those of training.
        simulation: numerics and delay of actions; None for those of training.
    """

    parameter: str
    value: float | str
    region: Region
    ranges: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    sensors: SensorSet | None = None
    simulation: Simulation | None = None


@dataclass(frozen=True)
class Sweep:
    """Values of one parameter.

    Attributes:
        parameter: its name.
        unit: of the values.
        conditions: from the smallest value to the largest.
        training: range of the values in training; None for names.
        test: range of test; None where there is none.
    """

    parameter: str
    unit: str
    conditions: tuple[Condition, ...]
    training: tuple[float, float] | None = None
    test: tuple[float, float] | None = None


def sweeps_of(task: Task, parameters: Sequence[str] | None = None) -> dict[str, Sweep]:
    """Return the sweeps over a task's parameters by name; all are varied about its own training range and sensors.

    Args:
        task: with intrinsic parameters and observation terms.
        parameters: names of some; None for all.

    Raises:
        InputError: for a name that is not there.

    Example:
        >>> from torchrl_atr.envs import riding
        >>> [condition.value for condition in sweeps_of(riding("a1"))["payload"].conditions]
        [1.0, 3.0, 5.0, 9.0]
    """
    found = {sweep.parameter: sweep for sweep in _sweeps(task)}
    for name in parameters or ():
        if name not in found:
            raise InputError(f"there is no parameter {name!r} to sweep; {nearest(name, found)}")
    return {name: sweep for name, sweep in found.items() if parameters is None or name in parameters}


def _sweeps(task: Task) -> Iterator[Sweep]:
    for name, parameter in task.intrinsics.items():
        vector = parameter.size == _VECTOR
        for part in [f"{name}[{i}]" for i in range(_VECTOR)] if vector else [name]:
            sides = [_outwards(parameter, sign) for sign in (-1, 1)]
            values = [*reversed(sides[0]), *sides[1]]
            conditions = tuple(Condition(part, value, region, {part: (value, value)}) for value, region in values)
            yield Sweep(part, UNITS.get(name, ""), conditions, parameter.train, parameter.test)
    errors, trained = _sensor_errors(task)
    group = task.observations["proprio"]
    if errors:
        late = max((group[name].delay for name in errors), default=0.0)
        factors = tuple(
            Condition("sensor_errors", k, _within(k, trained), sensors=_scaled(errors, k) if k or trained else {})
            for k in SENSOR_FACTORS
        )
        yield Sweep("sensor_errors", "times", factors, (0.0, trained))
        delays = (
            Condition("sensor_delay", _ms(k * CONTROL_DT), _within(k, late), sensors=_late(errors, k, trained))
            for k in SENSOR_DELAYS
        )
        yield Sweep("sensor_delay", "ms", tuple(delays), (0.0, _ms(late * CONTROL_DT)))
    yield Sweep("action_delay", "ms", _simulated("action_delay", ACTION_DELAYS), (0.0, 0.0))
    yield Sweep("timestep", "ms", _simulated("timestep", sorted(TIMESTEPS)), (_ms(TIMESTEP),) * 2)
    numerics = (Condition("solver", name, "beyond", simulation=each) for name, each in SOLVERS.items())
    yield Sweep("solver", "", tuple(numerics))
    yield Sweep(TOGETHER, "", tuple(_together(task, errors, trained)))


def _simulated(name: str, seconds: Sequence[float]) -> tuple[Condition, ...]:
    made: list[tuple[float, dict[str, Any]]] = [(s, {name: s}) for s in seconds]
    return tuple(Condition(name, _ms(s), "beyond", simulation=Simulation(**fields)) for s, fields in made)


def _outwards(parameter: IntrinsicParameter, sign: int) -> list[tuple[float, Region]]:
    """Return values from the end of the training range outwards, on one side; none where it ends at the nominal."""
    side = 0 if sign < 0 else 1
    end, test = parameter.train[side], parameter.test[side]
    if (end - parameter.nominal) * sign <= 0:
        return []
    step = abs(test - end) or abs(end - parameter.nominal)
    values: list[tuple[float, Region]] = [(end, "training")]
    if test != end:
        values.append((test, "test"))
    outer = max(test * sign, end * sign) * sign
    values += [(round(outer + sign * count * step, 6), "beyond") for count in BEYOND]
    positive = min(parameter.train) > 0.0  # a mass, a stiffness: less than nothing has no meaning
    return [(value, region) for value, region in values if value > 0.0 or not positive]


def _sensor_errors(task: Task) -> tuple[dict[str, dict[str, Any]], float]:
    """Return the errors of a task's sensors and 1; those of the realistic set and 0 if it has none."""
    group = task.observations["proprio"]
    own = {
        name: {"noise": term.noise, "bias": term.bias, "bias_time": term.bias_time, "delay": term.delay}
        for name, term in group.items()
        if term.has_errors
    }
    if own:
        return own, 1.0
    return {name: dict(each) for name, each in SENSORS.get("realistic").items() if name in group}, 0.0


def _scaled(errors: SensorSet, factor: float) -> SensorSet:
    """Return sensor errors with noise and bias times a factor, and their delays."""
    worse = {name: {k: factor * each[k] for k in ("noise", "bias") if k in each} for name, each in errors.items()}
    return {name: {**each, **worse[name]} for name, each in errors.items()}


def _late(errors: SensorSet, steps: float, factor: float) -> SensorSet:
    """Return sensor errors with a largest delay, control steps."""
    own = _scaled(errors, factor) or {name: {} for name in errors}
    return {name: {**each, "delay": steps} for name, each in own.items()}


def _together(task: Task, errors: SensorSet, trained: float) -> Iterator[Condition]:
    """Yield all parameters at once, uniform over ever wider ranges, with worse sensors and later actions."""
    stages: list[tuple[str, Region, float, Simulation | None]] = [
        ("training range", "training", trained, None),
        ("test range", "test", trained, None),
        ("one step beyond", "beyond", 2.0, Simulation(action_delay=0.005, timestep=0.004)),
        ("three steps beyond", "beyond", 4.0, Simulation(action_delay=0.01, timestep=0.004)),
    ]
    for stage, (name, region, factor, simulation) in enumerate(stages):
        ranges = {key: _range(parameter, stage) for key, parameter in task.intrinsics.items()}
        sensors = None if factor == trained else _scaled(errors, factor)
        yield Condition(TOGETHER, name, region, ranges, sensors, simulation)


def _range(parameter: IntrinsicParameter, stage: int) -> tuple[float, float]:
    """Return the range of a parameter at a stage of the sweep over all of them."""
    ends = []
    for sign, end in zip((-1, 1), parameter.train):
        values = _outwards(parameter, sign)
        shift = stage if any(region == "test" for _, region in values) else max(0, stage - 1)
        ends.append(values[min(shift, len(values) - 1)][0] if values else end)
    return ends[0], ends[1]


def _within(value: float, trained: float) -> Region:
    return "training" if value <= trained else "beyond"


def _ms(seconds: float) -> float:
    return round(1e3 * seconds, 6)


def describe(condition: Condition) -> dict[str, Any]:
    """Return a condition as plain values, which tell it from others.

    Example:
        >>> describe(Condition("payload", 1.0, "training", {"payload": (1.0, 1.0)}))["ranges"]
        {'payload': [1.0, 1.0]}
    """
    simulation = condition.simulation
    return {
        "parameter": condition.parameter,
        "value": condition.value,
        "region": condition.region,
        "ranges": {name: list(ends) for name, ends in condition.ranges.items()},
        "sensors": None if condition.sensors is None else _plain(condition.sensors),
        "simulation": None if simulation is None else dataclasses.asdict(simulation),
    }


def _plain(sensors: SensorSet) -> dict[str, dict[str, Any]]:
    return {name: {k: None if v == math.inf else v for k, v in each.items()} for name, each in sensors.items()}
