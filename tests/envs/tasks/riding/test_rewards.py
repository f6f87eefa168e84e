"""Table III by hand: every term, and how they add up."""

from __future__ import annotations

import dataclasses
import math

import pytest
import torch

from torchrl_atr.envs.interpretation import Interpretation, get_interpretation
from torchrl_atr.envs.models import ROBOTS
from torchrl_atr.envs.riding import RidingEnv
from torchrl_atr.envs.tasks import riding
from torchrl_atr.envs.tasks.riding.rewards import RIDING_REWARDS, outside_polygon, zero_moment_point

Q0 = list(ROBOTS.get("a1").q0)
TRACKING = ("forward_command", "steering_command")
UNEVEN = [[0.2, -0.1, 0.195], [-0.2, -0.1, 0.195], [0.2, 0.1, 0.215], [-0.2, 0.1, 0.275]]


def joints(*values: float) -> list[float]:
    return [*values, *[0.0] * (12 - len(values))]


def forces(*loads: float) -> list[list[float]]:
    return [[0.0, 0.0, load] for load in loads]


TURNING = {
    "platform_acceleration": [3, 4, 0],
    "platform_angular_acceleration": [2, 1, -2],
    "driven_acceleration": [-1.5, 0.5],
}
# (term, situation, value worked out by hand from Table III and the paper's weights)
SHEET = [
    ("forward_command", {"speeds": [1.5, 0.0], "command": (1.5, 0.0)}, 8.0),
    ("forward_command", {"speeds": [1.5, 9.0], "command": (2.0, 0.0)}, 8.0 * math.exp(-1.0)),
    ("forward_command", {"speeds": [-1.0, 0.0], "command": (1.0, 0.0)}, 8.0 * math.exp(-4.0)),
    ("steering_command", {"speeds": [0.0, -0.3], "command": (0.0, -0.3)}, 8.0),
    ("steering_command", {"speeds": [9.0, 0.2], "command": (0.0, 0.45)}, 8.0 * math.exp(-0.5)),
    ("position_alignment", {"com": [1.3, 0.4, 0.5], "platform_position": [1.0, 0.0, 0.15]}, -30.0 * 0.5),
    ("heading_alignment", {"euler": [0, 0, 0.3], "platform_euler": [0, 0, -0.2]}, -4.0 * 0.5),
    ("heading_alignment", {"euler": [0, 0, 3.1], "platform_euler": [0, 0, -3.1]}, -4.0 * (2 * math.pi - 6.2)),
    ("com_stabilization", {"com": [0.19, -0.09, 0.5]}, 0.0),
    ("com_stabilization", {"com": [0.21, 0.0, 0.5]}, -1.0),
    ("com_stabilization", {"com": [0.0, -0.11, 0.5]}, -1.0),
    # height 0.3 over the feet, vertical acceleration 0: the ZMP is 0.3 / 9.81 × 5 = 0.153 m behind the CoM
    ("zmp_stabilization", {"acceleration": [5.0, 0.0, 0.0]}, 0.0),
    ("zmp_stabilization", {"acceleration": [0.0, 5.0, 0.0]}, -1.0),
    ("zmp_stabilization", {"acceleration": [7.0, 0.0, 0.0]}, -1.0),
    # pressed down with 9.81 more, it is half as far
    ("zmp_stabilization", {"acceleration": [7.0, 0.0, 9.81]}, 0.0),
    ("contact_maintenance", {"foot_force": forces(50.0, 0.5, 0.0, 2.0)}, -2.0 * 2),
    ("contact_maintenance", {}, 0.0),
    # 0.275 above the deck's centre, where 0.28 above its top = 0.305 is wanted
    ("height_maintenance", {"position": [0, 0, 0.425]}, -0.03),
    ("height_maintenance", {"position": [0, 0, 0.475]}, -0.02),
    ("transporter_smoothness", {**TURNING, "interpretation": Interpretation(driven_smoothness=True)}, -(1.5 + 0.5)),
    ("transporter_smoothness", {**TURNING, "interpretation": Interpretation(driven_smoothness=False)}, -(5.0 + 3.0)),
    ("body_orientation", {"euler": [0.3, -0.4, 2.0]}, -0.9 * 0.5),
    ("body_velocity", {"angular_velocity": [3, -4, 9], "velocity": [7, 7, -2]}, -1e-3 * (5.0 + 2.0)),
    ("action_smoothness", {"action": joints(3.0, 1.0), "previous_action": joints(0.0, 5.0)}, -1e-5 * 5.0),
    ("joint_torque", {"torque": joints(3, 4)}, -1e-4 * 5),
    ("joint_velocity", {"joint_velocity": joints(6, 8)}, -1e-4 * 10),
    ("joint_acceleration", {"joint_acceleration": joints(0, 1e4)}, -1e-7 * 1e4),
    ("postural_deviation", {"joint_position": [Q0[0] + 0.3, Q0[1] - 0.4, *Q0[2:]]}, -1e-2 * 0.5),
    # 2 × 1 counts; -3 × 1, 4 × (-1) brake
    (
        "energy_efficiency",
        {"torque": joints(2, -3, 4, -5), "torque_velocity": joints(1, 1, -1, -2), "joint_velocity": joints(9)},
        -1e-4 * (2 + 10),
    ),
    ("force_regulation", {"foot_force": forces(150.0, 100.0, 99.0, 250.0)}, -1e-2 * (50 + 150)),
    ("force_regulation", {"foot_force": [[90.0, 120.0, 0.0], *forces(1, 1, 1)]}, -1e-2 * 50),
    ("collision_avoidance", {"other_force": [0.0, 0.0, 1.5]}, -10.0),
    ("collision_avoidance", {"other_force": [0.0, 0.5, 0.5]}, 0.0),
    ("termination", {"terminated": True}, -10.0),
    ("termination", {"terminated": False}, 0.0),
]


def test_the_paper_has_eighteen_terms_with_twenty_weights_and_the_sheet_covers_them():
    assert list(dict.fromkeys(term.symbol for term in RIDING_REWARDS.values())) == [f"r{i}" for i in range(18)]
    assert len(RIDING_REWARDS) == 20
    assert list(dict.fromkeys(name for name, *_ in SHEET)) == list(RIDING_REWARDS)


@pytest.mark.parametrize(("name", "situation", "expected"), SHEET, ids=[f"{i}-{row[0]}" for i, row in enumerate(SHEET)])
def test_term_by_hand(make_context, name, situation, expected):
    value = RIDING_REWARDS[name](make_context(**situation))
    assert value.shape == (1,)
    assert value.item() == pytest.approx(expected, rel=1e-5, abs=1e-6)


def test_feet_that_roll_do_not_slide(make_context):
    slipping = make_context(foot_slip=[0.3, 0.06, 0.04, 0.0])
    assert riding(slip_weight=10.0).rewards["foot_slip"](slipping).item() == pytest.approx(-10.0 * (0.25 + 0.01))


def test_standing_still_as_asked_earns_the_two_tracking_rewards_alone(make_context):
    terms = {name: term(make_context()).item() for name, term in RIDING_REWARDS.items()}
    assert {name for name, value in terms.items() if abs(value) > 1e-6} == set(TRACKING)
    assert terms["forward_command"] == terms["steering_command"] == 8.0


def test_polygon_is_the_quadrilateral_of_the_feet():
    feet = torch.tensor([[0.2, -0.1], [-0.3, -0.2], [0.2, 0.1], [-0.3, 0.2]]).expand(6, 4, 2)
    points = torch.tensor([[0.0, 0.0], [0.0, 0.13], [0.1, 0.13], [-0.25, -0.18], [0.21, 0.0], [-0.31, 0.0]])
    assert outside_polygon(points, feet).tolist() == [0, 0, 1, 0, 1, 1]


def test_alignment_is_of_the_centre_of_mass_or_of_the_trunks_origin(make_context):
    shifted = {"com": [1.0, 0.0, 0.5], "position": [1.3, 0.4, 0.5], "platform_position": [1.0, 0.0, 0.15]}
    for by_com, expected in ((True, 0.0), (False, -30.0 * 0.5)):
        context = make_context(**shifted, interpretation=Interpretation(aligned_com=by_com))
        assert RIDING_REWARDS["position_alignment"](context)[0].item() == pytest.approx(expected, rel=1e-6)


def test_a_rider_who_moves_with_the_board_is_aligned_at_any_speed():
    """The centre of mass is known at the start of the last substep, 5 ms and 25 mm before the board's position."""
    env = RidingEnv(num_envs=1, seed=0, randomization="off", pushes=False, num_threads=1)
    td, state, layout = env.reset(), env.get_state(), env.scene.layout
    state["qvel"][:, layout.root_dof] = state["qvel"][:, env.scene.support_layout.planar_dof[0]] = 5.0
    state["speeds"][:, 0] = 5.0
    env.set_state(state)
    terms = env.step(td.set("action", torch.zeros(1, 12)))["next", "reward_terms"]
    assert abs(terms["position_alignment"].item()) < 0.02 * 30.0 * 0.003


@pytest.mark.parametrize(
    ("situation", "expected"),
    [
        # (0.495 - 0.195) / 9.81 x 3 behind the CoM, and to its right
        ({"acceleration": [3.0, 1.0, 0.0]}, [-0.9 / 9.81, -0.3 / 9.81]),
        # over feet that are 0.22 high on average
        ({"acceleration": [3.0, 0.0, 0.0], "foot_position": UNEVEN}, [-0.275 / 9.81 * 3.0, 0.0]),
        # in free fall and beyond it, feet are taken to carry a tenth of the weight
        ({"acceleration": [0.3, 0.0, -9.81]}, [-0.3 / 0.981 * 0.3, 0.0]),
        ({"acceleration": [0.3, 0.0, -12.0]}, [-0.3 / 0.981 * 0.3, 0.0]),
    ],
    ids=["on level feet", "on uneven feet", "in free fall", "pulled down"],
)
def test_the_zero_moment_point_by_hand(make_state, situation, expected):
    assert zero_moment_point(make_state(**situation))[0].tolist() == pytest.approx(expected, abs=1e-6)


def test_polygon_of_the_feet_in_contact():
    feet = torch.tensor([[0.2, -0.1], [-0.2, -0.1], [0.2, 0.1], [-0.2, 0.1]]).expand(5, 4, 2)  # FR, RR, FL, RL
    point = torch.tensor([0.1, 0.06]).expand(5, 2)  # towards FL, just left of the diagonal RR-FL
    lifted = [(), (0,), (1,), (2,), (0, 3)]
    contacts = torch.tensor([[leg not in legs for leg in range(4)] for legs in lifted])
    # FR or RR may be lifted; without FL it tips; two feet are a line
    assert outside_polygon(point, feet, contacts).tolist() == [0, 0, 0, 1, 1]
    assert outside_polygon(point, feet).tolist() == [0] * 5


@pytest.mark.parametrize("term", ["com_stabilization", "zmp_stabilization"])
def test_a_lifted_foot_shrinks_the_polygon_only_if_read_so(make_context, term):
    lifted = {"foot_force": forces(30.0, 30.0, 0.0, 30.0), "com": [0.1, 0.06, 0.5]}
    for contacting, expected in ((False, 0.0), (True, -1.0)):
        context = make_context(**lifted, interpretation=Interpretation(contacting_polygon=contacting))
        assert RIDING_REWARDS[term](context).item() == expected


def test_penalties_are_never_positive(make_context):
    generator = torch.Generator().manual_seed(0)
    example = make_context()
    for _ in range(50):
        state = {
            field.name: torch.randn(getattr(example.state, field.name).shape[1:], generator=generator) * 3
            for field in dataclasses.fields(example.state)
        }
        context = make_context(
            command=(1.0, -1.0),
            action=torch.randn(12, generator=generator),
            previous_action=torch.randn(12, generator=generator),
            terminated=bool(torch.rand((), generator=generator) < 0.5),
            **state,
        )
        for name, term in RIDING_REWARDS.items():
            value = term(context)
            assert torch.isfinite(value).all(), name
            assert (value >= 0).all() if name in TRACKING else (value <= 0).all(), name


@pytest.mark.parametrize("profile", ["default", "legged_gym"])
def test_the_env_emits_terms_that_make_up_its_reward(profile):
    env = RidingEnv(num_envs=3, seed=0, profile=profile, num_threads=1)
    steps = env.rollout(8, break_when_any_done=False)["next"]
    terms = steps["reward_terms"]
    assert list(terms.keys()) == list(RIDING_REWARDS)
    total = torch.stack(list(terms.values())).sum(0)
    if profile == "legged_gym":
        total = (total - terms["termination"]).clamp_min(0.0) + terms["termination"]
    torch.testing.assert_close(steps["reward"], total)


def test_rewards_are_multiplied_by_the_control_period_unless_the_profile_says_no():
    rewards = []
    for times_dt in (True, False):
        interpretation = get_interpretation("default", rewards_times_dt=times_dt)
        env = RidingEnv(num_envs=2, seed=0, profile=interpretation, num_threads=1)
        td = env.reset().set("action", torch.zeros(2, 12))
        rewards.append(env.step(td)["next", "reward"])
    torch.testing.assert_close(rewards[0], 0.02 * rewards[1])
