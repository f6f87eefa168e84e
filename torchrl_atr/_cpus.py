"""How many CPUs there are to share."""

from __future__ import annotations

import os


def available_cpus() -> int:
    """The CPUs that this process may use, on systems that can keep it from some; else all.

    Example:
        >>> available_cpus() >= 1
        True
    """
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1
