"""Commands beyond the range are clipped: yaw rate first, then speed."""

from __future__ import annotations

import copy
import json

import pytest
import torch
from tensordict import TensorDict
from torchrl.data import Composite, Unbounded

from torchrl_atr._errors import InputError
from torchrl_atr.modules import COMMAND_RANGE_FILE, CommandClippedPolicy, CommandRange, make_networks

LIMITS = CommandRange(max_speed=4.0, max_yaw_rate=1.0, max_lateral_acceleration=2.0)


@pytest.mark.parametrize(
    ("limits", "asked", "told"),
    [
        (LIMITS, (1.5, -0.5), (1.5, -0.5)),  # within
        (LIMITS, (-9.0, 0.0), (-4.0, 0.0)),
        (LIMITS, (0.0, -3.0), (0.0, -1.0)),
        (LIMITS, (-9.0, -3.0), (-4.0, -0.5)),  # 4 m/s leave 0.5 rad/s
        (CommandRange(4.0, 1.0, 2.0, least_yaw_rate=0.8), (4.0, 1.0), (2.5, 0.8)),  # and 0.8 rad/s 2.5 m/s
        (CommandRange(4.0, 1.0, 2.0, least_yaw_rate=0.8), (4.0, -0.6), (2.0 / 0.6, -0.6)),
        (CommandRange(4.0, 1.0), (9.0, 3.0), (4.0, 1.0)),
        (CommandRange(4.0, 1.0, 0.0), (9.0, 3.0), (4.0, 0.0)),  # straight on alone
        (CommandRange(0.0, 1.0, 2.0), (9.0, 0.7), (0.0, 0.7)),
    ],
)
def test_yaw_rate_gives_way_first_and_then_speed(limits, asked, told):
    torch.testing.assert_close(limits(torch.tensor([asked])), torch.tensor([told]))


def test_whatever_is_asked_is_in_the_range_and_stays_there():
    asked = 20 * torch.randn(4, 500, 2, generator=torch.Generator().manual_seed(0))
    for least in (0.0, 0.4):
        limits = CommandRange(4.0, 1.0, 2.0, least)
        told = limits(asked)
        assert told.shape == asked.shape
        assert (told.abs() <= torch.tensor([4.0, 1.0])).all()
        assert (told.prod(-1).abs() <= 2.0 + 1e-5).all()
        assert (told * asked >= 0).all()
        torch.testing.assert_close(limits(told), told)


@pytest.mark.parametrize(
    "bounds", [{"max_speed": -1.0}, {"max_yaw_rate": float("nan")}, {"max_lateral_acceleration": -0.1}]
)
def test_impossible_bounds_are_named(bounds):
    with pytest.raises(InputError, match=next(iter(bounds))):
        CommandRange(**{"max_speed": 1.0, "max_yaw_rate": 1.0, **bounds})


def test_a_range_is_kept_in_a_folder(tmp_path):
    assert CommandRange.load(tmp_path) is None
    for limits in (LIMITS, CommandRange(4.0, 1.0)):
        assert limits.save(tmp_path) == tmp_path / COMMAND_RANGE_FILE
        assert CommandRange.load(tmp_path) == limits
    for text in ("{", json.dumps({"max_speed": 1.0}), json.dumps({"max_speed": -1.0, "max_yaw_rate": 1.0}), "[]"):
        (tmp_path / COMMAND_RANGE_FILE).write_text(text)
        with pytest.raises(InputError, match=r"is no range of commands .* remove it, or record it anew"):
            CommandRange.load(tmp_path)


def test_deployed_policy_acts_as_if_the_clipped_command_had_been_given():
    privileged = Composite(intrinsic=Unbounded((6,)), extrinsic=Unbounded((3,)))
    spec = Composite(observation=Unbounded((5,)), history=Unbounded((4, 5)), privileged=privileged)
    networks = make_networks(spec, Unbounded((2,))).eval()
    free = networks.deployed_policy()
    td = TensorDict({"observation": 9 * torch.randn(8, 5), "history": 9 * torch.randn(8, 4, 5)}, [8])
    networks.command_range = LIMITS
    clipped = networks.deployed_policy()
    assert isinstance(clipped, CommandClippedPolicy)
    assert (set(clipped.in_keys), set(clipped.out_keys)) == (set(free.in_keys), set(free.out_keys))
    told = td.clone()
    for key in ("observation", "history"):
        told[key][..., -2:] = LIMITS(told[key][..., -2:])
    with torch.no_grad():
        found = clipped(td.clone())
        torch.testing.assert_close(found["action"], free(told.clone())["action"])
        assert not torch.allclose(found["action"], free(td.clone())["action"])
        assert (found["observation"] == td["observation"]).all()
        assert (copy.deepcopy(clipped)(td.clone())["action"] == found["action"]).all()
        assert torch.equal(clipped(told.clone())["action"], free(told.clone())["action"])  # within: bit for bit
