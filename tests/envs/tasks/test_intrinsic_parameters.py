"""Intrinsic parameters as data: an own one reaches the compiled model; one that cannot be used is named."""

from __future__ import annotations

import pytest
import torch

from torchrl_atr.envs import QuadrupedEnv
from torchrl_atr.envs.physics import ModelFields
from torchrl_atr.envs.tasks import IntrinsicError, IntrinsicParameter, Task, mirrors, riding, walking


def friction_loss(fields, value, scene):
    """Dry friction of the joints, N m."""
    fields["dof_frictionloss"][:, scene.layout.joint_dof] = value


LOSS = IntrinsicParameter(friction_loss, train=(0.0, 0.4), size="joints", mirror=mirrors.joint_gains)


def riding_with(parameter: object) -> Task:
    task = riding(pushes=False)
    return task.replace(intrinsics={**task.intrinsics, "loss": parameter})


def make(parameter: object, num_envs: int = 3, **arguments: object) -> QuadrupedEnv:
    return QuadrupedEnv(riding_with(parameter), num_envs, **{"seed": 0, "num_threads": 1, **arguments})


@pytest.mark.parametrize(("physics", "num_envs"), [("batch", 3), ("dm_control", 1)])
def test_an_own_parameter_reaches_every_simulations_model_and_is_observed(physics, num_envs):
    env = make(LOSS, num_envs, physics=physics)
    joints, previous = env.scene.layout.joint_dof, None
    for _ in range(2):
        x_int = env.reset()["privileged", "intrinsic"]
        assert x_int.shape == (num_envs, 34 + 12)
        for i in range(num_envs):
            model = env.engine.batch.get_model(i) if physics == "batch" else env.engine.physics.model.ptr
            loss = torch.from_numpy(model.dof_frictionloss[joints])
            torch.testing.assert_close(loss, 0.2 + 0.2 * x_int[i, 34:].double())
        assert previous is None or not torch.equal(x_int, previous)
        previous = x_int
    assert (env.model.dof_frictionloss[joints] == 0).all()  # the nominal model stays


def test_a_partial_reset_changes_the_rows_it_names_alone():
    env = make(LOSS)
    td = env.reset()
    before = env.engine.fields["dof_frictionloss"].clone()
    env.reset(td.set("_reset", torch.tensor([[False], [True], [False]])))
    changed = (env.engine.fields["dof_frictionloss"] != before).any(-1)
    assert changed.tolist() == [False, True, False]


def test_its_mirror_image_swaps_sides_and_keeps_signs():
    image = make(LOSS).reflections["privileged", "intrinsic"][34:, 34:]
    assert (image @ torch.arange(12.0)).tolist() == [6, 7, 8, 9, 10, 11, 0, 1, 2, 3, 4, 5]


@pytest.mark.parametrize(("randomization", "ends"), [("train", (0.0, 0.4)), ("test", (0.1, 0.8)), ("off", (0.3, 0.3))])
def test_ranges_and_nominal_are_those_that_were_given(randomization, ends):
    parameter = IntrinsicParameter(friction_loss, (0.0, 0.4), (0.1, 0.8), 0.3, "joints")
    env = make(parameter, 64, randomization=randomization)
    env.reset()
    loss = env.engine.fields["dof_frictionloss"][:, env.scene.layout.joint_dof]
    assert ends[0] - 1e-6 <= loss.min() <= ends[0] + 0.01
    assert ends[1] - 0.01 <= loss.max() <= ends[1] + 1e-6


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"train": (0.4, 0.0)}, r"train=\(0.4, 0.0\) of an intrinsic parameter is no range"),
        ({"train": (0.0, float("inf"))}, r"train=\(0.0, inf\)"),
        ({"train": (1.0,)}, r"train=\(1.0,\)"),
        ({"test": (1.0, 1.0)}, r"test=\(1.0, 1.0\)"),
        ({"train": None}, "train=None of an intrinsic parameter is no range"),
        ({"train": ("a", "b")}, r"train=\('a', 'b'\) of an intrinsic parameter is no range"),
        ({"nominal": "mid"}, "nominal='mid': choose a number that is finite .of an intrinsic parameter"),
        ({"size": True}, "size=True"),
        ({"size": 0}, "size=0"),
        ({"size": "legs"}, "size='legs'"),
        ({"apply": "friction"}, "apply='friction' of an intrinsic parameter cannot be called"),
    ],
)
def test_a_wrong_number_is_named_where_it_is_written(arguments, message):
    with pytest.raises(IntrinsicError, match=message):
        IntrinsicParameter(**{"apply": friction_loss, "train": (0.0, 1.0), **arguments})


@pytest.mark.parametrize("physics", ["batch", "dm_control"])
def test_a_task_without_any_has_an_empty_entry(physics):
    task = walking("a1", pushes=False).replace(intrinsics={})
    env = QuadrupedEnv(task, num_envs=1, physics=physics, num_threads=1, seed=0)
    assert env.rollout(2)["privileged", "intrinsic"].shape == (1, 2, 0)
    assert env.reflections["privileged", "intrinsic"].shape == (0, 0)


def replaced(fields, value, scene):
    fields["body_mass"] = value


def test_what_is_assigned_to_a_field_is_written_into_it_if_it_has_its_shape():
    with pytest.raises(IntrinsicError, match=r"'loss' could not be applied: .*'body_mass' is of \(3, .*not \(3, 1\)"):
        make(IntrinsicParameter(replaced, (0.0, 1.0)))
    fields, live = ModelFields({"geom_friction": torch.zeros(2, 3)}.__getitem__), torch.ones(2, 3)
    before = fields["geom_friction"]
    fields["geom_friction"] = live
    assert fields["geom_friction"] is before
    assert torch.equal(before, live)


def misspelt(fields, value, scene):
    fields["body_weight"][:, 1] = value[:, 0]


def test_what_cannot_be_used_is_named_before_the_first_step():
    with pytest.raises(IntrinsicError, match=r"'loss' is <function"):
        make(friction_loss)
    with pytest.raises(IntrinsicError, match=r"'loss' could not be applied: InputError: 'body_weight' is no field"):
        make(IntrinsicParameter(misspelt, (0.0, 1.0)))
    with pytest.raises(IntrinsicError, match=r"'loss' could not be applied: .*shape mismatch"):
        make(IntrinsicParameter(friction_loss, (0.0, 1.0), size=5))
    with pytest.raises(IntrinsicError, match=r"'loss' is of \(2, 2\); it has 1 components"):
        make(IntrinsicParameter(misspelt, (0.0, 1.0), mirror=(1.0, -1.0)))
