"""Rows and columns of a lidar, found in its clouds.

Rows are, in order of preference,

1. its lasers, if every point tells its laser: each at the median elevation of its points;
2. the elevations where points crowd, as those of a spinning lidar or of even pixels do: peaks of the histogram of
   elevations, if most points lie nearer to one than a third of the way to the next;
3. else even steps of the usual angle between neighbouring points of a cloud, or of twice that if they lie as at random
   (a pattern that does not repeat), so that most cells are hit in most clouds.

Columns are even steps of the usual azimuth between neighbouring points of a row. Azimuths lie in the middle of their
columns if they are the same in all clouds. Columns go all around or, if clouds leave a gap, from one side of it to the
other.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from toolkit.arrays import Float32, Float64, Int64, Mask
from toolkit.frame import SensorCloud
from toolkit.sensors.models import RowLidar

NEAREST = 1.0  # m: nearer points do not tell angles
TELLING_POINTS = 100  # of a sensor, in all clouds together
MOST_PIXELS = 4_000_000
SEAM_GAP = np.deg2rad(20.0)  # azimuth without a point: with a wider gap a lidar does not look all around
FARTHER = 1.25  # range of the sensor over its farthest point
_LEAST_RANGE = 200.0  # m
_BIN = np.deg2rad(0.01)  # of the histogram of elevations
_SMOOTH = (3, 8, 20)  # bins, standard deviations of the smoothing, tried in turn
_LEAST_PEAK = 0.1  # of the median height of peaks
_CROWDED, _THIRD = 0.85, 1 / 3  # share of points that lie within this share of the distance between rows
_SMALLEST_STEP = np.deg2rad(0.02)
_AT_RANDOM = 2.5  # 90 % quantile of nearest-neighbour distances over the 10 % one: above this they are random
_LEAST_PHASE = 0.3  # length of the mean of unit vectors by the phase of azimuths, 1 where all have the same
_SOME = 20_000  # points of a cloud whose neighbours are looked for


@dataclass(frozen=True)
class LidarGrid:
    """A grid of rows, columns and range (`model`). rings: laser of each row, empty if clouds do not tell it."""

    model: RowLidar
    rings: tuple[int, ...] = ()


def find_grid(clouds: Sequence[SensorCloud]) -> LidarGrid:
    """Find the grid of one sensor in some of its clouds. Raises ValueError for fewer than 100 points, and for an image
    of more than 4 million pixels."""
    clouds = [cloud for cloud in clouds if len(cloud.points)]
    name = clouds[0].name if clouds else "the sensor"
    kept, rings = [], []
    for cloud in clouds:
        angles = compute_angles(cloud.in_sensor())
        far = angles[2] > NEAREST
        kept.append(angles[:, far])
        rings += [] if cloud.ring is None else [cloud.ring[far]]
    total = sum(each.shape[1] for each in kept)
    if total < TELLING_POINTS:
        said = f"{total} points of {name} say nothing of its rows"
        raise ValueError(f"{said}, {TELLING_POINTS} are needed: give more clouds")
    elevation, azimuth, distance = np.concatenate(kept, axis=1)
    numbers: tuple[int, ...] = ()
    if len(rings) == len(kept):
        elevations, numbers = _ring_rows(elevation, np.concatenate(rings))
        step = _step_in_rows([(each[1], ring) for each, ring in zip(kept, rings, strict=True)])
    elif (crowded := _crowded_rows(elevation)) is not None:
        elevations = crowded
        step = _step_in_rows([(each[1], nearest_row(each[0], crowded)) for each in kept])
    else:
        elevations, step = _even_rows(kept)
    heading, span = _span(azimuth)
    if span is None:
        columns, width = max(1, round(2 * np.pi / step)), 2 * np.pi
        middle = azimuth * columns - np.pi * (columns - 1)  # multiples of 2 pi in the middle of a column
        mean = np.exp(1j * middle).mean()
        heading = float(np.angle(mean) / columns) if abs(mean) > _LEAST_PHASE else 0.0
    else:
        columns = max(1, int(np.ceil(span / step - 0.5)) + 1)
        width = min(columns * step, 2 * np.pi)
    if len(elevations) * columns > MOST_PIXELS:
        size = f"{len(elevations)} x {columns} pixels"
        raise ValueError(f"the image of {name} would have {size}: are its points in its own frame?")
    reach = float(max(_LEAST_RANGE, np.ceil(FARTHER * float(distance.max()))))
    return LidarGrid(RowLidar(tuple(elevations.tolist()), columns, width, heading, max_range=reach), numbers)


def compute_angles(points: Float64[np.ndarray, "n 3"]) -> Float64[np.ndarray, "3 n"]:
    """Elevation, azimuth (rad) and range (m) of points, sensor frame."""
    x, y, z = points.T
    across = np.hypot(x, y)
    return np.stack([np.arctan2(z, across), np.arctan2(y, x), np.hypot(across, z)])


def nearest_row(elevation: Float64[np.ndarray, " n"], rows: Float64[np.ndarray, " m"]) -> Int64[np.ndarray, " n"]:
    """Row, top first, of the nearest elevation."""
    return np.searchsorted(-(rows[1:] + rows[:-1]) / 2, -elevation, side="left").astype(np.int64)


def _ring_rows(elevation: np.ndarray, ring: np.ndarray) -> tuple[Float64[np.ndarray, " m"], tuple[int, ...]]:
    numbers = np.unique(ring)
    middle = np.array([np.median(elevation[ring == number]) for number in numbers])
    order = np.argsort(-middle, kind="stable")
    rows = middle[order]
    for k in range(1, len(rows)):  # lasers side by side at one elevation stay rows of their own
        rows[k] = min(rows[k], np.nextafter(rows[k - 1], -np.inf) - 1e-9)
    return rows, tuple(numbers[order].tolist())


def _crowded_rows(elevation: np.ndarray) -> Float64[np.ndarray, " m"] | None:
    """Elevations where points crowd; None if they do not."""
    from scipy.ndimage import gaussian_filter1d

    low = elevation.min() - 100 * _BIN
    counts = np.bincount(((elevation - low) / _BIN).astype(np.int64))
    counts = np.concatenate([counts, np.zeros(100, np.int64)]).astype(np.float64)
    for smooth in _SMOOTH:
        smoothed = gaussian_filter1d(counts, smooth)
        peak = np.flatnonzero((smoothed[1:-1] > smoothed[:-2]) & (smoothed[1:-1] >= smoothed[2:])) + 1
        if not len(peak):
            continue
        peak = peak[smoothed[peak] >= _LEAST_PEAK * np.median(smoothed[peak])]
        rows = (low + (peak + 0.5) * _BIN)[::-1]
        row = nearest_row(elevation, rows)
        rows = np.array([np.median(elevation[row == k]) if (row == k).any() else rows[k] for k in range(len(rows))])
        row, apart = nearest_row(elevation, rows), -np.diff(rows)
        to_next = np.minimum(np.append(apart, np.inf), np.insert(apart, 0, np.inf))
        if len(rows) > 1 and (np.abs(elevation - rows[row]) <= _THIRD * to_next[row]).mean() >= _CROWDED:
            return rows
    return None


def _step_in_rows(clouds: Sequence[tuple[np.ndarray, np.ndarray]]) -> float:
    """Usual step between neighbours in a row. clouds: azimuths and rows of their points."""
    steps = []
    for azimuth, row in clouds:
        order = np.lexsort((azimuth, row))
        steps.append(np.diff(azimuth[order])[row[order][1:] == row[order][:-1]])
    every = np.concatenate(steps)
    every = every[every > _SMALLEST_STEP]
    return float(np.median(every)) if len(every) else 2 * np.pi


def _even_rows(clouds: Sequence[np.ndarray]) -> tuple[Float64[np.ndarray, " m"], float]:
    """Even rows, and the same step of the azimuth."""
    from scipy.spatial import cKDTree

    elevation, azimuth, _ = max(clouds, key=lambda each: each.shape[1])
    flat = np.column_stack([elevation, azimuth * np.cos(elevation)])
    some = np.random.default_rng(0).permutation(len(flat))[:_SOME]
    low, middle, high = np.quantile(cKDTree(flat).query(flat[some], k=2)[0][:, 1], [0.1, 0.5, 0.9])
    step = float(max(middle * (2 if high > _AT_RANDOM * max(low, 1e-9) else 1), _SMALLEST_STEP))
    top, bottom = (float(pick([pick(each[0]) for each in clouds])) for pick in (np.max, np.min))
    rows = max(2, int(np.ceil((top - bottom) / step)) + 1)
    return (top + bottom) / 2 + ((rows - 1) / 2 - np.arange(rows)) * step, step


def _span(azimuth: np.ndarray) -> tuple[float, float | None]:
    """Middle and width of the observed azimuths. Returns 0 and None for all around."""
    ordered = np.sort(azimuth)
    gaps = np.diff(ordered, append=ordered[0] + 2 * np.pi)
    widest = int(gaps.argmax())
    if gaps[widest] < SEAM_GAP:
        return 0.0, None
    span = 2 * np.pi - float(gaps[widest])
    middle = float(ordered[(widest + 1) % len(ordered)]) + span / 2
    return float(np.arctan2(np.sin(middle), np.cos(middle))), span


SHARED_CELL, OUTSIDE_GRID = "points in a cell with a nearer one", "points outside the rows and columns of their sensor"


@dataclass(frozen=True, eq=False)
class CloudImage:
    """A cloud as an image. measurement: ranges (m), 0 where nothing returned; cells: of every point of the cloud,
    counted row by row, the nearest one for points outside; inside: mask of the points in the grid; shown: mask of those
    that the image shows."""

    grid: LidarGrid
    measurement: Float32[np.ndarray, "rows columns"]
    cells: Int64[np.ndarray, " n"]
    inside: Mask
    shown: Mask

    @property
    def left_out(self) -> dict[str, int]:
        """Number of points missing from the image, by kind."""
        counts = {SHARED_CELL: int((self.inside & ~self.shown).sum()), OUTSIDE_GRID: int((~self.inside).sum())}
        return {kind: count for kind, count in counts.items() if count}

    @cached_property
    def points(self) -> Float32[np.ndarray, "m 3"]:
        """Points of the image, sensor frame, in the cloud's order."""
        cells = self.cells[self.shown]
        rays = self.grid.model.rays().reshape(-1, 3)
        return rays[cells] * self.measurement.ravel()[cells, None]


def rasterize_cloud(cloud: SensorCloud, grid: LidarGrid) -> CloudImage:
    """Return the cloud of a sensor in its grid: each point in the row of its laser, else in the nearest row, if that is
    no farther than the next row."""
    model = grid.model
    elevation, azimuth, distance = compute_angles(cloud.in_sensor())
    rows = np.array(model.elevations)
    if grid.rings and cloud.ring is not None:
        numbers = np.array(grid.rings)
        order = np.argsort(numbers)
        row = order[np.minimum(np.searchsorted(numbers[order], cloud.ring), len(numbers) - 1)].astype(np.int64)
        in_rows = numbers[row] == cloud.ring
    else:
        row, apart = nearest_row(elevation, rows), -np.diff(rows)
        widest = np.maximum(np.append(apart, 0), np.insert(apart, 0, 0)) if len(apart) else np.full(1, np.inf)
        in_rows = np.abs(elevation - rows[row]) <= widest[row]
    turned = (azimuth - model.heading + np.pi) % (2 * np.pi) - np.pi
    place = np.floor(turned / (model.azimuth_fov / model.columns) + model.columns / 2).astype(np.int64)
    column = np.clip(place, 0, model.columns - 1)
    in_columns = (place == column) | (model.azimuth_fov >= 2 * np.pi)
    ranges = distance.astype(np.float32)
    inside = in_rows & in_columns & (ranges > 0) & (ranges < model.max_range)
    cells = row * model.columns + column
    within = np.flatnonzero(inside)
    order = within[np.lexsort((ranges[within], cells[within]))]
    shown = np.zeros(len(cells), bool)
    shown[order[np.diff(cells[order], prepend=-1) > 0]] = True  # the nearest of each cell
    image = np.zeros(len(rows) * model.columns, np.float32)
    image[cells[shown]] = ranges[shown]
    return CloudImage(grid, image.reshape(model.shape), cells, inside, shown)
