"""Page that shows and steers a session: scene, joystick, controls and panels on one viser server."""

from __future__ import annotations

import time
from pathlib import Path
from typing import TYPE_CHECKING

from torchrl_atr.envs.physics import CONTROL_DT
from torchrl_atr.viewer.controls import Controls
from torchrl_atr.viewer.joystick import Joystick
from torchrl_atr.viewer.loop import Loop
from torchrl_atr.viewer.panels import Panels
from torchrl_atr.viewer.scene import CAMERA, LOOK_AT, SceneDisplay
from torchrl_atr.viewer.session import Session

if TYPE_CHECKING:
    from viser import ViserServer

_PANEL_INTERVAL = 0.2
"""Time between two updates of the charts, s: they are a hundred times as large as the poses."""


class Page:
    """Page of a session; connects itself to the session's loop.

    Args:
        server: that serves it.
        loop: of the session.
        policies: that can be chosen, by name.
    """

    def __init__(self, server: ViserServer, loop: Loop, policies: dict[str, Path]) -> None:
        self._server, self._loop = server, loop
        server.initial_camera.position, server.initial_camera.look_at = CAMERA, LOOK_AT
        server.gui.configure_theme(show_share_button=False, show_logo=False)
        server.gui.main_panel.dock_right()
        self._controls = Controls(server, loop, policies)
        self._panels = Panels(server, loop)
        self._joystick = Joystick(server, self._controls.steer)
        self._shown: tuple[int, int] | None = None
        self._builds = 0
        self._drawn = 0.0
        loop.show, loop.warn, loop.watched = self.show, self.warn, self.watched
        self.show(loop.session)

    def watched(self) -> bool:
        """Return whether a browser shows the page."""
        return bool(self._server.get_clients())

    def warn(self, line: str) -> None:
        """Show a line in all browsers, such as why a policy cannot be loaded."""
        for client in self._server.get_clients().values():
            client.add_notification("This did not work", line, color="red", auto_close_seconds=15.0)
        self._controls.show(self._loop.session)  # what was chosen is not what is in force

    def show(self, session: Session) -> None:
        """Show a session after a step or an action."""
        if self._shown != (session.builds, session.views):
            self._rebuild(session)
        with self._server.atomic():  # one message to each browser
            self._scene.update(session, CONTROL_DT)
            self._joystick.move(session.command)
            self._controls.update(session)
            now = time.monotonic()
            if now - self._drawn >= _PANEL_INTERVAL or self._loop.paused:
                self._drawn = now
                self._panels.update(session)

    def _rebuild(self, session: Session) -> None:
        if self._builds != session.builds:
            self._server.scene.reset()
            self._scene = SceneDisplay(self._server, session)
            self._joystick.show(session.area, session.limits)
            self._panels.show(session)
            self._builds = session.builds
        self._controls.show(session)
        self._shown = session.builds, session.views
