"""Standard transforms of an env with commands, in their order."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from torchrl.envs.transforms import CatTensors, Compose, RewardSum, StepCounter

from torchrl_atr._checks import check_flag, check_pair, check_whole
from torchrl_atr._errors import InputError
from torchrl_atr.envs.transforms.compact_storage import CompactStorage
from torchrl_atr.envs.transforms.curriculum import CommandCurriculum
from torchrl_atr.envs.transforms.foot_repositioning import FootRepositioning
from torchrl_atr.envs.transforms.history import ObservationHistory
from torchrl_atr.envs.transforms.overspeed import OverspeedTermination
from torchrl_atr.envs.transforms.slew import CommandSlew
from torchrl_atr.envs.transforms.step_counter import RandomizedStepCounter, TimeLimitGrowth


def task_transforms(
    tracking_max: Sequence[float],
    *,
    history_length: int = 10,
    include_current: bool = False,
    max_steps: int = 1000,
    stagger: int = 0,
    time_limit_growth: TimeLimitGrowth | None = None,
    command_slew: tuple[float, float] | None = None,
    overspeed_margin: tuple[float, float] | None = None,
    overspeed_penalty: float = 0.0,
    foot_repositioning: FootRepositioning | None = None,
    compact_storage: bool = False,
    **curriculum: Any,
) -> Compose:
    """Return the transforms for command, observation, history, time limit and episode reward, in a consistent order.

    ``CommandCurriculum -> CatTensors -> ObservationHistory -> StepCounter -> RewardSum``: the observation is
    put together again after the command was resampled, and the history stores that observation. The
    curriculum does not see the time limit: a window that ends with the episode is scored, and the last
    observation holds the next command, as it does at the end of every other window.

    Args:
        tracking_max: See :class:`CommandCurriculum`.
        history_length: H, past observations in ``history``.
        include_current: Whether the history ends with o_t (question A19).
        max_steps: Steps after which an episode is truncated (20 s at 50 Hz).
        stagger: If positive, the first episodes end at different times, and the limit is checked every ``stagger``
            steps: a :class:`RandomizedStepCounter`.
        time_limit_growth: Lower time limit at first, of a :class:`RandomizedStepCounter`, which ``stagger`` makes.
        command_slew: If given, rates of a :class:`CommandSlew` behind the curriculum, m/s² and rad/s²; rows of the
            curriculum's ``unscored_key``, which start moving, start at their command.
        overspeed_margin: If given, of a :class:`OverspeedTermination` behind the curriculum, m/s and rad/s.
        overspeed_penalty: Added to the reward where an episode ends for its speed.
        foot_repositioning: If given, it is applied to the actions.
        compact_storage: Whether collected steps hold the history at the root alone, and reward terms in ``next`` alone:
            a :class:`CompactStorage` behind all others.
        **curriculum: Further arguments of :class:`CommandCurriculum`, such as ``window``, ``grid`` or
            ``seed``.

    Returns:
        The transforms, ``[0]`` being the curriculum: ``TransformedEnv(env, task_transforms(...))``.

    Raises:
        InputError: for a time limit that grows without ``stagger``, or a number out of range.

    Example:
        >>> [type(t).__name__ for t in task_transforms((0.2, 0.1), seed=0)]
        ['CommandCurriculum', 'CatTensors', 'ObservationHistory', 'StepCounter', 'RewardSum']
    """
    max_steps, stagger = check_whole("max_steps", max_steps, low=1), check_whole("stagger", stagger)
    check_flag("compact_storage", compact_storage)
    check_whole("history_length", history_length, low=1)
    if time_limit_growth is not None and not stagger:
        raise InputError("time_limit_growth needs staggered first episodes; give stagger=1 or more")
    if overspeed_margin is not None:
        check_pair("overspeed_margin", overspeed_margin, "two positive numbers (m/s, rad/s)")
    command = CommandCurriculum(tracking_max, **curriculum)
    moving = curriculum.get("unscored_key")
    slews = [CommandSlew(command_slew, moving_key=moving, command_key=command.command_key)] if command_slew else []
    guards = [] if overspeed_margin is None else [OverspeedTermination(command, overspeed_margin, overspeed_penalty)]
    return Compose(
        command,
        *slews,
        *guards,
        CatTensors(["proprio", command.command_key], "observation", sort=False, del_keys=False),
        ObservationHistory(history_length, include_current=include_current),
        StepCounter(max_steps)
        if stagger == 0
        else RandomizedStepCounter(max_steps, curriculum.get("seed"), stagger, time_limit_growth),
        RewardSum(),
        *([] if foot_repositioning is None else [foot_repositioning]),
        *([CompactStorage(at_root=["history"], in_next=["reward_terms"])] if compact_storage else []),
    )
