"""`Renders`: the cloud of each candidate in each frame.

Clouds are rendered on first use and kept packed.

A candidate's measurements are kept as in `models.training.packed`: its view of the empty site once, and the differing
pixels of each frame. Noise depends only on a seed, the frame's number and the sensor's pose and model, so a set of
sensors measures the same in any order, pool or process. Errors beyond the sensors' own noise need whole images, since
they look at neighbouring pixels and may carry points into the crop: these are packed separately.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from hashlib import sha256
from typing import TYPE_CHECKING, Any

import numpy as np

from models.training.packed import STEPS_PER_METRE, Rig
from models.training.packing import FARTHEST, change
from placement_env.fidelity.traffic import Traffic, build_renderer
from toolkit.arrays import Float32, Int64, Shaped
from toolkit.calibration.empty_scene import EmptyScene, SceneLearner
from toolkit.calibration.scenes import Scenes
from toolkit.datasets.dataset import CoopDataset
from toolkit.datasets.readings import ReadRecording, Reads, read_frame, with_errors
from toolkit.detection.view import Captured
from toolkit.frame import Frame
from toolkit.objects import Objects
from toolkit.points import frame_points
from toolkit.runtime.cache import Cache, make_key
from toolkit.runtime.code_digest import code_digest
from toolkit.sensors.error_profiles import PAPER_ERRORS, ErrorProfile, check_drawn, only_own_noise
from toolkit.sensors.error_terms import velocities
from toolkit.sensors.sensor import Sensor

if TYPE_CHECKING:
    from placement_env.candidates.candidates import Candidates

IN_MEMORY = 256  # candidates held in memory when a cache keeps them


class Renders:
    """Measurements of candidates in traffic.

    cache: where renders are kept and shared with other processes, None for this object's memory; noise_seed: None for
    no noise; errors: of the sensors, drawn from that seed when a cloud is requested. Pickles exclude rendered data.
    """

    def __init__(
        self,
        traffic: Traffic,
        candidates: Candidates,
        cache: Cache | None = None,
        *,
        noise_seed: int | None = 0,
        errors: ErrorProfile = PAPER_ERRORS,
    ) -> None:
        check_drawn(errors, noise_seed)
        self.traffic, self.site, self.sensors = traffic, traffic.site, candidates.sensors
        self.frames = len(traffic)
        self._arguments = (traffic, candidates, cache)
        self._cache, self._noise_seed, self.errors = cache, noise_seed, errors
        self._packed: dict[int, _Packed] = {}
        self._scenes: dict[int, EmptyScene] = {}

    def __reduce__(self) -> tuple[Any, ...]:
        return partial(Renders, noise_seed=self._noise_seed, errors=self.errors), self._arguments

    @staticmethod
    def of(recording: CoopDataset, noise_seed: int | None = 0, *, errors: ErrorProfile = PAPER_ERRORS) -> Recorded:
        """Measurements of a recording. They are as in `toolkit.detection.evaluation`."""
        return Recorded(recording, noise_seed, errors=errors)

    @cached_property
    def digest(self) -> str:
        """SHA-256 over everything behind clouds except the sensor."""
        parts = [_code(self.sensors), self.traffic.digest(), self._noise_seed]
        return make_key(*parts, *_beyond_noise(self.errors)).hex()

    def clouds(self, k: int, c: int) -> Float32[np.ndarray, "n 3"]:
        """Points of candidate c in frame k. They are inside the crop, in the world frame."""
        packed, rng = self._of_candidate(c), None
        if self._whole:
            return frame_points(self._reading(packed, k, c), area=self.site)[0]
        if self._noise_seed is not None:
            rng = np.random.default_rng([self._noise_seed, k, _seed(self.sensors[c])])
        return packed.rig.points(0, *packed.frame(k), rng)

    def captured(self, k: int, c: int) -> Captured:
        """Image behind these points. It shows the crop, or everything where errors need whole images."""
        packed, sensor, snapshot = self._of_candidate(c), self.sensors[c], self.traffic.snapshots[k]
        if self._whole:
            return Captured(self._reading(packed, k, c), 0, self.site)
        rng = None if self._noise_seed is None else np.random.default_rng([self._noise_seed, k, _seed(sensor)])
        _, pixels, depth = packed.rig.measure(0, *packed.frame(k), rng)
        image = np.zeros(sensor.model.shape, np.float32)
        image.ravel()[pixels] = depth
        frame = Frame((sensor,), (image,), snapshot.objects, snapshot.time, k)
        return Captured(frame, 0, self.site, kept=pixels.astype(np.int64))

    def scene(self, c: int) -> EmptyScene:
        """Empty scene of candidate c. It is rendered, or learnt from its frames where it has errors."""
        if c not in self._scenes:
            packed, sensor = self._of_candidate(c), self.sensors[c]
            learner = SceneLearner(sensor)
            for k in range(self.frames) if self._whole else ():
                learner.add(self._reading(packed, k, c).images[0])
            still = np.zeros(sensor.model.shape, np.float32)
            still.ravel()[packed.rig.pixels[0]] = packed.rig.depth[0]
            self._scenes[c] = learner.scene() if self._whole else EmptyScene.of(sensor, still)
        return self._scenes[c]

    def objects(self, k: int) -> Objects:
        """All objects in frame k, scored or not."""
        return self.traffic.snapshots[k].objects

    @property
    def _whole(self) -> bool:
        return not only_own_noise(self.errors)

    def _reading(self, packed: _Packed, k: int, c: int) -> Frame:
        """Reading of candidate c in frame k, with errors."""
        snapshots, sensor = self.traffic.snapshots, self.sensors[c]
        now, speed = snapshots[k], None
        if self.errors.needs_velocities:
            around = [snapshots[other] for other in (k - 1, k + 1) if 0 <= other < len(snapshots)]
            speed = velocities(now.objects, now.time, [(each.objects, each.time) for each in around])
        frame = Frame((sensor,), (packed.image(k),), now.objects, now.time, k)
        return with_errors(frame, self.errors, self._noise_seed or 0, velocities=speed, numbers=[_seed(sensor)])

    def _of_candidate(self, c: int) -> _Packed:
        packed = self._packed.pop(c, None) or self._kept(c)
        if self._cache is not None and len(self._packed) >= IN_MEMORY:
            self._packed.pop(next(iter(self._packed)))  # least recently used
        self._packed[c] = packed
        return packed

    def _kept(self, c: int) -> _Packed:
        """Kept render of a candidate. A missing or damaged one is rendered."""
        if self._cache is None:
            return self._render(c)
        sensor = self.sensors[c]
        key = make_key(
            "whole render" if self._whole else "render", _code([sensor]), self.traffic.digest(), sensor.digest
        )
        arrays = self._cache.get([key])[0]
        if arrays is not None:
            return _unpacked(self._rig(c), arrays)
        packed = self._render(c)
        self._cache.put({key: packed.arrays()})
        return packed

    def _render(self, c: int) -> _Packed:
        renderer = build_renderer(self.traffic).looking([self.sensors[c]])
        if self._whole:
            images = (renderer.render(snapshot).measurements[0] for snapshot in self.traffic.snapshots)
            return _packed_whole(self._rig(c), renderer.background[0], images)
        area, height, slope = self.site.area, self.site.height, self.site.relief.slope
        rig = Rig.seeing(renderer.sensors, area, height, renderer.background, slope)
        changes = []
        for snapshot in self.traffic.snapshots:
            frame = Frame(renderer.sensors, renderer.render(snapshot).measurements, snapshot.objects)
            changes.append(change(rig, frame))
        ends = np.cumsum([0, *(len(each.pixels[0]) for each in changes)])
        pixels, steps = ([getattr(each, name)[0] for each in changes] for name in ("pixels", "steps"))
        return _Packed(rig, np.concatenate(pixels), np.concatenate(steps), ends)

    def _rig(self, c: int) -> Rig:
        area = tuple(self.site.area.tolist())
        return Rig((self.sensors[c],), area, self.site.height, (), (), self.site.relief.slope)


class Recorded:
    """Measurements of a recording. They are the same points, to the bit, as `toolkit.detection.evaluation` gets."""

    def __init__(
        self, recording: CoopDataset, noise_seed: int | None = 0, *, errors: ErrorProfile = PAPER_ERRORS
    ) -> None:
        check_drawn(errors, noise_seed)
        self.recording, self.site, self.sensors = recording, recording.site, recording.sensors
        self.frames, self._noise_seed, self.errors = len(recording), noise_seed, errors
        self._last: Frame | None = None
        self.scene = Scenes(ReadRecording(recording, Reads(errors, noise_seed)))

    @cached_property
    def digest(self) -> str:
        """SHA-256 over everything behind clouds except the sensor."""
        from toolkit.sites.files import format_site

        parts = [_code(self.sensors), self._noise_seed, format_site(self.site), *_beyond_noise(self.errors)]
        sha = sha256(" ".join(map(str, parts)).encode())
        with self.recording.path.open("rb") as file:
            while block := file.read(1 << 20):
                sha.update(block)
        return sha.hexdigest()

    def clouds(self, k: int, c: int) -> Float32[np.ndarray, "n 3"]:
        """Points of sensor c in frame k. They are inside the crop, in the world frame."""
        return frame_points(self._frame(k), [c], area=self.site)[0]

    def captured(self, k: int, c: int) -> Captured:
        """Image behind these points."""
        return Captured(self._frame(k), c, self.site)

    def objects(self, k: int) -> Objects:
        """All objects in frame k, scored or not."""
        return self._frame(k).objects

    def _frame(self, k: int) -> Frame:
        if self._last is None or self._last.index != k:
            self._last = read_frame(self.recording, k, errors=self.errors, noise_seed=self._noise_seed)
        return self._last


@dataclass(frozen=True, eq=False)
class _Packed:
    """Packed frames of one candidate.

    It holds the rig, the pixels that differ from it in any frame, their measurement in steps (0: none), and the start
    of each frame's pixels.
    """

    rig: Rig
    pixels: Shaped[np.ndarray, " p"]
    steps: Shaped[np.ndarray, " p"]
    ends: Int64[np.ndarray, " _"]

    def frame(self, k: int) -> tuple[Shaped[np.ndarray, " n"], Float32[np.ndarray, " n"]]:
        """Changed pixels of frame k and their measurements (m)."""
        rows = slice(*self.ends[k : k + 2])
        return self.pixels[rows], self.steps[rows].astype(np.float32) / np.float32(STEPS_PER_METRE)

    def image(self, k: int) -> Float32[np.ndarray, "rows columns"]:
        """Whole image of frame k. Available where whole images are packed."""
        shape = self.rig.sensors[0].model.shape
        flat = np.zeros(shape[0] * shape[1], np.float32)
        flat[self.rig.pixels[0]] = self.rig.depth[0]
        pixels, depth = self.frame(k)
        flat[pixels] = depth
        return flat.reshape(shape)

    def arrays(self) -> tuple[np.ndarray, ...]:
        """Arrays for a cache."""
        return self.rig.pixels[0], self.rig.depth[0], self.pixels, self.steps, self.ends


def _unpacked(rig: Rig, arrays: tuple[np.ndarray, ...]) -> _Packed:
    still_pixels, still_depth, *changes = arrays
    return _Packed(replace(rig, pixels=(still_pixels,), depth=(still_depth,)), *changes)


def _packed_whole(rig: Rig, background: np.ndarray, images: Iterable[np.ndarray]) -> _Packed:
    """Whole view of one sensor, in and outside the crop.

    Surfaces beyond the range of the steps that are not always present are treated as nothing.
    """
    still = background.ravel().astype(np.float32)
    seen = np.flatnonzero(still > 0).astype(np.uint32)
    pixels, steps = [], []
    for image in images:
        flat = image.ravel()
        pixels.append(np.flatnonzero(flat != still).astype(np.uint32))
        depth = flat[pixels[-1]]
        near = (depth > 0) & (depth < FARTHEST)
        steps.append(np.where(near, np.maximum(np.rint(depth * STEPS_PER_METRE), 1), 0).astype(np.uint16))
    ends = np.cumsum([0, *map(len, pixels)])
    rig = replace(rig, pixels=(seen,), depth=(still[seen],))
    return _Packed(rig, np.concatenate(pixels), np.concatenate(steps), ends)


def _beyond_noise(errors: ErrorProfile) -> list[str]:
    """Part of a key that errors add. Empty where only the sensors' own noise applies."""
    return [] if only_own_noise(errors) else [errors.digest, code_digest(*errors.modules)]


def _code(sensors: Sequence[Sensor]) -> str:
    """Digest of the source that measures with these sensors."""
    return code_digest(__name__, *sorted({type(sensor.model).__module__ for sensor in sensors}))


def _seed(sensor: Sensor) -> int:
    """Seed of a sensor's noise. It is not `Sensor.digest`, since published figures were measured with this noise."""
    described = json.dumps((repr(sensor.model), sensor.pose.tolist()))
    return int.from_bytes(sha256(described.encode()).digest()[:8], "big")
