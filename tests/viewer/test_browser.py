"""The page as a person uses it, in a headless Chromium that renders in software: a minute of CPU, so only if asked for.

    scripts/browser_test

``VIEWER_SCREENSHOT=page.png`` keeps the picture.
"""

from __future__ import annotations

import os
import shutil
import threading
from pathlib import Path

import numpy as np
import pytest

from torchrl_atr.viewer import Loop, Session, Setup, ridable

pytest.importorskip("viser")
pytest.importorskip("mjviser")
playwright = pytest.importorskip("playwright.sync_api")
from tests.viewer.client import wait_until  # noqa: E402
from torchrl_atr.viewer.page import Page  # noqa: E402
from torchrl_atr.viewer.serve import viser_server  # noqa: E402

SIZE = {"width": 1200, "height": 680}
RUN = Path(__file__).parents[2] / "results" / "a1-single_board"
NAMES = ("chromium-headless-shell", "chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
CHROMIUM = next((path for path in map(shutil.which, NAMES) if path), None)
SOFTWARE = ["--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--ignore-gpu-blocklist"]
pytestmark = [
    pytest.mark.skipif(not os.environ.get("BROWSER_TESTS"), reason="only with BROWSER_TESTS=1"),
    pytest.mark.skipif(CHROMIUM is None, reason="no Chromium: apt-get install chromium-headless-shell"),
]


@pytest.fixture
def ride():
    """A session on a server, whose loop runs in a thread."""
    with viser_server(port=0) as server:
        session = Session(Setup(RUN))
        loop = Loop(session)
        page = Page(server, loop, ridable(RUN))
        thread = threading.Thread(target=loop.run)
        thread.start()
        yield server, loop, page
        loop.end()
        thread.join()


def on_screen(camera, point, box):
    """Pixel of a point of the scene, by the camera that the browser tells of (OpenCV convention)."""
    w, x, y, z = camera.wxyz
    rotation = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )
    right, down, ahead = rotation.T @ (np.asarray(point) - camera.position)
    focal = box["height"] / 2 / np.tan(camera.fov / 2)
    return box["x"] + box["width"] / 2 + focal * right / ahead, box["y"] + box["height"] / 2 + focal * down / ahead


def test_dragging_the_stick_sets_the_command_and_the_robot_follows(ride, tmp_path):
    server, loop, page = ride
    with playwright.sync_playwright() as play:
        browser = play.chromium.launch(executable_path=CHROMIUM, args=[*SOFTWARE, "--no-sandbox"])
        tab = browser.new_page(viewport=SIZE)
        tab.goto(f"http://127.0.0.1:{server.get_port()}")
        assert wait_until(page.watched, 60)
        tab.wait_for_selector("text=Rewards", timeout=60_000)
        assert wait_until(lambda: loop.session.time > 0.5, 60)
        tab.wait_for_timeout(2000)
        camera, box = next(iter(server.get_clients().values())).camera, tab.locator("canvas").first.bounding_box()
        start, end = (on_screen(camera, page._joystick._place(*command), box) for command in ((0, 0), (1.4, 0.2)))
        tab.mouse.move(*start)
        tab.mouse.down()
        tab.mouse.move(*end, steps=5)
        assert wait_until(lambda: loop.session.command[0] > 1.0, 20)
        tab.mouse.up()
        assert loop.session.command[0] == pytest.approx(1.4, abs=0.25)
        assert loop.session.command[1] == pytest.approx(0.2, abs=0.2)
        begun = loop.session.time
        assert wait_until(lambda: loop.session.reading.actual[0] > 0.7 or loop.session.time > begun + 8, 120)
        assert loop.session.reading.actual[0] > 0.7
        loop.toggle_pause()  # software rendering leaves no time for a picture between the frames
        assert wait_until(lambda: loop.paused)
        tab.screenshot(path=os.environ.get("VIEWER_SCREENSHOT", tmp_path / "page.png"), timeout=120_000)
        loop.toggle_pause()
        browser.close()
    assert wait_until(lambda: not page.watched(), 20)
    assert wait_until(lambda: _stands(loop), 20)


def _stands(loop):
    """Nobody looks: time stands still."""
    before = loop.session.time
    threading.Event().wait(0.3)
    return loop.session.time == before
