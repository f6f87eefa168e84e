"""Choice of an engine by name."""

from __future__ import annotations

from collections.abc import Callable

from torchrl_atr._errors import InputError
from torchrl_atr.envs.models.scene import Scene
from torchrl_atr.envs.physics.engine import Engine
from torchrl_atr.envs.physics.hook import SubstepHook
from torchrl_atr.envs.physics.simulation import Simulation


def make_engine(
    scene: Scene,
    make_hook: Callable[[Engine], SubstepHook] | None,
    physics: str | Simulation,
    num_envs: int,
    num_threads: int | None = None,
) -> Engine:
    """Return an engine by name.

    Args:
        scene: the compiled scene.
        make_hook: see :class:`~torchrl_atr.envs.physics.engine.Engine`.
        physics: ``"batch"`` or ``"dm_control"``, or a :class:`~torchrl_atr.envs.physics.Simulation` for one of these
            with other numerics than in training, or with a delay of actions.
        num_envs: N.
        num_threads: of ``"batch"``; None for the CPUs this process may use.

    Raises:
        InputError: for unknown ``physics``, or more than one robot for ``"dm_control"``.
    """
    own = physics if isinstance(physics, Simulation) else Simulation(engine=physics)  # type: ignore[arg-type]
    scene = own.applied(scene)
    if own.engine == "batch":
        from torchrl_atr.envs.physics.batch import BatchEngine

        return BatchEngine(scene, num_envs, make_hook, num_threads, own.action_delay)
    if own.engine == "dm_control":
        if num_envs != 1:
            raise InputError(f"physics='dm_control' simulates one robot; num_envs={num_envs} needs physics='batch'")
        from torchrl_atr.envs.physics.dmc import DmControlEngine  # slow to import: never on the training path

        return DmControlEngine(scene, make_hook, own.action_delay)
    raise InputError(f"unknown physics {own.engine!r}; choose 'batch' or 'dm_control'")
