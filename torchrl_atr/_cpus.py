"""Count the CPUs that this process may use, and those that others use meanwhile."""

from __future__ import annotations

import os
import time
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
    quota = cgroup_quota()
    return len(_mask()) if quota is None else max(1, min(len(_mask()), int(quota)))


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
        lines = membership.read_text(encoding="utf-8").splitlines()
    except OSError:  # not Linux
        return None
    quotas = []
    for line in lines:
        _, controllers, path = line.split(":", 2)
        if controllers and "cpu" not in controllers.split(","):
            continue
        mount = root / controllers if controllers else root  # version 1 mounts each hierarchy by its controllers
        inside = PurePosixPath(path).relative_to("/")
        for group in (inside, *inside.parents):
            quotas.append(_quota(mount / group))
    return min((quota for quota in quotas if quota is not None), default=None)


def _quota(group: Path) -> float | None:
    try:
        if (group / "cpu.max").is_file():  # version 2
            quota, period = (group / "cpu.max").read_text(encoding="utf-8").split()
        else:
            quota, period = ((group / f"cpu.cfs_{name}_us").read_text(encoding="utf-8") for name in ("quota", "period"))
        return int(quota) / int(period) if quota != "max" and int(quota) > 0 else None
    except (OSError, ValueError):  # no such file, or one of another format
        return None


def _mask() -> list[int]:
    if hasattr(os, "sched_getaffinity"):
        return sorted(os.sched_getaffinity(0))
    return list(range(os.cpu_count() or 1))


class NeighbourLoad:
    """Measure how many of this process's CPUs other processes keep busy.

    The load is what its CPUs did less what this process and its descendants did: it sees neighbours of any user, on
    Linux also the host's other machines (stolen time), and nothing of this process's own threads.

    Example:
        >>> load = NeighbourLoad()
        >>> time.sleep(0.1)
        >>> load.measure() >= 0.0
        True
    """

    def __init__(self) -> None:
        self._process = psutil.Process()
        self._last = self._read()

    def measure(self) -> float:
        """Return the CPUs that others used on average since the last call (or the construction)."""
        before, self._last = self._last, self._read()
        seconds, busy, own = (now - then for now, then in zip(self._last, before))
        return max(0.0, (busy - own) / seconds) if seconds > 0 else 0.0

    def _read(self) -> tuple[float, float, float]:
        """Return the time and the CPU seconds so far: of all processes on this process's CPUs, and of its own."""
        every = psutil.cpu_times(percpu=True)
        mask = [cpu for cpu in _mask() if cpu < len(every)]
        idle = ("idle", "iowait", "guest", "guest_nice")  # a guest's time is part of user's
        busy = sum(sum(v for k, v in every[cpu]._asdict().items() if k not in idle) for cpu in mask)
        own = 0.0
        for process in (self._process, *self._process.children(recursive=True)):
            try:
                own += sum(process.cpu_times()[:4])  # user and system, and those of children that ended
            except psutil.Error:  # ended meanwhile
                continue
        return time.monotonic(), busy, own
