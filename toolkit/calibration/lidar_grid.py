"""Rows and columns of a lidar, found in its clouds.

Rows are, in order of preference,

1. its lasers, if every point names its laser: each at the median elevation of its points;
2. the elevations at which points crowd, as with a spinning lidar or with even pixels: peaks of
   the histogram of elevations, if most points are nearer to one than a third of the way to the
   next;
3. else even steps of the usual angle between neighbouring points of a cloud, or of twice that if
   their pattern is random (it does not repeat), so that most cells are hit in most clouds.

Columns are even steps of the usual azimuth between neighbouring points of a row. Azimuths are in
the middle of their columns if they are the same in all clouds. Columns go all around or, if clouds
leave a gap, from one side of it to the other."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from toolkit.arrays import Float64, Int64
from toolkit.frame import SensorCloud
from toolkit.sensors.models import RowLidar

NEAREST = 1.0  # m: nearer points do not tell angles
TELLING_POINTS = 100  # of a sensor, in all clouds together
MOST_PIXELS = 4_000_000
# azimuth without a point: with a wider gap a lidar does not look all around
SEAM_GAP = np.deg2rad(20.0)
FARTHER = 1.25  # range of the sensor over its farthest point
_LEAST_RANGE = 200.0  # m
_BIN = np.deg2rad(0.01)  # of the histogram of elevations
_SMOOTH = (3, 8, 20)  # bins, standard deviations of the smoothing, tried in turn
_LEAST_PEAK = 0.1  # of the median height of peaks
# share of points that lie within this share of the distance between rows
_CROWDED = 0.85
_THIRD = 1 / 3
_SMALLEST_STEP = np.deg2rad(0.02)
# 90 % quantile of nearest-neighbour distances over the 10 % one: above this they are random
_AT_RANDOM = 2.5
_LEAST_PHASE = (
    0.3  # length of the mean of unit vectors by the phase of azimuths, 1 where all have the same
)
_SOME = 20_000  # points of a cloud whose neighbours are looked for


@dataclass(frozen=True)
class LidarGrid:
    """A grid of rows, columns and range (`model`). rings: laser of each row, empty if clouds do not
    tell it."""

    model: RowLidar
    rings: tuple[int, ...] = ()


def find_grid(clouds: Sequence[SensorCloud]) -> LidarGrid:
    """Find the grid of a sensor in its clouds. Raises ValueError below 100 points and above 4
    million pixels."""
    clouds = [cloud for cloud in clouds if len(cloud.points)]
    name = clouds[0].name if clouds else "the sensor"
    angle_tables = []
    rings = []
    for cloud in clouds:
        angles = compute_angles(cloud.in_sensor())
        far = angles[2] > NEAREST
        angle_tables.append(angles[:, far])
        rings += [] if cloud.ring is None else [cloud.ring[far]]
    total = sum(columns_of_angles.shape[1] for columns_of_angles in angle_tables)
    if total < TELLING_POINTS:
        problem = f"{total} points of {name} say nothing of its rows"
        raise ValueError(f"{problem}, {TELLING_POINTS} are needed: give more clouds")
    elevation, azimuth, distance = np.concatenate(angle_tables, axis=1)
    numbers: tuple[int, ...] = ()
    if len(rings) == len(angle_tables):
        elevations, numbers = _ring_rows(elevation, np.concatenate(rings))
        step = _step_in_rows(
            [
                (columns_of_angles[1], ring)
                for columns_of_angles, ring in zip(angle_tables, rings, strict=True)
            ]
        )
    elif (crowded := _crowded_rows(elevation)) is not None:
        elevations = crowded
        step = _step_in_rows(
            [
                (columns_of_angles[1], nearest_row(columns_of_angles[0], crowded))
                for columns_of_angles in angle_tables
            ]
        )
    else:
        elevations, step = _even_rows(angle_tables)
    heading, span = _span(azimuth)
    if span is None:
        columns = max(1, round(2 * np.pi / step))
        width = 2 * np.pi
        # multiples of 2 pi in the middle of a column
        middle = azimuth * columns - np.pi * (columns - 1)
        mean = np.exp(1j * middle).mean()
        heading = float(np.angle(mean) / columns) if abs(mean) > _LEAST_PHASE else 0.0
    else:
        columns = max(1, int(np.ceil(span / step - 0.5)) + 1)
        width = min(columns * step, 2 * np.pi)
    if len(elevations) * columns > MOST_PIXELS:
        size = f"{len(elevations)} x {columns} pixels"
        raise ValueError(f"the image of {name} would have {size}: are its points in its own frame?")
    reach = float(max(_LEAST_RANGE, np.ceil(FARTHER * float(distance.max()))))
    return LidarGrid(
        RowLidar(tuple(elevations.tolist()), columns, width, heading, max_range=reach), numbers
    )


def compute_angles(points: Float64[np.ndarray, "n 3"]) -> Float64[np.ndarray, "3 n"]:
    """Elevation, azimuth (rad) and range (m) of points, sensor frame."""
    x, y, z = points.T
    across = np.hypot(x, y)
    return np.stack([np.arctan2(z, across), np.arctan2(y, x), np.hypot(across, z)])


def nearest_row(
    elevation: Float64[np.ndarray, " n"], rows: Float64[np.ndarray, " m"]
) -> Int64[np.ndarray, " n"]:
    """Row, top first, of the nearest elevation."""
    return np.searchsorted(-(rows[1:] + rows[:-1]) / 2, -elevation, side="left").astype(np.int64)


def _ring_rows(
    elevation: np.ndarray, ring: np.ndarray
) -> tuple[Float64[np.ndarray, " m"], tuple[int, ...]]:
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
        peak = (
            np.flatnonzero((smoothed[1:-1] > smoothed[:-2]) & (smoothed[1:-1] >= smoothed[2:])) + 1
        )
        if not len(peak):
            continue
        peak = peak[smoothed[peak] >= _LEAST_PEAK * np.median(smoothed[peak])]
        rows = (low + (peak + 0.5) * _BIN)[::-1]
        row = nearest_row(elevation, rows)
        rows = np.array(
            [
                np.median(elevation[row == k]) if (row == k).any() else rows[k]
                for k in range(len(rows))
            ]
        )
        row = nearest_row(elevation, rows)
        apart = -np.diff(rows)
        to_next = np.minimum(np.append(apart, np.inf), np.insert(apart, 0, np.inf))
        if (
            len(rows) > 1
            and (np.abs(elevation - rows[row]) <= _THIRD * to_next[row]).mean() >= _CROWDED
        ):
            return rows
    return None


def _step_in_rows(clouds: Sequence[tuple[np.ndarray, np.ndarray]]) -> float:
    """Usual step between neighbours in a row. clouds: azimuths and rows of their points."""
    steps = []
    for azimuth, row in clouds:
        order = np.lexsort((azimuth, row))
        steps.append(np.diff(azimuth[order])[row[order][1:] == row[order][:-1]])
    all_steps = np.concatenate(steps)
    all_steps = all_steps[all_steps > _SMALLEST_STEP]
    return float(np.median(all_steps)) if len(all_steps) else 2 * np.pi


def _even_rows(clouds: Sequence[np.ndarray]) -> tuple[Float64[np.ndarray, " m"], float]:
    """Even rows, and the same step of the azimuth."""
    from scipy.spatial import cKDTree

    elevation, azimuth, _ = max(clouds, key=lambda angles: angles.shape[1])
    flat = np.column_stack([elevation, azimuth * np.cos(elevation)])
    sample = np.random.default_rng(0).permutation(len(flat))[:_SOME]
    low, middle, high = np.quantile(
        cKDTree(flat).query(flat[sample], k=2)[0][:, 1], [0.1, 0.5, 0.9]
    )
    step = float(max(middle * (2 if high > _AT_RANDOM * max(low, 1e-9) else 1), _SMALLEST_STEP))
    top = float(max(angles[0].max() for angles in clouds))
    bottom = float(min(angles[0].min() for angles in clouds))
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
