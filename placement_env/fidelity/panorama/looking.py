"""Views of many sensors at few places. Each is found from the strips of objects seen at its place."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from placement_env.fidelity.occlusion import Seen
from placement_env.fidelity.panorama.ray_table import (
    PER_STEEP,
    PER_TURN,
    TABLE_TILTS,
    RayTable,
    Rectangles,
    compute_aim,
    ray_table,
)
from placement_env.fidelity.panorama.still import Still
from toolkit.arrays import Bool, Float32, Float64, Int32, Int64
from toolkit.rendering.strips import BEYOND, WITHIN, Strips
from toolkit.sensors.sensor import Sensor, SensorModel

TableKey = tuple[SensorModel, float, float]  # model, tilt and roll of a table


@dataclass(frozen=True, eq=False)
class Views:
    """S sensors at V viewpoints.

    viewpoint: of each sensor; heading: places of azimuth; more: places of elevation by which it is tilted more than its
    table; groups: sensors by table, at most one per viewpoint in each.
    """

    viewpoints: Float64[np.ndarray, "V 3"]
    viewpoint: Int64[np.ndarray, " S"]
    heading: Float32[np.ndarray, " S"]
    more: Float32[np.ndarray, " S"]
    groups: tuple[tuple[TableKey, Int64[np.ndarray, " _"]], ...]

    @staticmethod
    def of(sensors: Sequence[Sensor]) -> Views:
        """Sensors grouped by position and aim."""
        positions = np.array([sensor.position for sensor in sensors]).round(6)
        viewpoints, viewpoint = np.unique(positions, axis=0, return_inverse=True)
        keys, heading, more = table_keys(sensors)
        members: dict[TableKey, list[int]] = {}
        for s, key in enumerate(keys):
            members.setdefault(key, []).append(s)
        groups = [(key, part) for key, each in members.items() for part in _one_each(np.array(each), viewpoint.ravel())]
        return Views(viewpoints, viewpoint.ravel(), heading, more, tuple(groups))


def table_keys(
    sensors: Sequence[Sensor],
) -> tuple[list[TableKey], Float32[np.ndarray, " S"], Float32[np.ndarray, " S"]]:
    """Ray table, heading and extra tilt of each sensor.

    The table knows its rays; the heading is in places of azimuth. The extra tilt is beyond the table's, in places of
    elevation.
    """
    aims = [compute_aim(sensor) for sensor in sensors]
    base = [round(aim.tilt / TABLE_TILTS) for aim in aims]
    more = np.array([aim.tilt - steps * TABLE_TILTS for aim, steps in zip(aims, base, strict=True)])
    more[np.abs(more) < 1e-6] = 0
    heading = np.array([aim.heading for aim in aims], np.float32) * PER_TURN
    keys = [
        (sensor.model, steps * TABLE_TILTS, round(aim.roll, 4) + 0.0)
        for sensor, aim, steps in zip(sensors, aims, base, strict=True)
    ]
    return keys, heading, more.astype(np.float32) * PER_STEEP


@dataclass(frozen=True, eq=False)
class Sight:
    """Strips of objects, ready for lookup.

    item: number of each strip's object, frame: of its frame; counts: whether its points count; far: whether they are
    far.
    """

    viewpoint: Int32[np.ndarray, " n"]
    item: Int64[np.ndarray, " n"]
    frame: Int64[np.ndarray, " n"]
    rectangles: Rectangles
    azimuth: Float32[np.ndarray, " n"]
    elevation: Float32[np.ndarray, " n"]
    counts: Bool[np.ndarray, " n"]
    far: Bool[np.ndarray, " n"]

    @staticmethod
    def of(strips: Strips, frame: Int64[np.ndarray, " items"]) -> Sight:
        """Strips of objects, given the frame of each."""
        item = strips.item.astype(np.int64)
        return Sight(
            strips.viewpoint, item, frame[item],
            Rectangles.of(strips.left, strips.right, strips.bottom, strips.top),
            (strips.left + strips.right) / 2, (strips.bottom + strips.top) / 2,
            strips.shows >= WITHIN, strips.shows == BEYOND,
        )  # fmt: skip

    def count_gain(self, still: Still) -> tuple[Float32[np.ndarray, " n"], Float32[np.ndarray, " n"]]:
        """Gain of one ray in each strip.

        It is the change to the points sent and the far ones, relative to the background.
        """
        sent, far = still.behind(self.viewpoint, self.azimuth, self.elevation)
        return self.counts - sent, self.far - far


def alone(views: Views, stills: Mapping[SensorModel, Still]) -> Float64[np.ndarray, "2 S"]:
    """Points that each sensor sends in a still scene. The far ones come too. stills: the standing scene, by model."""
    found = np.zeros((2, len(views.viewpoint)))
    for key, members in views.groups:
        cells = ray_table(*key).cells
        for s in members.tolist():
            heading = float(views.heading[s] / PER_TURN)
            found[:, s] = stills[key[0]].of_cells(int(views.viewpoint[s]), cells, heading)
    return found


def look_through(
    views: Views,
    sight: Sight,
    stills: Mapping[SensorModel, Still],
    empty: Float64[np.ndarray, "2 S"],
    shape: tuple[int, int],
) -> Seen:
    """View of sensors through the strips.

    Returns points on each item and points sent in each frame. stills: the standing scene, by model; empty: points sent
    when nothing moves, see `alone`; shape: numbers of items and frames.
    """
    items, frames = shape
    count = len(views.viewpoint)
    points = np.zeros(count * items)
    sent, far = (np.repeat(each[:, None], frames, axis=1) for each in empty)
    gains = {model: sight.count_gain(still) for model, still in stills.items()}
    for key, members in views.groups:
        table, (more_sent, more_far) = ray_table(*key), gains[key[0]]
        sensor, strip, rays = _rays_on(views, sight, table, members)
        cells = sensor * items + sight.item.take(strip)
        points += np.bincount(cells, rays * sight.counts.take(strip), minlength=len(points))
        cells = sensor * frames + sight.frame.take(strip)
        for total, more in ((sent, more_sent), (far, more_far)):
            total += np.bincount(cells, rays * more.take(strip), minlength=total.size).reshape(total.shape)
    each = (points.reshape(count, items), sent, far)
    return Seen(*(np.maximum(figures, 0).astype(np.float32) for figures in each))


def _rays_on(
    views: Views, sight: Sight, table: RayTable, members: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Sensor, strip and number of rays. They are listed where members of a group have rays on a strip."""
    at = np.full(len(views.viewpoints), -1)
    at[views.viewpoint[members]] = members
    sensor = at.take(sight.viewpoint)
    if (sensor >= 0).all():
        strip, rays = table.counts(sight.rectangles, views.heading.take(sensor), views.more.take(sensor))
        return sensor.take(strip), strip, rays
    rows = np.flatnonzero(sensor >= 0)
    sensor = sensor[rows]
    held, rays = table.counts(sight.rectangles.take(rows), views.heading.take(sensor), views.more.take(sensor))
    return sensor.take(held), rows.take(held), rays


def _one_each(members: Int64[np.ndarray, " n"], viewpoint: Int64[np.ndarray, " S"]) -> Iterator[np.ndarray]:
    """Groups of members, at most one per viewpoint."""
    order = members[np.argsort(viewpoint[members], kind="stable")]
    _, first, counts = np.unique(viewpoint[order], return_index=True, return_counts=True)
    for rank in range(counts.max()):
        yield order[first[counts > rank] + rank]
