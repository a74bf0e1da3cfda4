"""`Renders`: the cloud of each candidate in each frame, rendered when first asked for and kept packed.

A candidate's measurements are kept as in `models.training.packed`: what it sees of the empty site once, and of each
frame the pixels that differ. Noise is drawn from a seed, the frame's number and the sensor's pose and model alone, so
that a set of sensors measures the same in any order, pool or process.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from hashlib import sha256
from typing import TYPE_CHECKING, Any

import numpy as np

from models.training.packed import STEPS_PER_METRE, Rig
from models.training.packing import change
from placement_env.fidelity.traffic import Traffic, renderer_of
from toolkit.arrays import Float32, Int64, Shaped
from toolkit.datasets.dataset import CoopDataset, noisy
from toolkit.frame import Frame
from toolkit.objects import Objects
from toolkit.points import frame_points
from toolkit.runtime.cache import Cache, key_of
from toolkit.runtime.code_digest import code_digest
from toolkit.sensors.sensor import Sensor

if TYPE_CHECKING:
    from placement_env.candidates.candidates import Candidates

IN_MEMORY = 256  # candidates, of those that are kept in a cache


class Renders:
    """What candidates measure of traffic.

    cache: where renders are kept and shared with other processes, None for this object's memory; noise_seed: None for
    no noise. Pickles without what it has rendered.
    """

    def __init__(
        self,
        traffic: Traffic,
        candidates: Candidates,
        cache: Cache | None = None,
        *,
        noise_seed: int | None = 0,
    ) -> None:
        self.traffic, self.site, self.sensors = traffic, traffic.site, candidates.sensors
        self.frames = len(traffic)
        self._arguments = (traffic, candidates, cache, noise_seed)
        self._cache, self._noise_seed = cache, noise_seed
        self._packed: dict[int, _Packed] = {}

    def __reduce__(self) -> tuple[Any, ...]:
        traffic, candidates, cache, noise_seed = self._arguments
        return partial(Renders, noise_seed=noise_seed), (traffic, candidates, cache)

    @staticmethod
    def of(recording: CoopDataset, noise_seed: int | None = 0) -> Recorded:
        """What the sensors of a recording measured, as `toolkit.detection.evaluation` sees it."""
        return Recorded(recording, noise_seed)

    @cached_property
    def digest(self) -> str:
        """SHA-256 over all that clouds depend on but the sensor."""
        return key_of(_code(self.sensors), self.traffic.digest(), self._noise_seed).hex()

    def clouds(self, k: int, c: int) -> Float32[np.ndarray, "n 3"]:
        """Points of candidate c in frame k inside the crop, world frame."""
        packed, rng = self._of_candidate(c), None
        if self._noise_seed is not None:
            rng = np.random.default_rng([self._noise_seed, k, _seed(self.sensors[c])])
        return packed.rig.points(0, *packed.frame(k), rng)

    def objects(self, k: int) -> Objects:
        """All that is there in frame k, scored or not."""
        return self.traffic.snapshots[k].objects

    def _of_candidate(self, c: int) -> _Packed:
        packed = self._packed.pop(c, None) or self._kept(c)
        if self._cache is not None and len(self._packed) >= IN_MEMORY:
            self._packed.pop(next(iter(self._packed)))  # the one not asked for the longest
        self._packed[c] = packed
        return packed

    def _kept(self, c: int) -> _Packed:
        """What the cache keeps of a candidate; it is rendered where that is missing or damaged."""
        if self._cache is None:
            return self._render(c)
        sensor = self.sensors[c]
        key = key_of("render", _code([sensor]), self.traffic.digest(), sensor.digest)
        arrays = self._cache.get([key])[0]
        if arrays is not None:
            return _unpacked(self._rig(c), arrays)
        packed = self._render(c)
        self._cache.put({key: packed.arrays()})
        return packed

    def _render(self, c: int) -> _Packed:
        renderer = renderer_of(self.traffic).looking([self.sensors[c]])
        rig = Rig.seeing(renderer.sensors, self.site.area, self.site.height, renderer.background)
        changes = []
        for snapshot in self.traffic.snapshots:
            frame = Frame(renderer.sensors, renderer.render(snapshot).measurements, snapshot.objects)
            changes.append(change(rig, frame))
        ends = np.cumsum([0, *(len(each.pixels[0]) for each in changes)])
        pixels, steps = ([getattr(each, name)[0] for each in changes] for name in ("pixels", "steps"))
        return _Packed(rig, np.concatenate(pixels), np.concatenate(steps), ends)

    def _rig(self, c: int) -> Rig:
        area = tuple(self.site.area.tolist())
        return Rig((self.sensors[c],), area, self.site.height, (), ())


class Recorded:
    """What the sensors of a recording measured: the same points, to the bit, as `toolkit.detection.evaluation` gets."""

    def __init__(self, recording: CoopDataset, noise_seed: int | None = 0) -> None:
        self.recording, self.site, self.sensors = recording, recording.site, recording.sensors
        self.frames, self._noise_seed = len(recording), noise_seed
        self._last: Frame | None = None

    @cached_property
    def digest(self) -> str:
        """SHA-256 over all that clouds depend on but the sensor."""
        from toolkit.sites.geojson import dumps

        sha = sha256(f"{_code(self.sensors)} {self._noise_seed} {dumps(self.site)}".encode())
        with self.recording.path.open("rb") as file:
            while block := file.read(1 << 20):
                sha.update(block)
        return sha.hexdigest()

    def clouds(self, k: int, c: int) -> Float32[np.ndarray, "n 3"]:
        """Points of sensor c in frame k inside the crop, world frame."""
        return frame_points(self._frame(k), [c], area=self.site)[0]

    def objects(self, k: int) -> Objects:
        """All that is there in frame k, scored or not."""
        return self._frame(k).objects

    def _frame(self, k: int) -> Frame:
        if self._last is None or self._last.index != k:
            frame = self.recording[k]
            self._last = frame if self._noise_seed is None else noisy(frame, self._noise_seed)
        return self._last


@dataclass(frozen=True, eq=False)
class _Packed:
    """One candidate: its rig, the pixels that differ from it in any frame, their measurement in steps (0: none), and
    where those of each frame begin."""

    rig: Rig
    pixels: Shaped[np.ndarray, " p"]
    steps: Shaped[np.ndarray, " p"]
    ends: Int64[np.ndarray, " _"]

    def frame(self, k: int) -> tuple[Shaped[np.ndarray, " n"], Float32[np.ndarray, " n"]]:
        """The changed pixels of frame k and what they measure (m)."""
        rows = slice(*self.ends[k : k + 2])
        return self.pixels[rows], self.steps[rows].astype(np.float32) / np.float32(STEPS_PER_METRE)

    def arrays(self) -> tuple[np.ndarray, ...]:
        """What a cache keeps."""
        return self.rig.pixels[0], self.rig.depth[0], self.pixels, self.steps, self.ends


def _unpacked(rig: Rig, arrays: tuple[np.ndarray, ...]) -> _Packed:
    still_pixels, still_depth, *changes = arrays
    return _Packed(replace(rig, pixels=(still_pixels,), depth=(still_depth,)), *changes)


def _code(sensors: Sequence[Sensor]) -> str:
    """A digest of the source that measures with these sensors."""
    return code_digest(__name__, *sorted({type(sensor.model).__module__ for sensor in sensors}))


def _seed(sensor: Sensor) -> int:
    """What its noise is drawn from: not `Sensor.digest`, since published figures were measured with this noise."""
    described = json.dumps((repr(sensor.model), sensor.pose.tolist()))
    return int.from_bytes(sha256(described.encode()).digest()[:8], "big")
