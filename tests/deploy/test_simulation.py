"""The robot in plain MuJoCo is the robot of our env."""

from __future__ import annotations

import json
import subprocess
import sys

import mujoco
import numpy as np
import pytest
import torch

import torchrl_atr
from torchrl_atr.deploy import BundleError, PolicyRunner, read_manifest, run_policy
from torchrl_atr.deploy.export import export_run
from torchrl_atr.deploy.simulation import SimulatedRobot, drive_law
from torchrl_atr.envs.interpretation import Interpretation
from torchrl_atr.envs.models import TRANSPORTERS
from torchrl_atr.envs.tasks.riding.drive_law import DriveLaw
from torchrl_atr.training import Trainer, make_config

COMMAND = (1.0, 0.3)


@pytest.mark.parametrize("name", ["single_board_g1", "two_board_g2"])
@pytest.mark.parametrize(
    "interpretation",
    [
        {},
        {"coulomb_smoothing": 0.0},
        {"coulomb_smoothing": 0.0, "odd_resistance": False, "relative_mass": False},
        {"steering_smoothing": 0.1},
    ],
)
def test_the_drive_law_is_ours(name, interpretation):
    spec, own = TRANSPORTERS.get(name), Interpretation(**interpretation)
    law = DriveLaw(spec, own)
    scale = law.mass_scale(torch.tensor([spec.mass], dtype=torch.float64))
    facts = {
        **{key: getattr(spec, key) for key in ("mass", "max_acceleration", "max_yaw_acceleration", "tilt_norm")},
        "resistance": spec.resistance,
        "inertia_z": spec.inertia[2],
        "interpretation": {key: getattr(own, key) for key in vars(own)},
    }
    rng = np.random.default_rng(0)
    driving = np.array(spec.design.driving)
    for tilt, speeds in zip(rng.normal(0.0, 0.4, (50, 2)), [np.zeros(2), *rng.normal(0.0, 2.0, (49, 2))]):
        ours = law(torch.tensor(speeds)[None], torch.tensor(tilt)[None], scale, 0.005)[0].numpy()
        np.testing.assert_allclose(drive_law(speeds, driving @ tilt, facts, 0.005), ours, atol=1e-12)


def test_it_rides_ten_seconds_as_our_env_does(bundle):
    """From the same initial state the readings stay the same, and so does the ride."""
    policy, make_env = torchrl_atr.load_policy(bundle)
    env = make_env(num_envs=1, seed=0, sensors="ideal", randomization="off", num_threads=1)
    env.curriculum.pin(COMMAND)
    first = env.reset()
    qpos = env.base_env.get_state()["qpos"][0].numpy()
    ours = env.rollout(500, policy, auto_reset=False, tensordict=first)
    assert ours.shape == (1, 500)
    robot, readings, speeds = SimulatedRobot(bundle), [], []
    robot.reset(qpos)

    def watch(state):
        readings.append(np.concatenate([*state.imu, state.joint_positions, state.joint_velocities]))
        speeds.append(robot.speeds)
        assert robot.height > 0.15 + 0.025 + 0.14  # the deck's top, and where A1 has fallen

    run_policy(PolicyRunner(bundle, robot="a1"), robot, lambda time: COMMAND, 10.0, watch)
    proprio = ours["proprio"][0, :, :32].numpy()
    np.testing.assert_allclose(np.array(readings)[:50], proprio[:50], atol=1e-3)
    settled = np.array(speeds)[250:].mean(0)
    np.testing.assert_allclose(settled, ours["speeds"][0, 250:].mean(0), atol=0.1)
    assert abs(settled - COMMAND).max() < 0.6


def test_a_walking_robot_is_that_of_our_env(tmp_path):
    tiny = {"env.num_envs": 2, "total_frames": 8, "ppo.rollout_steps": 2, "ppo.minibatches": 1}
    Trainer(make_config({**tiny, "task.name": "walking", "compute.num_threads": 1}), tmp_path / "run").save()
    export_run(tmp_path / "run", tmp_path / "walker")
    manifest = read_manifest(tmp_path / "walker")
    assert manifest["transporter"] is None
    assert manifest["command"]["clipping"].startswith("speed within [0, 1.5] m/s")
    assert manifest["dead_reckoning"]["method"] == "integral"
    policy, make_env = torchrl_atr.load_policy(tmp_path / "walker")
    env = make_env(num_envs=1, seed=0, randomization="off", num_threads=1)
    env.curriculum.pin(COMMAND)
    first = env.reset()
    robot, readings = SimulatedRobot(tmp_path / "walker"), []
    robot.reset(env.base_env.get_state()["qpos"][0].numpy())
    ours = env.rollout(25, policy, auto_reset=False, tensordict=first)

    def watch(state):
        readings.append(np.concatenate([*state.imu, state.joint_positions, state.joint_velocities]))

    run_policy(PolicyRunner(tmp_path / "walker"), robot, lambda time: COMMAND, 0.5, watch)
    np.testing.assert_allclose(np.array(readings), ours["proprio"][0, :, :32].numpy(), atol=1e-3)
    np.testing.assert_allclose(robot.speeds, ours["next", "speeds"][0, -1], atol=1e-2)


WITHOUT_TORCH = """
import sys

class Refuse:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in {refused}:
            raise ImportError(name)

sys.meta_path.insert(0, Refuse())
"""
HEAVY = ("torch", "torchrl", "tensordict", "scipy", "matplotlib")


def run(code: str, *arguments: str, refused: tuple[str, ...] = HEAVY) -> str:
    code = WITHOUT_TORCH.replace("{refused}", repr(refused)) + code
    done = subprocess.run([sys.executable, "-c", code, *arguments], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr[-2000:]
    return done.stdout


def test_the_runtime_needs_numpy_and_onnxruntime_alone(bundle):
    code = """
import numpy as np
from torchrl_atr.deploy import Imu, PolicyRunner, verify
assert verify(sys.argv[1]).error < 1e-4
runner = PolicyRunner(sys.argv[1])
q0 = [joint["q0"] for joint in runner.manifest["joints"]]
print(runner.step(Imu(np.zeros(3), np.zeros(3), np.zeros(2)), q0, np.zeros(12), (0.0, 0.0)).targets.tolist())
assert not {"torch", "mujoco"} & set(sys.modules)
"""
    assert len(json.loads(run(code, str(bundle), refused=(*HEAVY, "mujoco", "onnx", "safetensors")))) == 12


def test_it_rides_and_is_verified_without_torch(bundle):
    code = """
from torchrl_atr.cli import main
from torchrl_atr.deploy import PolicyRunner, run_policy
from torchrl_atr.deploy.simulation import SimulatedRobot
assert main(["verify", sys.argv[1]]) == 0
robot = SimulatedRobot(sys.argv[1])
run_policy(PolicyRunner(sys.argv[1]), robot, lambda time: (1.0, 0.0), 2.0)
print(robot.height)
"""
    assert float(run(code, str(bundle)).splitlines()[-1]) > 0.3


def test_importing_the_package_does_not_import_torch():
    assert run("import torchrl_atr.deploy; print(torchrl_atr.__version__)")


def test_a_missing_package_is_named_with_its_extra(bundle):
    code = """
from torchrl_atr.deploy import PolicyRunner
try:
    PolicyRunner(sys.argv[1])
except ImportError as error:
    print(error)
"""
    out = run(code, str(bundle), refused=("onnxruntime",))
    assert out.strip() == "onnxruntime is not installed; pip install 'torchrl_atr[deploy]'"


def test_a_bundle_without_a_scene_says_so(rewritten):
    folder = rewritten(lambda manifest: manifest["files"].pop("scene.xml"))
    with pytest.raises(BundleError, match=r"no scene for plain MuJoCo .*torchrl-atr play"):
        SimulatedRobot(folder)


def test_gains_are_applied(bundle):
    robot, runner = SimulatedRobot(bundle), PolicyRunner(bundle)
    state = robot.read()
    command = runner.step(*state[1:], (0.0, 0.0))
    robot.send(command._replace(gains=command.gains._replace(kp=np.full(12, 7.0))))
    assert set(robot.model.actuator_gainprm[:, 0]) == {7.0}
    assert set(robot.model.actuator_biasprm[:, 1]) == {-7.0}
    assert isinstance(robot.model, mujoco.MjModel)
