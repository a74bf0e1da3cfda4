"""`Renders`: the cloud of each candidate in each frame, rendered on first use and kept packed.

Noise depends only on a seed, the frame's number and the sensor's pose and model, so a set of
sensors measures the same in any order, pool or process. Errors beyond the sensors' own noise need
whole images, packed separately, since they look at neighbouring pixels and may carry points into
the crop."""

import hashlib
import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np

from models.training.packed import STEPS_PER_METRE, Rig
from models.training.packing import MAX_DEPTH_M, change
from placement_env.candidates.candidates import Candidates
from placement_env.fidelity.traffic import Traffic, build_renderer
from toolkit.arrays import Float32, ImageRanges, Int64, Shaped
from toolkit.calibration.empty_scene import EmptyScene, SceneLearner
from toolkit.calibration.recording_scenes import Scenes
from toolkit.datasets.dataset import CoopDataset
from toolkit.datasets.recording_views import (
    ReadRecording,
    Reads,
    block_seed,
    read_frame,
    with_errors,
)
from toolkit.detection.view import Captured
from toolkit.frame import Frame
from toolkit.objects import Objects
from toolkit.points import frame_points
from toolkit.runtime.cache import Arrays, Cache, code_digest, make_key, recall
from toolkit.sensors.error_profile import ErrorProfile
from toolkit.sensors.error_profiles import PAPER_ERRORS, check_drawn, only_own_noise
from toolkit.sensors.sensor import Sensor
from toolkit.sensors.track_velocities import velocities
from toolkit.sites.files import format_site
from toolkit.traffic.spawner import LIFE

IN_MEMORY = 2048  # parts held in memory when a cache keeps them
# of the frames, rendered separately: a race looks at one frame of every block of so many first
RENDER_PARTS = 2 * LIFE


class Renders:
    """Measurements of candidates in traffic.

    Pickles exclude rendered data.

    Args:
        traffic: Frames to render.
        candidates: Sensors that measure.
        cache: Keeps renders for other processes too, None to keep them in this object's memory.
        noise_seed: Seed of noise and errors, None for no noise.
        errors: Errors of the sensors, drawn when a cloud is requested.
        redrawn: Draw the errors for each block of `LIFE` frames again, as if the sensors were
            mounted again, so that figures over all frames are means over many mountings; else once
            for all frames."""

    def __init__(
        self,
        traffic: Traffic,
        candidates: Candidates,
        cache: Cache | None = None,
        *,
        noise_seed: int | None = 0,
        errors: ErrorProfile = PAPER_ERRORS,
        redrawn: bool = True,
    ) -> None:
        check_drawn(errors, noise_seed)
        self.redrawn = redrawn
        self.traffic = traffic
        self.site = traffic.site
        self.sensors = candidates.sensors
        self.frames = len(traffic)
        self._arguments = (traffic, candidates, cache)
        self._cache = cache
        self._noise_seed = noise_seed
        self.errors = errors
        self._whole = not only_own_noise(errors)
        self._packed: dict[tuple[int, int], _Packed] = {}
        self._rigs: dict[int, Rig] = {}
        self._scenes: dict[int, EmptyScene] = {}

    def __reduce__(self) -> tuple[object, ...]:
        make = partial(
            Renders, noise_seed=self._noise_seed, errors=self.errors, redrawn=self.redrawn
        )
        return make, self._arguments

    @cached_property
    def digest(self) -> str:
        """SHA-256 over everything behind clouds except the sensor."""
        parts = [_code(self.sensors), self.traffic.digest(), self._noise_seed]
        return make_key(
            *parts, *_beyond_noise(self.errors), *(() if self.redrawn else ("once",))
        ).hex()

    def draw_once(self, seed: int, indices: Sequence[int], frames: int) -> "Renders":
        """Measurements of some candidates in the first frames, with errors drawn once for all of
        them."""
        traffic, candidates, cache = self._arguments
        fewer = replace(traffic, snapshots=traffic.snapshots[:frames])
        selection = candidates.select(np.asarray(indices))
        return Renders(fewer, selection, cache, noise_seed=seed, errors=self.errors, redrawn=False)

    def clouds(self, k: int, c: int) -> Float32[np.ndarray, "n 3"]:
        """Points of candidate c in frame k, world frame."""
        return (
            frame_points(self._reading(k, c), area=self.site)[0]
            if self._whole
            else self._measure(k, c)[0]
        )

    def captured(self, k: int, c: int) -> Captured:
        """Image behind these points. It shows the crop, or everything where errors need whole
        images."""
        if self._whole:
            return Captured(self._reading(k, c), 0, self.site)
        sensor, snapshot, (_, pixels, depth) = (
            self.sensors[c],
            self.traffic.snapshots[k],
            self._measure(k, c),
        )
        image = np.zeros(sensor.model.shape, np.float32)
        image.ravel()[pixels] = depth
        frame = Frame((sensor,), (image,), snapshot.objects, snapshot.time, k)
        return Captured(frame, 0, self.site, crop_pixels=pixels.astype(np.int64))

    def scene(self, c: int) -> EmptyScene:
        """Empty scene of candidate c. It is rendered, or learnt from its frames where it has
        errors."""
        if c not in self._scenes:
            if self._whole:
                learner = SceneLearner(self.sensors[c])
                for k in range(self.frames):
                    learner.add(self._reading(k, c).images[0])
                self._scenes[c] = learner.scene()
            else:
                self._scenes[c] = EmptyScene.from_render(self.sensors[c], _still(self._rig(c)))
        return self._scenes[c]

    def objects(self, k: int) -> Objects:
        """All objects in frame k, scored or not."""
        return self.traffic.snapshots[k].objects

    def _measure(self, k: int, c: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Points in the crop, with noise, their pixels and measurements."""
        packed = self._of_candidate(c, k)
        rng = None
        if self._noise_seed is not None:
            rng = np.random.default_rng([self._noise_seed, k, _seed(self.sensors[c])])
        return self._rig(c).measure(0, *packed.frame(k), rng)

    def _reading(self, k: int, c: int) -> Frame:
        """Whole image of candidate c in frame k, with errors."""
        snapshots = self.traffic.snapshots
        sensor = self.sensors[c]
        packed = self._of_candidate(c, k)
        now = snapshots[k]
        speed = None
        image = _still(self._rig(c))
        if self.errors.needs_velocities:
            neighbours = [
                snapshots[index] for index in (k - 1, k + 1) if 0 <= index < len(snapshots)
            ]
            speed = velocities(
                now.objects,
                now.time,
                [(neighbour.objects, neighbour.time) for neighbour in neighbours],
            )
        pixels, depth = packed.frame(k)
        image.ravel()[pixels] = depth
        frame = Frame((sensor,), (image,), now.objects, now.time, k)
        seed = (
            block_seed(self._noise_seed or 0, k // LIFE) if self.redrawn else self._noise_seed or 0
        )
        return with_errors(frame, self.errors, seed, velocities=speed, numbers=[_seed(sensor)])

    def _of_candidate(self, c: int, k: int) -> "_Packed":
        """Packed part of a candidate's frames with frame k."""
        key = c, k % RENDER_PARTS
        packed = self._packed.pop(key, None) or self._kept(*key)
        if self._cache is not None and len(self._packed) >= IN_MEMORY:
            self._packed.pop(next(iter(self._packed)))  # least recently used
        self._packed[key] = packed
        return packed

    def _kept(self, c: int, part: int) -> "_Packed":
        """Kept part of a candidate's frames, rendered anew if damaged."""
        (arrays,) = recall(
            self._cache, [self._key(c, part)], lambda _: [self._render_part(c, part)]
        )
        return _Packed(*arrays)

    def _rig(self, c: int) -> Rig:
        """A candidate and its view of the empty site, as far as that is packed."""
        if c not in self._rigs:
            (arrays,) = recall(
                self._cache, [self._key(c, "empty")], lambda _: [self._render_empty(c)]
            )
            area = tuple(self.site.area.tolist())
            height = self.site.height
            slope = self.site.relief.slope
            self._rigs[c] = Rig((self.sensors[c],), area, height, (arrays[0],), (arrays[1],), slope)
        return self._rigs[c]

    def _key(self, c: int, part: int | str) -> bytes:
        sensor = self.sensors[c]
        kind = "whole render" if self._whole else "render"
        return make_key(
            kind, _code([sensor]), self.traffic.digest(), sensor.digest, part, RENDER_PARTS
        )

    def _render_empty(self, c: int) -> Arrays:
        """Pixels and measurements of the empty site."""
        renderer = build_renderer(self.traffic).looking([self.sensors[c]])
        if self._whole:
            still = renderer.background[0].ravel().astype(np.float32)
            seen = np.flatnonzero(still > 0).astype(np.uint32)
            return seen, still[seen]
        area = self.site.area
        height = self.site.height
        slope = self.site.relief.slope
        rig = Rig.seeing(renderer.sensors, area, height, renderer.background, slope)
        return rig.pixels[0], rig.depth[0]

    def _render_part(self, c: int, part: int) -> Arrays:
        """Render every `RENDER_PARTS`-th frame of sensor c, from frame `part` on.

        Returns pixels, steps and ends of `_Packed`: what differs from the empty site, frame after
        frame."""
        renderer = build_renderer(self.traffic).looking([self.sensors[c]])
        empty_image = renderer.background[0].ravel().astype(np.float32)
        rig = self._rig(c)
        frame_pixels = []
        frame_steps = []
        for snapshot in self.traffic.snapshots[part::RENDER_PARTS]:
            images = renderer.render(snapshot).measurements
            if self._whole:
                pixels, steps = _find_changes(empty_image, images[0].ravel())
            else:
                changed = change(rig, Frame(renderer.sensors, images, snapshot.objects))
                pixels = changed.pixels[0]
                steps = changed.steps[0]
            frame_pixels.append(pixels)
            frame_steps.append(steps)
        ends = np.cumsum([0, *map(len, frame_pixels)])
        return np.concatenate(frame_pixels), np.concatenate(frame_steps), ends


class Recorded:
    """Measurements of a recording."""

    def __init__(
        self,
        recording: CoopDataset,
        noise_seed: int | None = 0,
        *,
        errors: ErrorProfile = PAPER_ERRORS,
    ) -> None:
        check_drawn(errors, noise_seed)
        self.recording = recording
        self.site = recording.site
        self.sensors = recording.sensors
        self.frames = len(recording)
        self._noise_seed = noise_seed
        self.errors = errors
        self._last: Frame | None = None
        self.scene = Scenes(ReadRecording(recording, Reads(errors, noise_seed)))

    @cached_property
    def digest(self) -> str:
        """SHA-256 over everything behind clouds except the sensor."""
        parts = [
            _code(self.sensors),
            self._noise_seed,
            format_site(self.site),
            *_beyond_noise(self.errors),
        ]
        sha = hashlib.sha256(" ".join(map(str, parts)).encode())
        with self.recording.path.open("rb") as file:
            return hashlib.file_digest(file, lambda: sha).hexdigest()

    def clouds(self, k: int, c: int) -> Float32[np.ndarray, "n 3"]:
        """Points of sensor c in frame k, world frame."""
        return frame_points(self._frame(k), [c], area=self.site)[0]

    def captured(self, k: int, c: int) -> Captured:
        """Image behind these points."""
        return Captured(self._frame(k), c, self.site)

    def objects(self, k: int) -> Objects:
        """All objects in frame k, scored or not."""
        return self._frame(k).objects

    def _frame(self, k: int) -> Frame:
        if self._last is None or self._last.index != k:
            self._last = read_frame(
                self.recording, k, errors=self.errors, noise_seed=self._noise_seed
            )
        return self._last


@dataclass(frozen=True, eq=False)
class _Packed:
    """Packed part of a candidate's frames.

    Attributes:
        pixels: Pixels that differ from the empty site, frame after frame.
        steps: Measurement of each of these pixels in steps, 0 for none.
        ends: Index at which the pixels of each frame end, after a 0."""

    pixels: Shaped[np.ndarray, " p"]
    steps: Shaped[np.ndarray, " p"]
    ends: Int64[np.ndarray, " _"]

    def frame(self, k: int) -> tuple[Shaped[np.ndarray, " n"], Float32[np.ndarray, " n"]]:
        """Changed pixels of frame k and their measurements (m)."""
        rows = slice(*self.ends[k // RENDER_PARTS :][:2])
        return self.pixels[rows], self.steps[rows].astype(np.float32) / np.float32(STEPS_PER_METRE)


def _still(rig: Rig) -> ImageRanges:
    """Image of the empty site, as far as it is packed."""
    image = np.zeros(rig.sensors[0].model.shape, np.float32)
    image.ravel()[rig.pixels[0]] = rig.depth[0]
    return image


def _find_changes(still: np.ndarray, image: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Pixels and steps of a whole view. Surfaces beyond the range of the steps that come and go
    count as nothing."""
    pixels = np.flatnonzero(image != still).astype(np.uint32)
    depth = image[pixels]
    near = (depth > 0) & (depth < MAX_DEPTH_M)
    return pixels, np.where(near, np.maximum(np.rint(depth * STEPS_PER_METRE), 1), 0).astype(
        np.uint16
    )


def _beyond_noise(errors: ErrorProfile) -> list[str]:
    """Part of a key that errors add."""
    return [] if only_own_noise(errors) else [errors.digest, code_digest(*errors.modules)]


def _code(sensors: Sequence[Sensor]) -> str:
    """Digest of the source that measures with these sensors."""
    return code_digest(__name__, *sorted({type(sensor.model).__module__ for sensor in sensors}))


def _seed(sensor: Sensor) -> int:
    """Seed of a sensor's noise. It is not `Sensor.digest`, since published figures were measured
    with this noise."""
    described = json.dumps((repr(sensor.model), sensor.pose.tolist()))
    return int.from_bytes(hashlib.sha256(described.encode()).digest()[:8], "big")
