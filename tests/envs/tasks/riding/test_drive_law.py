"""The drive law against closed forms: Eqs. 1 and 3, and the questions A9-A11."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from torchrl_atr.envs.interpretation import Interpretation, get_interpretation
from torchrl_atr.envs.models import TRANSPORTERS
from torchrl_atr.envs.models.drives import tilt_drive
from torchrl_atr.envs.physics.batch import BatchEngine
from torchrl_atr.envs.tasks.riding.drive_law import DriveHook, DriveLaw, combination, combine, resistance

DECK = TRANSPORTERS.get("single_board_g1")
DT = 0.005


def law(**answers: object) -> DriveLaw:
    """The default law with the jump of sgn(x) in the resistance, but for the given answers."""
    return DriveLaw(DECK, get_interpretation("default", **{"coulomb_smoothing": 0.0, **answers}))


def doubles(values) -> torch.Tensor:
    return torch.as_tensor(values, dtype=torch.float64)


def drive(tilt, interpretation: Interpretation) -> torch.Tensor:
    """Propulsion of the board at rest at these (pitch, roll)."""
    tilt = doubles(tilt)
    return tilt_drive(tilt, torch.zeros_like(tilt), DECK, interpretation)


def run(model: DriveLaw, tilt: tuple[float, float], speeds: tuple[float, float], steps: int, dt: float = DT):
    """Speeds after ``steps`` at a fixed (pitch, roll)."""
    now, scale = doubles([speeds]), model.mass_scale(doubles([DECK.mass]))
    for _ in range(steps):
        now = model(now, doubles([tilt]), scale, dt)
    return now[0].numpy()


def steady(push: float, smoothing: float = 0.0) -> float:
    """The positive root of s(v) (0.2 + 0.05 v + 0.005 v²) = push, by bisection."""
    low, high = 0.0, 100.0
    for _ in range(80):
        v = (low + high) / 2
        sign = np.tanh(v / smoothing) if smoothing else 1.0
        low, high = (v, high) if sign * (0.2 + 0.05 * v + 0.005 * v * v) < push else (low, v)
    return low


@pytest.mark.parametrize("smoothing", [0.0, 0.5])
@pytest.mark.parametrize("pitch", [0.05, 0.2, -0.2, 0.5])
def test_steady_speed_balances_drive_and_resistance(pitch, smoothing):
    expected = np.sign(pitch) * steady(12.0 * abs(pitch) / 0.78, smoothing)
    speed = run(law(coulomb_smoothing=smoothing), (pitch, 0.0), (0.0, 0.0), 1000, dt=0.3)[0]
    assert speed == pytest.approx(expected, rel=1e-6)


@pytest.mark.parametrize("pitch", [0.3, -0.3])
@pytest.mark.parametrize("roll", [0.2, -0.2])
def test_steady_yaw_rate_has_the_sign_of_eq_3(pitch, roll):
    expected = np.sign(pitch) * np.sign(-roll) * steady(3.0 * abs(roll) / 0.78)
    assert run(law(), (pitch, roll), (0.0, 0.0), 1000, dt=0.3)[1] == pytest.approx(expected, rel=1e-6)


def test_drive_peaks_at_twelve_and_three_and_saturates():
    for tilt in (0.78, 1.2):
        forward, yaw = drive([[tilt, -tilt]], Interpretation()).T
        assert (forward[0], yaw[0]) == pytest.approx((12.0, 3.0))


def test_from_rest_the_net_peaks_are_eleven_point_eight_and_two_point_eight():
    assert run(law(), (0.78, -0.78), (0.0, 0.0), 1) / DT == pytest.approx([11.8, 2.8])


@pytest.mark.parametrize("angle", [0.3, -0.1, 1.0])
def test_two_boards_at_one_angle_drive_like_a_single_board_at_that_pitch(angle):
    two = DriveLaw(TRANSPORTERS.get("two_board_g1"), get_interpretation("default", coulomb_smoothing=0.0))
    np.testing.assert_allclose(two.mass_scale(doubles([11.0])), law().mass_scale(doubles([11.0])))
    np.testing.assert_allclose(
        run(two, (angle, angle), (0.4, -0.2), 3), run(law(), (angle, 0.0), (0.4, -0.2), 3), rtol=1e-12
    )


def test_two_boards_steer_by_half_their_difference():
    """θ_avg = 0.2, θ_dif = (θ_R - θ_L) / 2 = 0.1: α = -3 · 0.1 / 0.78 - R, so the right board nose down turns right."""
    two = DriveLaw(TRANSPORTERS.get("two_board_g1"), get_interpretation("default", coulomb_smoothing=0.0))
    speed, yaw_rate = run(two, (0.3, 0.1), (0.0, 0.0), 1) / DT
    assert (speed, yaw_rate) == pytest.approx((12 * 0.2 / 0.78 - 0.2, -3 * 0.1 / 0.78 + 0.2))


def test_sign_of_zero_pitch_is_one():
    assert drive([[0.0, -0.78]], Interpretation())[0, 1].item() == pytest.approx(3.0)


def test_mirrored_tilts_and_speeds_mirror_the_motion():
    rng = np.random.default_rng(0)
    tilt, speeds = doubles(rng.uniform(-0.9, 0.9, (200, 2))), doubles(rng.uniform(-5.0, 5.0, (200, 2)))
    for model in (law(), law(coulomb_smoothing=0.5, steering_smoothing=0.05)):
        scale = model.mass_scale(doubles([DECK.mass] * 200))
        forward = model(speeds, tilt, scale, DT)
        np.testing.assert_allclose(model(-speeds, tilt * doubles([-1, 1]), scale, DT), -forward, atol=1e-12)


def test_resistance_is_odd_by_default_and_even_as_printed():
    x = torch.linspace(0.1, 15.0, 40, dtype=torch.float64)
    odd, literal = Interpretation(coulomb_smoothing=0.0), get_interpretation("literal")
    np.testing.assert_allclose(resistance(x, DECK.resistance, odd), 0.2 + 0.05 * x + 0.005 * x * x)
    np.testing.assert_allclose(resistance(-x, DECK.resistance, odd), -resistance(x, DECK.resistance, odd))
    np.testing.assert_allclose(resistance(-x, DECK.resistance, literal), 0.2 - 0.05 * x + 0.005 * x * x)


def test_literal_resistance_pushes_backwards_at_rest():
    model = DriveLaw(DECK, get_interpretation("literal"))
    assert run(model, (0.0, 0.0), (0.0, 0.0), 1)[0] == pytest.approx(-0.2 * DT / DECK.mass)


@pytest.mark.parametrize("start", [0.1, -0.1, 1e-4])
def test_stiction_stops_the_motion_and_never_reverses_it(start):
    speed, model = start, law()
    for _ in range(120):
        after = run(model, (0.0, 0.0), (speed, 0.0), 1)[0]
        assert after * start >= 0.0
        assert abs(after) <= abs(speed)
        speed = after
    assert speed == 0.0


def test_stiction_holds_the_deck_below_its_threshold_and_lets_go_above():
    threshold = 0.2 / 12.0 * 0.78
    assert run(law(), (0.99 * threshold, 0.0), (0.0, 0.0), 100)[0] == 0.0
    assert run(law(), (1.01 * threshold, 0.0), (0.0, 0.0), 100)[0] > 0.0


def test_smoothed_coulomb_term_grows_from_zero():
    interpretation = Interpretation(coulomb_smoothing=0.5)
    assert resistance(torch.zeros(1), DECK.resistance, interpretation)[0] == 0.0
    expected = np.tanh(1.0 / 0.5) * 0.255
    assert resistance(torch.ones(1), DECK.resistance, interpretation).item() == pytest.approx(expected)


def test_smoothed_steering_sign_vanishes_at_zero_pitch():
    yaw = drive([[0.0, -0.78], [0.05, -0.78]], Interpretation(steering_smoothing=0.05))[:, 1]
    assert yaw.tolist() == pytest.approx([0.0, 3.0 * np.tanh(1.0)])


def test_mass_is_relative_to_nominal_or_printed():
    masses = doubles([DECK.mass, 2 * DECK.mass])
    np.testing.assert_allclose(law().mass_scale(masses), [[1.0, 1.0], [0.5, 0.5]])
    printed = DriveLaw(DECK, get_interpretation("literal")).mass_scale(masses)
    inertia = 11.5 * (0.9**2 + 0.7**2) / 12
    np.testing.assert_allclose(printed, [[1 / 11.5, 1 / inertia], [0.5 / 11.5, 0.5 / inertia]])


def test_as_printed_the_nominal_deck_peaks_near_one():
    model = DriveLaw(DECK, get_interpretation("literal"))
    assert run(model, (0.78, 0.0), (0.0, 0.0), 1)[0] / DT == pytest.approx((12.0 - 0.2) / 11.5)


@pytest.fixture
def hook(scene) -> DriveHook:
    """Of two boards with a robot on each, at rest and level."""
    return BatchEngine(scene, 2, DriveHook, num_threads=1).hook


def test_holding_a_speed_takes_the_same_power_on_boards_of_any_mass(hook, scene):
    """Their resistance is a force, 11.5 kg times the R of Eq. 1: at 2 m/s it takes 11.5 (0.2 + 0.1 + 0.02) 2 W."""
    engine, layout = hook.engine, scene.support_layout
    engine.fields["body_mass"][1, layout.board_bodies] *= 2.0
    hook.refresh(torch.arange(2))
    hook.speeds[:, 0] = 2.0
    engine.qpos[:, layout.tilt_qpos[0]] = 0.32 / 12.0 * 0.78
    assert hook.power().tolist() == pytest.approx([11.5 * 0.32 * 2.0] * 2, rel=0.01)  # tanh(2 / 0.5) is nearly one


def test_the_force_points_along_the_heading_at_the_end_of_the_substep(hook, scene):
    """From rest: the wanted velocity, which has turned by ω dt, is all that is missing."""
    hook.speeds[:] = doubles([[3.0, 8.0], [3.0, -8.0]])
    hook.engine.qpos[:, scene.support_layout.planar_qpos[2]] = 0.3
    hook.apply(DT)
    x, y, _ = hook.engine.qfrc_applied[:, scene.support_layout.planar_dof].unbind(-1)
    torch.testing.assert_close(torch.atan2(y, x), 0.3 + hook.speeds[:, 1] * DT)
    assert hook.speeds[:, 1].abs().min() > 7.9


@pytest.mark.parametrize(
    "matrix", [((1.0, 0.0), (0.0, 1.0)), ((0.5, 0.5), (0.5, -0.5)), ((1.0, 0.0, 2.0), (0.0, 3.0, 0.0))]
)
def test_combined_angles_are_the_matrix_product_in_memory_of_their_own(matrix):
    angles = torch.rand(5, len(matrix[0]), dtype=torch.float64)
    combined = combine(angles, combination(matrix, torch.float64))
    torch.testing.assert_close(combined, angles @ doubles(matrix).T)
    combined.zero_()  # as a drive of one's own may do
    assert angles.all()
