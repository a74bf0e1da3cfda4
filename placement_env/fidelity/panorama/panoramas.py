"""Views of many sensors on traffic, from panoramas: each place is rendered once for all sensors there."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from placement_env.fidelity.blocks import Block, see_blocks
from placement_env.fidelity.occlusion import Seen
from placement_env.fidelity.panorama.ray_table import Lookup
from placement_env.fidelity.panorama.still import Still
from placement_env.fidelity.panorama.surround import ScoredItems, Surround, find_place_strips, successive_strips
from placement_env.fidelity.traffic import Traffic, build_renderer
from placement_env.setting import Rendering
from toolkit.arrays import Bool, Float64, Int64
from toolkit.rendering.strips import SuccessiveStrips
from toolkit.runtime.cache import make_key
from toolkit.runtime.code_digest import code_digest
from toolkit.runtime.run import Run
from toolkit.sensors.sensor import Sensor, SensorModel

FRAMES_AT_ONCE = 8  # frames that a process handles before it returns its views
SHARED = 4  # mean number of sensors per place above which panoramas pay


def choose_quick(sensors: Sequence[Sensor], traffic: Traffic, rendering: Rendering) -> Bool[np.ndarray, " S"]:
    """Mask of sensors to see in panoramas.

    "auto" takes panoramas where many sensors share their places, as in a pool. Only far-sighted sensors are seen so,
    those that measure the whole detection area: panoramas have no limited range.
    """
    places = {sensor.position.round(6).tobytes() for sensor in sensors}
    if rendering == "full" or (rendering == "auto" and len(sensors) < SHARED * len(places)):
        return np.zeros(len(sensors), np.bool_)
    xmin, ymin, xmax, ymax = traffic.site.area.tolist()
    corners = np.array([[x, y] for x in (xmin, xmax) for y in (ymin, ymax)])
    positions = np.array([sensor.position for sensor in sensors]).reshape(-1, 3)
    across = np.linalg.norm(positions[:, None, :2] - corners, axis=2).max(axis=1)
    ends = np.concatenate([snapshot.objects.boxes[:, 2] for snapshot in traffic.snapshots] or [np.zeros(0)])
    low, high = ends.min(initial=0) - 10, max(ends.max(initial=0) + 10, traffic.site.height)
    up = np.maximum(np.abs(positions[:, 2] - low), np.abs(positions[:, 2] - high))
    return np.hypot(across, up) < [sensor.model.max_range for sensor in sensors]


def look_round(traffic: Traffic, sensors: Sequence[Sensor], labels: Sequence[int], run: Run = Run()) -> Seen:
    """View of far-sighted sensors on all frames. Arguments as of `placement_env.fidelity.seeing.see`."""
    look = _Look(traffic, tuple(sensors), tuple(labels))
    blocks = [(k, min(k + FRAMES_AT_ONCE, len(traffic))) for k in range(0, len(traffic), FRAMES_AT_ONCE)]
    tell = run.stage("poses rendered", len(sensors))
    report = None if tell is None else lambda frames: tell(len(sensors) * frames // len(traffic))
    return Seen(
        *(np.concatenate(each, axis=1) for each in zip(*see_blocks(look, look.key, blocks, run, report), strict=True))
    )


@dataclass(frozen=True, eq=False)
class _Look:
    """View of some frames from all sensors."""

    traffic: Traffic
    sensors: tuple[Sensor, ...]
    labels: tuple[int, ...]

    def __call__(self, block: Block, /) -> Seen:
        scored = ScoredItems.of(self.traffic, self.traffic.snapshots[slice(*block)], self.labels)
        places, viewpoint = self._places
        seen = Seen(*(np.zeros((len(self.sensors), size), np.float32) for size in (scored.items, *[scored.frames] * 2)))
        for v, strips in enumerate(find_place_strips(self._strips, self.traffic, range(*block), len(places))):
            surround = Surround.of(strips, scored, self._stills[v])
            for s in np.flatnonzero(viewpoint == v).tolist():
                for whole, row in zip(seen, surround.seen(self._lookups[s]), strict=True):
                    whole[s] = row
        return seen

    def key(self, block: Block) -> bytes:
        return make_key("panoramas", self._depends_on, block)

    @cached_property
    def _places(self) -> tuple[Float64[np.ndarray, "V 3"], Int64[np.ndarray, " S"]]:
        """Places of the sensors, and that of each."""
        positions = np.array([sensor.position for sensor in self.sensors]).round(6)
        places, viewpoint = np.unique(positions, axis=0, return_inverse=True)
        return places, viewpoint.ravel()

    @cached_property
    def _lookups(self) -> list[Lookup]:
        return [Lookup.of(sensor) for sensor in self.sensors]

    @cached_property
    def _strips(self) -> SuccessiveStrips:
        return successive_strips(self.traffic, self._places[0])

    @cached_property
    def _stills(self) -> list[dict[SensorModel, Still]]:
        """Standing scene seen from each place by its sensors' models."""
        stills: list[dict[SensorModel, Still]] = [{} for _ in self._places[0]]
        for v, model in {
            (v, sensor.model): None for v, sensor in zip(self._places[1].tolist(), self.sensors, strict=True)
        }:
            stills[v][model] = Still.of(build_renderer(self.traffic), self.traffic.site, self._places[0][v], model)
        return stills

    @cached_property
    def _depends_on(self) -> tuple[str, str, list[str], tuple[int, ...]]:
        code = code_digest(__name__, *sorted({type(sensor.model).__module__ for sensor in self.sensors}))
        return code, self.traffic.digest(), [sensor.digest for sensor in self.sensors], self.labels

    def __reduce__(self) -> tuple[type[_Look], tuple[object, ...]]:
        return _Look, (self.traffic, self.sensors, self.labels)
