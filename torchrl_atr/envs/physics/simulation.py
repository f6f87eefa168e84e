"""Numerics of a simulation, and the delay of its actuators: what a policy should not depend on."""

from __future__ import annotations

import copy
import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

import mujoco

from torchrl_atr._checks import check_choice, check_number, check_whole
from torchrl_atr._errors import InputError
from torchrl_atr.envs.models.scene import Scene
from torchrl_atr.envs.physics.engine import CONTROL_DT

EngineName = Literal["batch", "dm_control"]
"""Name of an engine: N robots on all CPUs, or one robot, the reference."""
_SOLVERS = {"newton": "mjSOL_NEWTON", "cg": "mjSOL_CG", "pgs": "mjSOL_PGS"}
_INTEGRATORS = {"implicitfast": "mjINT_IMPLICITFAST", "implicit": "mjINT_IMPLICIT", "euler": "mjINT_EULER"}
_CONES = {"elliptic": "mjCONE_ELLIPTIC", "pyramidal": "mjCONE_PYRAMIDAL"}
_CHOICES: Mapping[str, tuple[Any, Mapping[str, str]]] = {
    "solver": (mujoco.mjtSolver, _SOLVERS),
    "integrator": (mujoco.mjtIntegrator, _INTEGRATORS),
    "cone": (mujoco.mjtCone, _CONES),
}
MOST_DELAY = 1.0
"""Largest delay of actions, s."""


@dataclass(frozen=True)
class Simulation:
    """Engine, its numerics and the delay of actions; a number or name that is None is that of training.

    Attributes:
        engine: ``"batch"`` or ``"dm_control"``.
        timestep: of the simulation, s; divides the control period of 20 ms.
        solver: of contacts, ``"newton"``, ``"cg"`` or ``"pgs"``.
        iterations: of the solver.
        integrator: ``"implicitfast"``, ``"implicit"`` or ``"euler"``.
        cone: of friction, ``"elliptic"`` or ``"pyramidal"``.
        noslip_iterations: of MuJoCo's no-slip solver.
        action_delay: time after which joint targets take effect, s, to the nearest time step. At the start of an
            episode, targets are those of the stand.

    Raises:
        InputError: names the field that does not fit.

    Example:
        >>> from torchrl_atr.envs import make_riding_env
        >>> env = make_riding_env(num_envs=2, physics=Simulation(timestep=0.0025, action_delay=0.01))
        >>> env.rollout(3)["action"].shape
        torch.Size([2, 3, 12])
    """

    engine: EngineName = "batch"
    timestep: float | None = None
    solver: str | None = None
    iterations: int | None = None
    integrator: str | None = None
    cone: str | None = None
    noslip_iterations: int | None = None
    action_delay: float = 0.0

    def __post_init__(self) -> None:
        if self.timestep is not None:
            steps = CONTROL_DT / check_number("timestep", self.timestep, 1e-4, CONTROL_DT)
            if abs(steps - round(steps)) > 1e-6:
                near = CONTROL_DT / round(steps)
                raise InputError(
                    f"timestep={self.timestep} must divide the control period, {CONTROL_DT} s; take {near:g}"
                )
        for name, (_, known) in _CHOICES.items():
            if getattr(self, name) is not None:
                check_choice(name, getattr(self, name), tuple(known))
        check_whole("iterations", self.iterations, 1, optional=True)
        check_whole("noslip_iterations", self.noslip_iterations, 0, optional=True)
        check_number("action_delay", self.action_delay, 0.0, MOST_DELAY)

    def applied(self, scene: Scene) -> Scene:
        """Return a scene with these numerics; the given one stays as it is.

        Example:
            >>> from torchrl_atr.envs.models import ROBOTS, FlatGround, build_scene
            >>> scene = build_scene(ROBOTS.get("a1"), FlatGround())
            >>> Simulation(timestep=0.0025).applied(scene).model.opt.timestep, scene.model.opt.timestep
            (0.0025, 0.005)
        """
        changed = {
            name: value
            for name, value in dataclasses.asdict(self).items()
            if name not in ("engine", "action_delay") and value is not None
        }
        if not changed:
            return scene
        model = copy.copy(scene.model)
        for name, value in changed.items():
            if name in _CHOICES:
                kinds, names = _CHOICES[name]
                value = getattr(kinds, names[value])
            setattr(model.opt, name, value)
        return dataclasses.replace(scene, model=model)
