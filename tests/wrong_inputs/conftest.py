"""Shared by the tables of wrong inputs: what every refusal has in common, and a run to spoil."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import pytest

from torchrl_atr.cli import main
from torchrl_atr.training import Trainer, make_config

TINY = {
    "env.num_envs": 2,
    "ppo.rollout_steps": 2,
    "total_frames": 8,
    "compute.num_threads": 1,
    "ppo.minibatches": 1,
    "ppo.critic_cells": [8],
}
_LONGEST = 3 * 160
"""Characters of a message: three lines of a wide terminal."""


def _check(message: str, culprit: str, remedy: str) -> None:
    assert culprit in message
    assert remedy in message
    assert "Traceback" not in message
    assert len(message.splitlines()) <= 3, message
    assert len(message) <= _LONGEST, message


@pytest.fixture
def check_message() -> Callable[[str, str, str], None]:
    """``check_message(message, culprit, remedy)``: it is short and names both."""
    return _check


@pytest.fixture
def refused(capsys) -> Callable[[Sequence[object], str, str], None]:
    """``refused(arguments, culprit, remedy)``: the command ends with code 2 and one such message."""

    def check(arguments: Sequence[object], culprit: str, remedy: str) -> None:
        try:
            code = main([str(argument) for argument in arguments])
        except SystemExit as stop:  # argparse
            code = stop.code
        output = capsys.readouterr()
        assert code == 2
        assert "Traceback" not in output.out
        lines = output.err.strip().splitlines()
        while lines[0].startswith(("usage:", " ")):
            lines = lines[1:]
        assert lines[0].startswith("torchrl-atr")
        _check("\n".join(lines), culprit, remedy)

    return check


@pytest.fixture(scope="session")
def untouched_run(tmp_path_factory) -> Path:
    """The folder of a run that has not begun; only to be read."""
    folder = tmp_path_factory.mktemp("runs") / "run"
    Trainer(make_config(TINY), folder).save()
    return folder


@pytest.fixture
def tiny() -> list[str]:
    """Options of a run that lasts two iterations."""
    values = {**TINY, "ppo.critic_cells": "8"}
    return [part for name, value in values.items() for part in (f"--{name}", str(value))]
