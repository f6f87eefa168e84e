"""Wrong configuration files."""

from __future__ import annotations

import pytest


@pytest.mark.parametrize(
    ("name", "text", "culprit", "remedy"),
    [
        ("recipe.toml", None, "no configuration file", "check its path"),
        ("recipe.yaml", "gamma: 0.9", "recipe.yaml", "use a .toml or .json file"),
        ("recipe.toml", "gamma 0.9", "recipe.toml is not valid TOML", "at line 1, column 7"),
        ("recipe.toml", "gamma = 0.9\ngamma = 0.8\n", "recipe.toml is not valid TOML", "at line 2"),
        (
            "recipe.json",
            '{"gamma": 0.9,}',
            "recipe.json is not valid JSON",
            "line 1 column 1",
        ),  # 14 or 15: Pythons differ
        ("recipe.json", "[0.9]", "recipe.json holds a list", '{"seed": 1}'),
        (
            "recipe.toml",
            "[ppo]\nlearnin_rate = 1e-3",
            "'ppo.learnin_rate'",
            "did you mean 'ppo.learning_rate', of the group ppo?",
        ),
        ("recipe.toml", "[pppo]\ngamma = 0.9", "unknown setting 'pppo'", "list settings"),
        ("recipe.toml", "gamma = 0.9", "unknown setting 'gamma'", "did you mean 'ppo.gamma', of the group ppo?"),
        ("recipe.toml", "ppo = 3", "ppo=3", "a group of settings; write ppo.NAME, or [ppo]"),
        ("recipe.toml", "[ppo.gamma]\nvalue = 0.9", "gamma={'value': 0.9}", "a number such as"),
        ("recipe.toml", 'ppo.gamma = "high"', "gamma='high'", "a number such as"),
        ("recipe.toml", "env.num_envs = 2.5", "num_envs=2.5", "a whole number such as"),
        ("recipe.toml", "env.num_envs = true", "num_envs=True", "a whole number such as"),
        ("recipe.toml", "estimator.dead_reckoning = 1", "dead_reckoning=1", "true or false"),
        ("recipe.toml", "ppo.critic_cells = 256", "critic_cells=256", "a list such as"),
        ("recipe.toml", "ppo.critic_cells = [256, 'x']", "critic_cells=[256, 'x']", "a list such as"),
        ("recipe.toml", "ppo.critic_cells = [65, 64]", "critic_cells=[65, 64]", "or ppo.symmetric=false"),
        ("recipe.toml", "imports = [3]", "imports=[3]", "a list such as my_module"),
        ("recipe.json", '{"task": {"robot": null}}', "robot=None", "a text such as a1"),
        ("recipe.toml", 'task.robot = "mine.toml"', "no robot file mine.toml", "check its path"),
        (
            "recipe.toml",
            "curriculum.command_seconds = 21",
            "command_seconds=21",
            "must not exceed env.episode_seconds=20",
        ),
        (
            "recipe.toml",
            "curriculum.score_from_seconds = 4.99",
            "score_from_seconds=4.99",
            "below curriculum.command_seconds=5",
        ),
    ],
)
def test_refused(refused, tmp_path, monkeypatch, name, text, culprit, remedy):
    monkeypatch.chdir(tmp_path)
    if text is not None:
        (tmp_path / name).write_text(text)
    before = list(tmp_path.iterdir())
    refused(["train", "--config", tmp_path / name], culprit, remedy)
    assert list(tmp_path.iterdir()) == before
