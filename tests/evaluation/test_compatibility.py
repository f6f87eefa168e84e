"""A policy on other robots and transporters: what can work rides, what cannot is named."""

from __future__ import annotations

from functools import partial

import pytest
from matplotlib import image
from tensordict.nn import TensorDictModule

from torchrl_atr.cli.printing import compatibility_lines
from torchrl_atr.envs import make_riding_env
from torchrl_atr.evaluation.compatibility import (
    CompatibilityError,
    Pair,
    check_fit,
    compatibility_table,
    evaluate_compatibility,
)
from torchrl_atr.evaluation.compatibility_figure import plot_compatibility

SHORT = {"robots": 2, "seconds": 0.04, "command_seconds": 0.04, "settle": 0.0}
STAND = TensorDictModule(lambda o: o.new_zeros(len(o), 12), ["observation"], ["action"])
make_env = partial(make_riding_env, num_threads=1, history_length=2)


def test_every_pair_of_the_size_class_is_ridden(tmp_path):
    ridden = []

    def make(num_envs, **options):
        env = make_env(num_envs=num_envs, **options)
        if num_envs == SHORT["robots"]:
            ridden.append((env.base_env.scene.robot.name, env.base_env.scene.support.name))
        return env

    metrics = evaluate_compatibility(STAND, make, **SHORT)
    assert ridden == [(cell["robot"], cell["transporter"]) for cell in metrics["cells"]]
    cells = {(cell["robot"], cell["transporter"]): cell for cell in metrics["cells"]}
    assert {robot for robot, _ in cells} >= {"a1", "go1"}
    assert {deck for _, deck in cells} == {"single_board_g1", "two_board_g1"}
    assert all(cell["survival"] == 1.0 for cell in cells.values())
    assert metrics["trained_on"] == {"robot": "a1", "transporter": "single_board_g1"}
    metrics["cells"][-1] = {"robot": "go1", "transporter": "two_board_g1", "refused": "joint 3 turns the other way"}
    assert "| a1 | single_board_g1 (trained on) | 100% [34%, 100%]" in "\n".join(compatibility_table(metrics))
    assert next(reversed(list(compatibility_lines(metrics)))).endswith("joint 3 turns the other way")
    assert image.imread(plot_compatibility(metrics, tmp_path / "matrix.png")).shape[1] > 400


def test_what_cannot_work_is_named():
    own, other = (make_env(num_envs=1) for _ in range(2))
    check_fit(STAND, own, other)
    other.base_env.model.jnt_axis[other.base_env.model.joint("FL_calf_joint").id] *= -1.0
    with pytest.raises(CompatibilityError, match="joint FL_calf_joint of a1 on single_board_g1 turns the other way"):
        check_fit(STAND, own, other)
    with pytest.raises(CompatibilityError, match=r"reads 'observation' of size \(46,\); a1 on .* has \(49,\)"):
        check_fit(STAND, own, make_env(num_envs=1, observe_tilt=True))
    with pytest.raises(ValueError, match="'go1' is no pair; give ROBOT/TRANSPORTER"):
        Pair.of("go1")
    with pytest.raises(ValueError, match="unknown robot 'go2'"):
        evaluate_compatibility(STAND, make_env, ["go2/two_board"], **SHORT)
