"""The mastered range holds what was ridden well, and little else."""

from __future__ import annotations

import numpy as np
import torch

from torchrl_atr.evaluation import mastered_range
from torchrl_atr.modules import CommandRange

COMMANDS = (np.arange(-4.0, 5.0), np.arange(-4, 5) * 0.25)


def falls_where(failing):
    return lambda command: command.where(~failing(command.abs()).unsqueeze(-1), torch.tensor(torch.nan))


def test_all_is_mastered(evaluate):
    assert mastered_range(evaluate(lambda command: command, COMMANDS)) == CommandRange(4.0, 1.0, 4.0)


def test_nothing_is_mastered(evaluate):
    assert mastered_range(evaluate(falls_where(lambda c: c[:, 0] >= 0), COMMANDS)) is None


def test_turns_that_are_too_sharp_are_left_out(evaluate):
    result = evaluate(falls_where(lambda c: c.prod(-1) > 1.5), COMMANDS)
    assert mastered_range(result, share=1.0) == CommandRange(4.0, 1.0, 1.5)


def test_a_box_of_slow_commands(evaluate):
    result = evaluate(falls_where(lambda c: (c[:, 0] > 2) | (c[:, 1] > 0.5)), COMMANDS)
    assert mastered_range(result, share=1.0) == CommandRange(2.0, 0.5, 1.0)


def test_a_few_commands_in_it_may_fail(evaluate):
    result = evaluate(falls_where(lambda c: (c[:, 0] == 1) & (c[:, 1] == 0.25)), COMMANDS)  # 4 of 81
    assert mastered_range(result, share=0.95) == CommandRange(4.0, 1.0, 4.0)
    # commands of one product go together: without those of 0.25 m/s², straight lines and turns on the spot are left
    assert mastered_range(result, share=1.0) == CommandRange(4.0, 1.0, 0.0)


def test_turns_that_all_fail_are_left_out_though_the_share_would_let_them_pass(evaluate):
    result = evaluate(falls_where(lambda c: c.prod(-1) > 3.5), COMMANDS)  # 4 of 81, those of 4 m/s²
    assert mastered_range(result, share=0.95) == CommandRange(4.0, 1.0, 3.0)


def test_a_range_of_forward_commands_alone_passes_none_backwards(evaluate):
    mastered = mastered_range(evaluate(lambda command: command, (np.arange(0.0, 3.0), COMMANDS[1])))
    assert mastered == CommandRange(2.0, 1.0, 2.0, forward_only=True)
    assert mastered(torch.tensor([-1.0, 0.0])).tolist() == [0.0, 0.0]
