"""Wrong command lines."""

from __future__ import annotations

import subprocess
import sys

import pytest


@pytest.mark.parametrize(
    ("arguments", "culprit", "remedy"),
    [
        ("", "command", "required"),
        ("trian", "'trian'", "choose from"),
        ("list robot", "'robot'", "robots"),
        ("train --rbot a1", "'--rbot'", "did you mean '--robot'?"),
        ("train --gamma 0.9", "'--gamma'", "did you mean '--ppo.gamma', of the group ppo?"),
        ("train -robot a1", "'-robot'", "did you mean '--robot'?"),
        ("evaluate RUN --quiet", "'--quiet'", "see torchrl-atr evaluate --help"),
        ("train --robot A1", "unknown robot 'A1'", "did you mean 'a1'?"),
        ("train --robot a1.xml", "unknown robot 'a1.xml'", "a .toml file that describes one"),
        ("train --transporter singleboard", "'singleboard'", "did you mean 'single_board'?"),
        ("train --task walkng", "unknown task 'walkng'", "did you mean 'walking'? known: "),
        (
            "train --task walking --transporter two_board",
            "transporter='two_board'",
            "leave it out, or take --task riding",
        ),
        ("train --task walking --curriculum.max-speed 1.6", "max_speed=1.6", "a whole multiple of its bin 0.25"),
        ("train --task walking --robot A1", "unknown robot 'A1'", "did you mean 'a1'?"),
        ("train --estimator cnn-gru", "'cnn-gru'", "did you mean 'cnn_gru'?"),
        ("train --preset litteral", "'litteral'", "did you mean 'literal'?"),
        ("train --ppo.gamma", "'--ppo.gamma'", "Expected 1 value"),
        ("train --task.rewards.termination", "--task.rewards.termination", "needs a value"),
        ("train --task.rewards -1", "'--task.rewards'", "write --task.rewards.NAME VALUE"),
        ("train --task.rewards.terminaton -1", "task.rewards.terminaton=-1", "did you mean 'termination'?"),
        (
            "train --ppo.learning-rat 1e-3",
            "'--ppo.learning-rat'",
            "did you mean '--ppo.learning-rate', of the group ppo?",
        ),
        ("train --velocity 3", "'--velocity'", "list settings"),
        ("train --env.episode-seconds 0", "env.episode_seconds=0.0", "choose a number in [0.1, 1000000] s"),
        ("train --ppo.gamma 1.5", "gamma=1.5", "choose a number in [0, 0.99999]"),
        ("train --ppo.critic-cells 0", "critic_cells=0", "choose a number in [1, 100000]"),
        ("train --ppo.learning-rate 0.5", "learning_rate=0.5", "must not exceed ppo.max_learning_rate=0.002"),
        ("train --num-envs 2.5", "num_envs=2.5", "a whole number such as"),
        ("train --total-frames inf", "total_frames=inf", "a whole number such as"),
        ("train --seed -1", "seed=-1", "choose a number in [0, 2147483647]"),
        ("train --device mps", "device='mps'", "use 'cpu'"),
        ("train --device cuda:99", "device='cuda:99'", "use 'cpu'"),
        ("train --import my_module.py", "'my_module.py'", "such as my_module"),
        ("train --import no_such_module", "'no_such_module'", "run where it can be found"),
        ("train --num-envs 4 --compute.collector process --compute.workers 3", "workers=3", "choose a multiple"),
        ("train --output ''", "--output", "give a path"),
        ("train --output RUN", "holds a run", "give another --output, --resume"),
        ("train --resume RUN --ppo.gamma 0.9 --robot spot", "--robot, --ppo.gamma", "leave it out"),
        ("train --from nowhere", "no checkpoint at nowhere", "give a run folder"),
        ("train --from RUN --output RUN --overwrite", "begins from", "give another --output"),
        ("train --from RUN --transporter two_board --output x", "do not fit these settings", "the settings"),
        ("train --from RUN --preset literal --output x", "--preset literal", "keeps that run's, default"),
        ("train --from RUN --seed -1 --output x", "seed=-1", "choose a number in [0, 2147483647]"),
        ("train --resume RUN --from RUN", "--from", "leave it out"),
        ("train --exploration.anneal-until 0.2", "anneal_from=0.4", "must be below exploration.anneal_until=0.2"),
        ("train --curriculum.max-speed 2.1", "max_speed=2.1", "a whole multiple of its bin 0.2"),
        ("train --curriculum.max-yaw-rate 0.2", "max_yaw_rate=0.2", "must lie within its bound"),
        ("evaluate RUN --randomization none", "'none'", "choose from"),
        ("evaluate RUN --robots-per-command 0", "--robots-per-command", "a whole number in [1, 100000]"),
        ("evaluate RUN --max-speed nan", "--max-speed", "a number in [0, 100]"),
        ("evaluate RUN --speed-step 0.3", "speed step 0.3", "take 0.5"),
        ("evaluate RUN --max-speed 40 --speed-step 40", "command [-40.0, -1.0]", "within ±(15.0, 2.0)"),
        ("evaluate RUN --protocol marathon", "'marathon'", "choose from"),
        ("evaluate RUN --sensors perfect", "unknown sensor set 'perfect'", "known: ideal, realistic"),
        (
            "evaluate RUN --seconds 60",
            "--seconds",
            "only of --protocol endurance or --protocol rob",
        ),
        ("evaluate RUN --no-pushes", "--no-pushes", "only of --protocol endurance or"),
        (
            "evaluate RUN --protocol endurance --speed-step 1",
            "--speed-step",
            "only of --protocol tracking or --protocol pa",
        ),
        ("evaluate RUN --protocol endurance --max-speed 16", "max_speed=16.0", "give up to 15"),
        ("evaluate RUN --protocol endurance --seconds 0", "--seconds", "a number in [1, 86400]"),
        ("play RUN --video ride.avi", "'ride.avi'", "ends in .mp4 or .gif"),
        ("play RUN --video ride.mp4 --seconds 0", "--seconds", "a number in [0.1, 3600]"),
        ("play RUN --seed -1", "--seed", "a whole number in [0, 2147483647]"),
        ("play RUN", "no display", "--video out.mp4"),
        ("model a1 single_board", "--output", "required"),
    ],
)
def test_refused(refused, tmp_path, monkeypatch, untouched_run, arguments, culprit, remedy):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("torchrl_atr.evaluation.viewer.has_display", lambda: False)
    words = [word.replace("RUN", str(untouched_run)).replace("''", "") for word in arguments.split()]
    refused(words, culprit, remedy)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("arguments", "culprit", "remedy"),
    [("play", "run", "required"), ("train --ppo.gama 0.9", "'--ppo.gama'", "did you mean '--ppo.gamma'")],
)
def test_the_installed_command_does_the_same(tmp_path, check_message, arguments, culprit, remedy):
    command = [sys.executable, "-m", "torchrl_atr.cli", *arguments.split()]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=120)
    assert (done.returncode, done.stdout) == (2, "")
    assert "Traceback" not in done.stderr
    check_message(done.stderr.strip().splitlines()[-1], culprit, remedy)


def test_what_is_no_wrong_input_keeps_its_traceback(tmp_path, monkeypatch):
    (tmp_path / "broken_module.py").write_text("1 / 0\n")
    monkeypatch.chdir(tmp_path)
    from torchrl_atr.cli import main

    with pytest.raises(ZeroDivisionError):
        main(["train", "--import", "broken_module", "--output", "run"])
