"""Processes of one host that train one policy together: each rides its own robots, and they average what they learn."""

from __future__ import annotations

import atexit
import multiprocessing
import signal
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from datetime import timedelta
from multiprocessing import resource_tracker
from multiprocessing.process import BaseProcess
from typing import Any

import torch
from torch import Tensor, distributed
from torch.utils._pytree import tree_flatten, tree_unflatten

from torchrl_atr._errors import UserError, first_line
from torchrl_atr._interrupt import SIGNALS, signals_held

_PATIENCE = timedelta(days=1)
"""How long a member waits for the others: the leader may be evaluated in between. A dead one is noticed at once."""
_FAREWELL = 10.0
"""Seconds that a helper may take to end."""
_GLANCE = 0.05
"""Seconds between two looks at whether helpers have come."""
_HOST = "127.0.0.1"


class TeamError(UserError, RuntimeError):
    """A member of a team that died or could not be started."""


class Team:
    """What a process knows of those it learns with; by default it is alone, and everything is its own.

    The group is ``torch.distributed``'s default one, over gloo.

    Args:
        rank: which member this is; 0 leads.
        size: how many there are.

    Example:
        >>> team = Team()
        >>> team.average({"a": 1.0}), team.share("all"), team.gather("mine")
        ({'a': 1.0}, 'all', ['mine'])
    """

    def __init__(self, rank: int = 0, size: int = 1) -> None:
        self.rank, self.size = rank, size
        self._helpers: list[BaseProcess] = []

    @classmethod
    def form(cls, size: int, helper: Callable[..., None], *arguments: Any) -> Team:
        """The leader's: starts ``size - 1`` processes that call ``helper(team, *arguments)``.

        Args:
            size: members, this process included; 1 starts none.
            helper: importable function; it ends with its process.
            *arguments: can be pickled.

        Raises:
            TeamError: if ``torch.distributed`` is in use already, or a helper dies while it starts.
        """
        team = cls(0, size)
        if size == 1:
            return team
        if distributed.is_initialized():
            raise TeamError(f"learners={size}: this process uses torch.distributed already; take learners=1")
        store = distributed.TCPStore(_HOST, 0, is_master=True, wait_for_workers=False)
        spawn = multiprocessing.get_context("spawn")
        atexit.register(team.disband)  # helpers outlive the SIGTERM that multiprocessing sends them then
        try:
            resource_tracker.ensure_running()  # it lets signals through when it starts
            with signals_held():  # helpers are not ended by what the leader is asked while they import
                for rank in range(1, size):
                    process = spawn.Process(target=_join, args=(rank, size, store.port, helper, arguments), daemon=True)
                    process.start()
                    team._helpers.append(process)
            team._wait_for_helpers(store)
            with team._together():
                _meet(team, store)
        except BaseException:
            team.disband()
            raise
        return team

    def _wait_for_helpers(self, store: distributed.TCPStore) -> None:
        """Until all have come: gloo itself would wait for one that died on its way."""
        places = [_place(rank) for rank in range(1, self.size)]
        while not store.check(places):
            if not all(process.is_alive() for process in self._helpers):
                raise TeamError(f"learners={self.size}: a learner could not be started, see above")
            time.sleep(_GLANCE)

    def dismiss(self) -> None:
        """Tells helpers that wait for an order that there is none any more, and waits until they are gone."""
        self.share(None)
        for process in self._helpers:
            process.join(_FAREWELL)

    def disband(self) -> None:
        """Ends the helpers that are left, whatever they do."""
        for process in self._helpers:
            process.kill()
            process.join()
        if self._helpers and distributed.is_initialized():
            distributed.destroy_process_group()
        self._helpers = []
        atexit.unregister(self.disband)

    def share(self, value: Any) -> Any:
        """The leader's ``value``, in every member."""
        if self.size == 1:
            return value
        box = [value]
        with self._together():
            distributed.broadcast_object_list(box, src=0)
        return box[0]

    def gather(self, value: Any) -> list[Any]:
        """Every member's ``value`` by rank, in the leader; nothing elsewhere."""
        if self.size == 1:
            return [value]
        values = [None] * self.size if self.rank == 0 else None
        with self._together():
            distributed.gather_object(value, values, dst=0)
        return values or []

    def average(self, values: Any) -> Any:
        """Means over the members of every number in nested dicts and lists, such as state dicts; all else is one's own.

        Args:
            values: of the same make in every member; tensors of any shape, or numbers.

        Returns:
            The same nest, in new tensors; the means are the same in every member to the bit.
        """
        leaves, spec = tree_flatten(values)
        places = [place for place, leaf in enumerate(leaves) if _is_real(leaf)]
        if self.size > 1 and places:
            flat = torch.cat([torch.as_tensor(leaves[place], dtype=torch.float64).reshape(-1) for place in places])
            mean = self._reduced(flat, distributed.ReduceOp.SUM) / self.size
            sizes = [leaf.numel() if isinstance(leaf, Tensor) else 1 for leaf in (leaves[place] for place in places)]
            for place, part in zip(places, mean.split(sizes), strict=True):
                leaf = leaves[place]
                leaves[place] = part.to(leaf.dtype).reshape(leaf.shape) if isinstance(leaf, Tensor) else float(part)
        return tree_unflatten(leaves, spec)

    def maximum(self, value: Tensor) -> Tensor:
        """Elementwise maximum over the members, any shape."""
        return self._reduced(value, distributed.ReduceOp.MAX) if self.size > 1 else value

    def _reduced(self, value: Tensor, operation: Any) -> Tensor:
        reduced = value.detach().clone()
        with self._together():
            distributed.all_reduce(reduced, operation)
        return reduced

    @contextmanager
    def _together(self) -> Iterator[None]:
        """Turns what gloo raises when a member is gone into one error."""
        try:
            yield
        except RuntimeError as error:
            raise TeamError(
                f"learners={self.size}: a learner failed ({first_line(error)}, see above); "
                "go on from the last checkpoint, if there is one, with --resume"
            ) from error


def _join(rank: int, size: int, port: int, helper: Callable[..., None], arguments: Sequence[Any]) -> None:
    """What a helper's process runs."""
    for number in SIGNALS:
        signal.signal(number, signal.SIG_IGN)  # both may reach all processes; the leader decides
    signal.pthread_sigmask(signal.SIG_UNBLOCK, SIGNALS)
    team = Team(rank, size)
    try:
        store = distributed.TCPStore(_HOST, port, is_master=False)
        store.set(_place(rank), "here")
        _meet(team, store)
        helper(team, *arguments)
    except TeamError:
        raise SystemExit(1) from None  # the leader is gone, or says so itself


def _place(rank: int) -> str:
    return f"member {rank}"


def _meet(team: Team, store: distributed.TCPStore) -> None:
    distributed.init_process_group("gloo", store=store, rank=team.rank, world_size=team.size, timeout=_PATIENCE)


def _is_real(leaf: Any) -> bool:
    return isinstance(leaf, float) or (isinstance(leaf, Tensor) and leaf.is_floating_point())
