"""Simulation loop of a session in real time: pause, single step, slow motion, and actions from other threads."""

from __future__ import annotations

import queue
import threading
import time
from collections.abc import Callable

from torchrl_atr._errors import UserError, first_line
from torchrl_atr._files import explain
from torchrl_atr._threads import one_torch_thread
from torchrl_atr.envs.physics import CONTROL_DT
from torchrl_atr.viewer.session import Session

_BEHIND = 0.1
"""Delay beyond which the loop stops catching up, s."""
_WATCH = 1.0
"""Interval at which a run is looked at for a new checkpoint, s."""
_IDLE = 0.1
Action = Callable[[Session], object]


class Loop:
    """Loop that steps a session at its control rate times :attr:`rate`, in the thread that calls :meth:`run`.

    Without a watcher it does nothing: a closed browser costs no CPU.

    Args:
        session: to step.
        show: called in the loop's thread after every step, every second one where the machine is too slow, and after
            actions while paused.
        warn: called with one line on an action that failed.
        watched: returns whether anyone looks.

    Attributes:
        paused: whether time stands still.
        rate: simulated seconds per second.
        follows: whether new checkpoints of the run are loaded.
        measured_rate: simulated seconds per second, measured over the last second.

    Example:
        >>> loop = Loop(session, show=print)  # doctest: +SKIP
        >>> loop.post(lambda session: session.steer(1.0, 0.0))  # doctest: +SKIP
        >>> loop.run()  # doctest: +SKIP
    """

    def __init__(
        self,
        session: Session,
        show: Callable[[Session], object] = lambda session: None,
        warn: Callable[[str], object] = lambda line: None,
        watched: Callable[[], bool] = lambda: True,
    ) -> None:
        self.session, self.show, self.warn, self.watched = session, show, warn, watched
        self.paused, self.rate, self.follows = False, 1.0, True
        self.measured_rate = 0.0
        self._actions: queue.SimpleQueue[Action] = queue.SimpleQueue()
        self._ended = threading.Event()
        self._single = 0
        self._late = self._hidden = False
        self._next = self._looked = time.monotonic()
        self._mark = (time.monotonic(), 0.0)

    def post(self, action: Action) -> None:
        """Have an action carried out between two steps; any thread may call this."""
        self._actions.put(action)

    def single_step(self) -> None:
        """Pause, and make one step."""

        def step(session: Session) -> None:
            self.paused = True
            self._single += 1

        self.post(step)

    def toggle_pause(self) -> None:
        """Pause, or go on."""

        def toggle(session: Session) -> None:
            self.paused = not self.paused

        self.post(toggle)

    def end(self) -> None:
        """Have :meth:`run` return; any thread may call this."""
        self._ended.set()

    def run(self, tick: Callable[[], object] = lambda: None) -> None:
        """Step in real time until :meth:`end`.

        Args:
            tick: called in every round, steps or not, such as to end the loop.
        """
        with one_torch_thread():  # others would spin on the CPUs that physics and the server need
            self._restart_clock()
            while not self._ended.is_set():
                tick()
                self.turn()

    def turn(self) -> None:
        """Make one round: actions, then a step if it is time for one, else a short wait."""
        acted = self._act()
        if not self.watched():
            self._ended.wait(_IDLE)
            self._restart_clock()
            return
        self._look_for_checkpoint()
        if self.paused and not self._single:
            if acted:
                self.show(self.session)
            self._ended.wait(CONTROL_DT)
            self._restart_clock()
            return
        self._single = max(0, self._single - 1)
        self.session.step()
        self._hidden = self._late and not self._hidden  # a slow machine shows every second step
        if not self._hidden:
            self.show(self.session)
        self._keep_time()

    def _act(self) -> bool:
        acted = False
        while True:
            try:
                action = self._actions.get_nowait()
            except queue.Empty:
                return acted
            self._try(action)
            acted = True

    def _try(self, action: Action) -> None:
        try:
            action(self.session)
        except (UserError, ImportError) as error:
            self.warn(str(error))
        except OSError as error:
            self.warn(explain(error))
        except (ValueError, KeyError, RuntimeError, TypeError) as error:  # of a policy's own code: the ride goes on
            self.warn(f"{type(error).__name__}: {first_line(error)}")

    def _look_for_checkpoint(self) -> None:
        now = time.monotonic()
        if self.follows and now - self._looked >= _WATCH:
            self._looked = now
            self._try(Session.refresh)

    def _keep_time(self) -> None:
        self._next += CONTROL_DT / self.rate
        now = time.monotonic()
        wait = self._next - now
        self._late = wait < 0
        if wait < -_BEHIND:
            self._next = now
        elif wait > 0:
            self._ended.wait(wait)
        begun, simulated = self._mark
        simulated += CONTROL_DT
        if now - begun >= 1.0:
            self.measured_rate = simulated / (now - begun)
            begun, simulated = now, 0.0
        self._mark = begun, simulated

    def _restart_clock(self) -> None:
        self._next = time.monotonic()
        self._mark, self._late = (self._next, 0.0), False
