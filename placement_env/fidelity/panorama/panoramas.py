"""Views of many sensors on traffic, from panoramas.

The frames are processed in turn. Each place is rendered once for all sensors there.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from placement_env.fidelity.blocks import Block, see_blocks
from placement_env.fidelity.occlusion import Seen
from placement_env.fidelity.panorama.looking import Sight, Views, alone, look_through
from placement_env.fidelity.panorama.still import Still
from placement_env.fidelity.traffic import Traffic, build_renderer, scored
from toolkit.arrays import Bool, Float64
from toolkit.points import Crop, has_centre_inside
from toolkit.rendering.strips import Counted, SuccessiveStrips
from toolkit.runtime.cache import make_key
from toolkit.runtime.code_digest import code_digest
from toolkit.runtime.run import Run
from toolkit.sensors.sensor import Sensor, SensorModel

FRAMES_AT_ONCE = 4  # frames that a process handles before it returns its views
SHARED = 4  # mean number of sensors per place above which panoramas pay


def worthwhile(sensors: Sequence[Sensor]) -> bool:
    """True where many sensors share their places. Those of a pool do."""
    return len(sensors) >= SHARED * len({sensor.position.round(6).tobytes() for sensor in sensors})


def far_sighted(sensors: Sequence[Sensor], traffic: Traffic) -> Bool[np.ndarray, " S"]:
    """Mask of sensors that measure the whole detection area. Panoramas have no limited sensor range."""
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
    return _frame_after_frame(see_blocks(look, blocks, run, report))


def _frame_after_frame(parts: Sequence[Seen]) -> Seen:
    """View of the same sensors on consecutive frames."""
    return Seen(*(np.concatenate(each, axis=1) for each in zip(*parts, strict=True)))


@dataclass(frozen=True, eq=False)
class _Look:
    """View of some frames from all sensors."""

    traffic: Traffic
    sensors: tuple[Sensor, ...]
    labels: tuple[int, ...]

    def __call__(self, block: Block, /) -> Seen:
        return _frame_after_frame([self._frame(k) for k in range(*block)])

    def key(self, block: Block) -> bytes:
        """Cache key of some frames."""
        return make_key("panoramas", self._depends_on, block)

    def _frame(self, k: int) -> Seen:
        site, snapshot, renderer = self.traffic.site, self.traffic.snapshots[k], build_renderer(self.traffic)
        boxes = snapshot.objects.boxes
        strips = self._strips.of(renderer.moment(snapshot), has_centre_inside(boxes, site.area))
        sight = Sight.of(strips, np.zeros(len(boxes), np.int64))
        seen = look_through(self._views, sight, self._stills, self._alone, (len(boxes), 1))
        return seen._replace(points=seen.points[:, scored(snapshot.objects, site, self.labels)])

    @cached_property
    def _views(self) -> Views:
        return Views.of(self.sensors)

    @cached_property
    def _strips(self) -> SuccessiveStrips:
        counted = Counted(Crop.of(self.traffic.site), self.traffic.site.hybrid_radius)
        return SuccessiveStrips(build_renderer(self.traffic), self._views.viewpoints, counted)

    @cached_property
    def _stills(self) -> dict[SensorModel, Still]:
        """Standing scene by sensor model."""
        models = dict.fromkeys(sensor.model for sensor in self.sensors)
        site, renderer = self.traffic.site, build_renderer(self.traffic)
        return {model: Still.of(renderer, site, self._views.viewpoints, model) for model in models}

    @cached_property
    def _alone(self) -> Float64[np.ndarray, "2 S"]:
        return alone(self._views, self._stills)

    @cached_property
    def _depends_on(self) -> tuple[str, str, list[str], tuple[int, ...]]:
        code = code_digest(__name__, *sorted({type(sensor.model).__module__ for sensor in self.sensors}))
        return code, self.traffic.digest(), [sensor.digest for sensor in self.sensors], self.labels

    def __getstate__(self) -> tuple[object, ...]:
        return self.traffic, self.sensors, self.labels

    def __setstate__(self, state: tuple[object, ...]) -> None:
        for name, value in zip(("traffic", "sensors", "labels"), state, strict=True):
            object.__setattr__(self, name, value)
