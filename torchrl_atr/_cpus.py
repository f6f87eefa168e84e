"""Numbers of the CPUs that this process may use, and of those that other processes use meanwhile."""

from __future__ import annotations

import os
import time
from collections.abc import Iterator
from pathlib import Path, PurePosixPath

import psutil

_CGROUPS = Path("/sys/fs/cgroup")


def available_cpus() -> int:
    """Return how many whole CPUs this process may use: its affinity mask, within the CPU quotas of its cgroups.

    A quota of 1.5 CPUs counts as one: two threads would be throttled for part of every period.

    Example:
        >>> available_cpus() >= 1
        True
    """
    quota, mask = cgroup_quota(), len(cpu_mask())
    return mask if quota is None else max(1, min(mask, int(quota)))


def cgroup_quota(root: Path = _CGROUPS, membership: Path = Path("/proc/self/cgroup")) -> float | None:
    """Return the smallest CPU quota of this process's cgroup and those above it, in CPUs; None without one.

    Args:
        root: where the cgroup file systems are mounted.
        membership: lists the cgroups of the process, a line for each hierarchy.

    Example:
        >>> import tempfile
        >>> folder = Path(tempfile.mkdtemp())
        >>> _ = (folder / "cpu.max").write_text("150000 100000")
        >>> _ = (folder / "self").write_text("0::/")
        >>> cgroup_quota(folder, folder / "self")
        1.5
    """
    try:
        lines = membership.read_text(encoding="utf-8", errors="surrogateescape").splitlines()
    except OSError:  # not Linux
        return None
    groups = (group for line in lines for group in _groups(line, root))
    return min((quota for quota in map(_quota, groups) if quota is not None), default=None)


def _groups(line: str, root: Path) -> Iterator[Path]:
    """Yield the folders of a line's cgroup and of those above it, where the line's hierarchy has CPU quotas."""
    _, controllers, path = line.split(":", 2)
    if not controllers:  # version 2
        mounts = [root]
    elif "cpu" in controllers.split(","):  # version 1: by the controllers' names in some order, and a link
        mounts = [root / controllers, root / "cpu"]
    else:
        return
    inside = PurePosixPath(path).relative_to("/")
    for mount in mounts:
        yield from (mount / group for group in (inside, *inside.parents))


def _quota(group: Path) -> float | None:
    try:
        if (group / "cpu.max").is_file():  # version 2
            quota, period = (group / "cpu.max").read_text(encoding="utf-8").split()
        else:
            quota, period = ((group / f"cpu.cfs_{name}_us").read_text(encoding="utf-8") for name in ("quota", "period"))
        return int(quota) / int(period) if quota != "max" and int(quota) > 0 else None
    except (OSError, ValueError):  # no such file, or one of another format
        return None


def cpu_mask() -> list[int]:
    """Return the CPUs that this process's threads may be put on."""
    if hasattr(os, "sched_getaffinity"):
        return sorted(os.sched_getaffinity(0))
    return list(range(os.cpu_count() or 1))


class NeighbourLoad:
    """Number of this process's CPUs that other processes keep busy.

    The load is what its CPUs did less what this process and its descendants did: it sees neighbours of any user, on
    Linux also the host's other machines (stolen time), and nothing of this process's own threads. Where the system
    does not report it, it is zero.

    Example:
        >>> load = NeighbourLoad()
        >>> time.sleep(0.1)
        >>> load.measure() >= 0.0
        True
    """

    def __init__(self) -> None:
        self._process = psutil.Process()
        self._load = 0.0
        self._last = self._read()

    def measure(self) -> float:
        """Return the CPUs that others used on average since the last call (or the construction)."""
        before, self._last = self._last, self._read()
        if before is not None and self._last is not None:
            seconds, busy, own = (now - then for now, then in zip(self._last, before))
            if seconds > 0 and own >= 0:  # less than before: a descendant ended while the list was read
                self._load = min(max(0.0, (busy - own) / seconds), float(len(cpu_mask())))
        return self._load

    def _read(self) -> tuple[float, float, float] | None:
        """Return the time and the CPU seconds so far: of all processes on this process's CPUs, and of its own."""
        try:
            every = psutil.cpu_times(percpu=True)
            family = [self._process, *self._process.children(recursive=True)]
        except (psutil.Error, OSError, NotImplementedError):  # sandboxes may forbid it
            return None
        mask = cpu_mask()
        if len(mask) != len(every):  # else all of them, though some containers and systems number them otherwise
            every = [every[cpu] for cpu in mask if cpu < len(every)]
        idle = ("idle", "iowait", "guest", "guest_nice")  # a guest's time is part of user's
        busy = sum(value for times in every for name, value in times._asdict().items() if name not in idle)
        return time.monotonic(), busy, sum(map(_cpu_seconds, family))


def _cpu_seconds(process: psutil.Process) -> float:
    """Return the CPU seconds of a process and of those children of it that ended; 0 if it has ended itself."""
    try:
        return float(sum(process.cpu_times()[:4]))  # user and system, and those of children
    except psutil.Error:
        return 0.0
