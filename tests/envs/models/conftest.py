"""Shared by the tests of models."""

from __future__ import annotations

import mujoco
import pytest


@pytest.fixture
def stand():
    """``stand(model)``: data of keyframe 0, forwarded."""

    def make(model: mujoco.MjModel) -> mujoco.MjData:
        data = mujoco.MjData(model)
        mujoco.mj_resetDataKeyframe(model, data, 0)
        mujoco.mj_forward(model, data)
        return data

    return make
