"""A row of a policy's card says what was measured, with its interval."""

from __future__ import annotations

from benchmarks import scorecard


def test_a_row_has_survival_with_its_interval_and_what_there_is_of_errors():
    metrics = {"survival": 0.88, "n": 400, "settled_speed_error": 0.328, "settled_yaw_error": None}
    text = scorecard.row("endurance", {**metrics, "survival_interval": [0.844, 0.908]})
    assert text == "| 60 s, pushes, commands change every 5 s | 400 | 88.0% [84.4%, 90.8%] | 0.328 | - | - |"
    assert "88.0% [84.4%, 90.8%]" in scorecard.row("tracking", {**metrics, "commands_mastered": 0.3})


def test_every_row_is_a_call_of_evaluate():
    from torchrl_atr.cli.parser import build_parser
    from torchrl_atr.cli.protocols import fill_options

    for _, options in scorecard.EVALUATIONS.values():
        arguments = build_parser().parse_args(["evaluate", "run", *options])
        fill_options(arguments)
        assert arguments.randomization in ("train", "test")
