import numpy as np
import pytest
import torch
from tensordict.nn import TensorDictModule
from torchrl.envs import TransformedEnv

from torchrl_atr.envs import make_env
from torchrl_atr.envs.riding import RidingEnv
from torchrl_atr.envs.tasks import walking
from torchrl_atr.envs.transforms import task_transforms
from torchrl_atr.evaluation import DEFAULT_RIDE, play_viewer, record_video, rendering
from torchrl_atr.evaluation.access import command_limits
from torchrl_atr.evaluation.rendering import OffscreenRenderer, SceneView
from torchrl_atr.evaluation.video import command_at, ride_with_resets, within
from torchrl_atr.evaluation.viewer import Keyboard


@pytest.fixture
def env():
    base = RidingEnv(num_envs=2, seed=0, pushes=False, num_threads=1)
    return TransformedEnv(base, task_transforms((0.16, 0.16), history_length=2, seed=0))


@pytest.fixture
def stand(env):
    joints = env.action_spec.shape[-1]
    return TensorDictModule(
        lambda observation: observation.new_zeros(len(observation), joints),
        in_keys=["observation"],
        out_keys=["action"],
    )


@pytest.fixture
def picture(env):
    env.reset()
    try:
        with OffscreenRenderer(env, size=(64, 48)) as made:
            yield made
    except RuntimeError as error:
        if "cannot render" not in str(error):
            raise
        pytest.skip(f"no OpenGL here: {error}")


def test_the_command_in_force():
    commands = [(0.0, 0.0, 0.0), (1.0, 2.0, 0.5), (2.0, -1.0, 0.0)]
    assert command_at(commands, 0.99) == (0.0, 0.0)
    assert command_at(commands, 1.0) == (2.0, 0.5)
    assert command_at(commands, 99.0) == (-1.0, 0.0)
    assert command_at(commands[1:], 0.0) == (2.0, 0.5)


def test_a_ride_follows_the_sequence_and_unpins(env, stand):
    """At 50 Hz the command of 0.04 s is in force from the third step on."""
    commands = [(0.0, 0.25, 0.0), (0.04, 0.5, 0.25)]
    seen = []
    for command, fell in ride_with_resets(stand, env, commands, 4):
        seen.append((command, fell))
    assert seen == [((0.25, 0.0), False)] * 2 + [((0.5, 0.25), False)] * 2
    assert env.transform[0].command.tolist() == [[0.5, 0.25]] * 2
    env.reset()
    assert env.transform[0].command.tolist() != [[0.5, 0.25]] * 2


def test_the_policy_sees_the_command_of_its_step(env):
    joints, seen = env.action_spec.shape[-1], []

    def watch(command):
        seen.append(command[0].tolist())
        return command.new_zeros(len(command), joints)

    policy = TensorDictModule(watch, in_keys=["command"], out_keys=["action"])
    told = [command for command, _ in ride_with_resets(policy, env, [(0.0, 0.25, 0.0), (0.04, 0.5, 0.25)], 4)]
    assert seen == [list(command) for command in told]


def test_the_mirror_puts_the_board_where_the_odometer_says(env):
    env.rand_step(env.reset())
    engine = env.base_env.engine
    engine.world_offset[:] = torch.tensor([[0.0, 0.0], [30.0, -7.0]])
    view, layout, support = SceneView(env, row=1), engine.scene.layout, engine.scene.support_layout
    planar, root = support.planar_qpos[:2], layout.root_qpos
    x, y, heading = view.pose()
    np.testing.assert_allclose([x, y], engine.qpos[1, planar] + torch.tensor([30.0, -7.0]))
    assert heading == pytest.approx(engine.qpos[1, support.planar_qpos[2]].item(), abs=1e-12)
    # board and robot move together: their distance, and the joints, are the engine's
    shown = view.data.qpos
    np.testing.assert_allclose(
        shown[root : root + 2] - shown[planar], engine.qpos[1, root : root + 2] - engine.qpos[1, planar]
    )
    np.testing.assert_array_equal(shown[layout.joint_qpos], engine.qpos[1, layout.joint_qpos])
    np.testing.assert_allclose(view.data.xpos[layout.trunk_body][:2], shown[root : root + 2])
    assert view.model is not env.base_env.model


def test_a_picture_shows_board_and_sky(picture):
    image = picture.render()
    assert image.shape == (48, 64, 3)
    assert image.dtype == np.uint8
    sky, middle = image[2].mean(0), image[20:40, 20:44].reshape(-1, 3)
    assert sky[2] > sky[0]  # blue
    assert (middle[:, 2].astype(int) - middle[:, 0] > 40).any()  # the deck's blue
    assert not np.array_equal(image, picture.render("speed", "1.0 m/s"))


def test_the_floor_moves_and_the_board_stays_in_the_middle(env, picture):
    before = picture.render().astype(int)
    env.base_env.engine.world_offset[0] += torch.tensor([0.7, 0.3])
    after = picture.render().astype(int)
    deck = [(image[..., 2] - image[..., 0] > 40)[12:] for image in (before, after)]
    assert deck[0].any()
    assert (deck[0] == deck[1]).mean() > 0.97
    assert (np.abs(before - after).sum(-1) > 20).mean() > 0.05


@pytest.mark.parametrize("far", [(4.0, 0.0), (48.0, -52.0), (200.0, 0.0), (1e3, -404.0), (1e5, 3e4)])
def test_far_away_the_picture_is_the_same(env, picture, far):
    """The floor repeats every 4 m: whole tiles further on, from the first picture there, nothing has changed."""

    def differs(image: np.ndarray) -> float:
        return float((np.abs(near - image.astype(int)).sum(-1) > 15).mean())

    near = picture.render().astype(int)
    env.base_env.engine.world_offset[0] += torch.tensor(far)
    assert differs(picture.render()) < 1e-3
    env.base_env.engine.world_offset[0] += torch.tensor([2.0, 0.0])  # half of it: light and dark change places
    assert differs(picture.render()) > 0.3


def test_the_mirror_stays_near_the_origin(env):
    engine = env.base_env.engine
    engine.world_offset[1] = torch.tensor([12_345.5, -1e6 - 0.25])
    x, y, _ = SceneView(env, row=1).pose()
    np.testing.assert_allclose([x, y], [45.5, -0.25], atol=0.1)


@pytest.mark.parametrize("suffix", [".mp4", ".gif"])
def test_a_video_of_five_frames(suffix, env, stand, picture, tmp_path):
    ffmpeg = pytest.importorskip("imageio_ffmpeg")
    pytest.importorskip("mediapy")
    path = tmp_path / f"ride{suffix}"
    outcome = record_video(stand, env, path, seconds=0.2, size=(64, 48))
    assert (outcome.steps, outcome.frames, outcome.falls) == (10, 5, 0)
    about, *frames = ffmpeg.read_frames(str(path))
    assert about["size"] == (64, 48)
    assert about["fps"] == 25.0
    assert len(frames) == 5
    assert list(tmp_path.iterdir()) == [path]


def test_bad_videos_are_named(env, stand, tmp_path):
    with pytest.raises(ValueError, match=r"\.mp4 or \.gif"):
        record_video(stand, env, tmp_path / "ride.avi")
    with pytest.raises(ValueError, match="0 commands cannot be; give at least one command"):
        record_video(stand, env, tmp_path / "ride.mp4", commands=[])
    with pytest.raises(ValueError, match="unknown camera 'front'; choose one of chase"):
        OffscreenRenderer(env, camera="front")
    with pytest.raises(ValueError, match="up to"):
        OffscreenRenderer(env, size=(10_000, 10))


def test_without_opengl_the_error_says_what_to_install(env, monkeypatch):
    monkeypatch.setitem(rendering._BACKENDS, "egl", "torchrl_atr.no_such_backend")
    monkeypatch.setenv("MUJOCO_GL", "egl")
    with pytest.raises(RuntimeError, match=r"MUJOCO_GL=egl.*libegl1.*libosmesa6"):
        OffscreenRenderer(env)


@pytest.mark.parametrize(
    ("variables", "backend"),
    [
        ({}, "egl"),
        ({"DISPLAY": ":0"}, "glfw"),
        ({"MUJOCO_GL": "osmesa"}, "osmesa"),
        ({"MUJOCO_GL": "EGL"}, "egl"),
    ],
)
def test_the_backend_follows_the_surroundings(variables, backend, monkeypatch):
    for name in ("DISPLAY", "WAYLAND_DISPLAY", "MUJOCO_GL"):
        monkeypatch.delenv(name, raising=False)
    for name, value in variables.items():
        monkeypatch.setenv(name, value)
    monkeypatch.setattr(rendering.sys, "platform", "linux")
    monkeypatch.setattr(rendering.ctypes.util, "find_library", lambda name: name)
    assert rendering.gl_backend() == backend


def test_the_viewer_needs_a_display(env, stand, monkeypatch):
    monkeypatch.setattr(rendering.sys, "platform", "linux")
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    with pytest.raises(RuntimeError, match="--video"):
        play_viewer(stand, env)


def test_the_keyboard_steers_within_limits():
    keyboard = Keyboard(limits=(0.5, 0.25))
    for key in (Keyboard.UP, Keyboard.UP, Keyboard.UP, Keyboard.LEFT, Keyboard.LEFT, 65):
        keyboard(key)
    assert command_at(keyboard, 3.0) == (0.5, 0.25)
    keyboard(Keyboard.DOWN)
    keyboard(Keyboard.RIGHT)
    assert command_at(keyboard, 0.0) == (0.25, 0.0)
    keyboard(Keyboard.SPACE)
    assert command_at(keyboard, 0.0) == (0.0, 0.0)


def test_keyboard_and_default_video_keep_within_what_the_task_draws(stand):
    env = make_env(walking(pushes=False), num_envs=1, num_threads=1)
    low, high = command_limits(env)
    keyboard = Keyboard(high, lowest=low)
    for key in (Keyboard.DOWN, *(Keyboard.RIGHT,) * 5):
        keyboard(key)
    assert command_at(keyboard, 0.0) == (0.0, -1.0)
    for _ in range(9):
        keyboard(Keyboard.UP)
    assert command_at(keyboard, 0.0) == (1.5, -1.0)
    cut = within((low, high), DEFAULT_RIDE)
    assert cut == [(0.0, 0.0, 0.0), (2.0, 1.0, 0.0), (7.0, 1.5, 0.5), (12.0, 1.5, -0.5), (17.0, 0.0, 0.0)]
    for _, *command in cut:
        env.curriculum.pin(command)


def test_limits_of_riding_are_two_metres_a_second_either_way(env):
    low, high = command_limits(env)
    assert (low.tolist(), high.tolist()) == ([-2.0, -1.0], [2.0, 1.0])
    assert within((low, high), DEFAULT_RIDE) == list(DEFAULT_RIDE)


def test_a_fall_restarts_the_shown_robot(env):
    """Legs folded as far as they go: robot 0 falls, is counted, and stands again in the next step."""
    joints = env.action_spec.shape[-1]
    policy = TensorDictModule(
        lambda observation: torch.full((len(observation), joints), 20.0),
        in_keys=["observation"],
        out_keys=["action"],
    )
    rider = ride_with_resets(policy, env, [(0.0, 0.0, 0.0)], 200)
    assert any(fell for _, fell in rider)
    rider.close()
    assert (env.base_env.engine.hook.speeds[0] == 0).all()  # as only a reset leaves it
