"""`EmptyScene`: what one sensor measures where nobody is, learnt from its own frames, pixel by pixel.

The measurements of a pixel over time, sorted, fall into clusters wherever two neighbours lie farther apart than noise
explains; nothing returned is a cluster of its own, farther off than any other. Of these

    the farthest with a tenth of the measurements is the scene: who passes or parks stands before it, never behind it;
    a nearer one belongs to the scene too where it comes and goes, at least a quarter as often as draws by chance would,
    and is the farthest of a pixel at most two off: leaves that move and edges of a pole that sways continue in the
    image, while a queue at a stop line stands before the ground that its neighbours see, and who parks comes once; or
    where nothing returns in the rest of the time and it is there in half of it: drop-outs.

Each of the two has a median and a spread, the median deviation scaled to a standard deviation and never below the
sensor model's own. Who stands close before the scene falls into its cluster: where a spread is more than twice what is
usual at that distance, the densest stretch of the cluster takes its place. The one that is there more often is the
`first`. A parked car that leaves for a tenth of the time is not in the scene; one that never leaves is.
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
from toolkit.datasets.readings import Readable, read_frame
from toolkit.runtime.files import parse_json, read_arrays, write_arrays
from toolkit.sensors.error_profiles import PAPER_ERRORS, ErrorProfile
from toolkit.sensors.models import make_model
from toolkit.sensors.sensor import Sensor, SensorModel, returned

SAMPLE = 128  # images that are kept of a sensor
SIGMAS = 4.0  # spreads from a median within which a measurement shows the empty scene
LEAST_SHARE = 0.1  # of the measurements that make a cluster the scene's
HALF = 0.5  # of the measurements, from which on a surface before nothing is the scene's
GAP_SIGMAS, GAP_SHARE = 4.0, 0.004  # a gap between clusters: standard deviations of the model, share of the measurement
BROAD = 2.0  # times the usual spread at a distance, from which on a cluster is more than one surface
DISTANCES = 24  # steps of distance, on a scale of its logarithm, in which the usual spread is found
NEIGHBOURS = 2  # pixels up to which a surface continues
OTHER_SURFACE = 0.1  # share by which a depth differs from that of the plane through two others, if it is not on it
LEAST_FLICKER = 0.25  # how often what belongs to the scene comes, per time that draws by chance would
_MAD_TO_SIGMA = 1.4826
_IMAGES = ("first", "spread", "share", "second", "second_spread", "second_share")
_BLOCK = 1 << 21  # measurements that are sorted at once
_AT_ONCE = 256  # pixels whose measurements are compared pair by pair


@dataclass(frozen=True, eq=False)
class EmptyScene:
    """The empty scene of a sensor (by its name and model); all images are (rows, columns) float32.

    first: the median measurement, 0 where nothing returns; spread: its standard deviation; share: of the frames that
    show it; second, second_spread, second_share: the same of the other measurement that the scene has there, NaN, 0 and
    0 where it has one only. frames: how many it was learnt from.

    Raises ValueError where images have another shape than the model's, or numbers that no scene has.
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
            raise ValueError(f"an empty scene is learnt from a frame at least, got {self.frames}")

    @staticmethod
    def of(sensor: Sensor, image: Float32[np.ndarray, "rows columns"]) -> EmptyScene:
        """The scene that is known from a render without noise, its spread the sensor model's."""
        first = np.where(returned(image, sensor.model.max_range), image, 0).astype(np.float32)
        spread = np.where(first > 0, sensor.model.deviation(first), 0).astype(np.float32)
        always, never = np.ones_like(first), np.zeros_like(first)
        none = np.full(first.shape, np.nan, np.float32)
        return EmptyScene(sensor.name, sensor.model, first, spread, always, none, never, never.copy(), 1)

    @cached_property
    def digest(self) -> str:
        """SHA-256 of all it holds: sensor and fusion centre have the same scene where it is equal."""
        said = sha256(json.dumps([self.name, _described(self.model), self.frames], sort_keys=True).encode())
        for image in _IMAGES:
            said.update(np.ascontiguousarray(getattr(self, image)).tobytes())
        return said.hexdigest()

    def shows(
        self, measurement: Float[np.ndarray, "rows columns"], sigmas: float = SIGMAS
    ) -> Bool[np.ndarray, "rows columns"]:
        """Which pixels of an image show the empty scene: within so many spreads of one of its medians, or nothing
        returned where nothing may."""
        if measurement.shape != self.first.shape:
            raise ValueError(
                f"the empty scene of {self.name!r} has {self.first.shape} pixels, got an image of {measurement.shape}"
            )
        there = returned(measurement, self.model.max_range)
        near = np.abs(measurement - self.first) <= sigmas * self.spread
        near |= np.abs(measurement - self.second) <= sigmas * self.second_spread
        return np.where(there, near, (self.first == 0) | (self.second == 0))

    def renamed(self, name: str) -> EmptyScene:
        """The scene of a sensor that is called otherwise."""
        return replace(self, name=name)


class SceneLearner:
    """Learns the empty scene of a sensor from images that come one after another, in memory that does not grow: of n
    images every 2^k-th is kept, so that no more than `sample` are."""

    def __init__(self, sensor: Sensor, sample: int = SAMPLE) -> None:
        if sample < 2:
            raise ValueError(f"sample must be at least 2 images, got {sample}")
        self.sensor, self.sample, self.frames = sensor, sample, 0
        self._every, self._kept = 1, list[np.ndarray]()

    def add(self, measurement: Float[np.ndarray, "rows columns"]) -> None:
        """One more image."""
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
        """The empty scene as far as it is known. Raises ValueError before the first image."""
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
        far, near = (_narrowed(mode, usual(mode.median), self._kept) for mode in (far, near))
        flickers = np.concatenate(flickering) & (near.share >= LEAST_SHARE)
        continues = _continues(near, far.median)
        kept = flickers & (continues | ((far.median == 0) & (near.share >= HALF)))
        first, second = far, near.where(kept, _no_mode(model.shape))
        swap = second.share > first.share
        first, second = second.where(swap, first), first.where(swap, second)
        images = dict(zip(_IMAGES, (*first[:3], *second[:3]), strict=True))
        return EmptyScene(self.sensor.name, model, frames=self.frames, **images)


def learn_empty_scenes(
    recording: Readable,
    *,
    frames: int | None = None,
    sample: int = SAMPLE,
    errors: ErrorProfile | str = PAPER_ERRORS,
    noise_seed: int | None = 0,
) -> tuple[EmptyScene, ...]:
    """The empty scene of every sensor of a recording, in their order, from images spread over its first `frames`
    frames, all if not given; errors, noise_seed: of the sensors, see `toolkit.datasets.readings.read_frame`.

    Raises ValueError without frames.
    """
    count = min(len(recording), len(recording) if frames is None else frames)
    if count < 1:
        raise ValueError(f"there must be a frame to learn the empty scene from, got {frames} of {len(recording)}")
    learners: list[SceneLearner] = []
    for k in np.unique(np.linspace(0, count - 1, min(sample, count)).astype(int)):
        frame = read_frame(recording, int(k), errors=errors, noise_seed=noise_seed)
        learners = learners or [SceneLearner(sensor, max(sample, 2)) for sensor in frame.sensors]
        for learner, measurement in zip(learners, frame.measurements, strict=True):
            learner.add(measurement)
    return tuple(learner.scene() for learner in learners)


def save_empty_scenes(path: str | Path, scenes: Sequence[EmptyScene]) -> None:
    """Write the empty scenes of some sensors as one .npz file with a checksum, whole or not at all."""
    said = [{"name": each.name, "model": _described(each.model), "frames": each.frames} for each in scenes]
    arrays = {f"{k}_{image}": getattr(scene, image) for k, scene in enumerate(scenes) for image in _IMAGES}
    write_arrays(path, {"scenes": np.array(json.dumps(said)), **arrays})


def load_empty_scenes(path: str | Path) -> tuple[EmptyScene, ...]:
    """The empty scenes of a file. Raises FileNotFoundError; ValueError where it is damaged or holds none."""
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
        raise ValueError(f"{path} holds no empty scenes ({error}): write them with save_empty_scenes") from None


class _Mode(NamedTuple):
    """A cluster of every pixel: median (0 for nothing returned, NaN for no cluster), spread, share, least and greatest
    measurement."""

    median: Float32[np.ndarray, "rows columns"]
    spread: Float32[np.ndarray, "rows columns"]
    share: Float32[np.ndarray, "rows columns"]
    least: Float32[np.ndarray, "rows columns"]
    greatest: Float32[np.ndarray, "rows columns"]

    def where(self, mask: Bool[np.ndarray, "rows columns"], other: _Mode) -> _Mode:
        """This one where the mask is set, else the other."""
        return _Mode(*(np.where(mask, mine, theirs) for mine, theirs in zip(self, other, strict=True)))


def _no_mode(shape: tuple[int, ...]) -> _Mode:
    nothing = np.zeros(shape, np.float32)
    return _Mode(np.full(shape, np.nan, np.float32), *(nothing,) * 4)


def _clusters(
    images: Float32[np.ndarray, "n rows columns"], model: SensorModel
) -> tuple[_Mode, _Mode, Bool[np.ndarray, "rows columns"]]:
    """Of every pixel the farthest cluster that is the scene's, the largest of the nearer ones, and whether that one
    comes and goes."""
    shape, n = images.shape[1:], len(images)
    in_time = np.where(returned(images, model.max_range), images, np.inf).reshape(n, -1).T  # a row for each pixel
    values = np.sort(in_time, axis=1)
    finite = np.isfinite(values)
    solid = np.where(finite, values, np.float32(0))
    gap = np.maximum(GAP_SIGMAS * np.asarray(model.deviation(solid)), GAP_SHARE * solid)[:, :-1]
    begins = np.ones(values.shape, bool)
    with np.errstate(invalid="ignore"):  # nothing twice is infinity less infinity: no gap
        begins[:, 1:] = values[:, 1:] - values[:, :-1] > gap
    starts = np.flatnonzero(begins)
    ends = np.append(starts[1:], values.size)
    pixel, size = starts // n, ends - starts
    enough = size >= min(n, max(2, int(np.ceil(LEAST_SHARE * n))))
    nothing = ~finite.ravel()[starts]
    far = _last_of(pixel, np.arange(len(starts)), enough, size, len(values))
    rivals = enough & (np.arange(len(starts)) < far[pixel]) & ~nothing
    near = _last_of(pixel, np.where(rivals, size, 0), rivals, np.zeros_like(size), len(values))
    nearest, farthest = (values.ravel()[each][:, None] for each in (starts[near], ends[near] - 1))
    present = (in_time >= nearest) & (in_time <= farthest)
    flickers = rivals[near] & _comes_and_goes(present)
    far_mode, near_mode = (
        _Mode(*(each.reshape(shape) for each in _measured(solid.ravel(), starts, ends, chosen, n, model)))
        for chosen in (far, np.where(rivals[near], near, -1))
    )
    return far_mode, near_mode, flickers.reshape(shape)


def _comes_and_goes(present: Bool[np.ndarray, "pixels n"]) -> Bool[np.ndarray, " pixels"]:
    """Whether something comes at least `LEAST_FLICKER` times as often as draws by chance, as often there, would."""
    share = present.mean(axis=1)
    comes = (present[:, 1:] & ~present[:, :-1]).sum(axis=1) + present[:, 0]
    return comes >= LEAST_FLICKER * share * (1 - share) * present.shape[1]


def _last_of(
    pixel: np.ndarray, rank: np.ndarray, eligible: np.ndarray, otherwise: np.ndarray, pixels: int
) -> np.ndarray:
    """Of every pixel the eligible cluster of the highest rank; the one with the most of `otherwise` where none is."""
    order = np.lexsort((np.arange(len(pixel)), np.where(eligible, rank, otherwise), eligible, pixel))
    return order[np.searchsorted(pixel[order], np.arange(pixels), side="right") - 1]


def _measured(
    values: np.ndarray, starts: np.ndarray, ends: np.ndarray, chosen: np.ndarray, n: int, model: SensorModel
) -> _Mode:
    """Median, spread and share of one cluster of every pixel, -1 for none; values: sorted within each."""
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
    """The spread that most pixels have at a distance, as a function of it, from those that see the scene mostly."""
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


def _narrowed(
    mode: _Mode, usual: Float32[np.ndarray, "rows columns"], images: Sequence[Float32[np.ndarray, "rows columns"]]
) -> _Mode:
    """Where a cluster is broad, its densest stretch of `SIGMAS` usual spreads to either side."""
    found = _Mode(*(each.copy() for each in mode))
    every = np.flatnonzero(mode.spread > BROAD * usual)
    for first in range(0, len(every), _AT_ONCE):
        _narrow(found, every[first : first + _AT_ONCE], usual, images)
    return found


def _narrow(
    mode: _Mode, broad: np.ndarray, usual: np.ndarray, images: Sequence[Float32[np.ndarray, "rows columns"]]
) -> None:
    """The same of some pixels, written into the mode."""
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


def _continues(near: _Mode, far: Float32[np.ndarray, "rows columns"]) -> Bool[np.ndarray, "rows columns"]:
    """Where a pixel at most `NEIGHBOURS` off has as its farthest surface the nearer one of a pixel, and that surface is
    not the pixel's own farthest one going on, as the ground does below the foot of a car: planes have inverse depths
    that are linear in the image."""
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


def _described(model: SensorModel) -> dict[str, object]:
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
