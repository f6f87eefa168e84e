"""Solver options of contacts, which keep loaded feet from creeping."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import mujoco


@dataclass(frozen=True)
class ContactModel:
    """Options of MuJoCo that determine the creep of a loaded foot within its friction cone.

    MuJoCo's friction is soft: a foot under a steady tangential force moves at a steady speed. ``impratio`` divides
    that speed; no-slip iterations, which follow the solver's, remove it. They are fully effective with an elliptic cone
    only: a pyramidal one bounds the force along each of its two axes by the solver's split of the load between
    them. It also lets a foot that is pushed diagonally slide at 1/sqrt(2) of its friction; an elliptic one holds up
    to μ times the load in every direction.

    Attributes:
        cone: of friction, elliptic or pyramidal.
        impratio: ratio of the stiffness of friction to that of the normal force. The solver takes longer the higher it
            is, and from 50 on it fails.
        noslip_iterations: passes that remove the remaining creep. An engine without them, as on a GPU, should use an
            ``impratio`` of 10.

    Example:
        >>> from torchrl_atr.envs.models import ROBOTS, FlatGround, build_scene
        >>> option = build_scene(ROBOTS.get("a1"), FlatGround()).model.opt
        >>> option.impratio == CONTACTS.impratio, option.noslip_iterations == CONTACTS.noslip_iterations
        (True, True)
    """

    cone: mujoco.mjtCone = mujoco.mjtCone.mjCONE_ELLIPTIC
    impratio: float = 1.0
    noslip_iterations: int = 2

    def write(self, option: Any) -> None:
        """Set the options of a model or of its spec."""
        option.cone, option.impratio, option.noslip_iterations = self.cone, self.impratio, self.noslip_iterations


CONTACTS = ContactModel()
"""Contact model of all scenes: the cheapest of ``benchmarks/contact_creep.py`` that holds all robots."""
