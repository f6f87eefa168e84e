"""``torchrl-atr reproduce``: options, and policies by pair."""

from __future__ import annotations

from dataclasses import replace

import pytest

from torchrl_atr._errors import InputError
from torchrl_atr.cli import main
from torchrl_atr.cli import reproduce as command
from torchrl_atr.cli.reproduce import FIGURES, Figure
from torchrl_atr.reproduction import figure6, paper, policies
from torchrl_atr.reproduction.table5 import table5
from torchrl_atr.reproduction.tracking import grid_of


def test_there_are_eight_pairs_in_two_groups():
    assert len(paper.PAIRS) == 8
    assert [paper.group_of(pair) for pair in paper.PAIRS] == ["G1"] * 4 + ["G2"] * 4
    assert paper.other_robot("spot-two_board") == "anymal_c"
    assert len(paper.STATE_ERRORS) == 16


def test_policies_are_checked_against_the_pair_that_they_are_given_for(untrained, monkeypatch):
    monkeypatch.setattr(policies, "load_rider", lambda folder, imports: untrained)
    assert policies.load_policies(["a1-single_board=run"])[0].name == "a1-single_board"
    with pytest.raises(InputError, match="the run is of a1-single_board, not of go1-single_board"):
        policies.load_policies(["go1-single_board=run"])
    with pytest.raises(InputError, match="is of a1-single_board, too"):
        policies.load_policies(["run", "other"])


def test_an_estimator_that_reads_more_than_the_history_is_not_history_only(job, untrained, tmp_path):
    with pytest.raises(InputError, match="its estimator also reads dead_reckoned_velocity"):
        table5(job, tmp_path, history_only=[untrained])


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("figure4 --policies nowhere", "there is no checkpoint at nowhere"),
        ("figure4 --seeds 3", "--seeds: only of figure7; leave it out"),
        ("figure6 --compatibility", "--compatibility: only of figure4"),
        ("figure5 --max-speed 2", "--max-speed: only of figure4 and table5 and figure7; leave it out"),
        ("figure7 --policies RUN", "--policies: figure7 is not of given policies"),
        ("all --policies RUN --variants fulll", "unknown variant 'fulll'; did you mean 'full'"),
        ("all --policies RUN --maps nowhere", "map 'nowhere'"),
        ("all --policies RUN --walking nowhere", "there is no checkpoint at nowhere"),
        ("all --policies RUN --commands nowhere.csv", "nowhere.csv"),
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


def test_all_leaves_out_what_a_policy_does_not_fit(untrained_run, tmp_path, capsys, monkeypatch):
    def refuse(job, folder):
        raise InputError("no policy fits")

    figures = {"figure4": Figure(lambda imports: refuse, ()), "figure6": FIGURES["figure6"]}
    monkeypatch.setattr(command, "FIGURES", figures)
    monkeypatch.setattr(figure6, "QUICK", figure6.Sizes(1, 0.06))
    words = ["reproduce", "all", "--policies", str(untrained_run), "--quick", "--output", str(tmp_path / "all")]
    assert main(words) == 0
    out = capsys.readouterr().out
    assert "figure4 is left out: no policy fits" in out
    assert "Not made: figure4" in (tmp_path / "all" / "README.md").read_text()


def test_another_command_space_has_as_many_commands(job):
    assert grid_of(job, 3.0, 1.0)[:5] == (3.0, 1.0, 1.0, 0.5, 2)
    assert grid_of(job)[:5] == (15.0, 2.0, 5.0, 1.0, 2)
    assert grid_of(replace(job, quick=False), max_speed=2.0)[:5] == (2.0, 2.0, 0.1, 0.1, 1)
