"""Verdicts on claims, and the page that gathers them."""

from __future__ import annotations

import json

import pytest

from torchrl_atr._errors import InputError
from torchrl_atr.cli import main
from torchrl_atr.reproduction.report import FAILS, HOLDS, UNKNOWN, Claim, judge, write_report
from torchrl_atr.reproduction.summary import summary
from torchrl_atr.runs.provenance import machine


def test_a_verdict_needs_the_whole_interval_on_one_side():
    assert [judge(each, 0.9) for each in ((0.91, 1.0), (0.5, 0.89), (0.8, 1.0), None)] == [
        HOLDS,
        FAILS,
        UNKNOWN,
        UNKNOWN,
    ]


def test_a_report_says_how_it_was_made_and_the_summary_gathers_its_claims(job, tmp_path):
    claims = [
        Claim("Fast is hard", "error above 0", 0.5, (0.1, 0.9), HOLDS),
        Claim("Light is worse", "error", remark="G2 is missing"),
    ]
    page = write_report(job, tmp_path, "figure4", "Figure 4: tracking", ["text"], claims).read_text()
    assert page.startswith("# Figure 4: tracking\n\n`torchrl-atr reproduce figure`, seed 0")
    assert "Coarse sizes" in page
    assert "| Fast is hard | error above 0 | 0.500 [0.100, 0.900] | **holds** |" in page
    assert "| Light is worse | error | not measured | **cannot be told**. G2 is missing |" in page
    made = json.loads((tmp_path / "figure4.json").read_text())["made"]
    assert {"command", "seed", "hardware", "versions", "seconds", "policies"} <= made.keys()
    assert made["versions"] == machine()["versions"]  # with the commit, in a clone
    assert made["policies"]["a1-single_board"]["fingerprint"] == job.policies[0].fingerprint
    (tmp_path / "all" / "figure4").mkdir(parents=True)
    (tmp_path / "figure4.json").rename(tmp_path / "all" / "figure4" / "figure4.json")
    text = summary(tmp_path / "all").read_text()
    assert "2 tests: 1 holds, 0 does not hold here, 1 cannot be told" in text
    assert "Not made: table5, figure6, figure5, figure7." in text
    assert "(figure4/README.md)" in text


def test_a_summary_of_nothing_is_refused(tmp_path, capsys):
    with pytest.raises(InputError, match="holds no report"):
        summary(tmp_path)
    assert main(["reproduce", "summary", "--output", str(tmp_path)]) == 2
    assert "holds no report" in capsys.readouterr().err
