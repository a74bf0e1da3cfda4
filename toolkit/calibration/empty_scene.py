"""One sensor's view of a place without road users.

`EmptyScene` is learnt from the sensor's frames, pixel by pixel. The measurements of a pixel over
time, sorted, fall into clusters wherever two neighbours lie farther apart than noise explains;
"nothing returned" is a cluster of its own, the farthest one. The scene of a pixel is

    the farthest cluster with a tenth of the measurements: road users pass or park before the scene,
        never behind it;
    and a nearer cluster, if it comes and goes at least a quarter as often as random draws would,
        and continues the
    farthest surface of a pixel at most two off. So leaves that move and edges of a pole that sways
        belong to the
    scene. A queue at a stop line does not, since it stands before ground that its neighbours see,
        nor does a parked
    car, which comes once. Where nothing returns in the rest of the time, half of the measurements
        suffice: drop-outs.

Each of the two has a median and a spread, the median deviation scaled to a standard deviation and
never below the sensor model's own. Road users close to a surface fall into its cluster. So if a
spread is more than twice the usual one at that distance, the densest stretch of the cluster takes
its place. The more frequent of the two is `first`. A parked car that is away a tenth of the time is
not in the scene; one that never leaves is.

`Scenes` learns those of a recording on demand; clouds of a sensor become images of one grid first
(`toolkit.calibration.empty_scene`). Sensors must stand still.

Rows and columns of a lidar, found in its clouds.

Rows are, in order of preference,

1. its lasers, if every point tells its laser: each at the median elevation of its points;
2. the elevations where points crowd, as those of a spinning lidar or of even pixels do: peaks of
   the histogram of elevations, if most points lie nearer to one than a third of the way to the
   next;
3. else even steps of the usual angle between neighbouring points of a cloud, or of twice that if
   they lie as at random (a pattern that does not repeat), so that most cells are hit in most
   clouds.

Columns are even steps of the usual azimuth between neighbouring points of a row. Azimuths lie in
the middle of their columns if they are the same in all clouds. Columns go all around or, if clouds
leave a gap, from one side of it to the other."""

import json
import warnings
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, dataclass, field
from functools import cached_property, partial
from hashlib import sha256
from itertools import chain, islice, product
from pathlib import Path
from typing import NamedTuple

import numpy as np

from toolkit.arrays import Float, Float32, Float64, ImageMask, ImageRanges, Int64, Mask, Pose
from toolkit.frame import Frame, Frames, SensorCloud
from toolkit.runtime.files import parse_json, read_arrays, write_arrays
from toolkit.sensors.models import RowLidar, make_model
from toolkit.sensors.sensor import Sensor, SensorModel, is_return

NEAREST = 1.0  # m: nearer points do not tell angles
TELLING_POINTS = 100  # of a sensor, in all clouds together
MOST_PIXELS = 4_000_000
# azimuth without a point: with a wider gap a lidar does not look all around
SEAM_GAP = np.deg2rad(20.0)
FARTHER = 1.25  # range of the sensor over its farthest point
_LEAST_RANGE = 200.0  # m
_BIN = np.deg2rad(0.01)  # of the histogram of elevations
_SMOOTH = (3, 8, 20)  # bins, standard deviations of the smoothing, tried in turn
_LEAST_PEAK = 0.1  # of the median height of peaks
# share of points that lie within this share of the distance between rows
_CROWDED = 0.85
_THIRD = 1 / 3
_SMALLEST_STEP = np.deg2rad(0.02)
# 90 % quantile of nearest-neighbour distances over the 10 % one: above this they are random
_AT_RANDOM = 2.5
_LEAST_PHASE = (
    0.3  # length of the mean of unit vectors by the phase of azimuths, 1 where all have the same
)
_SOME = 20_000  # points of a cloud whose neighbours are looked for


@dataclass(frozen=True)
class LidarGrid:
    """A grid of rows, columns and range (`model`). rings: laser of each row, empty if clouds do not
    tell it."""

    model: RowLidar
    rings: tuple[int, ...] = ()


def find_grid(clouds: Sequence[SensorCloud]) -> LidarGrid:
    """Find the grid of a sensor in its clouds. Raises ValueError below 100 points and above 4
    million pixels."""
    clouds = [cloud for cloud in clouds if len(cloud.points)]
    name = clouds[0].name if clouds else "the sensor"
    angle_tables = []
    rings = []
    for cloud in clouds:
        angles = compute_angles(cloud.in_sensor())
        far = angles[2] > NEAREST
        angle_tables.append(angles[:, far])
        rings += [] if cloud.ring is None else [cloud.ring[far]]
    total = sum(columns_of_angles.shape[1] for columns_of_angles in angle_tables)
    if total < TELLING_POINTS:
        problem = f"{total} points of {name} say nothing of its rows"
        raise ValueError(f"{problem}, {TELLING_POINTS} are needed: give more clouds")
    elevation, azimuth, distance = np.concatenate(angle_tables, axis=1)
    numbers: tuple[int, ...] = ()
    if len(rings) == len(angle_tables):
        elevations, numbers = _ring_rows(elevation, np.concatenate(rings))
        step = _step_in_rows(
            [
                (columns_of_angles[1], ring)
                for columns_of_angles, ring in zip(angle_tables, rings, strict=True)
            ]
        )
    elif (crowded := _crowded_rows(elevation)) is not None:
        elevations = crowded
        step = _step_in_rows(
            [
                (columns_of_angles[1], nearest_row(columns_of_angles[0], crowded))
                for columns_of_angles in angle_tables
            ]
        )
    else:
        elevations, step = _even_rows(angle_tables)
    heading, span = _span(azimuth)
    if span is None:
        columns = max(1, round(2 * np.pi / step))
        width = 2 * np.pi
        # multiples of 2 pi in the middle of a column
        middle = azimuth * columns - np.pi * (columns - 1)
        mean = np.exp(1j * middle).mean()
        heading = float(np.angle(mean) / columns) if abs(mean) > _LEAST_PHASE else 0.0
    else:
        columns = max(1, int(np.ceil(span / step - 0.5)) + 1)
        width = min(columns * step, 2 * np.pi)
    if len(elevations) * columns > MOST_PIXELS:
        size = f"{len(elevations)} x {columns} pixels"
        raise ValueError(f"the image of {name} would have {size}: are its points in its own frame?")
    reach = float(max(_LEAST_RANGE, np.ceil(FARTHER * float(distance.max()))))
    return LidarGrid(
        RowLidar(tuple(elevations.tolist()), columns, width, heading, max_range=reach), numbers
    )


def compute_angles(points: Float64[np.ndarray, "n 3"]) -> Float64[np.ndarray, "3 n"]:
    """Elevation, azimuth (rad) and range (m) of points, sensor frame."""
    x, y, z = points.T
    across = np.hypot(x, y)
    return np.stack([np.arctan2(z, across), np.arctan2(y, x), np.hypot(across, z)])


def nearest_row(
    elevation: Float64[np.ndarray, " n"], rows: Float64[np.ndarray, " m"]
) -> Int64[np.ndarray, " n"]:
    """Row, top first, of the nearest elevation."""
    return np.searchsorted(-(rows[1:] + rows[:-1]) / 2, -elevation, side="left").astype(np.int64)


def _ring_rows(
    elevation: np.ndarray, ring: np.ndarray
) -> tuple[Float64[np.ndarray, " m"], tuple[int, ...]]:
    numbers = np.unique(ring)
    middle = np.array([np.median(elevation[ring == number]) for number in numbers])
    order = np.argsort(-middle, kind="stable")
    rows = middle[order]
    for k in range(1, len(rows)):  # lasers side by side at one elevation stay rows of their own
        rows[k] = min(rows[k], np.nextafter(rows[k - 1], -np.inf) - 1e-9)
    return rows, tuple(numbers[order].tolist())


def _crowded_rows(elevation: np.ndarray) -> Float64[np.ndarray, " m"] | None:
    """Elevations where points crowd; None if they do not."""
    from scipy.ndimage import gaussian_filter1d

    low = elevation.min() - 100 * _BIN
    counts = np.bincount(((elevation - low) / _BIN).astype(np.int64))
    counts = np.concatenate([counts, np.zeros(100, np.int64)]).astype(np.float64)
    for smooth in _SMOOTH:
        smoothed = gaussian_filter1d(counts, smooth)
        peak = (
            np.flatnonzero((smoothed[1:-1] > smoothed[:-2]) & (smoothed[1:-1] >= smoothed[2:])) + 1
        )
        if not len(peak):
            continue
        peak = peak[smoothed[peak] >= _LEAST_PEAK * np.median(smoothed[peak])]
        rows = (low + (peak + 0.5) * _BIN)[::-1]
        row = nearest_row(elevation, rows)
        rows = np.array(
            [
                np.median(elevation[row == k]) if (row == k).any() else rows[k]
                for k in range(len(rows))
            ]
        )
        row = nearest_row(elevation, rows)
        apart = -np.diff(rows)
        to_next = np.minimum(np.append(apart, np.inf), np.insert(apart, 0, np.inf))
        if (
            len(rows) > 1
            and (np.abs(elevation - rows[row]) <= _THIRD * to_next[row]).mean() >= _CROWDED
        ):
            return rows
    return None


def _step_in_rows(clouds: Sequence[tuple[np.ndarray, np.ndarray]]) -> float:
    """Usual step between neighbours in a row. clouds: azimuths and rows of their points."""
    steps = []
    for azimuth, row in clouds:
        order = np.lexsort((azimuth, row))
        steps.append(np.diff(azimuth[order])[row[order][1:] == row[order][:-1]])
    all_steps = np.concatenate(steps)
    all_steps = all_steps[all_steps > _SMALLEST_STEP]
    return float(np.median(all_steps)) if len(all_steps) else 2 * np.pi


def _even_rows(clouds: Sequence[np.ndarray]) -> tuple[Float64[np.ndarray, " m"], float]:
    """Even rows, and the same step of the azimuth."""
    from scipy.spatial import cKDTree

    elevation, azimuth, _ = max(clouds, key=lambda angles: angles.shape[1])
    flat = np.column_stack([elevation, azimuth * np.cos(elevation)])
    sample = np.random.default_rng(0).permutation(len(flat))[:_SOME]
    low, middle, high = np.quantile(
        cKDTree(flat).query(flat[sample], k=2)[0][:, 1], [0.1, 0.5, 0.9]
    )
    step = float(max(middle * (2 if high > _AT_RANDOM * max(low, 1e-9) else 1), _SMALLEST_STEP))
    top = float(max(angles[0].max() for angles in clouds))
    bottom = float(min(angles[0].min() for angles in clouds))
    rows = max(2, int(np.ceil((top - bottom) / step)) + 1)
    return (top + bottom) / 2 + ((rows - 1) / 2 - np.arange(rows)) * step, step


def _span(azimuth: np.ndarray) -> tuple[float, float | None]:
    """Middle and width of the observed azimuths. Returns 0 and None for all around."""
    ordered = np.sort(azimuth)
    gaps = np.diff(ordered, append=ordered[0] + 2 * np.pi)
    widest = int(gaps.argmax())
    if gaps[widest] < SEAM_GAP:
        return 0.0, None
    span = 2 * np.pi - float(gaps[widest])
    middle = float(ordered[(widest + 1) % len(ordered)]) + span / 2
    return float(np.arctan2(np.sin(middle), np.cos(middle))), span


SHARED_CELL = "points in a cell with a nearer one"
OUTSIDE_GRID = "points outside the rows and columns of their sensor"


@dataclass(frozen=True, eq=False)
class CloudImage:
    """A cloud as an image. measurement: ranges (m), 0 where nothing returned; cells: of every point
    of the cloud, counted row by row, the nearest one for points outside; inside: mask of the points
    in the grid; shown: mask of those that the image shows."""

    grid: LidarGrid
    measurement: ImageRanges
    cells: Int64[np.ndarray, " n"]
    inside: Mask
    shown: Mask

    @property
    def left_out(self) -> dict[str, int]:
        """Number of points missing from the image, by kind."""
        counts = {
            SHARED_CELL: int((self.inside & ~self.shown).sum()),
            OUTSIDE_GRID: int((~self.inside).sum()),
        }
        return {kind: count for kind, count in counts.items() if count}

    @cached_property
    def points(self) -> Float32[np.ndarray, "m 3"]:
        """Points of the image, sensor frame, in the cloud's order."""
        cells = self.cells[self.shown]
        rays = self.grid.model.rays().reshape(-1, 3)
        return rays[cells] * self.measurement.ravel()[cells, None]


def rasterize_cloud(cloud: SensorCloud, grid: LidarGrid) -> CloudImage:
    """Return a cloud in its sensor's grid: points in the row of their laser, else in the nearest
    one if near enough."""
    model = grid.model
    elevation, azimuth, distance = compute_angles(cloud.in_sensor())
    rows = np.array(model.elevations)
    if grid.rings and cloud.ring is not None:
        numbers = np.array(grid.rings)
        order = np.argsort(numbers)
        row = order[
            np.minimum(np.searchsorted(numbers[order], cloud.ring), len(numbers) - 1)
        ].astype(np.int64)
        in_rows = numbers[row] == cloud.ring
    else:
        row = nearest_row(elevation, rows)
        gaps = -np.diff(rows)
        widest = (
            np.maximum(np.append(gaps, 0), np.insert(gaps, 0, 0))
            if len(gaps)
            else np.full(1, np.inf)
        )
        in_rows = np.abs(elevation - rows[row]) <= widest[row]
    turned = (azimuth - model.heading + np.pi) % (2 * np.pi) - np.pi
    raw_column = np.floor(turned / (model.azimuth_fov / model.columns) + model.columns / 2).astype(
        np.int64
    )
    column = np.clip(raw_column, 0, model.columns - 1)
    in_columns = (raw_column == column) | (model.azimuth_fov >= 2 * np.pi)
    ranges = distance.astype(np.float32)
    inside = in_rows & in_columns & (ranges > 0) & (ranges < model.max_range)
    cells = row * model.columns + column
    within = np.flatnonzero(inside)
    order = within[np.lexsort((ranges[within], cells[within]))]
    is_shown = np.zeros(len(cells), bool)
    is_shown[order[np.diff(cells[order], prepend=-1) > 0]] = True  # the nearest of each cell
    image = np.zeros(len(rows) * model.columns, np.float32)
    image[cells[is_shown]] = ranges[is_shown]
    return CloudImage(grid, image.reshape(model.shape), cells, inside, is_shown)


SAMPLE = 128  # images kept of a sensor
SIGMAS = 4.0  # spreads: a measurement this near a median shows the empty scene
LEAST_SHARE = 0.1  # fraction of the measurements that makes a cluster part of the scene
HALF = 0.5  # fraction of the measurements that makes a surface before no return part of the scene
# gap between clusters: standard deviations of the model, share of the measurement
GAP_SIGMAS = 4.0
GAP_SHARE = 0.004
BROAD = 2.0  # times the usual spread at a distance: a broader cluster is more than one surface
DISTANCES = 24  # steps of log distance, each with a usual spread
NEIGHBOURS = 2  # pixels: a surface continues this far
OTHER_SURFACE = (
    0.1  # fraction by which a depth must leave the plane through two others to be another surface
)
LEAST_FLICKER = (
    0.25  # least rate at which a part of the scene comes and goes, relative to random draws
)
_MAD_TO_SIGMA = 1.4826
_IMAGES = ("first", "spread", "share", "second", "second_spread", "second_share")
_BLOCK = 1 << 21  # measurements sorted at once
_AT_ONCE = 256  # pixels whose measurements are compared in pairs at once


@dataclass(frozen=True, eq=False)
class EmptyScene:
    """Empty scene of one sensor, by its name and model. Raises ValueError for an image that does
    not fit the model's shape, or is negative or infinite."""

    name: str
    model: SensorModel
    first: ImageRanges  # median measurement, 0 where nothing returns
    spread: ImageRanges  # its standard deviation
    share: ImageRanges  # fraction of the frames that show it
    # the same for the other measurement of the scene: NaN, 0 and 0 where it has only one
    second: ImageRanges
    second_spread: ImageRanges
    second_share: ImageRanges
    frames: int  # that it was learnt from

    def __post_init__(self) -> None:
        for name in _IMAGES:
            image: Float[np.ndarray, "..."] = getattr(self, name)
            if image.shape != (shape := self.model.shape) or image.dtype != np.float32:
                got = f"{image.dtype} of {image.shape}"
                raise ValueError(f"{name} of {self.name!r} must be float32 of {shape}, got {got}")
            values = image[~np.isnan(image)] if name == "second" else image
            if not (np.isfinite(values).all() and (values >= 0).all()):
                raise ValueError(
                    f"{name} of {self.name!r} must be finite and 0 or more: learn the scene again"
                )
            image.setflags(write=False)
        if self.frames < 1:
            raise ValueError(f"an empty scene needs at least one frame, got {self.frames}")

    @staticmethod
    def of(sensor: Sensor, image: ImageRanges) -> "EmptyScene":
        """Scene of a noise-free render, with the model's spread."""
        first = np.where(is_return(image, sensor.model.max_range), image, 0).astype(np.float32)
        spread = np.where(first > 0, sensor.model.deviation(first), 0).astype(np.float32)
        always = np.ones_like(first)
        never = np.zeros_like(first)
        none = np.full(first.shape, np.nan, np.float32)
        return EmptyScene(
            sensor.name, sensor.model, first, spread, always, none, never, never.copy(), 1
        )

    @cached_property
    def digest(self) -> str:
        """SHA-256 of the scene's contents."""
        digest = sha256(
            json.dumps(
                [self.name, _describe_model(self.model), self.frames], sort_keys=True
            ).encode()
        )
        for image in _IMAGES:
            digest.update(np.ascontiguousarray(getattr(self, image)).tobytes())
        return digest.hexdigest()

    def shows(
        self, measurement: Float[np.ndarray, "rows columns"], sigmas: float = SIGMAS
    ) -> ImageMask:
        """Mark pixels within `sigmas` spreads of one of its medians, or with no return where that
        may be."""
        self.check_shape(measurement)
        is_measured = is_return(measurement, self.model.max_range)
        is_scene = np.abs(measurement - self.first) <= sigmas * self.spread
        is_scene |= np.abs(measurement - self.second) <= sigmas * self.second_spread
        return np.where(is_measured, is_scene, (self.first == 0) | (self.second == 0))

    def check_shape(self, measurement: Float[np.ndarray, "..."]) -> None:
        """Raise ValueError unless an image has the scene's shape."""
        if measurement.shape != self.first.shape:
            shapes = f"{self.first.shape} pixels, got an image of {measurement.shape}"
            raise ValueError(
                f"the empty scene of {self.name!r} has {shapes}: pass an image of the same sensor"
            )


class SceneLearner:
    """Learner of a sensor's empty scene from every 2^k-th image, at most `sample` of them."""

    def __init__(self, sensor: Sensor, sample: int = SAMPLE) -> None:
        if sample < 2:
            raise ValueError(f"sample must be at least 2 images, got {sample}")
        self.sensor = sensor
        self.sample = sample
        self.frames = 0
        self._every = 1
        self._kept = list[np.ndarray]()

    def add(self, measurement: Float[np.ndarray, "rows columns"]) -> None:
        """Add an image."""
        if measurement.shape != (shape := self.sensor.model.shape):
            raise ValueError(
                f"sensor {self.sensor.name!r} measures {shape} pixels, got {measurement.shape}"
            )
        if self.frames % self._every == 0:
            if len(self._kept) == self.sample:
                self._kept = self._kept[::2]
                self._every = self._every * 2
            if self.frames % self._every == 0:
                self._kept.append(np.array(measurement, np.float32))
        self.frames += 1

    def scene(self) -> EmptyScene:
        """Return the empty scene as known so far. Raises ValueError before the first image."""
        if not self._kept:
            raise ValueError(
                f"no image of {self.sensor.name!r} yet: add one before asking for its empty scene"
            )
        model = self.sensor.model
        rows, columns = model.shape
        height = max(1, _BLOCK // (len(self._kept) * columns))
        tops = range(0, rows, height)
        images = np.stack(self._kept)
        blocks = (_clusters(images[:, top : top + height], model) for top in tops)
        fars, nears, flickering = zip(*blocks, strict=True)
        far, near = (
            _Mode(*map(np.concatenate, zip(*modes, strict=True))) for modes in (fars, nears)
        )
        usual = _usual_spread(far, model)
        far, near = (_narrow_broad(mode, usual(mode.median), self._kept) for mode in (far, near))
        flickers = np.concatenate(flickering) & (near.share >= LEAST_SHARE)
        continues = _continuation_mask(near, far.median)
        is_second = flickers & (continues | ((far.median == 0) & (near.share >= HALF)))
        nothing = np.zeros(model.shape, np.float32)
        first = far
        second = near.where(is_second, _Mode(np.full_like(nothing, np.nan), *(nothing,) * 4))
        swap = second.share > first.share
        first, second = second.where(swap, first), first.where(swap, second)
        scene_images = dict(zip(_IMAGES, (*first[:3], *second[:3]), strict=True))
        return EmptyScene(self.sensor.name, model, frames=self.frames, **scene_images)


def learn_empty_scenes(
    recording: Frames, sample: int = SAMPLE, *, frames: int | None = None
) -> tuple[EmptyScene, ...]:
    """Learn the empty scene of every sensor of a recording, in their order. sample: images that are
    looked at, spread over the first `frames` frames, all if None. Raises ValueError without frames,
    and for frames of clouds."""
    count = min(len(recording), len(recording) if frames is None else frames)
    if count < 1:
        raise ValueError(
            f"there must be a frame to learn the empty scene from, got {frames} of {len(recording)}"
        )
    learners: list[SceneLearner] = []
    for k in np.unique(np.linspace(0, count - 1, min(sample, count)).astype(int)):
        frame = recording[int(k)]
        learners = learners or [SceneLearner(sensor, max(sample, 2)) for sensor in frame.sensors]
        for learner, measurement in zip(learners, frame.images, strict=True):
            learner.add(measurement)
    return tuple(learner.scene() for learner in learners)


def save_empty_scenes(path: str | Path, scenes: Sequence[EmptyScene]) -> None:
    """Write empty scenes as one .npz file with a checksum."""
    heads = [
        {"name": empty.name, "model": _describe_model(empty.model), "frames": empty.frames}
        for empty in scenes
    ]
    arrays = {
        f"{k}_{image}": getattr(scene, image) for k, scene in enumerate(scenes) for image in _IMAGES
    }
    write_arrays(path, {"scenes": np.array(json.dumps(heads)), **arrays})


def load_empty_scenes(path: str | Path) -> tuple[EmptyScene, ...]:
    """Read the empty scenes of a file. Raises FileNotFoundError; ValueError for any that is damaged
    or holds none."""
    arrays = read_arrays(path)
    scenes = []
    try:
        for k, head in enumerate(parse_json(str(arrays["scenes"]))):
            values = dict(head["model"])
            model = make_model(values.pop("class"), values)
            images = {name: arrays[f"{k}_{name}"] for name in _IMAGES}
            scenes.append(EmptyScene(head["name"], model, frames=head["frames"], **images))
        return tuple(scenes)
    except (KeyError, TypeError, AttributeError, ValueError) as error:
        raise ValueError(
            f"{path} has no empty scenes ({error}): write them with save_empty_scenes"
        ) from None


GRID_SAMPLES = 8  # first frames, used to find the grids
FEW_SAMPLES = 5  # with fewer frames, standing road users are taken for the scene
STANDS_STILL = 0.5  # m that a sensor may be off its first place in the map
_KEPT_PIXELS = 1 << 26  # of all images kept of one sensor


@dataclass(frozen=True, eq=False)
class LearntScene:
    """Empty scene of one sensor."""

    scene: EmptyScene
    grid: LidarGrid | None = None  # of the images of its clouds
    points: int = 0  # number of points of its clouds
    # those that its images do not show, by kind
    left_out: dict[str, int] = field(default_factory=dict)


@dataclass(eq=False)
class Scenes:
    """Empty scenes of a recording's sensors, all learnt when the first is asked for (`used`).

    given: scenes in place of those the recording shows, found by the sensors' names; sample: images
    kept of each sensor at most. Raises ValueError, when asked, for an unknown sensor, one that
    moves, and clouds that make no image; warns if frames of clouds are few."""

    recording: Frames
    given: Sequence[EmptyScene] | None = None
    sample: int = field(default=SAMPLE, kw_only=True)
    used: bool = field(default=False, init=False)

    def __call__(self, sensor: int) -> EmptyScene:
        """Empty scene of a sensor by number."""
        return self[self._names[sensor]].scene

    def __getitem__(self, name: str) -> LearntScene:
        """Scene and grid of the sensor of that name."""
        if name not in self.every:
            raise ValueError(
                f"there are empty scenes of {', '.join(self.every) or 'no sensor'}, none of {name}"
            )
        return self.every[name]

    def image(self, cloud: SensorCloud) -> CloudImage:
        """Return a cloud in the grid of its sensor."""
        return rasterize_cloud(cloud, self.grid(cloud.name))

    def grid(self, name: str) -> LidarGrid:
        """Grid of the clouds of a sensor. Raises ValueError if its scene was learnt from images of
        its own."""
        learnt = self[name]
        if learnt.grid is None:
            raise ValueError(
                f"the scene of {name!r} was learnt from images of {learnt.scene.model}, not from "
                "clouds"
            )
        return learnt.grid

    @property
    def digests(self) -> list[str]:
        """Digests of all scenes, none if unused."""
        return [learnt.scene.digest for learnt in self.every.values()] if self.used else []

    @cached_property
    def _names(self) -> tuple[str, ...]:
        return tuple(sensor.name for sensor in self.recording[0].sensors)

    @cached_property
    def every(self) -> dict[str, LearntScene]:
        """Scenes of all sensors, by name."""
        self.used = True
        if self.given is not None:
            grids = [
                LidarGrid(given_scene.model) if type(given_scene.model) is RowLidar else None
                for given_scene in self.given
            ]
            return {
                given_scene.name: LearntScene(given_scene, grid)
                for given_scene, grid in zip(self.given, grids, strict=True)
            }
        if not (len(self.recording) and self.recording[0].has_images):
            return learn_sample_scenes(
                (self.recording[k] for k in range(len(self.recording))), sample=self.sample
            )
        return {
            scene.name: LearntScene(scene)
            for scene in learn_empty_scenes(self.recording, self.sample)
        }


def learn_sample_scenes(
    samples: Iterable[Frame], *, sample: int = SAMPLE
) -> dict[str, LearntScene]:
    """Learn grid and empty scene of every sensor by name, of `sample` images at most. Raises
    ValueError as `Scenes`."""
    remaining = iter(samples)
    first = list(islice(remaining, GRID_SAMPLES))
    clouds: dict[str, list[SensorCloud]] = {}
    for cloud in (cloud for frame in first for cloud in frame.clouds if len(cloud.points)):
        clouds.setdefault(cloud.name, []).append(cloud)
    learners = {
        name: _Learner(name, find_grid(learner), sample) for name, learner in clouds.items()
    }
    count = 0
    for frame in chain(first, remaining):
        count += 1
        for cloud in frame.clouds:
            if len(cloud.points) and cloud.name in learners:
                learners[cloud.name].add(cloud, frame.map_SE3_world @ cloud.world_SE3_sensor)
    if not learners:
        raise ValueError("no cloud has a point: there is no empty scene to learn")
    if count < FEW_SAMPLES:
        problem = (
            f"empty scenes are learnt from {count} samples, so who stands still in them is part "
            "of the scene"
        )
        warnings.warn(f"{problem}: give {FEW_SAMPLES} or more, spread over minutes", stacklevel=2)
    pairs = learners.items()
    return {
        name: LearntScene(learner.learner.scene(), learner.grid, learner.points, learner.left_out)
        for name, learner in pairs
    }


class _Learner:
    def __init__(self, name: str, grid: LidarGrid, sample: int) -> None:
        self.grid = grid
        self.points = 0
        self.left_out = Counter[str]()
        self._place: Float64[np.ndarray, "3"] | None = None
        sample_limit = max(16, _KEPT_PIXELS // (grid.model.shape[0] * grid.model.shape[1]))
        self.learner = SceneLearner(
            Sensor(name, grid.model, np.eye(4)), max(2, min(sample, sample_limit))
        )

    def add(self, cloud: SensorCloud, map_SE3_sensor: Pose) -> None:
        position = map_SE3_sensor[:3, 3]
        self._place = position if self._place is None else self._place
        if (moved := np.linalg.norm(position - self._place)) > STANDS_STILL:
            remedy = "only a sensor that stands still has an empty scene"
            raise ValueError(f"{cloud.name} moves, by {moved:.1f} m: {remedy}")
        image = rasterize_cloud(cloud, self.grid)
        self.left_out.update(image.left_out)
        self.points += len(cloud.points)
        self.learner.add(image.measurement)


class _Mode(NamedTuple):
    """One cluster per pixel."""

    median: ImageRanges  # 0 for nothing returned, NaN for no cluster
    spread: ImageRanges
    share: ImageRanges
    least: ImageRanges  # extreme measurements
    greatest: ImageRanges

    def reshape(self, shape: tuple[int, ...]) -> "_Mode":
        """Return the same mode as images of a shape."""
        return _Mode(*(column.reshape(shape) for column in self))

    def where(self, mask: ImageMask, outside: "_Mode") -> "_Mode":
        """Return this mode inside the mask, the other outside."""
        return _Mode(
            *(
                np.where(mask, inside_image, outside_image)
                for inside_image, outside_image in zip(self, outside, strict=True)
            )
        )


def _clusters(
    images: Float32[np.ndarray, "n rows columns"], model: SensorModel
) -> tuple[_Mode, _Mode, ImageMask]:
    """Find each pixel's farthest cluster of the scene, the largest nearer one, and a mask where
    that flickers."""
    shape = images.shape[1:]
    n = len(images)
    # a row for each pixel
    in_time = np.where(is_return(images, model.max_range), images, np.inf).reshape(n, -1).T
    values = np.sort(in_time)
    solid = np.where(np.isfinite(values), values, np.float32(0))
    gap = np.maximum(GAP_SIGMAS * np.asarray(model.deviation(solid)), GAP_SHARE * solid)[:, :-1]
    begins = np.ones(values.shape, bool)
    with np.errstate(invalid="ignore"):  # two missing returns are infinity less infinity: no gap
        begins[:, 1:] = values[:, 1:] - values[:, :-1] > gap
    starts = np.flatnonzero(begins)
    ends = np.append(starts[1:], values.size)
    pixel = starts // n
    size = ends - starts
    enough = size >= min(n, max(2, int(np.ceil(LEAST_SHARE * n))))
    number = np.arange(len(starts))

    def pick(rank: np.ndarray, eligible: np.ndarray) -> np.ndarray:
        """Pick each pixel's eligible cluster of highest rank."""
        order = np.lexsort((number, rank, eligible, pixel))
        return order[np.searchsorted(pixel[order], np.arange(len(values)), side="right") - 1]

    far = pick(np.where(enough, number, size), enough)
    rivals = enough & (number < far[pixel])
    near = pick(size, rivals)
    nearest, farthest = (
        values.ravel()[indices][:, None] for indices in (starts[near], ends[near] - 1)
    )
    present = (in_time >= nearest) & (in_time <= farthest)
    share = present.mean(axis=1)
    comes = (present[:, 1:] & ~present[:, :-1]).sum(axis=1) + present[:, 0]
    flickers = rivals[near] & (comes >= LEAST_FLICKER * share * (1 - share) * n)
    measure = partial(_measure_mode, solid.ravel(), starts, ends, n=n, model=model)
    far_mode = measure(far).reshape(shape)
    near_mode = measure(np.where(rivals[near], near, -1)).reshape(shape)
    return far_mode, near_mode, flickers.reshape(shape)


def _measure_mode(
    values: np.ndarray,
    starts: np.ndarray,
    ends: np.ndarray,
    cluster: np.ndarray,
    n: int,
    model: SensorModel,
) -> _Mode:
    """Measure one chosen cluster (-1: none) of every pixel."""
    first = starts[cluster]
    last = ends[cluster]
    size = last - first
    median = (values[first + (size - 1) // 2] + values[first + size // 2]) / 2
    offset = np.arange(n)
    inside = offset < size[:, None]
    members = values[np.minimum(first[:, None] + offset, len(values) - 1)]
    deviation = np.sort(np.where(inside, np.abs(members - median[:, None]), np.float32(np.inf)))
    row = np.arange(len(cluster))
    typical = (deviation[row, (size - 1) // 2] + deviation[row, size // 2]) / 2
    spread = np.maximum(_MAD_TO_SIGMA * typical, np.asarray(model.deviation(median)))
    exists = cluster >= 0
    figures = (exists, median, np.nan), (exists & (median > 0), spread, 0), (exists, size / n, 0)
    ends_of = (np.where(exists, values[index], 0) for index in (first, last - 1))
    return _Mode(*(np.where(*figure).astype(np.float32) for figure in figures), *ends_of)


def _usual_spread(far: _Mode, model: SensorModel) -> Callable[[ImageRanges], ImageRanges]:
    """Return the usual spread as a function of distance, from pixels that mostly see the scene."""
    clear = (far.share >= HALF) & (far.median > 0)
    distance = np.log(far.median[clear])
    spread = far.spread[clear]
    if not len(distance):
        return lambda median: np.broadcast_to(model.deviation(np.nan_to_num(median)), median.shape)
    edges = np.linspace(distance.min(), distance.max() + 1e-6, DISTANCES + 1)
    step = np.digitize(distance, edges)
    steps = np.unique(step)
    usual = [np.median(spread[step == k]) for k in steps]
    middle = [np.median(distance[step == k]) for k in steps]

    def at(median: ImageRanges) -> ImageRanges:
        log_distance = np.log(np.where(median > 0, median, 1))
        return np.maximum(
            np.interp(log_distance, middle, usual), model.deviation(np.nan_to_num(median))
        ).astype(np.float32)

    return at


def _narrow_broad(mode: _Mode, usual: ImageRanges, images: Sequence[ImageRanges]) -> _Mode:
    """Replace broad clusters by their densest stretch, `SIGMAS` usual spreads wide to either
    side."""
    narrowed = _Mode(*(raster.copy() for raster in mode))
    broad_pixels = np.flatnonzero(mode.spread > BROAD * usual)
    for start in range(0, len(broad_pixels), _AT_ONCE):
        broad = broad_pixels[start : start + _AT_ONCE]
        lowest, greatest, spread = (
            raster.ravel()[broad][:, None] for raster in (mode.least, mode.greatest, usual)
        )
        values = np.stack([image.ravel()[broad] for image in images], axis=1)
        values = np.sort(np.where((values >= lowest) & (values <= greatest), values, np.inf))
        rank = np.arange(values.shape[1])
        row = np.arange(len(broad))
        within = values[:, None, :] <= values[:, :, None] + 2 * SIGMAS * spread[:, :, None]
        count = np.where(np.isfinite(values), within.sum(axis=2) - rank, 0)
        begin = rank[-1] - count[:, ::-1].argmax(axis=1)  # the farthest of the densest
        size = count[row, begin]
        median = (values[row, begin + (size - 1) // 2] + values[row, begin + size // 2]) / 2
        inside = (rank >= begin[:, None]) & (rank < (begin + size)[:, None])
        deviation = np.sort(np.where(inside, np.abs(values - median[:, None]), np.inf))[
            row, (size - 1) // 2
        ]
        narrowed.median.ravel()[broad] = median
        narrowed.spread.ravel()[broad] = np.clip(
            _MAD_TO_SIGMA * deviation, spread[:, 0], BROAD * spread[:, 0]
        )
        narrowed.share.ravel()[broad] = size / len(images)
    return narrowed


def _continuation_mask(near: _Mode, far: ImageRanges) -> ImageMask:
    """Mark pixels whose nearer surface continues a neighbour's farthest, at most `NEIGHBOURS` off,
    but not their own, as ground goes on below the foot of a car: planes have inverse depths that
    are linear in the image."""
    within = np.maximum(SIGMAS * near.spread, GAP_SHARE * near.median)
    inverse = np.where(far > 0, 1 / np.where(far > 0, far, 1), 0)
    padded = np.pad(far, NEIGHBOURS, constant_values=np.nan)
    opposite = np.pad(inverse, NEIGHBOURS, mode="edge")
    rows, columns = far.shape
    same = np.zeros(far.shape, bool)
    for down, right in product(range(-NEIGHBOURS, NEIGHBOURS + 1), repeat=2):
        beyond = padded[NEIGHBOURS + down :, NEIGHBOURS + right :][:rows, :columns]
        opposite_inverse = opposite[NEIGHBOURS - down :, NEIGHBOURS - right :][:rows, :columns]
        other_surface = np.abs((2 * inverse - opposite_inverse) * beyond - 1) > OTHER_SURFACE
        same |= (np.abs(beyond - near.median) <= within) & other_surface
    return same


def _describe_model(model: SensorModel) -> dict[str, object]:
    return {
        "class": type(model).__name__,
        **{key: value for key, value in asdict(model).items() if value is not None},
    }
