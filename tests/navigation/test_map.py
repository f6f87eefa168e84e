"""Maps: names, TOML files, images, and what is refused."""

from __future__ import annotations

import matplotlib.image
import numpy as np
import pytest
import shapely

from torchrl_atr._registry import UnknownNameError
from torchrl_atr.navigation import Map, MapError, load_map, map_names


@pytest.mark.parametrize("name", map_names())
def test_the_maps_of_the_package_are_large_and_in_one_piece(name):
    where = load_map(name)
    low_x, low_y, high_x, high_y = where.outline.bounds
    assert min(high_x - low_x, high_y - low_y) >= 100.0
    assert where.obstacles
    assert where.shrunk(1.0).geom_type == "Polygon"  # every place can be reached from every other


def test_a_toml_file_has_boxes_circles_and_polygons(tmp_path):
    file = tmp_path / "yard.toml"
    file.write_text(
        "outline = [[0, 0], [10, 0], [10, 10], [0, 10]]\n[[box]]\nlow = [1, 1]\nhigh = [2, 3]\n"
        "[[circle]]\ncenter = [5, 5]\nradius = 1\n[[polygon]]\ncorners = [[7, 7], [9, 7], [9, 9]]\n"
    )
    where = load_map(file)
    assert where.holds([(0.5, 0.5), (1.5, 2.0), (5.0, 5.5), (8.9, 7.1), (11.0, 1.0)]).tolist() == [True] + [False] * 4
    assert where.free.area == pytest.approx(100.0 - 2.0 - np.pi - 2.0, abs=0.02)


def test_dark_pixels_of_an_image_are_obstacles_and_its_lower_left_corner_is_the_origin(tmp_path):
    pixels = np.ones((4, 6))
    pixels[3, 0:2] = 0.0  # the lowest row
    matplotlib.image.imsave(tmp_path / "yard.png", pixels, cmap="gray")
    where = load_map(tmp_path / "yard.png", resolution=0.5)
    assert where.outline.bounds == (0.0, 0.0, 3.0, 2.0)
    assert where.free.area == pytest.approx(6.0 - 0.5)
    assert where.holds([(0.5, 0.25), (0.5, 0.75), (1.25, 0.25)]).tolist() == [False, True, True]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("outline = [[0, 0], [1, 0]", "is not TOML"),
        ("[[box]]\nlow = [0, 0]\nhigh = [1, 1]", "outline"),
        ("outline = [[0, 0], [9, 0], [9, 9]]\n[[box]]\nlow = [0, 0]", "box 0"),
        ("outline = [[0, 0], [9, 0], [9, 9]]\n[[circle]]\ncenter = [0, 0]\nradius = 'one'", "circle 0"),
        ("outline = [[0, 0], [9, 0], [9, 9]]\n[[wall]]\nlow = [0, 0]", "unknown entry 'wall'"),
        ("outline = [[0, 0], [1, 1], [1, 0], [0, 1]]", "the outline is no polygon"),
    ],
)
def test_a_wrong_file_names_the_entry(tmp_path, text, message):
    file = tmp_path / "wrong.toml"
    file.write_text(text)
    with pytest.raises(MapError, match=message):
        load_map(file)


def test_files_of_another_kind_are_named(tmp_path):
    (tmp_path / "latin.toml").write_bytes(b"# K\xf6ln")
    (tmp_path / "text.png").write_text("no image")
    (tmp_path / "number.toml").write_text("outline = [[0, 0], [9, 0], [9, 9]]\ncircle = 5")
    for name, message in (("latin.toml", "UTF-8"), ("text.png", "as an image"), ("number.toml", "circle is 5")):
        with pytest.raises(MapError, match=message):
            load_map(tmp_path / name)


def test_unknown_names_and_missing_files_say_what_there_is():
    with pytest.raises(UnknownNameError, match="did you mean 'streets'"):
        load_map("street")
    with pytest.raises(MapError, match=r"no map file nowhere\.toml; give an existing file, or one of open, streets"):
        load_map("nowhere.toml")
    with pytest.raises(MapError, match="the obstacles cover all"):
        _ = Map("full", shapely.box(0, 0, 1, 1), (shapely.box(0, 0, 2, 2),)).free
