"""One sensor's view of a place without road users.

`EmptyScene` is learnt from the sensor's frames, pixel by pixel. The measurements of a pixel over time, sorted, fall
into clusters wherever two neighbours lie farther apart than noise explains; "nothing returned" is a cluster of its
own, the farthest one. The scene of a pixel is

    the farthest cluster with a tenth of the measurements: road users pass or park before the scene, never behind it;
    and a nearer cluster, if it comes and goes at least a quarter as often as random draws would, and continues the
    farthest surface of a pixel at most two off. So leaves that move and edges of a pole that sways belong to the
    scene. A queue at a stop line does not, since it stands before ground that its neighbours see, nor does a parked
    car, which comes once. Where nothing returns in the rest of the time, half of the measurements suffice: drop-outs.

Each of the two has a median and a spread, the median deviation scaled to a standard deviation and never below the
sensor model's own. Road users close to a surface fall into its cluster. So if a spread is more than twice the usual
one at that distance, the densest stretch of the cluster takes its place. The more frequent of the two is `first`. A
parked car that is away a tenth of the time is not in the scene; one that never leaves is.

`SceneAdaptation` lets a scene follow slow changes.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from hashlib import sha256
from pathlib import Path
from typing import NamedTuple

import numpy as np

from toolkit.arrays import Bool, Float, Float32, Float64
from toolkit.frame import Frames
from toolkit.runtime.files import parse_json, read_arrays, write_arrays
from toolkit.sensors.models import make_model
from toolkit.sensors.sensor import Sensor, SensorModel, is_return

SAMPLE = 128  # images kept of a sensor
SIGMAS = 4.0  # spreads: a measurement this near a median shows the empty scene
LEAST_SHARE = 0.1  # fraction of the measurements that makes a cluster part of the scene
HALF = 0.5  # fraction of the measurements that makes a surface before no return part of the scene
GAP_SIGMAS, GAP_SHARE = 4.0, 0.004  # gap between clusters: standard deviations of the model, share of the measurement
BROAD = 2.0  # times the usual spread at a distance: a broader cluster is more than one surface
DISTANCES = 24  # steps of log distance, each with a usual spread
NEIGHBOURS = 2  # pixels: a surface continues this far
OTHER_SURFACE = 0.1  # fraction by which a depth must leave the plane through two others to be another surface
LEAST_FLICKER = 0.25  # least rate at which a part of the scene comes and goes, relative to random draws
_MAD_TO_SIGMA = 1.4826
_IMAGES = ("first", "spread", "share", "second", "second_spread", "second_share")
_BLOCK = 1 << 21  # measurements sorted at once
_AT_ONCE = 256  # pixels whose measurements are compared in pairs at once


@dataclass(frozen=True, eq=False)
class EmptyScene:
    """Empty scene of one sensor (its name and model).

    All images are (rows, columns) float32. first: median measurement, 0 where nothing returns; spread: its standard
    deviation; share: fraction of the frames that show it; second, second_spread, second_share: the same for the other
    measurement of the scene, NaN, 0 and 0 where it has only one; frames: number of frames it was learnt from.

    Raises ValueError for an image that does not fit the model's shape, or is negative or infinite.
    """

    name: str
    model: SensorModel
    first: Float32[np.ndarray, "rows columns"]
    spread: Float32[np.ndarray, "rows columns"]
    share: Float32[np.ndarray, "rows columns"]
    second: Float32[np.ndarray, "rows columns"]
    second_spread: Float32[np.ndarray, "rows columns"]
    second_share: Float32[np.ndarray, "rows columns"]
    frames: int

    def __post_init__(self) -> None:
        for image in _IMAGES:
            _check_image(self, image)
            getattr(self, image).setflags(write=False)
        if self.frames < 1:
            raise ValueError(f"an empty scene needs at least one frame, got {self.frames}")

    @staticmethod
    def of(sensor: Sensor, image: Float32[np.ndarray, "rows columns"]) -> EmptyScene:
        """Return the scene known from a render without noise. Its spread is the sensor model's."""
        first = np.where(is_return(image, sensor.model.max_range), image, 0).astype(np.float32)
        spread = np.where(first > 0, sensor.model.deviation(first), 0).astype(np.float32)
        always, never = np.ones_like(first), np.zeros_like(first)
        none = np.full(first.shape, np.nan, np.float32)
        return EmptyScene(sensor.name, sensor.model, first, spread, always, none, never, never.copy(), 1)

    @cached_property
    def digest(self) -> str:
        """SHA-256 of the scene's contents. Sensor and fusion centre have the same scene if it is equal."""
        digest = sha256(json.dumps([self.name, _describe_model(self.model), self.frames], sort_keys=True).encode())
        for image in _IMAGES:
            digest.update(np.ascontiguousarray(getattr(self, image)).tobytes())
        return digest.hexdigest()

    def shows(
        self, measurement: Float[np.ndarray, "rows columns"], sigmas: float = SIGMAS
    ) -> Bool[np.ndarray, "rows columns"]:
        """Mask of an image's pixels that show the empty scene.

        They lie within `sigmas` spreads of one of its medians, or have no return where that may be.
        """
        self.check_shape(measurement)
        there = is_return(measurement, self.model.max_range)
        near = np.abs(measurement - self.first) <= sigmas * self.spread
        near |= np.abs(measurement - self.second) <= sigmas * self.second_spread
        return np.where(there, near, (self.first == 0) | (self.second == 0))

    def check_shape(self, measurement: Float[np.ndarray, "..."]) -> None:
        """Check that an image has the scene's shape. Raises ValueError for another shape."""
        if measurement.shape != self.first.shape:
            raise ValueError(
                f"the empty scene of {self.name!r} has {self.first.shape} pixels, got an image of {measurement.shape}: "
                "pass an image of the same sensor"
            )

    def with_name(self, name: str) -> EmptyScene:
        """Return the scene for a sensor of another name."""
        return replace(self, name=name)


class SceneLearner:
    """Learns a sensor's empty scene image by image.

    Memory is bounded: every 2^k-th image is kept, so that there are at most `sample`.
    """

    def __init__(self, sensor: Sensor, sample: int = SAMPLE) -> None:
        if sample < 2:
            raise ValueError(f"sample must be at least 2 images, got {sample}")
        self.sensor, self.sample, self.frames = sensor, sample, 0
        self._every, self._kept = 1, list[np.ndarray]()

    def add(self, measurement: Float[np.ndarray, "rows columns"]) -> None:
        """Add an image."""
        if measurement.shape != self.sensor.model.shape:
            raise ValueError(
                f"sensor {self.sensor.name!r} measures {self.sensor.model.shape} pixels, got {measurement.shape}"
            )
        if self.frames % self._every == 0:
            if len(self._kept) == self.sample:
                self._kept, self._every = self._kept[::2], self._every * 2
            if self.frames % self._every == 0:
                self._kept.append(np.array(measurement, np.float32))
        self.frames += 1

    def scene(self) -> EmptyScene:
        """Return the empty scene as known so far. Raises ValueError before the first image."""
        if not self._kept:
            raise ValueError(f"no image of {self.sensor.name!r} yet: add one before asking for its empty scene")
        model = self.sensor.model
        rows, columns = model.shape
        height = max(1, _BLOCK // (len(self._kept) * columns))
        blocks = (
            _clusters(np.stack([image[top : top + height] for image in self._kept]), model)
            for top in range(0, rows, height)
        )
        fars, nears, flickering = zip(*blocks, strict=True)
        far, near = (_Mode(*map(np.concatenate, zip(*modes, strict=True))) for modes in (fars, nears))
        usual = _usual_spread(far, model)
        far, near = (_narrow_broad(mode, usual(mode.median), self._kept) for mode in (far, near))
        flickers = np.concatenate(flickering) & (near.share >= LEAST_SHARE)
        continues = _continuation_mask(near, far.median)
        kept = flickers & (continues | ((far.median == 0) & (near.share >= HALF)))
        first, second = far, near.where(kept, _no_mode(model.shape))
        swap = second.share > first.share
        first, second = second.where(swap, first), first.where(swap, second)
        images = dict(zip(_IMAGES, (*first[:3], *second[:3]), strict=True))
        return EmptyScene(self.sensor.name, model, frames=self.frames, **images)


def learn_empty_scenes(recording: Frames, sample: int = SAMPLE, *, frames: int | None = None) -> tuple[EmptyScene, ...]:
    """Learn the empty scene of every sensor of a recording.

    They keep the sensors' order.

    sample: images that are looked at, spread over the first `frames` frames, all if None. Raises ValueError without
    frames, and for frames of clouds.
    """
    count = min(len(recording), len(recording) if frames is None else frames)
    if count < 1:
        raise ValueError(f"there must be a frame to learn the empty scene from, got {frames} of {len(recording)}")
    learners: list[SceneLearner] = []
    for k in np.unique(np.linspace(0, count - 1, min(sample, count)).astype(int)):
        frame = recording[int(k)]
        learners = learners or [SceneLearner(sensor, max(sample, 2)) for sensor in frame.sensors]
        for learner, measurement in zip(learners, frame.images, strict=True):
            learner.add(measurement)
    return tuple(learner.scene() for learner in learners)


def save_empty_scenes(path: str | Path, scenes: Sequence[EmptyScene]) -> None:
    """Write empty scenes as one .npz file. It has a checksum, and is written whole or not at all."""
    said = [{"name": each.name, "model": _describe_model(each.model), "frames": each.frames} for each in scenes]
    arrays = {f"{k}_{image}": getattr(scene, image) for k, scene in enumerate(scenes) for image in _IMAGES}
    write_arrays(path, {"scenes": np.array(json.dumps(said)), **arrays})


def load_empty_scenes(path: str | Path) -> tuple[EmptyScene, ...]:
    """Read the empty scenes of a file.

    Raises FileNotFoundError; ValueError for a file that is damaged or holds no scene.
    """
    arrays = read_arrays(path)
    try:
        said = parse_json(str(arrays["scenes"]))
        return tuple(
            EmptyScene(
                each["name"],
                make_model(each["model"]["class"], {key: v for key, v in each["model"].items() if key != "class"}),
                frames=each["frames"],
                **{image: arrays[f"{k}_{image}"] for image in _IMAGES},
            )
            for k, each in enumerate(said)
        )
    except (KeyError, TypeError, AttributeError, ValueError) as error:
        raise ValueError(f"{path} has no empty scenes ({error}): write them with save_empty_scenes") from None


SECONDS = 600.0  # time constant (s) of pixels that show the scene
SETTLE = 86_400.0  # s until a nearer surface is the scene: longer than a visitor parks
REVEAL = 60.0  # s until a farther surface is the scene


class SceneAdaptation:
    """An empty scene that follows slow changes.

    It does not learn parked vehicles. Times are in s. Each image moves the scene, pixel by pixel:

        shows the scene    the median and the spread of that mode move towards it, by 1 - exp(-dt / `seconds`)
        stands nearer      the scene is frozen; an object that stands there unchanged for `settle` becomes the scene
        lies farther       the surface before it has gone; after `reveal` unchanged, the farther one becomes the scene

    Unchanged means within the tolerance of `EmptyScene.shows`, by the spread of the scene. Road users that pass before
    a waiting surface hide it without interrupting the wait; anything farther starts it anew. No return counts as
    farthest.

    Sensor and fusion centre need the same scene. A message names its scene by digest, so a new scene is sent before it
    is used; read `scene` only as often as that is worth it.

    Raises ValueError for times that are not above 0.
    """

    def __init__(
        self, scene: EmptyScene, *, seconds: float = SECONDS, settle: float = SETTLE, reveal: float = REVEAL
    ) -> None:
        for name, value in (("seconds", seconds), ("settle", settle), ("reveal", reveal)):
            if not value > 0:
                raise ValueError(f"{name} must be above 0 s, got {value}")
        self._began, self._seconds, self._settle, self._reveal = scene, seconds, settle, reveal
        self._medians = [np.array(scene.first), np.array(scene.second)]
        self._spreads = [np.array(scene.spread), np.array(scene.second_spread)]
        self._candidate = np.full(scene.first.shape, np.nan, np.float32)  # infinite for nothing returned
        self._since = np.full(scene.first.shape, np.inf)
        self._time: float | None = None
        self._frames = 0

    @property
    def scene(self) -> EmptyScene:
        """The empty scene as it is now."""
        began = self._began
        first, second = (each.copy() for each in self._medians)
        spread, second_spread = (each.copy() for each in self._spreads)
        second_share = np.where(np.isnan(second), 0, began.second_share).astype(np.float32)
        return replace(
            began,
            first=first,
            spread=spread,
            share=np.array(began.share),
            second=second,
            second_spread=second_spread,
            second_share=second_share,
            frames=began.frames + self._frames,
        )

    def update(self, measurement: Float[np.ndarray, "rows columns"], time: float) -> None:
        """Add an image to the scene. Raises ValueError for another shape, or a time before the last one."""
        self._began.check_shape(measurement)
        if self._time is not None and time < self._time:
            raise ValueError(f"images must be in order of time, got {time} s after {self._time} s")
        share = 0.0 if self._time is None else 1 - np.exp(-(time - self._time) / self._seconds)
        self._time, self._frames = time, self._frames + 1
        there = is_return(measurement, self._began.model.max_range)
        seen = np.where(there, measurement, np.inf).astype(np.float32)
        shown = np.zeros(seen.shape, bool)
        for median, spread in zip(self._medians, self._spreads, strict=True):
            shown |= self._follow(median, spread, seen, share)
        self._absorb(seen, shown, time)

    def _follow(
        self,
        median: Float32[np.ndarray, "rows columns"],
        spread: Float32[np.ndarray, "rows columns"],
        seen: Float32[np.ndarray, "rows columns"],
        share: float,
    ) -> Bool[np.ndarray, "rows columns"]:
        """Mask of the pixels that show a mode. The mode's median and spread follow them."""
        finite = np.isfinite(seen)
        off = np.where(finite, seen, 0) - median
        shows = finite & (median > 0) & (np.abs(off) <= SIGMAS * spread)
        median[shows] += share * off[shows]
        least = np.broadcast_to(self._began.model.deviation(np.nan_to_num(median)), median.shape)
        squared = (1 - share) * spread[shows] ** 2 + share * off[shows] ** 2
        spread[shows] = np.maximum(np.sqrt(squared), least[shows])
        return shows | (~finite & (median == 0))

    def _absorb(
        self, seen: Float32[np.ndarray, "rows columns"], shown: Bool[np.ndarray, "rows columns"], time: float
    ) -> None:
        """Start, continue or end the wait of foreground surfaces. At the end of the wait they become the scene."""
        first, spread = self._medians[0], self._spreads[0]
        surface = np.where(first > 0, first, np.inf)
        known = np.where(np.isfinite(self._candidate), self._candidate, 0)
        within = SIGMAS * np.maximum(spread, self._began.model.deviation(known))
        with np.errstate(invalid="ignore"):
            same = (np.abs(seen - self._candidate) <= within) | (np.isinf(seen) & np.isinf(self._candidate))
            hidden = seen < self._candidate - within
        goes_on = np.isfinite(self._since) & (same | (hidden & ~shown))
        begins = ~shown & ~goes_on
        self._candidate = np.where(goes_on, self._candidate, np.where(begins, seen, np.nan)).astype(np.float32)
        self._since = np.where(goes_on, self._since, np.where(begins, time, np.inf))
        farther = self._candidate > surface
        waited: Float64[np.ndarray, "rows columns"] = time - self._since
        ripe = goes_on & same & (waited >= np.where(farther, self._reveal, self._settle))
        if ripe.any():
            gone = np.isinf(self._candidate) & ripe
            first[ripe] = np.where(gone, 0, self._candidate)[ripe]
            spread[ripe] = np.where(gone, 0, np.broadcast_to(self._began.model.deviation(known), first.shape))[ripe]
            self._medians[1][ripe], self._spreads[1][ripe] = np.nan, 0
            self._candidate[ripe], self._since[ripe] = np.nan, np.inf


class _Mode(NamedTuple):
    """One cluster per pixel.

    median: 0 for nothing returned, NaN for no cluster; least, greatest: extreme measurements.
    """

    median: Float32[np.ndarray, "rows columns"]
    spread: Float32[np.ndarray, "rows columns"]
    share: Float32[np.ndarray, "rows columns"]
    least: Float32[np.ndarray, "rows columns"]
    greatest: Float32[np.ndarray, "rows columns"]

    def where(self, mask: Bool[np.ndarray, "rows columns"], other: _Mode) -> _Mode:
        """Return this mode inside the mask, the other outside."""
        return _Mode(*(np.where(mask, mine, theirs) for mine, theirs in zip(self, other, strict=True)))


def _no_mode(shape: tuple[int, ...]) -> _Mode:
    nothing = np.zeros(shape, np.float32)
    return _Mode(np.full(shape, np.nan, np.float32), *(nothing,) * 4)


def _clusters(
    images: Float32[np.ndarray, "n rows columns"], model: SensorModel
) -> tuple[_Mode, _Mode, Bool[np.ndarray, "rows columns"]]:
    """Find two clusters per pixel, and a mask of flicker.

    The first is the farthest that belongs to the scene, the second the largest of the nearer ones. The mask marks the
    pixels whose nearer cluster flickers.
    """
    shape, n = images.shape[1:], len(images)
    in_time = np.where(is_return(images, model.max_range), images, np.inf).reshape(n, -1).T  # a row for each pixel
    values = np.sort(in_time, axis=1)
    finite = np.isfinite(values)
    solid = np.where(finite, values, np.float32(0))
    gap = np.maximum(GAP_SIGMAS * np.asarray(model.deviation(solid)), GAP_SHARE * solid)[:, :-1]
    begins = np.ones(values.shape, bool)
    with np.errstate(invalid="ignore"):  # two missing returns are infinity less infinity: no gap
        begins[:, 1:] = values[:, 1:] - values[:, :-1] > gap
    starts = np.flatnonzero(begins)
    ends = np.append(starts[1:], values.size)
    pixel, size = starts // n, ends - starts
    enough = size >= min(n, max(2, int(np.ceil(LEAST_SHARE * n))))
    nothing = ~finite.ravel()[starts]
    far = _pick_cluster(pixel, np.arange(len(starts)), enough, size, len(values))
    rivals = enough & (np.arange(len(starts)) < far[pixel]) & ~nothing
    near = _pick_cluster(pixel, np.where(rivals, size, 0), rivals, np.zeros_like(size), len(values))
    nearest, farthest = (values.ravel()[each][:, None] for each in (starts[near], ends[near] - 1))
    present = (in_time >= nearest) & (in_time <= farthest)
    flickers = rivals[near] & _flicker_mask(present)
    far_mode, near_mode = (
        _Mode(*(each.reshape(shape) for each in _measure_mode(solid.ravel(), starts, ends, chosen, n, model)))
        for chosen in (far, np.where(rivals[near], near, -1))
    )
    return far_mode, near_mode, flickers.reshape(shape)


def _flicker_mask(present: Bool[np.ndarray, "pixels n"]) -> Bool[np.ndarray, " pixels"]:
    """Mask of the pixels that something enters often.

    It enters at least `LEAST_FLICKER` times as often as by chance.
    """
    share = present.mean(axis=1)
    comes = (present[:, 1:] & ~present[:, :-1]).sum(axis=1) + present[:, 0]
    return comes >= LEAST_FLICKER * share * (1 - share) * present.shape[1]


def _pick_cluster(
    pixel: np.ndarray, rank: np.ndarray, eligible: np.ndarray, otherwise: np.ndarray, pixels: int
) -> np.ndarray:
    """Pick the eligible cluster of highest rank for each pixel.

    Without one, pick the cluster with the most of `otherwise`.
    """
    order = np.lexsort((np.arange(len(pixel)), np.where(eligible, rank, otherwise), eligible, pixel))
    return order[np.searchsorted(pixel[order], np.arange(pixels), side="right") - 1]


def _measure_mode(
    values: np.ndarray, starts: np.ndarray, ends: np.ndarray, chosen: np.ndarray, n: int, model: SensorModel
) -> _Mode:
    """Median, spread and share of one cluster of every pixel.

    chosen is -1 for none. values: sorted within each cluster.
    """
    first, last = starts[chosen], ends[chosen]
    size = last - first
    median = (values[first + (size - 1) // 2] + values[first + size // 2]) / 2
    offset = np.arange(n)
    inside = offset < size[:, None]
    members = values[np.minimum(first[:, None] + offset, len(values) - 1)]
    deviation = np.sort(np.where(inside, np.abs(members - median[:, None]), np.float32(np.inf)), axis=1)
    row = np.arange(len(chosen))
    typical = (deviation[row, (size - 1) // 2] + deviation[row, size // 2]) / 2
    spread = np.maximum(_MAD_TO_SIGMA * typical, np.asarray(model.deviation(median)))
    there = chosen >= 0
    return _Mode(
        np.where(there, median, np.nan).astype(np.float32),
        np.where(there & (median > 0), spread, 0).astype(np.float32),
        np.where(there, size / n, 0).astype(np.float32),
        np.where(there, values[first], 0),
        np.where(there, values[last - 1], 0),
    )


def _usual_spread(
    far: _Mode, model: SensorModel
) -> Callable[[Float32[np.ndarray, "rows columns"]], Float32[np.ndarray, "rows columns"]]:
    """Return the usual spread as a function of distance. It is taken from pixels that mostly see the scene."""
    clear = (far.share >= HALF) & (far.median > 0)
    distance, spread = np.log(far.median[clear]), far.spread[clear]
    if not len(distance):
        return lambda median: np.asarray(model.deviation(np.nan_to_num(median))) + np.zeros_like(median)
    edges = np.linspace(distance.min(), distance.max() + 1e-6, DISTANCES + 1)
    step = np.clip(np.digitize(distance, edges) - 1, 0, DISTANCES - 1)
    there = [k for k in range(DISTANCES) if (step == k).any()]
    usual = [np.median(spread[step == k]) for k in there]
    middle = [np.median(distance[step == k]) for k in there]

    def at(median: Float32[np.ndarray, "rows columns"]) -> Float32[np.ndarray, "rows columns"]:
        known = np.log(np.where(median > 0, median, 1))
        return np.maximum(np.interp(known, middle, usual), model.deviation(np.nan_to_num(median))).astype(np.float32)

    return at


def _narrow_broad(
    mode: _Mode, usual: Float32[np.ndarray, "rows columns"], images: Sequence[Float32[np.ndarray, "rows columns"]]
) -> _Mode:
    """Replace broad clusters by their densest stretch. It is `SIGMAS` usual spreads wide to either side."""
    found = _Mode(*(each.copy() for each in mode))
    every = np.flatnonzero(mode.spread > BROAD * usual)
    for first in range(0, len(every), _AT_ONCE):
        _narrow_block(found, every[first : first + _AT_ONCE], usual, images)
    return found


def _narrow_block(
    mode: _Mode, broad: np.ndarray, usual: np.ndarray, images: Sequence[Float32[np.ndarray, "rows columns"]]
) -> None:
    """Narrow the clusters of some pixels in place."""
    least, greatest, spread = (each.ravel()[broad][:, None] for each in (mode.least, mode.greatest, usual))
    values = np.stack([image.ravel()[broad] for image in images], axis=1)
    values = np.sort(np.where((values >= least) & (values <= greatest), values, np.inf), axis=1)
    within = values[:, None, :] <= values[:, :, None] + 2 * SIGMAS * spread[:, :, None]
    count = np.where(np.isfinite(values), within.sum(axis=2) - np.arange(values.shape[1]), 0)
    begin = values.shape[1] - 1 - count[:, ::-1].argmax(axis=1)  # the farthest of the densest
    size, row = count[np.arange(len(broad)), begin], np.arange(len(broad))
    median = (values[row, begin + (size - 1) // 2] + values[row, begin + size // 2]) / 2
    place = np.arange(values.shape[1])
    inside = (place >= begin[:, None]) & (place < (begin + size)[:, None])
    deviation = np.sort(np.where(inside, np.abs(values - median[:, None]), np.inf), axis=1)[row, (size - 1) // 2]
    mode.median.ravel()[broad] = median
    mode.spread.ravel()[broad] = np.clip(_MAD_TO_SIGMA * deviation, spread[:, 0], BROAD * spread[:, 0])
    mode.share.ravel()[broad] = size / len(images)


def _continuation_mask(near: _Mode, far: Float32[np.ndarray, "rows columns"]) -> Bool[np.ndarray, "rows columns"]:
    """Mask of pixels whose nearer surface continues a neighbour's farthest.

    The neighbour is at most `NEIGHBOURS` off. The surface must not be the pixel's own farthest surface going on, as the
    ground does below the foot of a car: planes have inverse depths that are linear in the image.
    """
    within = np.maximum(SIGMAS * near.spread, GAP_SHARE * near.median)
    inverse = np.where(far > 0, 1 / np.where(far > 0, far, 1), 0)
    padded = np.pad(far, NEIGHBOURS, constant_values=np.nan)
    opposite = np.pad(inverse, NEIGHBOURS, mode="edge")
    rows, columns = far.shape
    reach, same = range(-NEIGHBOURS, NEIGHBOURS + 1), np.zeros(far.shape, bool)
    for down in reach:
        for right in reach:
            there = padded[NEIGHBOURS + down :, NEIGHBOURS + right :][:rows, :columns]
            before = opposite[NEIGHBOURS - down :, NEIGHBOURS - right :][:rows, :columns]
            other_surface = np.abs((2 * inverse - before) * there - 1) > OTHER_SURFACE
            same |= (np.abs(there - near.median) <= within) & other_surface
    return same


def _describe_model(model: SensorModel) -> dict[str, object]:
    return {"class": type(model).__name__, **{key: value for key, value in asdict(model).items() if value is not None}}


def _check_image(scene: EmptyScene, name: str) -> None:
    image: Float64[np.ndarray, "..."] = getattr(scene, name)
    if image.shape != scene.model.shape or image.dtype != np.float32:
        raise ValueError(
            f"{name} of {scene.name!r} must be float32 of {scene.model.shape}, got {image.dtype} of {image.shape}"
        )
    known = image[~np.isnan(image)] if name == "second" else image
    if not (np.isfinite(known).all() and (known >= 0).all()):
        raise ValueError(f"{name} of {scene.name!r} must be finite and 0 or more: learn the scene again")
