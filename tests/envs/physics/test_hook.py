"""What a task does before every substep, and the fields that it may change."""

from __future__ import annotations

import copy
import pickle

import pytest
import torch

from torchrl_atr._errors import InputError
from torchrl_atr.envs.models import ROBOTS, FlatGround, build_scene
from torchrl_atr.envs.models.scene import TIMESTEP
from torchrl_atr.envs.physics import DECIMATION, Engine, SubstepHook
from torchrl_atr.envs.physics.batch import BatchEngine


class Wind(SubstepHook):
    """Pushes the trunk with a force that grows at every substep."""

    def __init__(self, engine: Engine) -> None:
        super().__init__(engine)
        self.calls: list[float] = []
        self.state = {"gusts": torch.zeros(engine.num_envs, 1, dtype=torch.float64)}

    def start(self, rows):
        super().start(rows)
        self.state["gusts"][rows] = 0.0

    def apply(self, dt):
        self.calls.append(dt)
        self.state["gusts"] += 1.0
        self.engine.qfrc_applied[:, self.engine.scene.layout.root_dof] = 0.5 * self.state["gusts"][:, 0]

    def reset_diverged(self, rows):
        self.state["gusts"][rows] = -1.0


@pytest.fixture(scope="module")
def scene():
    return build_scene(ROBOTS.get("a1"), FlatGround())


@pytest.fixture(params=["batch", "dm_control"])
def make(request, scene):
    def build(hook=Wind) -> Engine:
        if request.param == "batch":
            return BatchEngine(scene, 2, hook, 1)
        from torchrl_atr.envs.physics.dmc import DmControlEngine

        return DmControlEngine(scene, hook)

    return build


def step(engine: Engine, count: int = 1) -> None:
    for _ in range(count):
        engine.step(torch.tensor([engine.scene.robot.q0] * engine.num_envs))


def test_it_is_called_before_each_substep_and_what_it_does_counts(make):
    blown, calm = make(), make(None)
    for engine in (blown, calm):
        step(engine, 5)
    assert blown.hook.calls == [TIMESTEP] * (5 * DECIMATION)
    assert (blown.hook.state["gusts"] == 5 * DECIMATION).all()
    root = blown.scene.layout.root_dof
    assert (blown.qvel[:, root] > calm.qvel[:, root] + 1e-3).all()


def test_its_state_is_the_engines_and_goes_on_bit_for_bit(make):
    engine = make()
    step(engine, 3)
    state = engine.get_state()
    assert (state["gusts"] == 3 * DECIMATION).all()
    step(engine, 4)
    expected = engine.get_state()
    assert (state["gusts"] == 3 * DECIMATION).all()  # a copy
    other = make()
    other.set_state(state)
    step(other, 4)
    for name, value in other.get_state().items():
        assert torch.equal(value, expected[name]), name
    with pytest.raises(KeyError, match="the state lacks 'gusts'"):
        engine.set_state({name: value for name, value in state.items() if name != "gusts"})


@pytest.mark.parametrize("duplicate", [copy.deepcopy, lambda engine: pickle.loads(pickle.dumps(engine))])
def test_a_copied_engine_has_a_hook_of_its_own_in_the_same_state(make, duplicate):
    engine = make()
    step(engine, 3)
    other = duplicate(engine)
    assert other.hook is not engine.hook
    assert other.hook.engine is other
    for each in (engine, other):
        step(each, 4)
    for name, value in other.get_state().items():
        assert torch.equal(value, engine.get_state()[name]), name


def test_it_starts_with_the_rows_that_do_and_hears_of_those_that_diverge(make):
    engine = make()
    step(engine)
    rows = torch.tensor([engine.num_envs - 1])
    key = engine.scene.model.key(0)
    state = torch.from_numpy(key.qpos)[None], torch.from_numpy(key.qvel)[None]
    engine.reset(rows, *state)
    wanted = [[float(DECIMATION)]] * (engine.num_envs - 1) + [[0.0]]
    assert engine.hook.state["gusts"].tolist() == wanted
    engine.qvel[-1, 8] = torch.nan
    step(engine)
    assert engine.diverged.tolist() == [False] * (engine.num_envs - 1) + [True]
    assert engine.hook.state["gusts"][-1] == -1.0


def test_a_field_becomes_one_per_simulation_when_it_is_asked_for(make):
    engine = make(None)
    assert "body_mass" not in engine.fields
    mass = engine.fields["body_mass"]
    assert list(engine.fields) == ["body_mass"]
    assert mass.shape == (engine.num_envs, engine.scene.model.nbody)
    torch.testing.assert_close(mass, engine.nominal("body_mass").expand_as(mass))
    trunk = engine.scene.layout.trunk_body
    mass[0, trunk] += 1.0
    model = engine.batch.get_model(0) if hasattr(engine, "batch") else engine.physics.model.ptr
    assert model.body_mass[trunk] == engine.scene.model.body_mass[trunk] + 1.0
    assert engine.fields["body_mass"] is mass


@pytest.mark.parametrize("name", ["body_weight", "nq", "names", "opt", ""])
def test_what_is_no_field_is_named(make, name):
    engine = make(None)
    with pytest.raises(InputError, match=f"'{name}' is no field of the compiled model"):
        _ = engine.fields[name]
    assert not engine.fields


def test_a_reset_writes_from_the_nominal_values_and_leaves_the_others_alone(make):
    engine = make(None)
    model, trunk, rows = engine.scene.model, engine.scene.layout.trunk_body, torch.tensor([0])
    key = model.key(0)
    state = torch.from_numpy(key.qpos)[None], torch.from_numpy(key.qvel)[None]

    def heavier(fields):
        fields["body_mass"][:, trunk] += 1.0

    for _ in range(3):  # does not add up
        engine.reset(rows, *state, heavier)
    others = [0.0] * (engine.num_envs - 1)
    added = engine.fields["body_mass"][:, trunk] - model.body_mass[trunk]
    assert added.tolist() == pytest.approx([1.0, *others])
