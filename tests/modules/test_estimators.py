from __future__ import annotations

import pytest
import torch
from torch import nn

from torchrl_atr.modules import (
    CNNGRUEstimator,
    available_estimators,
    check_estimator,
    get_estimator,
    register_estimator,
)
from torchrl_atr.modules.estimators import TimeConvolution

SHAPE, OUT = (6, 5), 3


@pytest.mark.parametrize("name", ["cnn_gru", "mlp"])
@pytest.mark.parametrize("shape", [(1, 4), (2, 4), (10, 46)])
def test_registered_estimators_pass_the_check(name, shape):
    check_estimator(get_estimator(name), history_shape=shape, out_features=OUT)


@pytest.mark.parametrize("length", [1, 2, 3, 4, 5, 7, 8, 9, 10, 11, 13, 14, 19, 20, 33, 50])
def test_cnn_gru_uses_every_sample_and_few_steps(length):
    net = CNNGRUEstimator((length, 3), 2, channels=8, gru_features=8, mlp_cells=(8,))
    seen = []
    net.gru.register_forward_pre_hook(lambda _, args: seen.append(args[0].shape[1]))
    history = torch.randn(2, length, 3, requires_grad=True)
    net(history).sum().backward()
    assert bool((history.grad.abs().sum((0, 2)) > 0).all())
    assert 1 <= seen[0] <= 6


def test_cnn_gru_matches_table_1():
    net = get_estimator("cnn_gru")(history_shape=(10, 46), out_features=16)
    assert net.gru.hidden_size == 64  # ours: the paper gives the MLP's width only
    assert [layer.out_features for layer in net.head if isinstance(layer, nn.Linear)] == [128, 16]
    assert sum(isinstance(layer, TimeConvolution) for layer in net.convolutions) == 2


def test_a_window_that_cnn_gru_pads_is_one_that_began_with_more_of_its_oldest_sample():
    """Two more of 13 make the 15 samples that a stride of 3 divides."""
    short, long = (CNNGRUEstimator((length, 3), 2, channels=8, gru_features=8, mlp_cells=(8,)) for length in (13, 15))
    long.load_state_dict(short.state_dict())
    history = torch.randn(4, 13, 3)
    torch.testing.assert_close(short(history), long(torch.cat([history[:, :1], history[:, :1], history], 1)))


@pytest.mark.parametrize(("length", "kernel", "stride"), [(10, 4, 2), (4, 2, 1), (5, 5, 3), (1, 1, 1)])
def test_a_time_convolution_is_a_convolution_over_time(length, kernel, stride):
    ours, x = TimeConvolution(3, 8, kernel, stride), torch.randn(7, length, 3)
    theirs = ours.weight.unflatten(1, (kernel, 3)).transpose(1, 2)
    expected = nn.functional.conv1d(x.transpose(1, 2), theirs, ours.bias, stride).transpose(1, 2)
    torch.testing.assert_close(ours(x), expected)


@pytest.mark.parametrize("name", ["cnn_gru", "mlp"])
def test_order_of_the_history_matters(name):
    net = get_estimator(name)(history_shape=SHAPE, out_features=OUT)
    history = torch.randn(1, *SHAPE)
    assert not torch.allclose(net(history), net(history.flip(1)))


def test_registry():
    @register_estimator("test_decorated")
    class Decorated(nn.Module):
        pass

    assert get_estimator("test_decorated") is Decorated
    assert register_estimator("test_called", Decorated) is Decorated
    assert {"test_decorated", "test_called", "cnn_gru", "mlp"} <= set(available_estimators())
    with pytest.raises(ValueError, match=r"cnn_gru.*register_estimator"):
        get_estimator("oracle")
    with pytest.raises(ValueError, match="cnn_gru"):
        register_estimator("cnn_gru", Decorated)
    with pytest.raises(ValueError, match="non-empty string"):
        register_estimator("", Decorated)
    with pytest.raises(TypeError, match="callable"):
        register_estimator("not_callable", 3)


def test_wrong_history_shape_is_named():
    with pytest.raises(ValueError, match=r"\(\*, 6, 5\).*\(2, 5, 6\)"):
        CNNGRUEstimator(SHAPE, OUT)(torch.zeros(2, 5, 6))


class Good(nn.Module):
    def __init__(self, history_shape, out_features):
        super().__init__()
        self.head = nn.Linear(history_shape[-1], out_features)

    def forward(self, history):
        return self.head(history[..., -1, :])


class OneBatchDim(Good):
    def forward(self, history):
        return self.head(history[:, -1].reshape(len(history), -1))


class WrongSize(Good):
    def forward(self, history):
        return super().forward(history)[..., :-1]


class WrongDtype(Good):
    def forward(self, history):
        return super().forward(history).double()


class Pair(Good):
    def forward(self, history):
        return super().forward(history), None


class NotFinite(Good):
    def forward(self, history):
        return super().forward(history) / 0.0


class Stateful(Good):
    calls = 0

    def forward(self, history):
        self.calls += 1
        return super().forward(history) + self.calls


class MixesRows(Good):
    def forward(self, history):
        out = super().forward(history)
        return out - out.mean(0, keepdim=True) if out.ndim > 1 else out


class InPlace(Good):
    def forward(self, history):
        return super().forward(history.mul_(2.0))


class Unused(Good):
    def __init__(self, history_shape, out_features):
        super().__init__(history_shape, out_features)
        self.spare = nn.Parameter(torch.zeros(1))


class ZeroGradient(Good):
    def forward(self, history):
        out = super().forward(history)
        return out - out + history[..., -1, : out.shape[-1]]


class HiddenState(Good):
    def __init__(self, history_shape, out_features):
        super().__init__(history_shape, out_features)
        self.offset = torch.randn(out_features)

    def forward(self, history):
        return super().forward(history) + self.offset


class KeepsGraph(Good):
    def forward(self, history):
        self.last = super().forward(history)
        return self.last


class HoldsOriginal(Good):
    def __init__(self, history_shape, out_features):
        super().__init__(history_shape, out_features)
        self.function = lambda history: self.head(history[..., -1, :])

    def forward(self, history):
        return self.function(history)


def test_check_accepts_a_minimal_estimator_and_leaves_the_random_state_alone():
    state = torch.get_rng_state()
    check_estimator(Good, history_shape=SHAPE, out_features=OUT)
    assert torch.equal(torch.get_rng_state(), state)


@pytest.mark.parametrize(
    ("factory", "failed"),
    [
        (lambda **_: lambda history: history, "module"),
        (OneBatchDim, "leading dimensions"),
        (WrongSize, "shape"),
        (WrongDtype, "dtype"),
        (Pair, "output"),
        (NotFinite, "finite"),
        (Stateful, "deterministic"),
        (MixesRows, "independent rows"),
        (InPlace, "input unchanged"),
        (Unused, "gradients.*spare"),
        (ZeroGradient, "gradients.*non-zero"),
        (HiddenState, "state_dict"),
        (KeepsGraph, "copy.*deepcopy raised RuntimeError"),
        (HoldsOriginal, "copy.*weights of the original"),
    ],
)
def test_check_names_what_is_wrong(factory, failed):
    with pytest.raises(AssertionError, match=failed):
        check_estimator(factory, history_shape=SHAPE, out_features=OUT)


def test_a_convolution_that_never_sees_the_window_is_refused():
    with pytest.raises(ValueError, match="kernel"):
        get_estimator("tcn")((10, 46), 16, kernel=1)
