"""Measurements of the library: speed, learning, robustness; run from a clone."""

import os

from torchrl_atr.cli import ENVIRONMENT

for _name, _value in ENVIRONMENT.items():  # as the command line does it, before torch is imported
    os.environ.setdefault(_name, _value)
