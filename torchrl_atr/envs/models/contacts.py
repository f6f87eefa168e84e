"""How contacts are solved, so that feet which do not slide stay where they are."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import mujoco


@dataclass(frozen=True)
class ContactModel:
    """MuJoCo's options that decide how far a loaded foot creeps within its friction cone.

    MuJoCo's friction is soft: a foot under a steady tangential force moves at a steady speed. ``impratio`` divides
    that speed; no-slip iterations, which follow the solver's, remove it. These are of full effect with an elliptic cone
    alone: a pyramidal one bounds what each of its two axes may take by how the solver happened to share the load
    between them. It also lets a foot that is pushed diagonally slide at 1/sqrt(2) of its friction; an elliptic one
    holds up to μ times the load in every direction.

    Attributes:
        cone: of friction, elliptic or pyramidal.
        impratio: how much stiffer friction is than the normal force. The solver takes longer the higher it is, and from
            50 on it fails.
        noslip_iterations: passes that remove what is left of the creep. An engine that has none, as on a GPU, is better
            off with an ``impratio`` of 10.

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
"""Every scene's: of the models of ``benchmarks/contact_creep.py`` the one that holds all robots at the least cost."""
