"""Measurements of the library: speed, learning, robustness; run from a clone."""

from torchrl_atr._environment import prepare_environment

prepare_environment()  # as the command line does it
