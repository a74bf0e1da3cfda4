"""The line a road of an OpenDRIVE map is measured along: plan view and elevation (OpenDRIVE 1.7, chapters 7, 8)."""

from __future__ import annotations

from dataclasses import dataclass
from xml.etree import ElementTree

import numpy as np

from toolkit.arrays import Float, Float64

LONGEST = 1e5  # m, of one piece of a road
_STEP = 0.25  # m between the points at which a spiral is summed up


@dataclass(frozen=True, eq=False)
class Cubics:
    """A function of s in pieces: row i is a + b ds + c ds² + d ds³ from s = starts[i] on. Without rows it is 0."""

    starts: Float64[np.ndarray, " n"]
    rows: Float64[np.ndarray, "n 4"]

    def at(self, s: Float[np.ndarray, " k"]) -> Float64[np.ndarray, " k"]:
        """The values at `s`; before the first piece they are those of the first."""
        if not len(self.starts):
            return np.zeros(len(s))
        which = np.clip(np.searchsorted(self.starts, s, side="right") - 1, 0, None)
        ds = np.maximum(s - self.starts[which], 0.0)
        return np.sum(self.rows[which] * ds[:, None] ** np.arange(4), axis=1)

    def slope(self, s: Float[np.ndarray, " k"]) -> Float64[np.ndarray, " k"]:
        """The derivatives at `s`."""
        return Cubics(self.starts, np.column_stack([self.rows[:, 1:] * [1, 2, 3], np.zeros(len(self.rows))])).at(s)


@dataclass(frozen=True, eq=False)
class Piece:
    """One <geometry>: from `start` on along s, from (x, y) in direction `heading`; `shape` is the element inside."""

    start: float
    x: float
    y: float
    heading: float
    length: float
    shape: ElementTree.Element

    def at(self, ds: Float[np.ndarray, " k"]) -> Float64[np.ndarray, "k 3"]:
        """x, y and direction `ds` m from its start."""
        u, v, turn = _local(self, ds)
        c, s = np.cos(self.heading), np.sin(self.heading)
        return np.column_stack([self.x + c * u - s * v, self.y + s * u + c * v, self.heading + turn])


@dataclass(frozen=True, eq=False)
class ReferenceLine:
    """A road's reference line: pieces in order of s, its length, its height over the map's zero."""

    pieces: tuple[Piece, ...]
    length: float
    elevation: Cubics

    def at(self, s: Float[np.ndarray, " k"]) -> Float64[np.ndarray, "k 3"]:
        """x, y and direction at `s`."""
        which = np.clip(np.searchsorted([p.start for p in self.pieces], s, side="right") - 1, 0, None)
        rows = np.zeros((len(s), 3))
        for i in np.unique(which):
            rows[which == i] = self.pieces[i].at(s[which == i] - self.pieces[i].start)
        return rows

    def beside(self, s: Float[np.ndarray, " k"], t: Float[np.ndarray, " k"]) -> Float64[np.ndarray, "k 2"]:
        """Places `t` m to the left of the line at `s`."""
        x, y, heading = self.at(s).T
        return np.column_stack([x - t * np.sin(heading), y + t * np.cos(heading)])


def number(element: ElementTree.Element, key: str, default: float | None = None) -> float:
    """An attribute as a finite number of less than a million; `default` where it is missing and that is no None."""
    text = element.get(key)
    if text is None and default is not None:
        return default
    try:
        value = float(text or "")
    except ValueError:
        value = np.nan
    if not abs(value) < 1e6:
        raise ValueError(f"<{element.tag}> needs a finite number as {key}, got {str(text)[:30]!r}: export it again")
    return value


def cubics(elements: list[ElementTree.Element], key: str = "s") -> Cubics:
    """The pieces that elements with a, b, c, d describe, in order of `key`."""
    rows = np.array([[number(e, k, 0.0) for k in (key, *"abcd")] for e in elements]).reshape(-1, 5)
    rows = rows[np.argsort(rows[:, 0], kind="stable")]
    return Cubics(rows[:, 0], rows[:, 1:])


def reference_line(road: ElementTree.Element) -> ReferenceLine:
    """The reference line of a <road>. Raises ValueError where it has none or a number in it is none."""
    pieces = []
    for element in road.findall("planView/geometry"):
        start, x, y, heading, length = (number(element, key) for key in ("s", "x", "y", "hdg", "length"))
        shape = next(iter(element), ElementTree.Element("line"))
        if shape.tag not in _SHAPES:
            raise ValueError(f"<geometry> holds <{shape.tag}>, not one of {', '.join(_SHAPES)}: export the map again")
        if not 0 <= length <= LONGEST:
            raise ValueError(f"<geometry> needs a length of 0 to {LONGEST:g} m, got {length:g}: export the map again")
        pieces.append(Piece(start, x, y, heading, length, shape))
    if not pieces:
        raise ValueError(f"road {road.get('id')!r} has no <geometry>: export the map again")
    pieces.sort(key=lambda piece: piece.start)
    length = pieces[-1].start + pieces[-1].length
    return ReferenceLine(tuple(pieces), length, cubics(road.findall("elevationProfile/elevation")))


def _local(piece: Piece, ds: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """u, v and direction in the piece's own frame."""
    shape = piece.shape
    if shape.tag == "arc":
        return _bent(number(shape, "curvature"), ds)
    if shape.tag == "spiral":
        return _spiral(number(shape, "curvStart"), number(shape, "curvEnd"), piece.length, ds)
    if shape.tag == "poly3":
        row = np.array([[number(shape, key, 0.0) for key in "abcd"]])
        v = Cubics(np.zeros(1), row)
        return ds, v.at(ds), np.arctan(v.slope(ds))
    if shape.tag == "paramPoly3":
        p = ds if shape.get("pRange") == "arcLength" else ds / max(piece.length, 1e-9)
        u, v = (Cubics(np.zeros(1), np.array([[number(shape, k + axis, 0.0) for k in "abcd"]])) for axis in "UV")
        return u.at(p), v.at(p), np.arctan2(v.slope(p), u.slope(p))
    return ds, np.zeros(len(ds)), np.zeros(len(ds))


def _bent(curvature: float, ds: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    turn = curvature * ds
    along = ds * np.sinc(turn / np.pi)
    aside = ds * np.sin(turn / 2) * np.sinc(turn / 2 / np.pi)
    return along, aside, turn


def _spiral(first: float, last: float, length: float, ds: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A clothoid, summed up by the midpoint rule."""
    rate = (last - first) / max(length, 1e-9)
    grid = np.linspace(0.0, length, int(length / _STEP) + 2)
    middle = (grid[1:] + grid[:-1]) / 2
    turn = first * middle + rate * middle**2 / 2
    u, v = (np.concatenate([[0.0], np.cumsum(np.diff(grid) * part)]) for part in (np.cos(turn), np.sin(turn)))
    return np.interp(ds, grid, u), np.interp(ds, grid, v), first * ds + rate * ds**2 / 2


_SHAPES = ("line", "arc", "spiral", "poly3", "paramPoly3")
