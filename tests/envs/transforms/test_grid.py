from __future__ import annotations

import math

import numpy as np
import pytest
import torch

from torchrl_atr.envs.transforms import CommandGrid

SMALL = CommandGrid(bounds=(2.0, 2.0), bin_size=(1.0, 1.0), initial=(0.5, 0.5), expansion=(1.0, 1.0))  # 5 x 5


def at(grid: CommandGrid, *cells: tuple[int, int]) -> torch.Tensor:
    return torch.tensor([row * grid.shape[1] + column for row, column in cells])


def test_default_grid_is_the_papers():
    grid = CommandGrid()
    weights = grid.initial_weights()
    assert grid.shape == (151, 21)
    assert weights.sum() == 15
    assert weights[73:78, 9:12].eq(1).all()  # 5 x 3 cells about the centre (75, 10)
    # the 15 cells tile the initial box: 4 * 0.5 * 0.3
    assert grid.area(weights) == pytest.approx((15 / 3171, 0.6))
    assert grid.frontier(weights) == (0.5, 0.3)


def test_full_grid_covers_exactly_the_bounds():
    grid = CommandGrid()
    full = torch.ones(grid.shape)
    assert grid.area(full) == pytest.approx((1.0, 30.0 * 4.0))
    assert grid.frontier(full) == (15.0, 2.0)


def test_centres_are_integer_multiples_of_the_bin():
    grid = CommandGrid()
    centres = grid.centres(torch.arange(151 * 21)).reshape(151, 21, 2)
    assert centres[75, 10].tolist() == [0.0, 0.0]
    for row in (0, 1, 74, 150):
        assert centres[row, 3].tolist() == [(row - 75) * 0.2, (3 - 10) * 0.2]
    assert torch.equal(grid.cell_of(centres.reshape(-1, 2)), torch.arange(151 * 21))


def test_update_table_by_hand():
    weights = SMALL.initial_weights()
    assert weights.sum() == 1
    assert weights[2, 2] == 1
    # one success at (2, 2), two at (1, 3)
    new = SMALL.update(weights, at(SMALL, (2, 2), (1, 3), (1, 3)))
    table = torch.tensor(
        [
            [0.0, 0.0, 0.2, 0.2, 0.2],
            [0.0, 0.1, 0.3, 0.3, 0.2],
            [0.0, 0.1, 1.0, 0.3, 0.2],
            [0.0, 0.1, 0.1, 0.1, 0.0],
            [0.0, 0.0, 0.0, 0.0, 0.0],
        ]
    )
    torch.testing.assert_close(new, table)


def test_own_cell_counted_twice_is_the_ancestors_reading():
    grid = CommandGrid(**{**SMALL.__dict__, "count_own_twice": True})
    new = grid.update(torch.zeros(5, 5), at(grid, (1, 1)))
    assert new[1, 1] == pytest.approx(0.2)
    assert new[1, 2] == pytest.approx(0.1)


def test_corner_cells_have_four_neighbours_in_the_grid():
    for corner in ((0, 0), (0, 4), (4, 0), (4, 4)):
        new = SMALL.update(torch.zeros(5, 5), at(SMALL, corner))
        assert (new > 0).sum() == 4
        assert new.sum() == pytest.approx(0.4)


def test_a_batch_equals_its_successes_one_by_one():
    grid, generator = CommandGrid(), torch.Generator().manual_seed(0)
    cells = torch.randint(151 * 21, (64,), generator=generator)
    cells = torch.cat([cells, cells[:16], cells[:4]])
    one_by_one = start = grid.initial_weights().double()
    for cell in cells:
        one_by_one = grid.update(one_by_one, cell[None])
    torch.testing.assert_close(grid.update(start, cells), one_by_one, rtol=0, atol=1e-12)


def test_weights_saturate_at_one_and_never_fall():
    grid, generator = CommandGrid(increment=0.3), torch.Generator().manual_seed(1)
    weights = grid.initial_weights()
    for _ in range(20):
        cells = torch.randint(1400, 1500, (40,), generator=generator)
        new = grid.update(weights, cells)
        assert (new >= weights).all()
        assert new.max() == 1  # the printed max(P + delta, 1) would grow without limit
        weights = new
    assert torch.equal(grid.update(weights, torch.empty(0, dtype=torch.long)), weights)


def test_every_inner_cell_has_all_its_neighbours():
    """Regression: float comparison finds three neighbours for only 87 (arange) or 64 (linspace) centres."""
    grid = CommandGrid()
    for centres, complete in ((np.arange(-75, 76) * 0.2, 87), (np.linspace(-15, 15, 151), 64)):
        near = (centres >= centres[:, None] - 0.2) & (centres <= centres[:, None] + 0.2)
        assert (near.sum(1) == 3).sum() == complete
    for row in range(1, 150):
        new = grid.update(torch.zeros(grid.shape), at(grid, (row, 10)))
        assert new.nonzero().tolist() == [[row + i, 10 + j] for i in (-1, 0, 1) for j in (-1, 0, 1)]


@pytest.mark.parametrize(("expansion", "radius"), [((0.2, 0.2), (1, 1)), ((0.6, 0.4), (3, 2)), ((0.0, 0.2), (0, 1))])
def test_radius_is_the_rounded_ratio(expansion, radius):
    assert CommandGrid(expansion=expansion).radius == radius


def test_initial_box_on_a_float_boundary_keeps_its_cells():
    # 0.6 / 0.2 = 2.9999999999999996: the cell centred on 0.6 still belongs to the box
    assert CommandGrid(initial=(0.6, 0.2)).initial_weights().sum() == 7 * 3


def test_sample_by_hand():
    weights = torch.zeros(5, 5)
    weights[1, 2], weights[4, 4] = 1.0, 0.5  # cells centred on (-1, 0) and (2, 2); probabilities 2/3 and 1/3
    uniforms = torch.tensor(
        [[0.0, 0.0, 0.0], [0.66, 0.5, 0.25], [0.67, 0.5, 0.5], [1 - 2**-53, 1 - 2**-53, 0.0]],
        dtype=torch.float64,
    )
    commands, cells = SMALL.sample(weights, uniforms)
    assert cells.tolist() == [7, 7, 24, 24]
    expected = [[-1.5, -0.5], [-1.0, -0.25], [1.75, 1.75], [2.0, 1.5]]  # the edge cell is cut at 2
    torch.testing.assert_close(commands, torch.tensor(expected, dtype=torch.float64))


def test_sample_never_leaves_cells_that_have_weight():
    grid = CommandGrid()
    weights = torch.zeros(grid.shape)
    weights[0, 0] = weights[80, 5] = weights[150, 20] = 0.3
    uniforms = torch.rand(5000, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(0))
    commands, cells = grid.sample(weights, uniforms)
    assert set(cells.tolist()) == {0, 80 * 21 + 5, 150 * 21 + 20}
    assert (commands.abs() <= torch.tensor([15.0, 2.0])).all()
    assert torch.equal(grid.cell_of(commands), cells)


def test_sample_follows_the_weights():
    weights = torch.zeros(5, 5)
    weights[0, 1], weights[2, 2], weights[3, 0] = 0.1, 0.3, 0.6
    n = 20_000
    uniforms = torch.rand(n, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(0))
    commands, cells = SMALL.sample(weights, uniforms)
    for cell, p in ((1, 0.1), (12, 0.3), (15, 0.6)):
        assert abs((cells == cell).sum().item() / n - p) < 4 * math.sqrt(p * (1 - p) / n)
    inside = commands[cells == 12]  # uniform on [-0.5, 0.5]^2: mean 0, variance 1/12
    assert inside.mean(0).abs().max() < 4 / math.sqrt(12 * len(inside))
    assert inside.var(0).sub(1 / 12).abs().max() < 0.005


def test_merge_commutes_and_is_idempotent():
    a, b = torch.rand(2, 5, 5, generator=torch.Generator().manual_seed(0))
    assert torch.equal(SMALL.merge(a, b), SMALL.merge(b, a))
    assert torch.equal(SMALL.merge(a, a), a)
    assert (SMALL.merge(a, b) >= a).all()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"bin_size": (0.7, 0.2)}, "whole multiple"),
        ({"initial": (16.0, 0.3)}, "within its bound"),
        ({"expansion": (0.05, 0.2)}, "reaches no neighbour"),
        ({"bounds": (math.inf, 2.0)}, "bounds must be two finite"),
        ({"bounds": (1.0, 2.0, 3.0)}, "bounds must be two finite"),
        ({"bin_size": (0.0, 0.2)}, "bin_size must be"),
        ({"increment": 0.0}, "increment"),
        ({"still": -0.1}, "still"),
        ({"still": 0.5, "turning": 0.3, "straight": 0.3}, "add up to more than 1"),
        ({"forward_only": 1}, "forward_only"),
    ],
)
def test_bad_settings_are_named(arguments, words):
    with pytest.raises(ValueError, match=words):
        CommandGrid(**arguments)


@pytest.mark.parametrize(
    ("weights", "words"),
    [
        (torch.ones(5, 4), "shape"),
        (torch.full((5, 5), 1.1), r"\[0, 1\]"),
        (torch.full((5, 5), math.nan), r"\[0, 1\]"),
        (torch.zeros(5, 5), "positive"),
    ],
)
def test_bad_weights_are_refused(weights, words):
    with pytest.raises(ValueError, match=words):
        SMALL.validate(weights)


def test_weights_are_cut_or_filled_up_around_rest():
    wide, narrow = CommandGrid(), CommandGrid(bounds=(2.2, 1.2), initial=(1.0, 0.2))
    weights = torch.rand(151, 21, generator=torch.Generator().manual_seed(0))
    cut = narrow.fitted(weights)
    assert torch.equal(cut, weights[64:87, 4:17])
    back = wide.fitted(cut)
    assert torch.equal(back[64:87, 4:17], cut)
    assert back.count_nonzero() == cut.count_nonzero()


FORWARD = CommandGrid(
    (1.5, 1.0), (0.25, 0.25), (1.5, 1.0), (0.25, 0.25), forward_only=True, still=0.1, turning=0.1, straight=0.15
)


def draw(grid: CommandGrid, weights: torch.Tensor, n: int = 20_000) -> tuple[torch.Tensor, torch.Tensor]:
    generator = torch.Generator().manual_seed(0)
    return grid.sample(weights, torch.rand(n, grid.uniforms, dtype=torch.float64, generator=generator))


def test_shares_that_stand_turn_or_go_straight_are_those_asked_for():
    commands, cells = draw(FORWARD, FORWARD.initial_weights())
    n, (speed, yaw_rate) = len(commands), (commands == 0).unbind(-1)
    for drawn, share in ((speed & yaw_rate, 0.1), (speed & ~yaw_rate, 0.1), (~speed & yaw_rate, 0.15)):
        assert abs(drawn.sum().item() / n - share) < 4 * math.sqrt(share * (1 - share) / n)
    assert torch.equal(FORWARD.cell_of(commands), cells)  # what a success there counts for
    for asked, bound in ((commands[speed & ~yaw_rate][:, 1], 1.0), (commands[~speed & yaw_rate][:, 0], 1.5)):
        assert asked.abs().max() > 0.95 * bound  # from all of the box
    assert set(cells[speed & yaw_rate].tolist()) == {int(FORWARD.cell_of(torch.zeros(2)))}


def test_shares_are_exclusive_and_may_be_everything():
    base = {**FORWARD.__dict__, "still": 0.0, "turning": 0.0, "straight": 0.0}
    for name, zero in (("still", [True, True]), ("turning", [True, False]), ("straight", [False, True])):
        grid = CommandGrid(**{**base, name: 1.0})
        commands, _ = draw(grid, grid.initial_weights(), 200)
        assert (commands == 0).all(0).tolist() == zero, name


def test_a_forward_only_grid_draws_no_negative_speed_and_all_others():
    weights = FORWARD.initial_weights()
    assert weights[:6].sum() == 0
    assert weights[6:].eq(1).all()
    commands, _ = draw(FORWARD, weights)
    assert commands[:, 0].min() == 0
    assert commands[:, 0].max() > 1.45
    assert commands[:, 1].min() < -0.95
    assert FORWARD.area(weights) == pytest.approx((1.0, 1.5 * 2.0))
    assert FORWARD.frontier(weights) == (1.5, 1.0)


def test_no_success_ever_leaks_weight_to_negative_speeds():
    grid = CommandGrid(**{**FORWARD.__dict__, "initial": (0.25, 0.25), "expansion": (0.75, 0.5)})
    weights, generator = grid.initial_weights(), torch.Generator().manual_seed(0)
    assert weights[:6].sum() == 0
    for _ in range(30):
        _, cells = grid.sample(weights, torch.rand(50, grid.uniforms, dtype=torch.float64, generator=generator))
        new = grid.update(weights, cells)
        assert new[:6].sum() == 0
        assert (new >= weights).all()
        weights = new
    assert weights[6:].eq(1).all()
    assert grid.area(weights)[0] == pytest.approx(1.0)
    assert draw(grid, weights)[0][:, 0].min() == 0


def test_weights_of_negative_speeds_are_refused_and_cut_from_another_grid_s():
    with pytest.raises(ValueError, match="speeds below zero must be 0: the grid is forward_only"):
        FORWARD.validate(torch.ones(FORWARD.shape))
    both_ways = CommandGrid(**{**FORWARD.__dict__, "forward_only": False, "bounds": (2.0, 1.0)})
    assert torch.equal(FORWARD.fitted(torch.ones(both_ways.shape)), FORWARD.initial_weights())


def test_a_grid_without_shares_draws_as_before():
    """Three numbers a command; the fourth that shares need changes none of the others."""
    plain = CommandGrid(**{**FORWARD.__dict__, "forward_only": False, "still": 0.0, "turning": 0.0, "straight": 0.0})
    shared = CommandGrid(**{**plain.__dict__, "still": 0.2})
    assert (plain.uniforms, shared.uniforms) == (3, 4)
    uniforms = torch.rand(500, 4, dtype=torch.float64, generator=torch.Generator().manual_seed(0))
    uniforms[:, 3] = 0.9
    weights = plain.initial_weights()
    for one, other in zip(plain.sample(weights, uniforms[:, :3]), shared.sample(weights, uniforms), strict=True):
        assert torch.equal(one, other)
    low, high = plain.centres(plain.sample(weights, uniforms[:, :3])[1]).aminmax(dim=0)
    assert low.tolist() == [-1.5, -1.0]
    assert high.tolist() == [1.5, 1.0]
