import numpy as np
import pytest
from matplotlib import image

from torchrl_atr.evaluation import figures


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


def test_heatmap_axes_are_the_commands():
    figure, axis = figures.plt.subplots()
    values = np.arange(6.0).reshape(3, 2)
    figures._heatmap(axis, np.array([-1.0, 0.0, 1.0]), np.array([0.0, 0.5]), values, "viridis", None)
    picture = axis.images[0]
    np.testing.assert_array_equal(picture.get_array(), values.T)
    assert picture.origin == "lower"
    assert picture.get_extent() == [-1.5, 1.5, -0.25, 0.75]
    figures.plt.close(figure)


def test_learning_curves_plot_what_there_is(tmp_path):
    csv = tmp_path / "progress.csv"
    csv.write_text("frames,episode_length,speed_error,unknown\n1000,10,1.0,x\n2000,20,,x\n3000,30,0.5,x\n")
    assert _colours(figures.plot_learning_curves(csv, tmp_path / "curves.png")) > 3
    columns = figures._read_columns(csv)
    assert columns["episode_length"].tolist() == [10, 20, 30]
    assert np.isnan(columns["speed_error"][1])


@pytest.mark.parametrize("text", ["frames,other\n1,2\n", "frames,episode_length\n", ""])
def test_learning_curves_of_nothing_are_an_error(text, tmp_path):
    csv = tmp_path / "progress.csv"
    csv.write_text(text)
    with pytest.raises(ValueError, match=r"progress\.csv has no rows, or none of the columns episode_length"):
        figures.plot_learning_curves(csv, tmp_path / "curves.png")


def test_curriculum_weights(tmp_path):
    weights = np.zeros((31, 21))
    weights[10:20, 8:12] = np.linspace(0.1, 1, 10)[:, None]
    assert _colours(figures.plot_curriculum(weights, (3.0, 2.0), tmp_path / "grid.png")) > 5


def test_runs_are_compared_group_by_group(tmp_path):
    csv = tmp_path / "progress.csv"
    csv.write_text("minutes,episode_length,episode_reward\n0.1,,\n0.2,20,1.0\n0.3,30,2.0\n")
    lines = {"single_board": csv, "two_board": csv}
    assert _colours(figures.plot_runs({"a1": lines, "go1": lines}, tmp_path / "runs.png")) > 3


def test_runs_without_rows_are_named(tmp_path):
    csv = tmp_path / "progress.csv"
    csv.write_text("minutes,episode_length,episode_reward\n")
    with pytest.raises(ValueError, match="no rows in the progress of a1, two_board"):
        figures.plot_runs({"a1": {"two_board": csv}}, tmp_path / "runs.png")
