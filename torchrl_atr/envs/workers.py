"""Changes of the envs that collectors and batched envs run in other processes."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from torchrl.collectors import BaseCollector
from torchrl.envs import EnvBase

from torchrl_atr._checks import check_kind
from torchrl_atr._errors import InputError


def reconfigure(target: BaseCollector | EnvBase, **changes: Any) -> None:
    """Change parameters of all envs of a collector, or of an env, also where they run in worker processes.

    Collectors are asked by TorchRL's ``collector.map_fn``, which those of this process, of worker processes
    (``backend="process"``) and of Ray have, batched envs by their dispatch of methods to workers. A value that does not
    fit changes nothing.

    Args:
        target: collector of envs of :func:`~torchrl_atr.envs.make_env`, such an env, or a ``SerialEnv`` or
            ``ParallelEnv`` of them that has started. Workers of an asynchronous collector change between two batches.
        **changes: see :meth:`~torchrl_atr.envs.tasks.reconfiguration.Reconfigurable.reconfigure`.

    Raises:
        InputError: (a ``ValueError``) names the parameter that is unknown, or has a value that does not fit; or says
            that the envs cannot be reached, as those of ``backend="distributed"``.

    Example:
        >>> from torchrl.collectors import Collector
        >>> from torchrl_atr.envs import make_riding_env
        >>> collector = Collector(make_riding_env(num_envs=2), frames_per_batch=8, total_frames=8)
        >>> reconfigure(collector, sensors="realistic", randomization="off")
        >>> collector.shutdown()
    """
    check_kind("target", target, (BaseCollector, EnvBase), "a collector or an env")
    try:
        if isinstance(target, BaseCollector):
            workers = getattr(target, "num_workers", None) or getattr(target, "num_collectors", None) or 1
            answers = target.map_fn("env.try_reconfigure", list_of_kwargs=[changes] * workers)
        else:
            answers = target.try_reconfigure(**changes)
    except AttributeError as error:
        raise InputError(
            f"the envs of this {type(target).__name__} cannot be changed: take envs of make_env, in this process, in a "
            f"collector with backend='process' or 'ray', or in a started batched env ({error})"
        ) from error
    for message in _texts(answers):
        if message:
            raise InputError(message)


def _texts(answers: str | Iterable[Any]) -> list[str]:
    """Return the answers of all envs; batched envs in workers answer in lists."""
    return [answers] if isinstance(answers, str) else [text for each in answers for text in _texts(each)]
