"""The runtime: readings in, targets out, and wrong readings named with the remedy."""

from __future__ import annotations

import warnings

import numpy as np
import pytest

from torchrl_atr._errors import InputError
from torchrl_atr.deploy import Imu, PolicyRunner, RobotState, run_policy, without_gravity
from torchrl_atr.deploy.manifest import EPISODE
from torchrl_atr.deploy.readings import UnitCheck
from torchrl_atr.deploy.runner import OnnxPolicy

AT_REST = Imu(np.zeros(3), np.zeros(3), np.zeros(2))


@pytest.fixture
def runner(bundle):
    return PolicyRunner(bundle)


@pytest.fixture
def q0(runner):
    return np.array([joint["q0"] for joint in runner.manifest["joints"]])


def step(runner, q0, **changed):
    given = {"imu": AT_REST, "joint_positions": q0, "joint_velocities": np.zeros(12), "command": (0.0, 0.0), **changed}
    return runner.step(**given)


def test_it_gives_targets_gains_and_estimates(runner, q0):
    targets, gains = step(runner, q0)
    low, high = np.array([joint["target_limits"] for joint in runner.manifest["joints"]]).T
    assert targets.shape == (12,)
    assert ((targets >= low) & (targets <= high)).all()
    assert gains.kp.tolist() == [40.0] * 12
    assert gains.kd.tolist() == [1.0] * 12
    assert runner.estimates["contacts"].shape == (4,)
    assert runner.estimates["dead_reckoned_velocity"][:2].tolist() == [0.0, 0.0]
    assert sum(len(value) for value in runner.estimates.values()) == 16 + 3


def test_estimates_by_name_are_the_outputs_of_the_policy_piece_by_piece(bundle, runner, q0):
    step(runner, q0, command=(1.0, 0.1))
    readings = {
        **dict(zip(("acceleration", "angular_velocity", "orientation"), AT_REST)),
        "joint_position": q0,
        "joint_velocity": np.zeros(12),
        "command": (1.0, 0.1),
    }
    policy = OnnxPolicy(bundle, runner.manifest)
    out = policy(np.array([True]), {name: np.float32([value]) for name, value in readings.items()})
    *named, velocity = runner.estimates.values()
    np.testing.assert_array_equal(np.concatenate(named), out["extrinsic"][0])
    np.testing.assert_array_equal(velocity, out["dead_reckoned_velocity"][0])
    assert len(named) > 4


def test_one_robot_at_a_time_gives_what_the_batch_gives(bundle, runner):
    """Every robot of the recorded episode, resets included."""
    with np.load(bundle / EPISODE) as file:
        episode = dict(file)
    for robot in range(episode["start"].shape[1]):
        policy = OnnxPolicy(bundle, runner.manifest)
        names = [name for name in episode if name not in ("start", "action")]
        for t in range(120):
            one = slice(robot, robot + 1)
            out = policy(episode["start"][t, one], {name: episode[name][t, one] for name in names})
            np.testing.assert_allclose(out["action"], episode["action"][t, one], atol=1e-4)


def test_reset_forgets_everything(runner, q0):
    first = step(runner, q0).targets
    for _ in range(5):
        moved = Imu((1.0, 0.5, 0.0), (0.1, 0.0, 0.2), (0.05, 0.0))
        step(runner, q0, imu=moved, command=(1.0, 0.5))
    assert not np.array_equal(step(runner, q0).targets, first)
    runner.reset()
    assert np.array_equal(step(runner, q0).targets, first)


def test_dead_reckoning_integrates_the_acceleration(runner, q0):
    for _ in range(50):
        step(runner, q0, imu=AT_REST._replace(acceleration=(1.0, 0.0, 0.0)))
    assert runner.estimates["dead_reckoned_velocity"][0] == pytest.approx(0.98, abs=0.01)


def test_a_command_beyond_the_range_is_clipped_with_one_warning(runner, q0):
    with pytest.warns(
        UserWarning, match=r"command \(9, 0\.2\) is beyond the range .*\(2\.2, 0\.2\) is followed instead"
    ):
        step(runner, q0, command=(9.0, 0.2))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for _ in range(80):  # it changes by 1.5 m/s a second
            step(runner, q0, command=(9.0, 0.2))
        np.testing.assert_allclose(runner.command, (2.2, 0.2), rtol=1e-5)
        step(runner, q0, command=(2.0, 0.2))


def test_the_command_that_is_followed_approaches_a_jump_at_a_limited_rate(runner, q0):
    """By 1.5 m/s and 0.5 rad/s a second, from zero."""
    for steps in range(3):
        step(runner, q0, command=(1.0, -0.2))
        np.testing.assert_allclose(runner.command, (steps * 0.03, steps * -0.01), atol=1e-6)


def test_a_strict_runner_refuses_it_and_keeps_its_state(bundle, q0):
    strict, other = PolicyRunner(bundle, strict=True), PolicyRunner(bundle)
    for runner in (strict, other):
        step(runner, q0)
    with pytest.raises(InputError, match=r"beyond the range of 'a1-single_board' .*ask for no more than that"):
        step(strict, q0, command=(0.0, -3.0), time=0.02)
    step(strict, q0, time=0.02)  # asked for again, with the same time
    step(other, q0)
    np.testing.assert_array_equal(step(strict, q0).targets, step(other, q0).targets)


WRONG = [
    ({"joint_positions": np.zeros(11)}, r"joint_positions has shape \(11,\); give \(12,\), in rad"),
    ({"joint_positions": np.zeros((2, 12))}, r"give \(12,\), in rad, of one robot"),
    ({"joint_velocities": "fast"}, "joint_velocities is str, no numbers"),
    ({"joint_velocities": np.full(12, np.nan)}, r"joint_velocities\[0\] is nan; do not command the robot by it"),
    ({"imu": (np.zeros(3), np.zeros(3))}, "imu: give Imu"),
    ({"imu": AT_REST._replace(acceleration=(0.0, np.inf, 0.0))}, r"imu.acceleration\[1\] is inf"),
    ({"imu": AT_REST._replace(orientation=(12.0, 1.0))}, "imu.orientation holds 12.0: degrees"),
    (
        {"imu": AT_REST._replace(orientation=(1.5, 0.0))},
        "imu.orientation holds 1.50 at the start .* degrees",
    ),
    ({"imu": AT_REST._replace(angular_velocity=(0.0, 90.0, 0.0))}, "degrees per second"),
    ({"imu": AT_REST._replace(acceleration=(0.0, 0.0, 9.8))}, "subtract gravity's reaction"),
    ({"joint_velocities": np.full(12, 200.0)}, "joint_velocities holds 200.0, more than 60 rad/s: degrees per second"),
    ({"command": (np.nan, 0.0)}, r"command\[0\] is nan"),
    ({"command": 1.0}, r"command has shape \(\); give \(2,\), in m/s, rad/s"),
]


@pytest.mark.parametrize(("changed", "message"), WRONG)
def test_wrong_readings_are_named(runner, q0, changed, message):
    with pytest.raises(InputError, match=message):
        step(runner, q0, **changed)


def test_degrees_are_recognised(runner, q0):
    with pytest.raises(InputError, match=r"degrees\? give radians"):
        step(runner, q0, joint_positions=np.degrees(q0))


@pytest.mark.parametrize(
    "order",
    [
        [2, 0, 1, 5, 3, 4, 8, 6, 7, 11, 9, 10],  # calf first
        [0, 2, 1, 3, 5, 4, 6, 8, 7, 9, 11, 10],  # calf and thigh exchanged
        [0, 3, 6, 9, 1, 4, 7, 10, 2, 5, 8, 11],  # joint by joint
    ],
)
def test_another_joint_order_is_recognised_at_the_start(runner, q0, order):
    with pytest.raises(InputError, match="order, signs and zeros"):
        step(runner, q0, joint_positions=q0[order])


DEGREES = [
    ({"orientation"}, r"imu.orientation changes 57 times as fast as imu.angular_velocity: degrees"),
    ({"angular_velocity"}, "imu.angular_velocity is 57 times the change of imu.orientation: degrees"),
    ({"joint_velocity"}, "joint_velocities is 57 times the change of joint_positions: degrees"),
    (set(), None),
]


@pytest.mark.parametrize(("wrong", "message"), DEGREES)
def test_degrees_that_look_like_radians_are_recognised_by_their_rates(wrong, message):
    """A sway of 0.15 rad at 0.5 Hz; the joints alike."""
    units, dt = UnitCheck(0.02), 0.02

    def ride():
        for step in range(100):
            angle, rate = 0.15 * np.sin(np.pi * step * dt), 0.15 * np.pi * np.cos(np.pi * step * dt)
            values = {"orientation": (angle, 0.0), "angular_velocity": (rate, 0.0, 0.3), "joint_velocity": [rate] * 12}
            given = {name: np.degrees(value) if name in wrong else np.array(value) for name, value in values.items()}
            units.check(given, np.full(12, angle), given["joint_velocity"])

    if message is None:
        ride()
    else:
        with pytest.raises(InputError, match=message):
            ride()
    units.reset()
    units.check({"orientation": np.zeros(2), "angular_velocity": np.zeros(3)}, np.zeros(12), np.zeros(12))


def test_another_sign_is_recognised_at_the_start(runner, q0):
    with pytest.raises(InputError, match="order, signs and zeros"):
        step(runner, q0, joint_positions=-q0)


def test_names_of_robot_and_joints_are_checked(bundle, runner):
    joints = [joint["name"] for joint in runner.manifest["joints"]]
    PolicyRunner(bundle, robot="a1", joints=joints)
    with pytest.raises(InputError, match="is of the robot 'a1', not 'go1'; take a bundle of that robot"):
        PolicyRunner(bundle, robot="go1")
    swapped = [*joints[6:], *joints[:6]]
    with pytest.raises(InputError, match=r"reorder readings by values\[\[6, 7, 8, 9, 10, 11, 0, 1") as refusal:
        PolicyRunner(bundle, joints=swapped)
    order = eval(str(refusal.value).split("values[")[1].split("]")[0] + "]")
    assert [swapped[i] for i in order] == joints
    with pytest.raises(InputError, match="'tail' is not in both"):
        PolicyRunner(bundle, joints=["tail", *joints[1:]])


def test_a_control_rate_that_differs_is_refused_and_a_late_step_is_not(runner, q0):
    times = np.arange(60) * 0.02
    times[30:] += 0.05  # one late step
    for time in times:
        step(runner, q0, time=time)
    with pytest.raises(InputError, match="does not follow that of the last step"):
        step(runner, q0, time=times[-1])
    runner.reset()
    for time in np.arange(50) * 0.005:
        step(runner, q0, time=time)
    with pytest.raises(InputError, match=r"came every 5\.0 ms; call step\(\) every 20 ms, at 50 Hz"):
        step(runner, q0, time=0.25)


def test_gravity_is_subtracted_in_the_frame_of_the_body():
    roll, pitch = 0.2, -0.1
    cr, sr, cp, sp = np.cos(roll), np.sin(roll), np.cos(pitch), np.sin(pitch)
    rotation = np.array([[cp, sp * sr, sp * cr], [0.0, cr, -sr], [-sp, cp * sr, cp * cr]])
    measured = rotation.T @ (np.array([1.0, 2.0, 3.0]) + (0.0, 0.0, 9.81))
    np.testing.assert_allclose(rotation @ without_gravity(measured, roll, pitch), (1.0, 2.0, 3.0), atol=1e-12)


def test_a_step_that_comes_at_a_wrong_rate_changes_nothing(runner, q0):
    for time in 0.02 * np.arange(50):
        step(runner, q0, time=time)
    for _ in range(2):  # the second one is not called out of order
        with pytest.raises(InputError, match="the last 50 steps came every"):
            step(runner, q0, time=2.0)
    step(runner, q0, time=1.0)


def test_a_robot_whose_readings_fail_is_damped(runner, q0):
    sent = []

    class Failing:
        def read(self):
            positions = q0 if len(sent) < 2 else q0 * np.nan
            return RobotState(0.02 * len(sent), AT_REST, positions, np.zeros(12))

        def send(self, command):
            sent.append(command)

    with pytest.raises(InputError, match="joint_positions"):
        run_policy(runner, Failing(), lambda time: (0.0, 0.0), 1.0)
    assert [float(command.gains.kp.max()) for command in sent] == [40.0, 40.0, 0.0]
    assert sent[-1].gains.kd.tolist() == [1.0] * 12
