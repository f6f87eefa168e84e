import numpy as np
import pytest
from matplotlib import pyplot as plt

from torchrl_atr.evaluation import command_grid, plotting


@pytest.fixture
def axis():
    return plotting.subplots(figsize=(4, 3))[1]


def test_cells_stand_at_their_commands_in_any_order(axis):
    """Speeds unsorted and at unequal distances; each cell covers its command and half the way to its neighbours."""
    values = np.array([[2.0, 5.0], [0.0, 3.0], [1.0, 4.0]])
    mesh = plotting.heatmap(axis, np.array([2.0, -1.0, 0.0]), np.array([0.0, 0.5]), values, "viridis", 5.0)
    np.testing.assert_array_equal(mesh.get_array().reshape(2, 3), [[0, 1, 2], [3, 4, 5]])
    np.testing.assert_allclose(mesh.get_coordinates()[0, :, 0], [-1.5, -0.5, 1.0, 3.0])
    np.testing.assert_allclose(mesh.get_coordinates()[:, 0, 1], [-0.25, 0.25, 0.75])
    places = {text.get_text(): text.get_position() for text in axis.texts}
    assert places["2.0"] == (2.0, 0.0)
    assert places["0"] == (-1.0, 0.0)


@pytest.mark.parametrize(
    ("grid", "speeds", "yaw_rates"),
    [
        ((2, 1, 1, 0.25), [-2, -1, 0, 1, 2], [-1, -0.5, 0, 0.5, 1]),
        ((15, 2, 1, 0.2), [-15, -10, -5, 0, 5, 10, 15], [-2, -1, 0, 1, 2]),
        ((6, 1.4, 0.2, 0.2), [-6, -4, -2, 0, 2, 4, 6], [-1.5, -1, -0.5, 0, 0.5, 1, 1.5]),
        ((0, 0, 1, 1), [0], [0]),
    ],
)
def test_ticks_are_round_numbers_and_few(axis, grid, speeds, yaw_rates):
    x, y = command_grid(*grid)
    plotting.heatmap(axis, x, y, np.ones((len(x), len(y))), "viridis", 1.0)
    for commands, ticks, limits in (
        (speeds, axis.get_xticks(), axis.get_xlim()),
        (yaw_rates, axis.get_yticks(), axis.get_ylim()),
    ):
        inside = [round(float(tick), 9) for tick in ticks if limits[0] <= tick <= limits[1]]
        assert inside == commands


def test_values_are_written_while_they_can_be_read(axis):
    for cells, written in (((11, 9), True), ((31, 21), False)):
        axis.clear()
        x, y = np.arange(float(cells[0])), np.arange(float(cells[1]))
        plotting.heatmap(axis, x, y, np.ones(cells), "viridis", 1.0)
        assert len(axis.texts) == (cells[0] * cells[1] if written else 0)


@pytest.mark.parametrize("power", [0.5, 1.0])
@pytest.mark.parametrize("top", [0.05, 1.0, 2.236, 15.0])
def test_a_colour_bar_begins_at_0_and_ends_at_its_top(axis, top, power):
    mesh = plotting.heatmap(axis, np.arange(3.0), np.arange(2.0), np.full((3, 2), 2 * top), "viridis", top, power)
    plotting.colour_bar(axis.figure, axis, mesh, "m/s")
    bar = mesh.colorbar
    ticks = bar.get_ticks()
    assert ticks[0] == 0.0
    assert ticks[-1] == pytest.approx(top)
    assert 4 <= len(ticks) <= 9
    assert (np.diff([float(mesh.norm(tick)) for tick in ticks]) > 0.09).all()
    assert bar.extend == "max"  # values lie beyond


def test_figures_are_none_of_the_users_pyplot():
    before = plt.get_fignums()
    _, axes = plotting.subplots(2, 3, figsize=(4, 3))
    assert axes.shape == (2, 3)
    assert plt.get_fignums() == before
