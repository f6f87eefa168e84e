"""Maps of obstacles in the plane, from TOML or image files."""

from __future__ import annotations

import tomllib
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray
from shapely.geometry.base import BaseGeometry

from torchrl_atr._checks import check_number
from torchrl_atr._errors import InputError
from torchrl_atr._registry import UnknownNameError, nearest

Array = NDArray[np.float64]
_IMAGES = (".png", ".pgm", ".jpg", ".bmp")


class MapError(InputError):
    """Error of a map file, or of a place on a map; the message names it and the remedy."""


@dataclass(frozen=True)
class Map:
    """Free space in the plane, m.

    Attributes:
        name: of the map.
        outline: polygon within which robots may be.
        obstacles: polygons that they must not touch.

    Raises:
        MapError: for an outline without area, or an obstacle that is not a valid polygon.

    Example:
        >>> yard = Map("yard", shapely.box(0, 0, 10, 10), (shapely.box(4, 4, 6, 6),))
        >>> yard.free.area
        96.0
        >>> yard.holds([(1.0, 1.0), (5.0, 5.0)]).tolist()
        [True, False]
    """

    name: str
    outline: BaseGeometry
    obstacles: tuple[BaseGeometry, ...] = ()

    def __post_init__(self) -> None:
        for what, shape in (
            ("the outline", self.outline),
            *((f"obstacle {i}", o) for i, o in enumerate(self.obstacles)),
        ):
            if not shape.is_valid or shape.area <= 0.0:
                reason = shapely.is_valid_reason(shape)
                raise MapError(f"map {self.name!r}: {what} is no polygon with an area ({reason}); correct its corners")

    @cached_property
    def free(self) -> BaseGeometry:
        """Outline without the obstacles."""
        free = self.outline.difference(shapely.union_all(list(self.obstacles)))
        if free.is_empty:
            raise MapError(f"map {self.name!r}: the obstacles cover all of the outline; leave some space")
        shapely.prepare(free)
        return free

    def shrunk(self, margin: float) -> BaseGeometry:
        """Return the places at least ``margin`` from every obstacle and from the outline, m."""
        inner = self.free.buffer(-margin)
        shapely.prepare(inner)
        return inner

    def holds(self, points: Any) -> NDArray[np.bool_]:
        """Return which points, (..., 2), are in free space, (...)."""
        return shapely.contains_xy(self.free, *np.moveaxis(np.asarray(points, dtype=float), -1, 0))


def load_map(source: str | Path | Map, resolution: float = 0.1) -> Map:
    """Return a map by name, or from a file.

    A TOML file has an ``outline``, a list of corners, and tables ``[[box]]`` (``low``, ``high``), ``[[circle]]``
    (``center``, ``radius``) and ``[[polygon]]`` (``corners``), in metres. In an image dark pixels are obstacles, and
    the lower left corner is the origin.

    Args:
        source: one of :func:`map_names`, a ``.toml`` file, an image, or a map.
        resolution: size of an image's pixel, m.

    Raises:
        UnknownNameError: for an unknown name.
        MapError: for a file that is missing, or has no valid map; names the entry.

    Example:
        >>> load_map("open").outline.bounds
        (0.0, 0.0, 120.0, 120.0)
    """
    if isinstance(source, Map):
        return source
    path = Path(source)
    if path.suffix.lower() in _IMAGES:
        return _from_image(_existing(path), check_number("resolution", resolution, above=0.0))
    if path.suffix == ".toml":
        return _from_toml(_existing(path).read_bytes(), path.stem)
    if str(source) not in map_names():
        known = nearest(str(source), map_names())
        raise UnknownNameError(f"unknown map {str(source)!r}; {known}, or give a .toml file or an image")
    return _from_toml((_MAPS / f"{source}.toml").read_bytes(), str(source))


_MAPS = resources.files("torchrl_atr.navigation") / "maps"


def map_names() -> list[str]:
    """Return the names of the maps in the package.

    Example:
        >>> map_names()
        ['open', 'streets']
    """
    return sorted(Path(file.name).stem for file in _MAPS.iterdir() if file.name.endswith(".toml"))


def _existing(path: Path) -> Path:
    if not path.is_file():
        raise MapError(f"no map file {path}; give an existing file, or one of {', '.join(map_names())}")
    return path


def _from_toml(content: bytes, name: str) -> Map:
    try:
        values = tomllib.loads(content.decode())
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise MapError(f"map {name!r} is not TOML in UTF-8: {error}") from error
    if unknown := set(values) - {"outline", *_SHAPES}:
        raise MapError(f"map {name!r}: unknown entry {min(unknown)!r}; take outline, {', '.join(_SHAPES)}")
    for kind in _SHAPES:
        if not isinstance(values.get(kind, []), list):
            raise MapError(f"map {name!r}: {kind} is {values[kind]!r}; give a list, such as by [[{kind}]]")
    outline = _shape("polygon", {"corners": values.get("outline")}, f"map {name!r}: outline")
    obstacles = [
        _shape(kind, each, f"map {name!r}: {kind} {i}")
        for kind in _SHAPES
        for i, each in enumerate(values.get(kind, ()))
    ]
    return Map(name, outline, tuple(obstacles))


_SHAPES: dict[str, Any] = {
    "box": lambda low, high: shapely.box(*map(float, low), *map(float, high)),
    "circle": lambda center, radius: shapely.Point(*map(float, center)).buffer(float(radius)),
    "polygon": lambda corners: shapely.Polygon([tuple(map(float, corner)) for corner in corners]),
}


def _shape(kind: str, values: dict[str, Any], where: str) -> BaseGeometry:
    try:
        return _SHAPES[kind](**values)
    except (TypeError, ValueError, shapely.errors.ShapelyError) as error:
        raise MapError(f"{where}: {values} is no {kind} ({error})") from error


def _from_image(path: Path, resolution: float) -> Map:
    import matplotlib.image

    try:
        pixels = np.asarray(matplotlib.image.imread(path), dtype=float)
    except (SyntaxError, OSError, ValueError) as error:
        raise MapError(f"map {path} cannot be read as an image ({error}); give a PNG or another image") from error
    grey = pixels[..., :3].mean(-1) if pixels.ndim == 3 else pixels
    dark = grey < 0.5 * (255.0 if grey.max() > 1.0 else 1.0)
    height, width = dark.shape
    obstacle = shapely.union_all(list(_runs(dark[::-1], resolution)))
    outline = shapely.box(0.0, 0.0, width * resolution, height * resolution)
    return Map(path.stem, outline, () if obstacle.is_empty else tuple(getattr(obstacle, "geoms", [obstacle])))


def _runs(dark: NDArray[np.bool_], resolution: float) -> Iterable[BaseGeometry]:
    """Yield a box for each row's run of dark pixels; row 0 is the lowest."""
    for row, line in enumerate(dark):
        edges = np.flatnonzero(np.diff(np.concatenate([[False], line, [False]]).astype(int)))
        for begin, end in zip(edges[::2], edges[1::2]):
            yield shapely.box(begin * resolution, row * resolution, end * resolution, (row + 1) * resolution)
