import numpy as np
import pytest
from matplotlib import image

from torchrl_atr.evaluation import figures, run_figures


def _colours(path):
    """Number of different colours of a PNG: a blank figure has one, its frame and text alone a few greys."""
    pixels = np.round(image.imread(path)[..., :3] * 255).astype(int).reshape(-1, 3)
    coloured = pixels[np.ptp(pixels, axis=1) > 30]
    return len(np.unique(coloured, axis=0))


@pytest.mark.parametrize("plot", [figures.plot_heatmaps, figures.plot_response, figures.plot_command_area])
def test_figures_show_a_result(plot, random_result, tmp_path):
    path = plot(random_result, tmp_path / "figure.png")
    assert path == tmp_path / "figure.png"
    assert _colours(path) > 20


def test_figures_of_nobody_left(evaluate, tmp_path):
    import torch

    result = evaluate(lambda command: torch.full_like(command, torch.nan), commands=([1.0], [0.0]))
    for plot in (figures.plot_heatmaps, figures.plot_response, figures.plot_command_area):
        assert plot(result, tmp_path / "figure.png").stat().st_size > 5000


def test_cells_are_means_over_the_chosen_robots():
    values = np.array([[[1.0, 3.0], [np.nan, 5.0]]])
    np.testing.assert_array_equal(figures._cells(values), [[2.0, 5.0]])
    none = np.zeros(values.shape, bool)
    assert np.isnan(figures._cells(values, none)).all()


def test_learning_curves_plot_what_there_is(tmp_path):
    csv = tmp_path / "progress.csv"
    csv.write_text("frames,episode_length,speed_error,unknown\n1000,10,1.0,x\n2000,20,,x\n3000,30,0.5,x\n")
    assert _colours(run_figures.plot_learning_curves(csv, tmp_path / "curves.png")) > 3
    columns = run_figures.read_columns(csv)
    assert columns["episode_length"].tolist() == [10, 20, 30]
    assert np.isnan(columns["speed_error"][1])


@pytest.mark.parametrize("text", ["frames,other\n1,2\n", "frames,episode_length\n", ""])
def test_learning_curves_of_nothing_are_an_error(text, tmp_path):
    csv = tmp_path / "progress.csv"
    csv.write_text(text)
    with pytest.raises(ValueError, match=r"progress\.csv has no rows, or none of the columns episode_length"):
        run_figures.plot_learning_curves(csv, tmp_path / "curves.png")


def test_curriculum_weights(tmp_path):
    weights = np.zeros((31, 21))
    weights[10:20, 8:12] = np.linspace(0.1, 1, 10)[:, None]
    assert _colours(run_figures.plot_curriculum(weights, (3.0, 2.0), tmp_path / "grid.png")) > 5


def test_every_panel_of_the_learning_curves_has_its_axis(tmp_path, monkeypatch):
    csv = tmp_path / "progress.csv"
    csv.write_text("frames,episode_length,speed_error,std,learning_rate\n1,1,1,0.04,1e-5\n2,2,2,0.04,2e-5\n")
    drawn = []
    monkeypatch.setattr(run_figures, "save", lambda figure, path: drawn.append(figure))
    run_figures.plot_learning_curves(csv, tmp_path / "curves.png")
    figure = drawn[0]
    figure.draw_without_rendering()
    assert len(figure.axes) == 4
    for axis in figure.axes:
        assert axis.get_xlabel() == "robot steps [million]"
        assert axis.get_title().endswith("]")
        assert any(label.get_visible() and label.get_text() for label in axis.get_xticklabels())
    low, high = figure.axes[2].get_ylim()  # a constant is not blown up
    assert high - low > 0.1 * 0.04


@pytest.fixture
def drawn(monkeypatch):
    """Figures that would have been written."""
    kept = []
    monkeypatch.setattr(figures, "save", lambda figure, path: kept.append(figure))
    return kept


def _panels(figure):
    """Axes by title, colour bars left out."""
    return {axis.get_title(): axis for axis in figure.axes if axis.get_title()}


def test_results_on_one_grid_share_their_colour_scales(evaluate, drawn):
    for function in (lambda command: command, lambda command: 0.3 * command):
        figures.plot_heatmaps(evaluate(function), "unused.png")
    limits = [{title: axis.collections[0].get_clim() for title, axis in _panels(f).items()} for f in drawn]
    assert limits[0] == limits[1]
    tops = [top for _, top in limits[0].values()]
    assert tops == pytest.approx([2.0, 0.5, np.hypot(2.0, 0.5)] + [2.0, 0.5, 1.0])
    figures.plot_heatmaps(evaluate(lambda command: command), "unused.png", largest=(15.0, 2.0))
    axis = next(iter(_panels(drawn[2]).values()))
    assert axis.collections[0].get_clim() == (0.0, 15.0)


def test_cells_where_every_robot_fell_are_hatched_and_explained(evaluate, drawn):
    def timid(command):
        import torch

        return torch.where((command[:, :1] > 0), torch.tensor(torch.nan), command)

    figures.plot_heatmaps(evaluate(timid), "unused.png")
    figures.plot_heatmaps(evaluate(lambda command: command), "unused.png")
    assert [text.get_text() for text in drawn[0].legends[0].get_texts()] == ["every robot fell: no settled error"]
    assert not drawn[1].legends
    settled = next(axis for title, axis in _panels(drawn[0]).items() if "settled" in title)
    assert settled.patches[0].get_hatch()
    assert settled.collections[0].get_array().mask.reshape(3, 3).sum(1).tolist() == [1, 1, 1]


def test_curves_that_coincide_stay_visible(evaluate, drawn):
    """A perfect tracker's three curves are one: each is narrower than, and drawn after, the one below, and dashed."""
    figures.plot_command_area(evaluate(lambda command: command), "unused.png")
    thick = [line for line in drawn[0].axes[0].lines if line.get_linewidth() > 1]
    assert len(thick) == 3
    widths, orders = [line.get_linewidth() for line in thick], [line.get_zorder() for line in thick]
    assert widths == sorted(widths, reverse=True)
    assert len(set(widths)) == len(set(orders)) == 3
    assert orders == sorted(orders)
    assert [line.is_dashed() for line in thick] == [False, True, True]


def test_a_dot_per_survivor_beside_those_of_other_commands(evaluate, drawn):
    figures.plot_response(evaluate(lambda command: command, robots=1), "unused.png")
    dots = drawn[0].axes[0].collections[-1].get_offsets()
    assert len(np.unique(np.round(dots[:, 0], 6))) == len(dots) == 9


def test_runs_are_compared_group_by_group(tmp_path):
    csv = tmp_path / "progress.csv"
    csv.write_text("minutes,episode_length,episode_reward\n0.1,,\n0.2,20,1.0\n0.3,30,2.0\n")
    lines = {"single_board": csv, "two_board": csv}
    assert _colours(run_figures.plot_runs({"a1": lines, "go1": lines}, tmp_path / "runs.png")) > 3


def test_runs_without_rows_are_named(tmp_path):
    csv = tmp_path / "progress.csv"
    csv.write_text("minutes,episode_length,episode_reward\n")
    with pytest.raises(ValueError, match="no rows in the progress of a1, two_board"):
        run_figures.plot_runs({"a1": {"two_board": csv}}, tmp_path / "runs.png")
