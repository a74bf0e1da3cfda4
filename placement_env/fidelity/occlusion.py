"""View of a block of sensors on every frame.

Each object's silhouette is cast once; then the nearest silhouette per pixel is found. Vehicles that stand still from
one frame to the next, parked or at a light, are cast once.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from placement_env.fidelity.traffic import Traffic, scored
from toolkit.arrays import Bool, Float32, Int64
from toolkit.geometry import level_rows
from toolkit.objects import VEHICLE
from toolkit.points import Crop, is_inside
from toolkit.rendering.renderer import Renderer
from toolkit.rendering.silhouettes import SensorRays, Windows
from toolkit.sensors.sensor import Sensor
from toolkit.sites.site import Site


class Seen(NamedTuple):
    """Points on the scored objects of all frames.

    Points in the crop per frame and the far ones come too; see `Visibility`.
    """

    points: Float32[np.ndarray, "S O"]
    sent: Float32[np.ndarray, "S F"]
    far: Float32[np.ndarray, "S F"]


class _Part(NamedTuple):
    """Pixels of one silhouette.

    For each: number, sensor, measurement, whether it counts for the object, and the points it adds to those sent and
    those far (below 0 where it hides something).
    """

    pixels: Int64[np.ndarray, " n"]
    sensors: Int64[np.ndarray, " n"]
    depth: Float32[np.ndarray, " n"]
    counted: Bool[np.ndarray, " n"]
    sent: Float32[np.ndarray, " n"]
    far: Float32[np.ndarray, " n"]


def look_at(
    traffic: Traffic, renderer: Renderer, sensors: Sequence[Sensor], labels: Sequence[int] = (VEHICLE,)
) -> Seen:
    """View of the sensors on all frames. renderer: of the traffic's site and bodies; labels: of the scored objects."""
    scene = _Scene(traffic.site, renderer, sensors)
    points, sent, far = [np.zeros((len(sensors), 0))], [], []
    parts: dict[tuple[int, bytes], _Part] = {}
    windows = _find_windows(traffic, scene)
    for snapshot in traffic.snapshots:
        boxes, bodies = snapshot.objects.boxes, snapshot.bodies.tolist()
        keys = [(body, box.tobytes()) for body, box in zip(bodies, boxes, strict=True)]
        parts = {
            key: parts[key] if key in parts else scene.part(body, box, windows[key])
            for key, body, box in zip(keys, bodies, boxes, strict=True)
        }
        on_objects, more_sent, more_far = scene.compose([parts[key] for key in keys])
        points.append(on_objects[:, scored(snapshot.objects, traffic.site, labels)])
        sent.append(scene.sent + more_sent)
        far.append(scene.far + more_far)
    return Seen(
        np.concatenate(points, axis=1).astype(np.float32),
        np.column_stack(sent).astype(np.float32),
        np.column_stack(far).astype(np.float32),
    )


def _find_windows(traffic: Traffic, scene: _Scene) -> dict[tuple[int, bytes], Windows]:
    """Windows in which each object may be seen. They cover all frames; an object that stands still has one."""
    different = {
        (body, box.tobytes()): (body, box)
        for snapshot in traffic.snapshots
        for body, box in zip(snapshot.bodies.tolist(), snapshot.objects.boxes, strict=True)
    }
    bodies = np.array([body for body, _ in different.values()], np.int64)
    boxes = np.array([box for _, box in different.values()]).reshape(-1, 7)
    return dict(zip(different, scene.windows(bodies, boxes), strict=True))


class _Scene:
    """Sensors of a block at the empty site. It has buffers for one frame."""

    def __init__(self, site: Site, renderer: Renderer, sensors: Sequence[Sensor]) -> None:
        self._site, self._views, self._crop = site, SensorRays(renderer, sensors), Crop.of(site)
        self._positions = np.array([sensor.position for sensor in sensors], np.float32)
        models = [sensor.model for sensor in sensors]
        self._models = tuple(dict.fromkeys(models))
        self._model = np.array([self._models.index(model) for model in models])
        views = self._views
        which = np.repeat(np.arange(len(sensors)), np.diff(views.first))
        self._still_sent, self._still_far = (np.zeros(len(views.still), np.float32) for _ in range(2))
        for s, image in enumerate(map(slice, views.first[:-1], views.first[1:])):  # one at a time, to spare memory
            pixels = np.flatnonzero(views.still[image] > 0) + views.first[s]
            points = views.rays[pixels] * views.still[pixels, None] + self._positions[s]
            self._still_sent[pixels], self._still_far[pixels] = self._worth(
                points, views.rays[pixels], views.still[pixels], which[pixels]
            )
        self.sent, self.far = (np.bincount(which, each, len(sensors)) for each in (self._still_sent, self._still_far))
        self._front = np.full(len(views.still), np.inf, np.float32)
        self._owner = np.zeros(len(views.still), np.int32)

    def windows(self, bodies: np.ndarray, boxes: np.ndarray) -> list[Windows]:
        """Windows in which objects may be seen."""
        return self._views.windows(bodies, boxes)

    def part(self, body: int, box: np.ndarray, windows: Windows) -> _Part:
        """Part of one object seen alone."""
        pixels, sensors, depth, points = self._views.silhouette(body, box, windows)
        if not len(pixels):
            return _Part(pixels, sensors, depth, np.zeros(0, np.bool_), depth, depth)
        sent, far = self._worth(points, self._views.rays.take(pixels, axis=0), depth, sensors)
        counted = self._crop.holds(points)
        more_sent, more_far = sent - self._still_sent.take(pixels), far - self._still_far.take(pixels)
        return _Part(pixels, sensors, depth, counted, more_sent, more_far)

    def compose(self, parts: Sequence[_Part]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Points on each object, and changes per sensor.

        Points are (S, n). The changes are the sum that all objects add to each sensor. The nearest hit counts; of
        equally near ones the first object's.
        """
        count = len(self._positions)
        if not parts:
            return np.zeros((count, 0)), np.zeros(count), np.zeros(count)
        pixels, sensors, depth, counted, sent, far = (np.concatenate(each) for each in zip(*parts, strict=True))
        objects = np.repeat(np.arange(len(parts)), [len(part.pixels) for part in parts])
        np.minimum.at(self._front, pixels, depth)
        hits = np.flatnonzero(depth == self._front.take(pixels))
        self._front[pixels] = np.inf
        self._owner[pixels[hits[::-1]]] = hits[::-1]
        hits = hits[self._owner.take(pixels[hits]) == hits]
        cells = (sensors * len(parts) + objects)[hits[counted[hits]]]
        on_objects = np.bincount(cells, minlength=count * len(parts)).reshape(count, len(parts))
        more_sent, more_far = (np.bincount(sensors[hits], each[hits], count) for each in (sent, far))
        return on_objects, more_sent, more_far

    def _worth(
        self, points: np.ndarray, rays: np.ndarray, depth: np.ndarray, sensors: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        spread = np.abs(rays[:, 2]) * self._deviation(depth, sensors)
        return worth(points, spread, self._positions[:, :2].take(sensors, axis=0), self._site)

    def _deviation(self, depth: np.ndarray, sensors: np.ndarray) -> np.ndarray | np.float32:
        """Noise standard deviation of each measurement. It follows the model of the sensor."""
        if len(self._models) == 1:
            return self._models[0].deviation(depth)
        which, deviation = self._model.take(sensors), np.empty(len(depth), np.float32)
        for k in np.flatnonzero(np.bincount(which)):
            own = which == k
            deviation[own] = self._models[k].deviation(depth[own])
        return deviation


def worth(
    points: Float32[np.ndarray, "n 3"],
    spread: Float32[np.ndarray, " n"],
    positions: Float32[np.ndarray, "n 2"],
    site: Site,
) -> tuple[Float32[np.ndarray, " n"], Float32[np.ndarray, " n"]]:
    """Chance of each point to be sent and far.

    Noise lifts half of even ground above z = 0. spread: standard deviation of its height; positions: of the sensor that
    measures it.
    """
    above = level_rows(points, site.relief.slope)
    within, z = is_inside(above, site.area, site.height, -np.inf), above[:, 2]
    sent = within * _normal(np.clip(z / np.maximum(spread, np.float32(1e-6)), -8, 8))
    offset = points[:, :2] - positions
    return sent, sent * (np.einsum("ij,ij->i", offset, offset) > site.hybrid_radius**2)


def _normal(x: Float32[np.ndarray, " n"]) -> Float32[np.ndarray, " n"]:
    """The standard normal distribution function. It is within 0.0003 (Page 1977, J. Royal Stat. Soc. C 26)."""
    return 0.5 * (1 + np.tanh(np.float32(0.7978846) * x * (1 + np.float32(0.044715) * x * x)))
