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

IN_MEMORY = 2048  # parts of candidates' frames held in memory if a cache keeps them too
# parts of the frames, rendered separately: part p has the frames whose number modulo this is p. A
# race of sets scores one frame of every block of so many first
RENDER_PARTS = 2 * LIFE


class Renders:
    """Measurements of candidates in traffic, rendered on first use.

    Pickles exclude rendered data. Frames are numbered k, candidates c, both from 0 in the order of
    `traffic` and `candidates`. Rendered images are free of noise; noise and errors are added each
    time a measurement is requested, the same for the same seed.

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
        self._whole = not only_own_noise(errors)  # whether errors need whole images
        # by candidate and part of the frames, least recently used first
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
        """SHA-256 (hexadecimal) over all that measurements depend on except the sensors.

        It covers code, traffic, noise seed and errors; a cache key adds each sensor's digest."""
        parts = [_code(self.sensors), self.traffic.digest(), self._noise_seed]
        return make_key(
            *parts, *_beyond_noise(self.errors), *(() if self.redrawn else ("once",))
        ).hex()

    def draw_once(self, seed: int, indices: Sequence[int], frames: int) -> "Renders":
        """Measurements of some candidates, with errors drawn once for all of the first frames.

        Args:
            seed: Seed of noise and errors.
            indices: Candidates, which are numbered in this order in the result.
            frames: Number of frames from the first on."""
        traffic, candidates, cache = self._arguments
        fewer = replace(traffic, snapshots=traffic.snapshots[:frames])
        selection = candidates.select(np.asarray(indices))
        return Renders(fewer, selection, cache, noise_seed=seed, errors=self.errors, redrawn=False)

    def clouds(self, k: int, c: int) -> Float32[np.ndarray, "n 3"]:
        """Points of candidate c in frame k inside the crop, with noise and errors (m, world)."""
        return (
            frame_points(self._reading(k, c), area=self.site)[0]
            if self._whole
            else self._measure(k, c)[0]
        )

    def captured(self, k: int, c: int) -> Captured:
        """Image of candidate c in frame k, from which the points of `clouds` come.

        Pixels outside the crop are 0, unless errors need whole images: then it shows everything."""
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
        """Scene without moving objects as candidate c measures it, kept once made.

        It is rendered; if errors need whole images it is learnt from all frames with errors."""
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
        """Points in the crop with noise (m, world frame), their pixels and measurements (m)."""
        packed = self._of_candidate(c, k)
        rng = None
        if self._noise_seed is not None:
            rng = np.random.default_rng([self._noise_seed, k, _seed(self.sensors[c])])
        return self._rig(c).measure(0, *packed.frame(k), rng)

    def _reading(self, k: int, c: int) -> Frame:
        """Frame k with one sensor, candidate c: its whole image with noise and errors.

        For errors that need velocities, the objects' ones come from the frames before and
        after."""
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
        """Packed frames of candidate c among which frame k is: every `RENDER_PARTS`-th one.

        The last `IN_MEMORY` used are in memory, or all without a cache."""
        key = c, k % RENDER_PARTS
        # removed and put back at the end: the order of use
        packed = self._packed.pop(key, None) or self._kept(*key)
        if self._cache is not None and len(self._packed) >= IN_MEMORY:
            self._packed.pop(next(iter(self._packed)))  # least recently used
        self._packed[key] = packed
        return packed

    def _kept(self, c: int, part: int) -> "_Packed":
        """Packed frames `part`, `part` + `RENDER_PARTS`, ... of candidate c.

        They come from the cache; they are rendered if it does not hold them or they are damaged."""
        (arrays,) = recall(
            self._cache, [self._key(c, part)], lambda _: [self._render_part(c, part)]
        )
        return _Packed(*arrays)

    def _rig(self, c: int) -> Rig:
        """Rig of candidate c as the only sensor, with its image of the empty site.

        The image holds the crop, or everything if errors need whole images; kept once made."""
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
        # part: number of a part of the frames, or "empty" for the empty site
        sensor = self.sensors[c]
        kind = "whole render" if self._whole else "render"
        return make_key(
            kind, _code([sensor]), self.traffic.digest(), sensor.digest, part, RENDER_PARTS
        )

    def _render_empty(self, c: int) -> Arrays:
        """Pixels (row after row of the image) of the empty site and their measurements (m).

        Pixels without a return are left out; those outside the crop too, unless errors need whole
        images."""
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
        """Render every `RENDER_PARTS`-th frame of candidate c, from frame `part` on.

        Returns pixels, steps and ends as in `_Packed`: the pixels that differ from the empty site,
        frame after frame."""
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
    """Measurements of a recording's sensors, with the interface of `Renders`.

    Frames are numbered k and sensors c, both from 0 in the order of the recording.

    Args:
        recording: The recording to read.
        noise_seed: Seed of noise and errors, None for no noise.
        errors: Errors of the sensors."""

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
        """SHA-256 (hexadecimal) over all that measurements depend on except the sensors.

        It covers code, noise seed, errors, site and the bytes of the recording's file."""
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
        """Points of sensor c in frame k inside the crop, with noise and errors (m, world)."""
        return frame_points(self._frame(k), [c], area=self.site)[0]

    def captured(self, k: int, c: int) -> Captured:
        """Image of sensor c in frame k, from which the points of `clouds` come."""
        return Captured(self._frame(k), c, self.site)

    def objects(self, k: int) -> Objects:
        """All objects in frame k, scored or not."""
        return self._frame(k).objects

    def _frame(self, k: int) -> Frame:
        # frame k with noise and errors; the last one is kept, as its sensors are asked in turn
        if self._last is None or self._last.index != k:
            self._last = read_frame(
                self.recording, k, errors=self.errors, noise_seed=self._noise_seed
            )
        return self._last


@dataclass(frozen=True, eq=False)
class _Packed:
    """Every `RENDER_PARTS`-th frame of one candidate: pixels that differ from the empty site.

    Attributes:
        pixels: These pixels (row after row of the image), frame after frame.
        steps: Measurement of each pixel, `STEPS_PER_METRE` to a metre, 0 for no return.
        ends: A 0, then for each frame the index after its last pixel."""

    pixels: Shaped[np.ndarray, " p"]
    steps: Shaped[np.ndarray, " p"]
    ends: Int64[np.ndarray, " _"]

    def frame(self, k: int) -> tuple[Shaped[np.ndarray, " n"], Float32[np.ndarray, " n"]]:
        """Pixels of frame k that differ from the empty site, and their measurements (m).

        k: Number among all frames of the traffic; it must be in this part."""
        rows = slice(*self.ends[k // RENDER_PARTS :][:2])
        return self.pixels[rows], self.steps[rows].astype(np.float32) / np.float32(STEPS_PER_METRE)


def _still(rig: Rig) -> ImageRanges:
    """New image of the empty site from the pixels of a rig's only sensor, 0 elsewhere (m)."""
    image = np.zeros(rig.sensors[0].model.shape, np.float32)
    image.ravel()[rig.pixels[0]] = rig.depth[0]
    return image


def _find_changes(still: np.ndarray, image: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Pixels that differ from the empty site in a whole image, and their measurements in steps.

    A pixel that changes to a surface beyond `MAX_DEPTH_M` has 0 steps, as if nothing returned.

    Args:
        still: Measurements (m) of the empty site, flat.
        image: Measurements (m) of the frame, flat."""
    pixels = np.flatnonzero(image != still).astype(np.uint32)
    depth = image[pixels]
    # at least 1 step, as 0 is no return
    near = (depth > 0) & (depth < MAX_DEPTH_M)
    return pixels, np.where(near, np.maximum(np.rint(depth * STEPS_PER_METRE), 1), 0).astype(
        np.uint16
    )


def _beyond_noise(errors: ErrorProfile) -> list[str]:
    """Digests of errors and their code, for a cache key; empty if only the sensors have noise."""
    return [] if only_own_noise(errors) else [errors.digest, code_digest(*errors.modules)]


def _code(sensors: Sequence[Sensor]) -> str:
    """Digest of the source code of this module and of the sensors' models, for a cache key."""
    return code_digest(__name__, *sorted({type(sensor.model).__module__ for sensor in sensors}))


def _seed(sensor: Sensor) -> int:
    """Seed of a sensor's noise and errors (64 bits), from its model and pose but not its name.

    It is not `Sensor.digest`, since published figures were measured with this noise."""
    described = json.dumps((repr(sensor.model), sensor.pose.tolist()))
    return int.from_bytes(hashlib.sha256(described.encode()).digest()[:8], "big")
