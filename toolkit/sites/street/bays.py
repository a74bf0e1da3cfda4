"""Parking bays: along kerbs, in line, at an angle or at right angles, and on forecourts behind the footways."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import shapely

from toolkit.arrays import Float, Float64
from toolkit.sites import furniture as f
from toolkit.sites.surroundings import Plot, along

BAY = (5.8, 2.6)  # m, length and width of a parking bay
ANGLES = {0: 2.3, 45: 4.8, 60: 5.1, 90: 5.2}  # degrees between bay and kerb, and how wide a strip of such bays is (m)
_CLEAR = 6.0  # m between a junction and the first bay
_REACH = 75.0  # m from a junction, beyond which nobody needs bays
_UNSEEN = 15.0  # m from the edge of the ground that is furnished, outside of which there are no bays on the road
Strip = tuple[Float[np.ndarray, "_ 2"], float]  # middle line as traffic goes, width


def kerb_bays(
    plot: Plot, strips: Mapping[str, Strip], angles: Mapping[str, int], rng: np.random.Generator
) -> Float64[np.ndarray, "n 3"]:
    """Bays x, y, yaw on the strips that have an angle (degrees, 0: in line with the kerb), a drawn share of them.

    The junction is at the end of a strip of an edge `in...`, and at the start of the others.
    """
    rows = [np.zeros((0, 3))]
    for edge, angle in angles.items():
        if edge in strips:
            marked = stations(strips[edge], angle, at_end=edge.startswith("in"))
            marked = marked[rng.random(len(marked)) < rng.uniform(0.35, 1.0)]
            rows.append(marked[[_claim(plot, bay) for bay in marked]].reshape(-1, 3))
    return np.concatenate(rows)


def stations(strip: Strip, angle: int, *, at_end: bool) -> Float64[np.ndarray, "n 3"]:
    """Middles x, y and headings of all bays that fit on a strip, from the junction on."""
    line = shapely.LineString(strip[0])
    at = np.arange(_CLEAR + BAY[0] / 2, min(line.length - BAY[0] / 2, _REACH), _spacing(angle))
    at = line.length - at if at_end else at
    return (stood_along(line, at, 0.25) - [0.0, 0.0, np.deg2rad(angle)]).round(4)  # the kerb is to the right


def bays_between(line: shapely.LineString, angle: int, *, kerb_left: bool = False) -> Float64[np.ndarray, "n 3"]:
    """Middles x, y and headings of all bays that fit on a strip along `line` (as traffic goes) from junction to
    junction."""
    at = np.arange(_CLEAR + BAY[0] / 2, line.length - _CLEAR - BAY[0] / 2, _spacing(angle))
    slant = np.deg2rad(-angle if kerb_left else angle)
    return (stood_along(line, at, 0.25) - [0.0, 0.0, slant]).round(4)


def _spacing(angle: int) -> float:
    """From bay to bay along the kerb (m)."""
    return BAY[0] + 0.4 if angle == 0 else BAY[1] / float(np.sin(np.deg2rad(angle)))


def stood_along(line: shapely.LineString, at: Float[np.ndarray, " n"], half: float) -> Float64[np.ndarray, "n 3"]:
    """x, y and heading of what stands `at` so far along a line (m), both its ends, `half` m from its middle, on it."""
    here, ahead = (shapely.get_coordinates(line.interpolate(s)).reshape(-1, 2) for s in (at - half, at + half))
    return np.column_stack([(here + ahead) / 2, np.arctan2(*(ahead - here).T[::-1])])


def forecourts(plot: Plot, rng: np.random.Generator) -> Float64[np.ndarray, "n 3"]:
    """Parking bays behind the footways, along the road or at right angles to it."""
    bays: list[tuple[float, float, float]] = []
    across = rng.random() < 0.5
    line = along(plot.road.surface.buffer(0.7 + BAY[not across] / 2).boundary.intersection(plot.window), 1.0)
    for x, y, direction in rng.permutation(line)[: rng.integers(0, 14)]:
        yaw = direction + (np.pi / 2 if across else 0.0) + np.pi * rng.integers(2)
        if plot.claim(outline(x, y, yaw)):
            bays.append((round(float(x), 3), round(float(y), 3), round(float(yaw), 4)))
    return np.array(bays, np.float64).reshape(-1, 3)


def outline(x: float, y: float, yaw: float, size: tuple[float, float] = BAY) -> shapely.Polygon:
    """The ground of a bay."""
    return shapely.Polygon(f.block(size, (x, y), yaw))


def _claim(plot: Plot, bay: Float64[np.ndarray, "3"]) -> bool:
    """Whether a bay on a shoulder is free; what of it reaches into the lane or to its neighbours counts for nothing."""
    ground = outline(bay[0], bay[1], bay[2], (BAY[0] - 0.2, BAY[1] - 0.2)).difference(plot.driven).buffer(-0.02)
    near = plot.window.buffer(-_UNSEEN, join_style="mitre").contains(ground)
    return bool(near and plot.claim(ground, shoulder=True))
