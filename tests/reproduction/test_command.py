"""``torchrl-atr reproduce``: options, and policies by pair."""

from __future__ import annotations

import pytest

from torchrl_atr._errors import InputError
from torchrl_atr.cli import main
from torchrl_atr.reproduction import figure6, paper
from torchrl_atr.reproduction.policies import load_policies


def test_there_are_eight_pairs_in_two_groups():
    assert len(paper.PAIRS) == 8
    assert [paper.group_of(pair) for pair in paper.PAIRS] == ["G1"] * 4 + ["G2"] * 4
    assert paper.other_robot("spot-two_board") == "anymal_c"
    assert len(paper.STATE_ERRORS) == 16


def test_policies_are_checked_against_the_pair_that_they_are_given_for(untrained_run):
    assert load_policies([f"a1-single_board={untrained_run}"])[0].name == "a1-single_board"
    with pytest.raises(InputError, match="the run is of a1-single_board, not of go1-single_board"):
        load_policies([f"go1-single_board={untrained_run}"])
    with pytest.raises(InputError, match="is of a1-single_board, too"):
        load_policies([str(untrained_run)] * 2)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("figure4 --policies nowhere", "there is no checkpoint at nowhere"),
        ("figure4 --seeds 3", "--seeds: only of figure7; leave it out"),
        ("figure6 --compatibility", "--compatibility: only of figure4"),
        ("figure7 --policies RUN", "--policies: figure7 is not of given policies"),
        ("table5 --policies RUN --history-only RUN", "its estimator also reads dead_reckoned_velocity"),
    ],
)
def test_bad_input_is_one_message(untrained_run, tmp_path, capsys, monkeypatch, words, message):
    monkeypatch.chdir(tmp_path)
    given = [str(untrained_run) if word == "RUN" else word for word in words.split()]
    assert main(["reproduce", *given]) == 2
    assert message in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


def test_the_command_writes_the_report_and_says_how_to_make_it_again(untrained_run, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(figure6, "QUICK", figure6.Sizes(1, 0.06))
    output = tmp_path / "figure6"
    words = ["reproduce", "figure6", "--policies", str(untrained_run), "--quick", "--seed", "7"]
    assert main([*words, "--output", str(output)]) == 0
    assert f"wrote {output / 'README.md'}" in capsys.readouterr().out
    page = (output / "README.md").read_text()
    assert f"`torchrl-atr reproduce figure6 --policies {untrained_run} --seed 7 --quick`, seed 7" in page
