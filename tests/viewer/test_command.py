"""``torchrl-atr demo`` and ``view``: what they say, and what ends them."""

from __future__ import annotations

import re
import signal
import subprocess
import sys
import threading

import pytest

from torchrl_atr.cli import main
from torchrl_atr.viewer import sources

pytest.importorskip("viser")
pytest.importorskip("mjviser")
from tests.viewer.client import browser, wait_until
from torchrl_atr.viewer.serve import serve
from torchrl_atr.viewer.session import Setup


def test_without_a_policy_it_says_how_to_get_one(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(sources, "policies", dict)
    monkeypatch.chdir(tmp_path)
    assert main(["demo", "--no-open"]) == 2
    error = capsys.readouterr().err
    assert "torchrl-atr train" in error
    assert len(error.strip().splitlines()) == 1


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["view", "nowhere", "--port", "0"], "there is no checkpoint at nowhere"),
        (["demo", "nowhere", "--host", "192.0.2.1"], "192.0.2.1 is not an IPv4 address of this machine"),
        (["view", "nowhere", "--sensors", "perfect", "--robots", "99"], "a whole number in [1, 16]"),
    ],
)
def test_bad_input_is_one_line(arguments, message, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    try:
        code = main([*arguments, "--no-open"])
    except SystemExit as end:  # of the parser
        code = end.code
    assert code == 2
    assert message in capsys.readouterr().err.strip().splitlines()[-1]


def test_a_demo_ends_when_its_last_browser_has_left(run, capsys):
    seen = []

    def visit(page, loop):
        def stay():
            with browser(page._server.get_port()):
                seen.append(wait_until(lambda: loop.session.time > 0.1))

        threading.Thread(target=stay).start()

    serve(Setup(run), port=0, open_browser=False, linger=0.3, started=visit)
    assert seen == [True]
    assert re.fullmatch(r"http://127\.0\.0\.1:\d+ shows .*; Ctrl-C ends it\n", capsys.readouterr().out)


def test_a_signal_ends_it_at_once_and_nothing_is_left(run):
    command = [sys.executable, "-m", "torchrl_atr.cli", "view", str(run), "--port", "0", "--no-open"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        line = process.stdout.readline()
        port = int(re.search(r":(\d+) shows", line)[1])
        with browser(port) as client:
            client.listen(0.5)
            process.send_signal(signal.SIGINT)
            out, error = process.communicate(timeout=60)
    assert (process.returncode, out, error) == (130, "", "stopped\n")
