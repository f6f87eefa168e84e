"""Measurements of the library: speed, learning, robustness; run from a clone."""
