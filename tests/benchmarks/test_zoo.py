"""The zoo's command: every step once, in order, again after an interruption from where it was, and its report."""

from __future__ import annotations

import json

import pytest

from benchmarks import scorecard, zoo
from torchrl_atr.cli.parser import build_parser
from torchrl_atr.cli.protocols import fill_options
from torchrl_atr.deploy.manifest import MANIFEST, seal

TRAINED = {"minutes": 90.2, "frames": 25_000_000, "seed": 0, "hardware": {"cpus": 2, "processor": "Some CPU"}}
LASTING = {"n": 400, "survival": 0.93, "survival_interval": [0.9, 0.95], "settled_speed_error": 0.21}
AREA = {"n": 792, "survival": 0.96, "settled_yaw_error": 0.1, "commands_mastered_of_envelope": 0.61}


@pytest.fixture
def asked(tmp_path):
    folders = {name: str(tmp_path / name) for name in ("runs", "policies", "output")}
    return [word for name, folder in folders.items() for word in (f"--{name}", folder)]


@pytest.fixture
def steps(monkeypatch):
    """Steps that write their files at once; ``steps.stop`` names one that is interrupted once."""

    class Steps(list):
        stop = ""

        def __call__(self, name, path, content):
            def work(pair, **_):
                self.append((pair.name, name))
                if self.stop == name:
                    self.stop = ""
                    raise KeyboardInterrupt
                file = path(pair)
                file.parent.mkdir(parents=True, exist_ok=True)
                file.write_text(json.dumps(content(pair)))

            return work

    steps = Steps()

    def bundle(pair):
        (pair.bundle / "policy.onnx").write_text("")
        facts = {"schema": "torchrl_atr.policy_bundle", "version": 2, "files": {}, "training": TRAINED}
        facts["figures"] = zoo.figures(pair.run)
        limits = {"max_speed": 2.0, "max_yaw_rate": 1.0}
        return seal({**facts, "command": {"limits": limits}, "parity": {"error": 3e-6}})

    card = {"evaluations": {"endurance": LASTING, zoo.AREA: AREA}}
    works = {
        "training": steps("training", lambda pair: pair.run / "run.json", lambda _: TRAINED),
        "scorecard": steps("scorecard", lambda pair: pair.run / "scorecard.json", lambda _: card),
        "range of commands": steps("range of commands", lambda pair: pair.run / "command_range.json", lambda _: {}),
        "robustness": steps("robustness", lambda pair: pair.run / "robustness" / "metrics.json", lambda _: {}),
        "compatibility": steps("compatibility", lambda pair: pair.run / "compatibility" / "metrics.json", lambda _: {}),
        "bundle": steps("bundle", lambda pair: pair.bundle / MANIFEST, bundle),
    }
    made = zoo.Pair
    monkeypatch.setattr(zoo, "STEPS", tuple(step._replace(work=works[step.name]) for step in zoo.STEPS))
    monkeypatch.setattr(
        made, "__post_init__", lambda pair: pair.bundle.mkdir(parents=True, exist_ok=True), raising=False
    )
    return steps


NAMES = [step.name for step in zoo.STEPS]


def test_it_does_every_step_once_and_reports(asked, steps, tmp_path):
    pairs = ["--pairs", "a1:single_board", "spot:two_board"]
    assert zoo.main([*asked, *pairs, "--max-minutes", "90"]) == 0
    assert steps == [(pair, name) for pair in ("a1-single_board", "spot-two_board") for name in NAMES]
    text = (tmp_path / "output" / "README.md").read_text()
    cells = ["a1-single_board", "90", "25,000,000", "93% [90%, 95%]", "0.21", "-", "96% [94%, 97%]", "61%"]
    assert f"| {' | '.join(cells)} | ±2 m/s, ±1 rad/s | 3e-06 |" in text
    assert "`python -m benchmarks.zoo --seed 0 --max-minutes 90`" in text
    assert "2 cores (Some CPU)" in text
    assert set(json.loads((tmp_path / "output" / "zoo.json").read_text())["pairs"]) == {
        "a1-single_board",
        "spot-two_board",
    }
    steps.clear()
    assert zoo.main([*asked, *pairs, "--max-minutes", "90"]) == 0
    assert steps == []


@pytest.mark.parametrize("name", ["training", "scorecard", "robustness", "bundle"])
def test_a_stopped_step_is_taken_up_again(asked, steps, name, capsys):
    steps.stop = name
    pairs = ["--pairs", "go1:two_board"]
    assert zoo.main([*asked, *pairs]) == 130
    assert "the same command continues" in capsys.readouterr().err
    done = len(steps)
    assert steps[-1][1] == name
    assert zoo.main([*asked, *pairs]) == 0
    again = [step for _, step in steps[done:]]
    # training is asked again until the scorecard shows that it ended, and so is the range until the sweep is there
    before = {"scorecard": ["training"], "robustness": ["range of commands"]}.get(name, [])
    assert again == [*before, *NAMES[NAMES.index(name) :]]


def test_one_recipe_for_all_pairs(asked):
    configs, here = [], zoo.Path()
    for name in zoo.PAIRS:
        arguments = type(
            "Given",
            (),
            {"seed": 3, "quick": False, "max_minutes": 45.0, "runs": here, "policies": here},
        )
        config = zoo.make_pair(name, arguments).config.to_dict()
        task = config.pop("task")
        configs.append((config, {k: v for k, v in task.items() if k not in ("robot", "transporter")}))
    assert len(configs) == 8
    assert all(config == configs[0] for config in configs)
    assert configs[0][0]["max_minutes"] == 45.0


def test_quick_calls_are_words_that_the_command_line_takes():
    for row, more in zoo.QUICK_ROWS.items():
        arguments = build_parser().parse_args(["evaluate", "run", *scorecard.EVALUATIONS[row][1], *more])
        fill_options(arguments)
    for protocol in ("robustness", "compatibility"):
        fill_options(build_parser().parse_args(["evaluate", "run", "--protocol", protocol, *zoo._QUICK_RIDE]))


def test_what_cannot_be_is_refused(asked, tmp_path, capsys):
    with pytest.raises(SystemExit):
        zoo.main(["--quick"])
    assert "give another folder with --policies" in capsys.readouterr().err
    (tmp_path / "runs" / "a1-two_board").mkdir(parents=True)
    (tmp_path / "runs" / "a1-two_board" / "config.toml").write_text("max_minutes = 3.0\n[ppo]\ngamma = 0.5\n")
    assert zoo.main([*asked, "--pairs", "a1:two_board"]) == 2
    message = capsys.readouterr().err
    assert "trained with" in message
    assert "ppo.gamma=0.5 instead of 0.99" in message
    assert "max_minutes" not in message


@pytest.mark.parametrize("name", ["robustness", "bundle"])
def test_a_bundle_of_other_measurements_or_a_damaged_one_is_packed_again(asked, steps, tmp_path, name):
    pairs = ["--pairs", "go1:two_board"]
    assert zoo.main([*asked, *pairs]) == 0
    steps.clear()
    if name == "bundle":
        (tmp_path / "policies" / "go1-two_board" / MANIFEST).write_text("{}")
    else:
        (tmp_path / "runs" / "go1-two_board" / "robustness" / "metrics.json").unlink()
    assert zoo.main([*asked, *pairs]) == 0
    done = [step for _, step in steps]
    assert done == (["bundle"] if name == "bundle" else ["range of commands", "robustness", "bundle"])
