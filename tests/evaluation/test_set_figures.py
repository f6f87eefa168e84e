"""Figures over sets of runs: what is pooled, what is drawn, and what is refused."""

from __future__ import annotations

import json

import numpy as np
import pytest

from torchrl_atr._errors import InputError
from torchrl_atr.cli import main
from torchrl_atr.evaluation import set_figures
from torchrl_atr.evaluation.set_figures import group_runs, plot_sets


def make_run(folder, reward, rows=40):
    folder.mkdir(parents=True)
    lines = [f"{i * 1000},{reward},{0.5 / i}" for i in range(1, rows + 1)]
    (folder / "progress.csv").write_text("\n".join(["frames,reward,yaw_error", *lines]), encoding="utf-8")
    return folder


def make_report(folder, protocol, **more):
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "metrics.json").write_text(json.dumps({"protocol": protocol, **more}), encoding="utf-8")


def curve(value, name="mean"):
    return {"seconds": [0.0, 1.0], name: [value, value], "low": [value - 0.1] * 2, "high": [value + 0.1] * 2}


def make_endurance(folder, share):
    errors = {"seconds": [0.0, 1.0], "speed": curve(0.3), "yaw": curve(0.2)}
    make_report(folder, "endurance", survival_over_time=curve(share, "share"), errors_over_time=errors)


@pytest.fixture
def drawn(monkeypatch):
    """Figures by name, before they are closed."""
    figures = {}

    def keep(figure, path):
        figures[path.name] = figure
        return path

    monkeypatch.setattr(set_figures, "save", keep)
    return figures


def band(axis):
    edges = axis.collections[0].get_paths()[0].vertices[:, 1]
    return edges.min(), edges.max()


def test_runs_of_a_label_are_one_line_with_a_band_that_ends_with_the_shortest(tmp_path, drawn):
    runs = [make_run(tmp_path / "a", 1.0), make_run(tmp_path / "b", 3.0, rows=20), make_run(tmp_path / "c", 5.0)]
    sets = group_runs([f"ours={runs[0]}", f"ours={runs[1]}", str(runs[2])])
    assert sets == {"ours": runs[:2], "c": runs[2:]}
    plot_sets(sets, tmp_path / "out", "svg", ["reward"])
    (axis,) = drawn["learning_curves.svg"].axes
    ours, other = axis.lines
    assert (ours.get_label(), other.get_label()) == ("ours (2 runs)", "c")
    assert np.allclose(ours.get_ydata(), 2.0)
    assert np.allclose(other.get_ydata(), 5.0)
    assert ours.get_xdata()[-1] == pytest.approx(0.02)
    assert other.get_xdata()[-1] == pytest.approx(0.04)
    assert band(axis) == (1.0, 3.0)


def test_a_single_evaluation_has_its_interval_and_several_their_range(tmp_path, drawn):
    for name, share in {"a": 0.9, "b": 0.7}.items():
        make_endurance(tmp_path / name / "endurance", share)  # beside the run, as `evaluate` writes it
    plot_sets({"alone": [tmp_path / "a"]}, tmp_path)
    assert band(drawn["endurance.pdf"].axes[0]) == pytest.approx((0.8, 1.0))
    plot_sets({"both": [tmp_path / "a", tmp_path / "b" / "endurance"]}, tmp_path)
    assert band(drawn["endurance.pdf"].axes[0]) == pytest.approx((0.7, 0.9))
    assert np.allclose(drawn["endurance.pdf"].axes[0].lines[0].get_ydata(), 0.8)


def test_areas_of_tracking(tmp_path, drawn):
    settled = {"speed": [0.0, 0.4], "yaw": [0.0, 0.6], "combined": [0.0, 0.2]}
    make_report(tmp_path / "a", "tracking", command_area={"epsilon": [0.0, 1.0], "settled": settled})
    plot_sets({"a": [tmp_path / "a"]}, tmp_path)
    assert [axis.lines[0].get_ydata()[-1] for axis in drawn["command_area.pdf"].axes] == [0.4, 0.6, 0.2]


def test_vector_files_are_written(tmp_path, capsys):
    make_endurance(make_run(tmp_path / "a", 1.0), 0.9)
    assert main(["plot", str(tmp_path / "a"), "--output", str(tmp_path / "figures")]) == 0
    files = capsys.readouterr().out.split()
    assert [file.rpartition("/")[2] for file in files] == ["learning_curves.pdf", "endurance.pdf"]
    for file in files:
        with open(file, "rb") as written:
            assert written.read(5) == b"%PDF-"


def test_styles_differ():
    styles = [style for style, _ in zip(set_figures.line_styles(), range(28))]
    assert len({str(style) for style in styles}) == 28


@pytest.mark.parametrize(
    ("make", "given", "words"),
    [
        (lambda folder: None, "none", "is no folder; give RUN or LABEL=RUN"),
        (lambda folder: (folder / "empty").mkdir(), "empty", "has neither progress.csv nor metrics.json"),
        (lambda folder: make_run(folder / "a", 1.0), "a", "has no column 'rewards'; did you mean 'reward'"),
    ],
)
def test_what_cannot_be_plotted_is_refused(tmp_path, make, given, words):
    make(tmp_path)
    with pytest.raises(InputError, match=words):
        plot_sets(group_runs([str(tmp_path / given)]), tmp_path / "out", curves=["rewards"])
