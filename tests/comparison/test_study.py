"""A comparison from the command line: every part once, kept, and refused where it cannot be made."""

from __future__ import annotations

import dataclasses
import json
from functools import partial
from pathlib import Path

import pytest
import torch
from tensordict import TensorDict

from torchrl_atr.cli import main
from torchrl_atr.comparison import CompareOptions, ComparisonError, Study, load_recording, record, study
from torchrl_atr.comparison import recording as recording_module
from torchrl_atr.comparison.fitting import config_with, estimator_weights, networks_with
from torchrl_atr.comparison.recording import AGE, Window
from torchrl_atr.comparison.summary import by_history
from torchrl_atr.modules.estimators import _ESTIMATORS
from torchrl_atr.training import DEPLOYMENT_OVERRIDES, Trainer, load_run, make_config, make_env

TINY = {
    "env.num_envs": 2,
    "ppo.rollout_steps": 4,
    "total_frames": 8,
    "compute.num_threads": 1,
    "compute.torch_threads": 1,
    "ppo.minibatches": 1,
    "ppo.actor_cells": [8],
    "ppo.critic_cells": [8],
    "estimator.name": "mlp",
    "estimator.arguments": {"cells": [8]},
}
PAGE = Path(__file__).parents[2] / "docs" / "compare.md"
"""Its first program is an estimator of one's own."""


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    folder = tmp_path_factory.mktemp("compare") / "run"
    Trainer(make_config(TINY), folder).train()
    return folder


@pytest.fixture(scope="module")
def loaded(run):
    return load_run(run, num_envs=1)[:3]


def test_two_estimators_are_compared_and_more_are_added(run, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(_ESTIMATORS, "_entries", dict(_ESTIMATORS._entries))
    monkeypatch.chdir(tmp_path)
    (tmp_path / "my_estimator.py").write_text(PAGE.read_text().split("```python\n")[1].partition("```")[0])
    asked = ["compare", str(run), "--quick", "--seconds", "0.4", "--output", "report", "--estimators", "mlp"]
    assert main([*asked, "gru"]) == 0
    printed = capsys.readouterr().out
    assert printed.count(": trained in") == 2
    metrics = json.loads((tmp_path / "report" / "comparison.json").read_text())
    (figures,) = metrics["sensors"].values()
    assert list(figures["estimators"]) == ["truth", "as trained", "mlp", "gru"]
    gru = figures["estimators"]["gru"]
    assert [component["label"] for component in gru["components"]][4] == "body velocity x"
    assert len(gru["probe"]["parameters"]) == 34
    assert gru["rides"]["n"] == 2
    assert metrics["command"].startswith(
        f"torchrl-atr compare {run} --estimators mlp gru --sensors realistic --seconds"
    )
    files = {file.name for file in (tmp_path / "report").iterdir()}
    assert {"README.md", "components_realistic.png", "drift_realistic.png"} <= files
    assert "| gru | 1 |" in (tmp_path / "report" / "README.md").read_text()
    # again, with an estimator of one's own: what is there is not made again
    monkeypatch.setattr(study, "fit", partial(_only, "newest_and_mean", study.fit))
    assert main([*asked, "gru", "newest_and_mean", "--import", "my_estimator"]) == 0
    made = [line for line in capsys.readouterr().out.splitlines() if line.partition(" in ")[2].endswith(" s")]
    assert len(made) == 3
    assert all(line.startswith("newest_and_mean, seed 0") for line in made)
    again = json.loads((tmp_path / "report" / "comparison.json").read_text())["sensors"]["realistic"]["estimators"]
    assert {name: again[name] for name in ("truth", "mlp", "gru")} == {
        name: figures["estimators"][name] for name in ("truth", "mlp", "gru")
    }


def _only(name, fit, networks, config, *arguments):
    assert config.estimator.name == name
    fit(networks, config, *arguments)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--estimators", "oracle"], "unknown estimator 'oracle'"),
        (["--estimators", "mlp", "--sensors", "magic"], "magic"),
    ],
)
def test_bad_input_is_one_message_and_nothing_is_recorded(run, tmp_path, capsys, words, message):
    output = tmp_path / "report"
    assert main(["compare", str(run), *words, "--quick", "--output", str(output)]) == 2
    assert message in capsys.readouterr().err
    assert not list(output.glob("**/*.memmap"))


def test_other_settings_are_refused(loaded, tmp_path):
    Study(*loaded, tmp_path, CompareOptions(robots=4, updates=3))._keep_settings()
    Study(*loaded, tmp_path, CompareOptions(robots=4, updates=3, seeds=9))
    with pytest.raises(ComparisonError, match="updates=3, not 5; ask for the same, or give another --output"):
        Study(*loaded, tmp_path, CompareOptions(robots=4, updates=5))


def test_a_run_without_an_encoder_is_refused(loaded, tmp_path):
    config, env, networks = loaded
    networks = networks_with(config, env, networks)
    networks.encoder = None
    with pytest.raises(ComparisonError, match="this run has no encoder"):
        Study(config, env, networks, tmp_path, CompareOptions())


def test_only_the_estimators_are_swapped(loaded):
    config, env, networks = loaded
    swapped = networks_with(config, env, networks)
    weights, other = networks.state_dict(), swapped.state_dict()
    differ = {name for name in weights if not torch.equal(weights[name], other[name])}
    assert differ
    assert all(".net." in name and name in estimator_weights(networks) for name in differ)
    swapped.load_state_dict(estimator_weights(networks), strict=False)
    step = env.reset()
    with torch.no_grad():
        mine, theirs = (each.deployed_policy()(step.clone())["loc"] for each in (networks, swapped))
    assert torch.equal(mine, theirs)
    assert config_with(config, "tcn").estimator.arguments == {}
    assert config_with(config, "mlp") == config


def test_a_recording_holds_rides_as_the_estimators_meet_them(loaded, tmp_path, monkeypatch):
    config, _, networks = loaded
    make = partial(make_env, config, **DEPLOYMENT_OVERRIDES)
    options = CompareOptions(robots=4, seconds=1.0, command_seconds=0.3)
    lasting = recording_module._lifetimes(CompareOptions(robots=400), torch.Generator().manual_seed(0))
    assert 50 <= lasting[:300].min() < 60
    assert 2500 < lasting[:300].max() <= 3000
    assert lasting[300:].isinf().all()
    short = torch.tensor([[20.0], [20.0], [20.0], [torch.inf]])
    monkeypatch.setattr(recording_module, "_lifetimes", lambda *_: short)
    recording = record(networks, make, options, tmp_path / "data", ["no_such_entry"])
    data = load_recording(tmp_path / "data").data
    assert data.shape == (4, 50)
    assert recording.train.shape == (3, 50)
    first, age = data["is_init"].squeeze(-1), data["ride_step"].squeeze(-1)
    assert first[:, 0].all()
    assert age[:3].max() == 19, "robots for training begin anew by themselves"
    assert age[3].max() > 19
    history, observation = data["history"], data["observation"]
    torch.testing.assert_close(history[first], observation[first].unsqueeze(-2).expand(-1, 10, -1))
    later = ~first[:, 1:]
    torch.testing.assert_close(history[:, 1:, -1][later], observation[:, :-1][later])
    torch.testing.assert_close(data["next", "observation"][:, :-1][later], observation[:, 1:][later])
    assert (age[:, 1:] == torch.where(first[:, 1:], 0, age[:, :-1] + 1)).all()
    intrinsic = data["privileged", "intrinsic"]
    assert (intrinsic[:, 1:] == intrinsic[:, :-1]).all(-1)[later].all(), "they change only where a ride begins"
    with torch.no_grad():
        latent = networks.encoder_module(data.select(("privileged", "intrinsic")))["latent", "intrinsic"]
    torch.testing.assert_close(latent, data["latent", "intrinsic"])
    everything = torch.arange(4).unsqueeze(1), torch.arange(50).unsqueeze(0)
    for length in (3, 10, 25):
        longer = Window(length, False, "observation", "history").take(data, *everything)["history"]
        shown = min(length, 10)
        torch.testing.assert_close(longer[..., -shown:, :], history[..., -shown:, :])
        whole = make_env(config_with(config, "mlp", length), num_envs=1, seed=0, **DEPLOYMENT_OVERRIDES)
        assert whole.observation_spec["history"].shape[-2:] == longer.shape[-2:]
    assert torch.equal(longer[..., 0, :][age < 25], observation[first][_ride_of(first)][age < 25])


@pytest.mark.parametrize(("current", "histories"), [(False, [[0, 0, 1], [3, 3, 3]]), (True, [[0, 1, 2], [3, 3, 4]])])
def test_the_newest_row_of_a_history_is_the_observation_itself_only_if_asked_for(current, histories):
    """Two rides of three steps each; their last step and the second one of the other."""
    steps = torch.arange(6).reshape(1, 6, 1)
    data = TensorDict({"observation": steps, AGE: steps % 3}, [1, 6])
    taken = Window(3, current, "observation", "history").take(data, torch.tensor([0]), torch.tensor([2, 4]))
    assert taken["history"].squeeze(-1).tolist() == histories


def _ride_of(first):
    """Number of each step's ride, in the order of ``observation[first]``."""
    return (first.flatten().cumsum(0) - 1).reshape(first.shape)


def test_histories_of_other_lengths_are_rows_of_their_own(run, tmp_path, capsys):
    asked = ["compare", str(run), "--quick", "--seconds", "0.4", "--output", str(tmp_path / "report")]
    assert main([*asked, "--estimators", "mlp", "gru", "--history-lengths", "3", "10", "14"]) == 0
    (figures,) = json.loads((tmp_path / "report" / "comparison.json").read_text())["sensors"].values()
    rows = figures["estimators"]
    assert list(rows) == ["truth", "as trained", "mlp", "gru", "mlp, 3 steps", "mlp, 14 steps"]
    parameters = [row["parameters"] for row in by_history(rows)["mlp"]]
    assert len(set(parameters)) == 3
    assert parameters == sorted(parameters)
    assert list(by_history(rows)) == ["mlp"]
    assert (tmp_path / "report" / "history_realistic.png").is_file()
    page = (tmp_path / "report" / "README.md").read_text()
    assert "history_realistic.png" in page
    assert "| state | as trained | mlp | gru |" in page, "tables of states show the run's length alone"
    assert "--history-lengths 3 10 14" in page
    capsys.readouterr()
    assert main([*asked, "--estimators", "mlp"]) == 0
    assert ": trained in" not in capsys.readouterr().out


def test_a_policy_that_reads_the_history_has_no_other_lengths(loaded, tmp_path):
    config, env, networks = loaded
    reads = dataclasses.replace(config.roa, actor_reads=("history", "latent", "extrinsic"))
    study = Study(dataclasses.replace(config, roa=reads), env, networks, tmp_path, CompareOptions())
    with pytest.raises(ComparisonError, match="this run's actor reads the history itself, of 10 steps"):
        study.run(["mlp"], "realistic", [5])
