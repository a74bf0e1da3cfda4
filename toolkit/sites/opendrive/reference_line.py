"""Reference lines of OpenDRIVE roads in plan view: lines, arcs, spirals and cubics."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple
from xml.etree import ElementTree

import numpy as np

from toolkit.arrays import Float, Float64
from toolkit.sites.opendrive.cubics import Cubics, read_number

CURVE_STEP_M = 0.25  # between the points at which a curve is summed up
MIN_CURVE_STEPS = 16  # for a short curve too

_U_KEYS = ("aU", "bU", "cU", "dU")
_V_KEYS = ("aV", "bV", "cV", "dV")


class _Offsets(NamedTuple):
    """Places relative to the start of a curve.

    Attributes:
        u: m ahead of the start.
        v: m to the left of the start.
        turn: direction against the start's (rad)."""

    u: Float64[np.ndarray, " k"]
    v: Float64[np.ndarray, " k"]
    turn: Float64[np.ndarray, " k"]


@dataclass(frozen=True, eq=False)
class Piece:
    """One <geometry> of a road.

    Attributes:
        start: s of its start (m).
        x: x of its start (m, map frame).
        y: y of its start (m, map frame).
        heading: direction at its start (rad, counter-clockwise from +x).
        length: length along the line (m), as the file gives it.
        shape: element inside: line, arc, spiral, poly3 or paramPoly3."""

    start: float
    x: float
    y: float
    heading: float
    length: float
    shape: ElementTree.Element

    def at(self, ds: Float[np.ndarray, " k"]) -> Float64[np.ndarray, "k 3"]:
        """Rows x, y (m, map frame), direction (rad from +x) of places on the line.

        ds: m along the line from its start."""
        offsets = self._find_offsets(ds)
        cos = np.cos(self.heading)
        sin = np.sin(self.heading)
        # u: m ahead of the start, v: m to its left
        x = self.x + cos * offsets.u - sin * offsets.v
        y = self.y + sin * offsets.u + cos * offsets.v
        return np.column_stack([x, y, self.heading + offsets.turn])

    def measure_curve(self) -> float:
        """Measure the length (m) of its curve.

        It should equal `length`, as the file gives it; only a paramPoly3 may have another."""
        if self.shape.tag != "paramPoly3":
            return self.length
        # m ahead and to the left of the start, as functions of a parameter from 0 to `end`
        u = _read_cubic(self.shape, _U_KEYS)
        v = _read_cubic(self.shape, _V_KEYS)
        end = self.length if self.shape.get("pRange") == "arcLength" else 1.0
        grid = _make_grid(end, self.length)
        middles = (grid[1:] + grid[:-1]) / 2
        speeds = np.hypot(u.slope(middles), v.slope(middles))  # m per unit of the parameter
        return float(np.sum(speeds * np.diff(grid)))

    def _find_offsets(self, ds: np.ndarray) -> _Offsets:
        """Places `ds` m along the curve from its start, relative to the start and its direction.

        A shape without a curve is a straight line."""
        match self.shape.tag:
            case "arc":
                return self._follow_arc(ds)
            case "spiral":
                return self._follow_spiral(ds)
            case "poly3":
                return self._follow_cubic(ds)
            case "paramPoly3":
                return self._follow_parametric_cubic(ds)
        return _Offsets(u=ds, v=np.zeros(len(ds)), turn=np.zeros(len(ds)))

    def _follow_arc(self, ds: np.ndarray) -> _Offsets:
        """Places `ds` m along an arc from its start, relative to the start and its direction."""
        turn = read_number(self.shape, "curvature") * ds  # rad
        # sinc(x) is sin(pi x) / (pi x), so that a curvature of 0 gives a line
        u = ds * np.sinc(turn / np.pi)
        v = ds * np.sin(turn / 2) * np.sinc(turn / 2 / np.pi)
        return _Offsets(u, v, turn)

    def _follow_spiral(self, ds: np.ndarray) -> _Offsets:
        """Places `ds` m along a spiral from its start, relative to the start and its direction.

        The curvature changes evenly; steps along the spiral are summed by the midpoint rule."""
        curvature = read_number(self.shape, "curvStart")  # rad per m
        change = read_number(self.shape, "curvEnd") - curvature
        rate = change / max(self.length, 1e-9)  # change of the curvature per m
        grid = np.linspace(0.0, self.length, int(self.length / CURVE_STEP_M) + 2)
        middles = (grid[1:] + grid[:-1]) / 2
        turns = curvature * middles + rate * middles**2 / 2  # directions at `middles` (rad)
        # m ahead and to the left of the start at the places of `grid`
        grid_u = np.cumsum([0.0, *(np.diff(grid) * np.cos(turns))])
        grid_v = np.cumsum([0.0, *(np.diff(grid) * np.sin(turns))])
        return _Offsets(
            u=np.interp(ds, grid, grid_u),
            v=np.interp(ds, grid, grid_v),
            turn=curvature * ds + rate * ds**2 / 2,
        )

    def _follow_cubic(self, ds: np.ndarray) -> _Offsets:
        """Places `ds` m along a cubic v(u) from its start, relative to the start and its direction.

        u, m ahead of the start, is found from the length along the curve."""
        v = _read_cubic(self.shape, "abcd")
        u = _find_parameter(ds, lambda grid: np.hypot(1.0, v.slope(grid)), self.length)
        return _Offsets(u=u, v=v.at(u), turn=np.arctan(v.slope(u)))

    def _follow_parametric_cubic(self, ds: np.ndarray) -> _Offsets:
        """Places `ds` m along a curve from its start, relative to the start and its direction.

        The curve has cubics u(p) (m ahead) and v(p) (m to the left). The parameter p is the length
        along the curve (pRange arcLength), or runs from 0 to 1 over it."""
        u = _read_cubic(self.shape, _U_KEYS)
        v = _read_cubic(self.shape, _V_KEYS)
        p = ds
        if self.shape.get("pRange") != "arcLength":
            p = _find_parameter(
                ds, lambda grid: np.hypot(u.slope(grid), v.slope(grid)), 1.0, length=self.length
            )
        return _Offsets(u=u.at(p), v=v.at(p), turn=np.arctan2(v.slope(p), u.slope(p)))


def step_aside(
    places: Float[np.ndarray, "k 3"], t: Float[np.ndarray, " k"]
) -> Float64[np.ndarray, "k 2"]:
    """Places x, y that are `t` m to the left of places x, y (m), direction (rad)."""
    x, y, heading = places.T
    return np.column_stack([x - t * np.sin(heading), y + t * np.cos(heading)])


def _find_parameter(
    ds: np.ndarray,
    speed: Callable[[np.ndarray], np.ndarray],
    end: float,
    *,
    length: float | None = None,
) -> np.ndarray:
    """Parameter of a curve at places `ds` m along it.

    Beyond the end of the curve the parameter grows at the speed of the end. speed: m per unit of
    the parameter, which runs from 0 to `end`; length: m from 0 to `end` as in the file, to which
    distances by the speed are scaled; None to take them as they are."""
    grid = _make_grid(end, length or end)
    middles = (grid[1:] + grid[:-1]) / 2
    # m from the start to each parameter of `grid`
    distances = np.concatenate([[0.0], np.cumsum(speed(middles) * np.diff(grid))])
    curve_length = distances[-1]
    scale = 1.0 if length is None else max(length, 1e-9) / max(curve_length, 1e-9)
    end_speed = float(speed(grid[-1:])[0]) * scale
    # how far the parameter is beyond `end`
    excess = np.maximum(ds - curve_length * scale, 0.0) / max(end_speed, 1e-9)
    return np.interp(ds, distances * scale, grid) + excess


def _make_grid(end: float, length: float) -> Float64[np.ndarray, " n"]:
    """Evenly spaced parameters from 0 to `end` of a curve that is about `length` m long.

    They are about `CURVE_STEP_M` apart along the curve, or less if it is short."""
    return np.linspace(0.0, end, max(int(length / CURVE_STEP_M), MIN_CURVE_STEPS) + 1)


def _read_cubic(shape: ElementTree.Element, keys: Sequence[str]) -> Cubics:
    """Read the cubic polynomial whose coefficients are attributes of an element.

    keys: their names, from the constant up; a missing one is 0."""
    coefficients = [read_number(shape, key, 0.0) for key in keys]
    return Cubics(starts=np.zeros(1), rows=np.array([coefficients]))
