"""Silhouettes: pixels of many sensors that meet an object, from one cast of rays.

As in `toolkit.rendering.renderer`, only the rays in the window of a body's box are cast. Here the windows of all
sensors go into one call, and rays that end before they can reach the box are left out.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from toolkit.arrays import BoxRows, Float32, Float64, Int64
from toolkit.rendering.renderer import Renderer
from toolkit.rendering.strips import counting
from toolkit.sensors.sensor import NEAR, Sensor, SensorModel, nearest

BOXES_TOGETHER = 512  # boxes whose windows are found together


class Silhouette(NamedTuple):
    """Pixels that meet an object in front of the static scene: numbers, sensors, depth (m), world points."""

    pixels: Int64[np.ndarray, " n"]
    sensors: Int64[np.ndarray, " n"]
    depth: Float32[np.ndarray, " n"]
    points: Float32[np.ndarray, "n 3"]


class Windows(NamedTuple):
    """Rectangles of pixels around one box, in all sensors."""

    rows: Int64[np.ndarray, "m 5"]  # sensor, top, bottom, left, right (pixels)
    least: Float32[np.ndarray, " S"]  # lower bound of each sensor's measurement of it (m)


class SensorRays:
    """Rays of sensors, and their lengths at the empty site.

    rays: (P, 3) of the pixels of all sensors, world axes; still: (P,) measurements of the empty site (m, 0 for none);
    first: (S + 1,) where the pixels of each sensor begin.
    """

    def __init__(self, renderer: Renderer, sensors: Sequence[Sensor]) -> None:
        self.sensors, self._renderer = tuple(sensors), renderer
        images = renderer.looking(sensors).background
        self.still = np.concatenate([image.ravel() for image in images])
        self.first = np.cumsum([0, *(image.size for image in images)])
        turns = [sensor.pose[:3, :3].T.astype(np.float32) for sensor in sensors]
        rays = (sensor.model.rays().reshape(-1, 3) for sensor in sensors)
        self.rays = np.concatenate([each @ turn for each, turn in zip(rays, turns, strict=True)])
        self._poses = np.array([sensor.pose for sensor in sensors])
        most = np.repeat([sensor.model.max_range for sensor in sensors], np.diff(self.first)).astype(np.float32)
        self._reach = np.where(self.still > 0, self.still, most)
        self._columns = np.array([sensor.model.shape[1] for sensor in sensors])
        models: dict[SensorModel, list[int]] = {}
        for number, sensor in enumerate(sensors):
            models.setdefault(sensor.model, []).append(number)
        self._alike = [(model, np.array(numbers)) for model, numbers in models.items()]

    def windows(self, bodies: Int64[np.ndarray, " n"], boxes: BoxRows) -> list[Windows]:
        """Windows of bodies of the renderer in their boxes."""
        each: list[Windows] = []
        rotations, positions = self._poses[:, :3, :3], self._poses[:, None, :3, 3]
        for first in range(0, len(boxes), BOXES_TOGETHER):
            some = slice(first, first + BOXES_TOGETHER)
            in_sensor = (self._renderer.outer_corners(bodies[some], boxes[some])[:, None] - positions) @ rotations
            count = len(in_sensor)
            least = np.zeros((count, len(self.sensors)), np.float32)
            found, owners = [], []
            for model, alike in self._alike:
                corners = in_sensor[:, alike].reshape(-1, 8, 3)
                least[:, alike] = nearest(model, corners).reshape(count, -1)
                windowed = model.windows(corners)
                owner, which = np.divmod(windowed[:, 0], len(alike))
                windowed[:, 0] = alike[which]
                found.append(windowed)
                owners.append(owner)
            owner, rows = np.concatenate(owners), np.concatenate(found)
            order = np.argsort(owner, kind="stable")
            ends = np.searchsorted(owner[order], np.arange(1, count))
            each += [Windows(*pair) for pair in zip(np.split(rows[order], ends), least, strict=True)]
        return each

    def silhouette(self, body: int, box: Float64[np.ndarray, "7"], windows: Windows | None = None) -> Silhouette:
        """Silhouette of a body of the renderer in its box, alone on the site. windows: of that box, if known."""
        (there,) = (windows,) if windows is not None else self.windows(np.array([body]), box[None])
        pixels, sensors = self._in_windows(there)
        if not len(pixels):
            return Silhouette(pixels, sensors, np.zeros(0, np.float32), np.zeros((0, 3), np.float32))
        body_from_world = self._renderer.body_from_world(box)
        turn = body_from_world[:3, :3].T.astype(np.float32)
        starts = ((self._poses[:, :3, 3] - box[:3]) @ body_from_world[:3, :3].T).astype(np.float32)
        lines = np.empty((len(pixels), 6), np.float32)
        np.matmul(self.rays.take(pixels, axis=0), turn, out=lines[:, 3:])
        np.multiply(lines[:, 3:], np.float32(NEAR), out=lines[:, :3])
        lines[:, :3] += starts.take(sensors, axis=0)
        depth = self._renderer.cast_body(body, lines) + np.float32(NEAR)
        met = np.flatnonzero(depth < self._reach.take(pixels))
        pixels, sensors, depth = pixels[met], sensors[met], depth[met]
        points = self.rays.take(pixels, axis=0) * depth[:, None]
        points += self._poses[:, :3, 3].astype(np.float32).take(sensors, axis=0)
        return Silhouette(pixels, sensors, depth, points)

    def _in_windows(self, windows: Windows) -> tuple[np.ndarray, np.ndarray]:
        """Pixels that may meet a box, and their sensors."""
        sensor, top, bottom, left, right = windows.rows.T
        once_each = len(set(sensor.tolist())) == len(sensor)
        rows = bottom - top
        sensor, left, width = (np.repeat(each, rows) for each in (sensor, left, right - left))
        row = counting(rows) + np.repeat(top, rows)
        begin = self.first[sensor] + row * self._columns[sensor] + left
        pixels, sensors = counting(width) + np.repeat(begin, width), np.repeat(sensor, width)
        reached = np.flatnonzero(self._reach.take(pixels) > windows.least.take(sensors))
        pixels, sensors = pixels[reached], sensors[reached]
        if not once_each:  # a lidar's windows may meet beyond its seam
            pixels, once = np.unique(pixels, return_index=True)
            sensors = sensors[once]
        return pixels, sensors
