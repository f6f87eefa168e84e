from __future__ import annotations

import pytest
import torch
from tensordict import TensorDict

from torchrl_atr.modules import ActSource, AssignActSource


def data(batch=(4,)):
    return TensorDict(
        {
            "latent": {"intrinsic": torch.randn(*batch, 3, requires_grad=True)},
            "privileged": {"extrinsic": torch.randn(*batch, 2)},
            "estimate": {
                "intrinsic": torch.randn(*batch, 3, requires_grad=True),
                "extrinsic": torch.randn(*batch, 2, requires_grad=True),
            },
            "act": {"student": torch.rand(*batch, 1) < 0.5},
        },
        batch_size=batch,
    )


def test_privileged_passes_values_and_gradient():
    td = data()
    out = ActSource("privileged")(td.clone(False))
    assert out["act", "intrinsic"] is td["latent", "intrinsic"]
    assert torch.equal(out["act", "extrinsic"], td["privileged", "extrinsic"])


def test_estimated_is_detached():
    td = ActSource("estimated")(data())
    for side in ("intrinsic", "extrinsic"):
        assert torch.equal(td["act", side], td["estimate", side])
        assert not td["act", side].requires_grad


@pytest.mark.parametrize("batch", [(4,), (2, 3)])
def test_mixed_chooses_by_row_and_blocks_the_students_gradient(batch):
    td = ActSource("mixed")(data(batch))
    student = td["act", "student"].squeeze(-1)
    assert torch.equal(td["act", "intrinsic"][student], td["estimate", "intrinsic"][student])
    assert torch.equal(td["act", "intrinsic"][~student], td["latent", "intrinsic"][~student])
    assert torch.equal(td["act", "extrinsic"][student], td["estimate", "extrinsic"][student])
    assert torch.equal(td["act", "extrinsic"][~student], td["privileged", "extrinsic"][~student])
    td["act", "intrinsic"].sum().backward()
    assert torch.equal(td["latent", "intrinsic"].grad, (~student).float().unsqueeze(-1).expand(*batch, 3))
    assert td["estimate", "intrinsic"].grad is None


@pytest.mark.parametrize(
    ("source", "reads"),
    [
        ("privileged", {("latent", "intrinsic"), ("privileged", "extrinsic")}),
        ("estimated", {("estimate", "intrinsic"), ("estimate", "extrinsic")}),
        (
            "mixed",
            {
                ("latent", "intrinsic"),
                ("privileged", "extrinsic"),
                ("estimate", "intrinsic"),
                ("estimate", "extrinsic"),
                ("act", "student"),
            },
        ),
    ],
)
def test_in_keys_are_exactly_what_is_needed(source, reads):
    module = ActSource(source)
    assert set(module.in_keys) == reads
    module(data().select(*reads))
    for key in reads:
        with pytest.raises(KeyError, match=key[-1]):
            module(data().exclude(key))


def test_renamed_keys():
    module = ActSource(
        "estimated",
        intrinsic_estimate="zhat",
        extrinsic_estimate=("a", "b"),
        act_intrinsic="z",
        act_extrinsic="x",
    )
    td = module(TensorDict({"zhat": torch.ones(2, 3), "a": {"b": torch.zeros(2, 1)}}, [2]))
    assert torch.equal(td["z"], torch.ones(2, 3))
    assert torch.equal(td["x"], torch.zeros(2, 1))


def test_unknown_source():
    with pytest.raises(ValueError, match=r"oracle.*privileged, estimated, mixed"):
        ActSource("oracle")


@pytest.mark.parametrize(("fraction", "students"), [(0.0, 0), (0.25, 1), (0.5, 3), (0.75, 4), (1.0, 5)])
def test_assignment_takes_the_first_rows_of_the_env_dimension(fraction, students):
    expected = torch.arange(5).lt(students).unsqueeze(-1)
    td = AssignActSource(fraction)(TensorDict(observation=torch.zeros(5, 7), batch_size=[5]))
    assert torch.equal(td["act", "student"], expected)
    nested = AssignActSource(fraction)(TensorDict(observation=torch.zeros(2, 5, 7), batch_size=[2, 5]))
    assert torch.equal(nested["act", "student"], expected.expand(2, 5, 1))


def test_assignment_bad_input():
    with pytest.raises(ValueError, match=r"\[0, 1\]"):
        AssignActSource(1.5)
    with pytest.raises(ValueError, match="batched env"):
        AssignActSource(0.5)(TensorDict(observation=torch.zeros(7)))
