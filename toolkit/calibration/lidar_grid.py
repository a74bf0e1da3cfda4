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
from typing import NamedTuple

import numpy as np

from toolkit.arrays import Float64, Int64
from toolkit.frame import SensorCloud
from toolkit.sensors.models import RowLidar

MIN_RANGE_M = 1.0  # angles of nearer points are too coarse
MIN_GRID_POINTS = 100  # in all clouds of a sensor together
MAX_GRID_PX = 4_000_000  # largest number of cells in a grid
MIN_SEAM_RAD = np.deg2rad(20.0)  # gap of the azimuth; with a wider one a lidar is not panoramic
REACH_RATIO = 1.25  # range of the sensor over its farthest point
_MIN_REACH_M = 200.0
_BIN_RAD = np.deg2rad(0.01)  # in the histogram of elevations
_SMOOTHING_BINS = (3, 8, 20)  # standard deviations of the smoothing, tried in turn
_MIN_PEAK_SHARE = 0.1  # lower peaks, relative to the median height of peaks, are no rows
_MIN_CROWDED_SHARE = 0.85  # least share of points near a row, for points to crowd at rows
_MIN_STEP_RAD = np.deg2rad(0.02)  # smaller steps of the azimuth are points of one direction
# 90 % quantile of nearest-neighbour distances over the 10 % one: above this they are random
_MIN_RANDOM_RATIO = 2.5
_MIN_PHASE = 0.3  # length of the mean of unit vectors by the phase of azimuths, 1 if all agree
_SAMPLED_POINTS = 20_000  # points of a cloud whose neighbours are looked for


@dataclass(frozen=True)
class LidarGrid:
    """Grid of a lidar's rows and columns.

    Attributes:
        model: elevations of the rows, number and azimuths of the columns, and range.
        rings: number of the laser of each row, empty if clouds do not name lasers."""

    model: RowLidar
    rings: tuple[int, ...] = ()


class _Angles(NamedTuple):
    """Angles and ranges of one cloud's points.

    Attributes:
        elevation: above the horizontal plane of the sensor's frame (rad).
        azimuth: from x towards y of the sensor's frame (rad).
        distance: range (m).
        ring: laser of each point, None if the cloud does not name lasers."""

    elevation: Float64[np.ndarray, " n"]
    azimuth: Float64[np.ndarray, " n"]
    distance: Float64[np.ndarray, " n"]
    ring: Int64[np.ndarray, " n"] | None


class _Rows(NamedTuple):
    """Rows of a lidar.

    Attributes:
        elevations: elevation of each row (rad), top first.
        step: usual step of the azimuth between neighbours in a row (rad).
        rings: laser of each row, empty if unknown."""

    elevations: Float64[np.ndarray, " m"]
    step: float
    rings: tuple[int, ...] = ()


class _Columns(NamedTuple):
    """Number of columns, and the azimuths that they cover together: width and middle (rad)."""

    number: int
    width: float
    heading: float


def find_grid(clouds: Sequence[SensorCloud]) -> LidarGrid:
    """Find the rows and columns of one lidar in some of its clouds.

    The range of its model has a margin beyond the farthest point. Raises ValueError below
    `MIN_GRID_POINTS` points and above `MAX_GRID_PX` cells."""
    filled_clouds = [cloud for cloud in clouds if len(cloud.points)]
    name = filled_clouds[0].name if filled_clouds else "the sensor"
    angles = [_measure_angles(cloud) for cloud in filled_clouds]
    total = sum(len(cloud_angles.distance) for cloud_angles in angles)
    if total < MIN_GRID_POINTS:
        problem = f"{total} points of {name} say nothing of its rows"
        raise ValueError(f"{problem}, {MIN_GRID_POINTS} are needed: give more clouds")
    rows = _find_rows(angles)
    columns = _find_columns(_join_azimuths(angles), rows.step)
    if len(rows.elevations) * columns.number > MAX_GRID_PX:
        size = f"{len(rows.elevations)} x {columns.number} pixels"
        raise ValueError(f"the image of {name} would have {size}: are its points in its own frame?")
    max_distance = max(float(cloud_angles.distance.max(initial=0.0)) for cloud_angles in angles)
    model = RowLidar(
        elevations=tuple(rows.elevations.tolist()),
        columns=columns.number,
        azimuth_fov=columns.width,
        heading=columns.heading,
        max_range=float(max(_MIN_REACH_M, np.ceil(REACH_RATIO * max_distance))),
    )
    return LidarGrid(model, rows.rings)


def compute_angles(points: Float64[np.ndarray, "n 3"]) -> Float64[np.ndarray, "3 n"]:
    """Elevation, azimuth (rad) and range (m), a row each, of points in the sensor's frame.

    The elevation is the angle above the horizontal plane; the azimuth is counted from x towards
    y."""
    x, y, z = points.T
    horizontal_length = np.hypot(x, y)
    elevation = np.arctan2(z, horizontal_length)
    return np.stack([elevation, np.arctan2(y, x), np.hypot(horizontal_length, z)])


def nearest_row(
    elevation: Float64[np.ndarray, " n"], rows: Float64[np.ndarray, " m"]
) -> Int64[np.ndarray, " n"]:
    """Index of the row with the nearest elevation, for each point.

    elevation: each point's (rad); rows: elevations of the rows (rad), descending."""
    # limits are halfway between two rows; negated, since searchsorted needs ascending ones
    negated_limits = -(rows[1:] + rows[:-1]) / 2
    return np.searchsorted(negated_limits, -elevation, side="left").astype(np.int64)


def _measure_angles(cloud: SensorCloud) -> _Angles:
    """Angles, ranges and lasers of a cloud's points farther than `MIN_RANGE_M`."""
    elevation, azimuth, distance = compute_angles(cloud.in_sensor())
    is_far = distance > MIN_RANGE_M
    return _Angles(
        elevation=elevation[is_far],
        azimuth=azimuth[is_far],
        distance=distance[is_far],
        ring=None if cloud.ring is None else cloud.ring[is_far],
    )


def _join_azimuths(angles: Sequence[_Angles]) -> Float64[np.ndarray, " n"]:
    """Azimuths (rad) of the points of all clouds, one after the other."""
    return np.concatenate([cloud_angles.azimuth for cloud_angles in angles])


def _find_rows(angles: Sequence[_Angles]) -> _Rows:
    """Find rows by lasers, else by elevations at which points crowd, else make even ones.

    angles: angles of each cloud of one sensor, whose `ring` is the laser of each point. Lasers
    count only if all clouds name them."""
    point_elevations = np.concatenate([cloud_angles.elevation for cloud_angles in angles])
    rings = [cloud_angles.ring for cloud_angles in angles if cloud_angles.ring is not None]
    if len(rings) == len(angles):
        row_elevations, row_rings = _find_ring_rows(point_elevations, np.concatenate(rings))
        steps = [
            _azimuth_steps(cloud_angles.azimuth, ring)
            for cloud_angles, ring in zip(angles, rings, strict=True)
        ]
        return _Rows(row_elevations, step=_median_step(steps), rings=row_rings)
    crowded_rows = _find_crowded_rows(point_elevations)
    if crowded_rows is None:
        return _make_even_rows(angles)
    steps = []
    for cloud_angles in angles:
        row = nearest_row(cloud_angles.elevation, crowded_rows)
        steps.append(_azimuth_steps(cloud_angles.azimuth, row))
    return _Rows(crowded_rows, step=_median_step(steps))


def _find_ring_rows(
    elevation: Float64[np.ndarray, " n"], ring: Int64[np.ndarray, " n"]
) -> tuple[Float64[np.ndarray, " m"], tuple[int, ...]]:
    """Median elevation (rad) of each laser, top first, and the lasers in this order.

    elevation, ring: elevation and laser of each point."""
    lasers = np.unique(ring)
    medians = np.array([np.median(elevation[ring == laser]) for laser in lasers])
    order = np.argsort(-medians, kind="stable")  # negated: top first
    rows = medians[order]
    # two lasers at one elevation stay two rows, since rows must descend
    for k in range(1, len(rows)):
        rows[k] = min(rows[k], np.nextafter(rows[k - 1], -np.inf) - 1e-9)
    return rows, tuple(lasers[order].tolist())


def _find_crowded_rows(elevation: Float64[np.ndarray, " n"]) -> Float64[np.ndarray, " m"] | None:
    """Elevations (rad) of rows at which points crowd, top first; None if they do not crowd.

    elevation: elevations of all points (rad). The peaks of their histogram are tried as rows, with
    wider smoothing each time, until most points are near a row."""
    from scipy.ndimage import gaussian_filter1d

    # histogram with 100 empty bins at either end, so that smoothing leaves the ends free
    low = elevation.min() - 100 * _BIN_RAD
    counts = np.bincount(((elevation - low) / _BIN_RAD).astype(np.int64))
    counts = np.concatenate([counts, np.zeros(100, np.int64)]).astype(np.float64)
    for deviation_bins in _SMOOTHING_BINS:
        smooth_counts = gaussian_filter1d(counts, deviation_bins)
        # a level top counts once, by its first bin
        rises = smooth_counts[1:-1] > smooth_counts[:-2]
        falls = smooth_counts[1:-1] >= smooth_counts[2:]
        peaks = np.flatnonzero(rises & falls) + 1
        if not len(peaks):
            continue
        high_peaks = peaks[
            smooth_counts[peaks] >= _MIN_PEAK_SHARE * np.median(smooth_counts[peaks])
        ]
        peak_elevations = (low + (high_peaks + 0.5) * _BIN_RAD)[::-1]  # middles of bins, top first
        rows = _row_medians(elevation, peak_elevations)
        if len(rows) > 1 and _share_near_rows(elevation, rows) >= _MIN_CROWDED_SHARE:
            return rows
    return None


def _row_medians(
    elevation: Float64[np.ndarray, " n"], rows: Float64[np.ndarray, " m"]
) -> Float64[np.ndarray, " m"]:
    """Median elevation (rad) of the points nearest to each row; a row without points stays.

    elevation: each point's; rows: elevations, top first."""
    row = nearest_row(elevation, rows)
    medians = rows.copy()
    for k in range(len(rows)):
        if (row == k).any():
            medians[k] = np.median(elevation[row == k])
    return medians


def _share_near_rows(
    elevation: Float64[np.ndarray, " n"], rows: Float64[np.ndarray, " m"]
) -> float:
    """Share of the points near a row, 0 to 1: at most a third of the way to the next row.

    elevation: each point's (rad); rows: elevations, top first (rad)."""
    row = nearest_row(elevation, rows)
    gaps = -np.diff(rows)
    # from each row to the nearer one of its two neighbours
    row_gap = np.minimum(np.append(gaps, np.inf), np.insert(gaps, 0, np.inf))
    is_near = np.abs(elevation - rows[row]) <= 1 / 3 * row_gap[row]
    return float(is_near.mean())


def _azimuth_steps(
    azimuth: Float64[np.ndarray, " n"], row: Int64[np.ndarray, " n"]
) -> Float64[np.ndarray, " k"]:
    """Steps of the azimuth (rad) between neighbours in a row, of all rows.

    azimuth, row: azimuth and row of each point of one cloud."""
    order = np.lexsort((azimuth, row))  # by row, then by azimuth
    is_same_row = row[order][1:] == row[order][:-1]
    return np.diff(azimuth[order])[is_same_row]


def _median_step(steps: Sequence[np.ndarray]) -> float:
    """Median of the steps (rad) above `_MIN_STEP_RAD`, a full turn without any.

    steps: steps of the azimuth in each cloud."""
    pooled_steps = np.concatenate(steps)
    counted_steps = pooled_steps[pooled_steps > _MIN_STEP_RAD]
    return float(np.median(counted_steps)) if len(counted_steps) else 2 * np.pi


def _make_even_rows(angles: Sequence[_Angles]) -> _Rows:
    """Make even rows that cover all elevations, with the same step as the azimuth.

    The step is the usual angle between neighbouring points of the largest cloud, or twice that if
    their pattern is random."""
    from scipy.spatial import cKDTree

    largest_cloud = max(angles, key=lambda cloud_angles: len(cloud_angles.distance))
    # places on a plane in which distances are about the angles between points
    places = np.column_stack(
        [largest_cloud.elevation, largest_cloud.azimuth * np.cos(largest_cloud.elevation)]
    )
    sample = np.random.default_rng(0).permutation(len(places))[:_SAMPLED_POINTS]
    # the nearest place is the point itself, the second nearest its neighbour
    distances, _ = cKDTree(places).query(places[sample], k=2)
    low, median, high = np.quantile(distances[:, 1], [0.1, 0.5, 0.9]).tolist()
    # distances in a regular pattern are nearly equal
    is_random = high > _MIN_RANDOM_RATIO * max(low, 1e-9)
    step = float(max(median * (2 if is_random else 1), _MIN_STEP_RAD))
    top = float(max(cloud_angles.elevation.max() for cloud_angles in angles))
    bottom = float(min(cloud_angles.elevation.min() for cloud_angles in angles))
    count = max(2, int(np.ceil((top - bottom) / step)) + 1)
    # rows are even about the middle of all elevations, top first
    offsets = (count - 1) / 2 - np.arange(count)
    return _Rows((top + bottom) / 2 + offsets * step, step=step)


def _find_columns(azimuth: Float64[np.ndarray, " n"], step: float) -> _Columns:
    """Find columns all around, or from one side of the widest gap to the other.

    azimuth: azimuths of all points (rad); step: usual step between neighbours (rad)."""
    middle, span = _find_span(azimuth)
    if span is not None:
        count = max(1, int(np.ceil(span / step - 0.5)) + 1)
        return _Columns(count, width=min(count * step, 2 * np.pi), heading=middle)
    count = max(1, round(2 * np.pi / step))
    # The phase is a multiple of 2 pi for an azimuth in the middle of a column, if the heading is 0.
    # If azimuths are the same in all clouds, so are phases, and their mean gives the heading.
    phase = azimuth * count - np.pi * (count - 1)
    mean_phasor = np.exp(1j * phase).mean()  # its length is 1 if all phases agree
    heading = float(np.angle(mean_phasor) / count) if abs(mean_phasor) > _MIN_PHASE else 0.0
    return _Columns(count, width=2 * np.pi, heading=heading)


def _find_span(azimuth: Float64[np.ndarray, " n"]) -> tuple[float, float | None]:
    """Middle and width of the observed azimuths (rad), 0 and None if they are all around.

    azimuth: from -pi to pi. The span is what the widest gap between neighbours leaves."""
    ordered_azimuth = np.sort(azimuth)
    # the last gap goes across -pi and pi
    gaps = np.diff(ordered_azimuth, append=ordered_azimuth[0] + 2 * np.pi)
    widest_gap = int(gaps.argmax())
    if gaps[widest_gap] < MIN_SEAM_RAD:
        return 0.0, None
    span = 2 * np.pi - float(gaps[widest_gap])
    middle = float(ordered_azimuth[(widest_gap + 1) % len(ordered_azimuth)]) + span / 2
    # to -pi..pi
    return float(np.arctan2(np.sin(middle), np.cos(middle))), span
