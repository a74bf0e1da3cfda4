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
from typing import NamedTuple

import numpy as np

from models.training.packed import STEPS_PER_METRE, Rig
from models.training.packing import MAX_DEPTH_M, change
from placement_env.candidates.candidates import Candidates
from placement_env.fidelity.traffic import Traffic, build_renderer
from placement_env.fidelity.way_frames import WayFrame
from toolkit.arrays import Float32, ImageRanges, Int64, Mask, Shaped
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
from toolkit.runtime.sent_once import SentOnce
from toolkit.sensors.error_profile import ErrorProfile
from toolkit.sensors.error_profiles import PAPER_ERRORS, check_drawn, only_own_noise
from toolkit.sensors.sensor import Sensor
from toolkit.sensors.track_velocities import velocities
from toolkit.sites.files import format_site
from toolkit.traffic.spawner import LIFE

MAX_PARTS_IN_MEMORY = 2048  # parts of candidates' frames held in memory if a cache keeps them too
# parts of the frames, rendered separately: part p has the frames whose number modulo this is p. A
# race of sets scores one frame of every half of so many first, which two processes share
RENDER_PARTS = 4 * LIFE


class _CropMeasurement(NamedTuple):
    """Measurement of one sensor in the crop, with noise.

    Attributes:
        points: Points (m, world frame).
        pixels: Pixel of each point, row after row of the image.
        depth: Measurement of each pixel (m)."""

    points: Float32[np.ndarray, "n 3"]
    pixels: Shaped[np.ndarray, " n"]
    depth: Float32[np.ndarray, " n"]


class Renders(SentOnce):
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
        """Keep what measurements depend on; nothing is rendered yet.

        noise_seed: seed of noise and errors, None for neither; redrawn: False to draw errors once
        for all frames."""
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
        # errors beyond noise look at neighbouring pixels, in the crop and outside
        self._needs_whole_images = not only_own_noise(errors)
        # by candidate and part of the frames, least recently used first
        self._packed: dict[tuple[int, int], _Packed] = {}
        self._rigs: dict[int, Rig] = {}  # by candidate
        self._scenes: dict[int, EmptyScene] = {}  # by candidate

    def __reduce__(self) -> tuple[object, ...]:
        make = partial(
            Renders, noise_seed=self._noise_seed, errors=self.errors, redrawn=self.redrawn
        )
        return make, self._arguments

    @cached_property
    def digest(self) -> str:
        """SHA-256 (hexadecimal) over all that measurements depend on except the sensors.

        It covers code, traffic, noise seed and errors; a cache key adds each sensor's digest."""
        parts = [_digest_code(self.sensors), self.traffic.digest(), self._noise_seed]
        parts += _digest_errors(self.errors)
        if not self.redrawn:
            parts.append("once")
        return make_key(*parts).hex()

    def draw_once(self, seed: int, indices: Sequence[int], frames: int) -> "Renders":
        """Measurements of some candidates, with errors drawn once for all of the first frames.

        Args:
            seed: Seed of noise and errors.
            indices: Candidates, which are numbered in this order in the result.
            frames: Number of frames from the first on."""
        traffic, candidates, cache = self._arguments
        return Renders(
            replace(traffic, snapshots=traffic.snapshots[:frames]),
            candidates.select(np.asarray(indices)),
            cache,
            noise_seed=seed,
            errors=self.errors,
            redrawn=False,
        )

    def clouds(self, k: int, c: int) -> Float32[np.ndarray, "n 3"]:
        """Points of candidate c in frame k inside the crop, with noise and errors (m, world)."""
        if self._needs_whole_images:
            (points,) = frame_points(self._read_frame(k, c), area=self.site)
            return points
        return self._measure(k, c).points

    def captured(self, k: int, c: int) -> Captured:
        """Image of candidate c in frame k, from which the points of `clouds` come.

        Pixels outside the crop are 0, unless errors need whole images: then it shows everything."""
        if self._needs_whole_images:
            return Captured(self._read_frame(k, c), index=0, area=self.site)
        sensor = self.sensors[c]
        snapshot = self.traffic.snapshots[k]
        measurement = self._measure(k, c)
        image = np.zeros(sensor.model.shape, np.float32)
        image.ravel()[measurement.pixels] = measurement.depth
        frame = Frame(
            sensors=(sensor,),
            measurements=(image,),
            objects=snapshot.objects,
            time=snapshot.time,
            index=k,
        )
        crop_pixels = measurement.pixels.astype(np.int64)
        return Captured(frame, index=0, area=self.site, crop_pixels=crop_pixels)

    def scene(self, c: int) -> EmptyScene:
        """Scene without moving objects as candidate c measures it, kept once made.

        It is rendered; if errors need whole images it is learnt from all frames with errors."""
        if c not in self._scenes:
            if self._needs_whole_images:
                learner = SceneLearner(self.sensors[c])
                for k in range(self.frames):
                    (image,) = self._read_frame(k, c).images
                    learner.add(image)
                self._scenes[c] = learner.scene()
            else:
                empty_image = _build_empty_image(self._find_rig(c))
                self._scenes[c] = EmptyScene.from_render(self.sensors[c], empty_image)
        return self._scenes[c]

    def objects(self, k: int) -> Objects:
        """All objects in frame k, scored or not."""
        return self.traffic.snapshots[k].objects

    def _measure(self, k: int, c: int) -> _CropMeasurement:
        """Measurement of candidate c in the crop in frame k, with noise."""
        # changes from the empty site; the noise of a sensor and frame is the same in any set
        pixels, depth = self._find_packed(c, k).frame(k)
        rng = None
        if self._noise_seed is not None:
            rng = np.random.default_rng([self._noise_seed, k, _hash_sensor(self.sensors[c])])
        rig = self._find_rig(c)  # candidate c is its only sensor, number 0
        return _CropMeasurement(*rig.measure(0, changed=pixels, measured=depth, rng=rng))

    def _read_frame(self, k: int, c: int) -> Frame:
        """Frame k with one sensor, candidate c: its whole image with noise and errors.

        For errors that need velocities, the objects' ones come from the frames before and
        after."""
        snapshots = self.traffic.snapshots
        sensor = self.sensors[c]
        packed = self._find_packed(c, k)
        now = snapshots[k]
        object_velocities = None
        if self.errors.needs_velocities:
            neighbours = [
                snapshots[index] for index in (k - 1, k + 1) if 0 <= index < len(snapshots)
            ]
            object_velocities = velocities(
                now.objects,
                now.time,
                [(neighbour.objects, neighbour.time) for neighbour in neighbours],
            )
        image = _build_empty_image(self._find_rig(c))
        pixels, depth = packed.frame(k)
        image.ravel()[pixels] = depth
        frame = Frame(
            sensors=(sensor,), measurements=(image,), objects=now.objects, time=now.time, index=k
        )
        seed = self._noise_seed or 0
        if self.redrawn:
            seed = block_seed(seed, k // LIFE)
        return with_errors(
            frame, self.errors, seed, velocities=object_velocities, numbers=[_hash_sensor(sensor)]
        )

    def _find_packed(self, c: int, k: int) -> "_Packed":
        """Packed frames of candidate c among which frame k is: every `RENDER_PARTS`-th one.

        The last `MAX_PARTS_IN_MEMORY` used are in memory, or all without a cache."""
        key = c, k % RENDER_PARTS
        # removed and put back at the end: the order of use
        packed = self._packed.pop(key, None) or self._load_packed(*key)
        if self._cache is not None and len(self._packed) >= MAX_PARTS_IN_MEMORY:
            self._packed.pop(next(iter(self._packed)))  # least recently used
        self._packed[key] = packed
        return packed

    def _load_packed(self, c: int, part: int) -> "_Packed":
        """Packed frames `part`, `part` + `RENDER_PARTS`, ... of candidate c.

        They come from the cache; they are rendered if it does not hold them or they are damaged."""
        (arrays,) = recall(
            self._cache, [self._key(c, part)], lambda _: [self._render_part(c, part)]
        )
        return _Packed(*arrays)

    def _find_rig(self, c: int) -> Rig:
        """Candidate c as a rig of one sensor: with its measurements of the empty site.

        They hold the crop, or everything if errors need whole images; kept once made."""
        if c not in self._rigs:
            (arrays,) = recall(
                self._cache, [self._key(c, "empty")], lambda _: [self._render_empty(c)]
            )
            pixels, depth = arrays
            self._rigs[c] = Rig(
                sensors=(self.sensors[c],),
                area=tuple(self.site.area.tolist()),
                height=self.site.height,
                pixels=(pixels,),
                depth=(depth,),
                slope=self.site.relief.slope,
            )
        return self._rigs[c]

    def _key(self, c: int, part: int | str) -> bytes:
        """Cache key of renders of candidate c.

        part: Number of a part of the frames, or "empty" for the empty site."""
        sensor = self.sensors[c]
        kind = "whole render" if self._needs_whole_images else "render"
        return make_key(
            kind, _digest_code([sensor]), self.traffic.digest(), sensor.digest, part, RENDER_PARTS
        )

    def _render_empty(self, c: int) -> Arrays:
        """Pixels (row after row of the image) of the empty site and their measurements (m).

        Pixels without a return are left out; those outside the crop too, unless errors need whole
        images."""
        renderer = build_renderer(self.traffic).looking([self.sensors[c]])
        (background,) = renderer.background  # image of the only sensor
        if self._needs_whole_images:
            empty_depth = background.ravel().astype(np.float32)
            pixels = np.flatnonzero(empty_depth > 0).astype(np.uint32)
            return pixels, empty_depth[pixels]
        rig = Rig.seeing(
            renderer.sensors,
            area=self.site.area,
            height=self.site.height,
            empty=[background],
            slope=self.site.relief.slope,
        )
        return rig.pixels[0], rig.depth[0]

    def _render_part(self, c: int, part: int) -> Arrays:
        """Render every `RENDER_PARTS`-th frame of candidate c, from frame `part` on.

        Returns:
            Pixels that differ from the empty site, frame after frame; the measurement of each,
            `STEPS_PER_METRE` to a metre, 0 for no return; and a 0, then for each frame the index
            after its last pixel."""
        renderer = build_renderer(self.traffic).looking([self.sensors[c]])
        (background,) = renderer.background  # image of the only sensor
        empty_image = background.ravel().astype(np.float32)
        rig = self._find_rig(c)
        frame_pixels = []
        frame_steps = []
        for snapshot in self.traffic.snapshots[part::RENDER_PARTS]:
            images = renderer.render(snapshot).measurements
            if self._needs_whole_images:
                pixels, steps = _find_changes(empty_image, images[0].ravel())
            else:
                changes = change(rig, Frame(renderer.sensors, images, snapshot.objects))
                (pixels,) = changes.pixels
                (steps,) = changes.steps
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
        errors: Errors of the sensors.
        ways: Frames to use, and the road users that count in each; None for all frames, in which
            everybody counts."""

    def __init__(
        self,
        recording: CoopDataset,
        noise_seed: int | None = 0,
        *,
        errors: ErrorProfile = PAPER_ERRORS,
        ways: Sequence[WayFrame] | None = None,
    ) -> None:
        """Keep what measurements depend on; nothing is read yet.

        noise_seed: seed of noise and errors, None for neither; ways: frames and road users that
        count, None for all."""
        check_drawn(errors, noise_seed)
        self.ways = ways
        self.recording = recording
        self.site = recording.site
        self.sensors = recording.sensors
        self.frames = len(recording) if ways is None else len(ways)
        self._noise_seed = noise_seed
        self.errors = errors
        self._last: Frame | None = None
        self.scene = Scenes(ReadRecording(recording, Reads(errors, noise_seed)))

    @cached_property
    def digest(self) -> str:
        """SHA-256 (hexadecimal) over all that measurements depend on except the sensors.

        It covers code, noise seed, errors, site and the bytes of the recording's file."""
        parts = [
            _digest_code(self.sensors),
            self._noise_seed,
            format_site(self.site),
            *_digest_errors(self.errors),
        ]
        if self.ways is not None:
            parts.append(make_key(self.ways).hex())
        sha = hashlib.sha256(" ".join(map(str, parts)).encode())
        with self.recording.path.open("rb") as file:
            return hashlib.file_digest(file, lambda: sha).hexdigest()  # goes on with `sha`

    def clouds(self, k: int, c: int) -> Float32[np.ndarray, "n 3"]:
        """Points of sensor c in frame k inside the crop, with noise and errors (m, world)."""
        (points,) = frame_points(self._frame(k), [c], area=self.site)
        return points

    def captured(self, k: int, c: int) -> Captured:
        """Image of sensor c in frame k, from which the points of `clouds` come."""
        return Captured(self._frame(k), index=c, area=self.site)

    def objects(self, k: int) -> Objects:
        """All objects in frame k, scored or not."""
        return self._frame(k).objects

    def counted(self, k: int) -> Mask:
        """Mask of the objects of frame k that count, if their class and place do."""
        objects = self.objects(k)
        if self.ways is None:
            return np.ones(len(objects), np.bool_)
        return np.isin(objects.ids, self.ways[k].ids)

    def _frame(self, k: int) -> Frame:
        """Frame k among the used ones, with noise and errors.

        The last one is kept, as its sensors are read in turn."""
        # its number in the recording; `self.ways` may list only some frames
        index = k if self.ways is None else self.ways[k].number
        if self._last is None or self._last.index != index:
            self._last = read_frame(
                self.recording, index, errors=self.errors, noise_seed=self._noise_seed
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
        # a part has every `RENDER_PARTS`-th frame, so this is the frame's index in its part
        index = k // RENDER_PARTS
        begin, end = self.ends[index : index + 2]
        depth = self.steps[begin:end].astype(np.float32) / np.float32(STEPS_PER_METRE)
        return self.pixels[begin:end], depth


def _build_empty_image(rig: Rig) -> ImageRanges:
    """New image of the empty site from the pixels of a rig's only sensor, 0 elsewhere (m)."""
    image = np.zeros(rig.sensors[0].model.shape, np.float32)
    image.ravel()[rig.pixels[0]] = rig.depth[0]
    return image


def _find_changes(empty_image: np.ndarray, image: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Pixels that differ from the empty site in a whole image, and their measurements in steps.

    A pixel that changes to a surface beyond `MAX_DEPTH_M` has 0 steps, as if nothing returned.

    Args:
        empty_image: Measurements (m) of the empty site, flat.
        image: Measurements (m) of the frame, flat.

    Returns:
        Flat indices of the pixels; measurement of each, `STEPS_PER_METRE` to a metre."""
    pixels = np.flatnonzero(image != empty_image).astype(np.uint32)
    depth = image[pixels]
    is_measured = (depth > 0) & (depth < MAX_DEPTH_M)
    # at least 1 step, as 0 is no return
    steps = np.where(is_measured, np.maximum(np.rint(depth * STEPS_PER_METRE), 1), 0)
    return pixels, steps.astype(np.uint16)


def _digest_errors(errors: ErrorProfile) -> list[str]:
    """Digests of errors and their code, for a cache key; empty if only the sensors have noise."""
    return [] if only_own_noise(errors) else [errors.digest, code_digest(*errors.modules)]


def _digest_code(sensors: Sequence[Sensor]) -> str:
    """Digest of the source code of this module and of the sensors' models, for a cache key."""
    return code_digest(__name__, *sorted({type(sensor.model).__module__ for sensor in sensors}))


def _hash_sensor(sensor: Sensor) -> int:
    """Seed of a sensor's noise and errors (64 bits), from its model and pose but not its name.

    It is not `Sensor.digest`, since published figures were measured with this noise."""
    description = json.dumps((repr(sensor.model), sensor.pose.tolist()))
    return int.from_bytes(hashlib.sha256(description.encode()).digest()[:8], "big")
