"""The presets: `paper` has nothing that is ours, and the docs say of each addition what the code says."""

from __future__ import annotations

from pathlib import Path

import pytest
from torch import nn

import torchrl_atr
from torchrl_atr._settings import settings
from torchrl_atr.envs import get_interpretation
from torchrl_atr.envs.tasks.riding import RIDING_REWARDS
from torchrl_atr.envs.transforms import OverspeedTermination, RandomizedStepCounter
from torchrl_atr.listings import settings_page
from torchrl_atr.modules.symmetry import EquivariantLinear
from torchrl_atr.training import PRESETS, TrainConfig, additions, make_config, make_env, make_run_networks

DOCS = Path(torchrl_atr.__file__).parents[1] / "docs"
PAPER = make_config({"preset": "paper"})
ADDITIONS = {  # setting and the value that turns it off, kept apart from the declarations
    "env.staggered_starts": False,
    "env.first_episode_seconds": 0.0,
    "env.overspeed_margin": (),
    "env.failed_episode_replay": 0.0,
    "env.reposition_feet": 0.0,
    "task.sensors": "ideal",
    "task.observe_tilt": False,
    "task.moving_start": 0.0,
    "task.displaced_start": 0.0,
    "task.steering_weight_peak": 1.0,
    "task.steadiness": 0.0,
    "task.slip_weight": 0.0,
    "task.stance": (),
    "task.pushes.interval": 3.0,
    "task.interpretation.coulomb_smoothing": 0.0,
    "task.interpretation.aligned_com": False,
    "task.interpretation.driven_smoothness": False,
    "curriculum.score_from_seconds": 0.0,
    "curriculum.max_speed": 0.0,
    "curriculum.slew_rates": (),
    "exploration.leg_patterns": False,
    "exploration.min_std": 0.0,
    "exploration.noise_correlation": 0.0,
    "exploration.anneal": False,
    "ppo.kl_stop": 0.0,
    "ppo.smoothness_coeff": 0.0,
    "ppo.ema_horizon": 1,
    "ppo.symmetric": False,
    "ppo.command_interaction": False,
    "ppo.tracking_errors": False,
    "ppo.tracking_forecast": False,
    "roa.act_source": "privileged",
    "estimator.dead_reckoning": False,
    "estimator.normalize_targets": False,
}


def value(config, path):
    for name in path.split("."):
        config = getattr(config, name)
    return config


def test_the_list_of_additions_is_whole_and_all_are_off_in_paper():
    assert {each.path: each.value_in("paper") for each in additions()} == ADDITIONS
    for each in additions():
        assert value(PAPER, each.path) == each.value_in("paper"), each.path
        assert value(TrainConfig(), each.path) == each.default, each.path
        assert each.text, each.path


@pytest.mark.parametrize("preset", ["literal", "legged_gym"])
def test_the_other_presets_have_no_additions_either(preset):
    config = make_config({"preset": preset})
    assert {each.path: value(config, each.path) for each in additions()} == ADDITIONS


def test_what_the_paper_prints_is_in_its_preset():
    assert PAPER.env.num_envs == 4096
    assert (PAPER.env.episode_seconds, PAPER.curriculum.command_seconds) == (10.0, 5.0)
    assert PAPER.curriculum.tracking_threshold == 0.8
    assert PAPER.grid.initial == (0.5, 0.3)
    assert (PAPER.grid.bounds, PAPER.grid.increment, PAPER.grid.expansion) == ((15.0, 2.0), 0.1, (0.2, 0.2))
    assert (PAPER.roa.coeff, PAPER.roa.ramp, PAPER.env.history_length) == (0.2, False, 10)
    assert PAPER.ppo.actor_cells == (512, 256, 128)
    task = PAPER.make_task()
    pushes = [step for step in range(1, 500) if step % task.disturbances["push"].steps == 0]
    assert pushes == [150, 300, 450]  # 3, 6 and 9 s
    assert task.rewards == RIDING_REWARDS
    assert task.interpretation == get_interpretation("paper") == PAPER.task.interpretation


def test_a_preset_is_a_profile_of_the_env_too():
    for name in PRESETS:
        if name in ("default", "paper", "literal", "legged_gym"):
            assert make_config({"preset": name}).task.interpretation == get_interpretation(name)


def test_paper_makes_plain_parts():
    config = make_config({"preset": "paper", "env.num_envs": 4, "compute.num_threads": 1})
    env = make_env(config)
    assert not any(isinstance(part, OverspeedTermination | RandomizedStepCounter) for part in env.transform)
    networks = make_run_networks(config, env)
    assert not any(isinstance(part, EquivariantLinear) for part in networks.modules())
    assert networks.exploration.basis is None
    assert networks.backbone.output_map is None
    widths = [part.in_features for part in networks.backbone.net.modules() if isinstance(part, nn.Linear)]
    assert widths[0] == 46 + 16 + 16
    assert networks.exploration.std().tolist() == pytest.approx([0.3] * 12)
    assert set(networks.deployed_policy().in_keys) == {"history", "observation"}
    assert set(networks.critic_module.in_keys) == {
        "observation",
        ("privileged", "intrinsic"),
        ("privileged", "extrinsic"),
    }


def test_what_differs_from_paper_says_why():
    for path, each in settings(TrainConfig).items():
        group = path.split(".")[0]
        if each.value_in("paper") != each.default and group != "ppo":  # whose docstring speaks for all of it
            assert each.text.count(".") >= 1, path


def test_the_page_of_settings_is_up_to_date():
    written = (DOCS / "settings.md").read_text(encoding="utf-8")
    assert written == "\n".join(settings_page()) + "\n", "run: torchrl-atr list settings --markdown > docs/settings.md"
