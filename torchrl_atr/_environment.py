"""Environment variables that torch and torchrl read when they are imported."""

from __future__ import annotations

import os

_VARIABLES = {
    "RL_LOGGING_LEVEL": "WARNING",
    "GOMP_SPINCOUNT": "20000",  # torch's idle threads spin on CPUs that MuJoCo's need
}


def prepare_environment() -> None:
    """Set the variables that are not set yet; to be called before torch and torchrl are imported."""
    for name, value in _VARIABLES.items():
        os.environ.setdefault(name, value)
