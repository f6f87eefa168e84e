"""What ``evaluate`` asks for under each protocol."""

from __future__ import annotations

import pytest

from torchrl_atr.cli.parser import build_parser
from torchrl_atr.cli.protocols import fill_options
from torchrl_atr.evaluation import command_grid
from torchrl_atr.training import ConfigError


def options(*words):
    arguments = build_parser().parse_args(["evaluate", "run", *words])
    fill_options(arguments)
    return arguments


def test_paper_asks_for_every_command_of_the_test_range():
    asked = options("--protocol", "paper")
    assert asked.randomization == "test"
    speeds, yaw_rates = command_grid(asked.max_speed, asked.max_yaw_rate, asked.speed_step, asked.yaw_rate_step)
    assert (len(speeds), len(yaw_rates), asked.robots_per_command) == (301, 41, 1)
    assert (speeds[0], speeds[-1], yaw_rates[-1]) == pytest.approx((-15, 15, 2))


def test_what_is_given_wins_over_the_protocol():
    asked = options("--protocol", "paper", "--randomization", "off", "--speed-step", "3")
    assert (asked.randomization, asked.speed_step, asked.max_yaw_rate) == ("off", 3.0, 2.0)


def test_tracking_is_the_default():
    asked = options()
    assert (asked.protocol, asked.randomization, asked.max_yaw_rate, asked.robots_per_command) == (
        "tracking",
        "train",
        1.0,
        8,
    )


def test_robustness_is_many_short_rides_of_the_training_range():
    asked = options("--protocol", "robustness", "--parameters", "payload", "com_shift[0]")
    assert (asked.randomization, asked.robots, asked.seconds, asked.pushes) == ("train", 100, 20.0, True)
    assert asked.parameters == ["payload", "com_shift[0]"]


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--protocol", "endurance", "--parameters", "payload"], "--parameters: only of --protocol robustness"),
        (["--protocol", "robustness", "--on", "go1/two_board"], "--on: only of --protocol compatibility"),
        (["--protocol", "robustness", "--command-range", "record"], "take --protocol tracking"),
        (["--command-range", "record", "--act-source", "privileged"], "leave out --act-source privileged"),
        (["--command-range", "record", "--sensors", "ideal"], "leave out --sensors ideal"),
        (["--command-range", "record", "--checkpoint", "best"], "leave out --checkpoint best"),
        (["--protocol", "robustness", "--randomization", "off"], "begins with the training range"),
        (["--protocol", "compatibility", "--robot", "go1"], "give --on ROBOT/TRANSPORTER"),
    ],
)
def test_options_of_other_protocols_are_refused(words, message):
    with pytest.raises(ConfigError, match=message):
        options(*words)
