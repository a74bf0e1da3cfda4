"""One sensor's view of a place without road users.

`EmptyScene` is learnt from the sensor's frames, pixel by pixel. The measurements of a pixel over
time fall into clusters (`toolkit.calibration.pixel_clusters`). The scene of a pixel is

    the farthest cluster with a tenth of the measurements: road users pass or park before the scene,
        never behind it;
    and a nearer cluster, if it comes and goes at least a quarter as often as random draws would,
        and continues the farthest surface of a pixel at most two off. So leaves that move and edges
        of a pole that sways belong to the scene. A queue at a stop line does not, since it is in
        front of ground that its neighbours see, nor does a parked car, which comes once. If nothing
        returns in the rest of the time, half of the measurements suffice: drop-outs.

Each of the two has a median and a spread, the median deviation scaled to a standard deviation and
never below the sensor model's. Road users close to a surface fall into its cluster. So if a
spread is more than twice the usual one at that distance, the densest stretch of the cluster takes
its place. The more frequent of the two is `first`. A parked car that is away a tenth of the time is
not in the scene; one that never leaves is."""

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from functools import cached_property
from hashlib import sha256

import numpy as np

from toolkit.arrays import Float, ImageMask, ImageRanges
from toolkit.calibration.pixel_clusters import (
    MIN_CLUSTER_SHARE,
    MIN_OPEN_SHARE,
    SCENE_SIGMAS,
    PixelMode,
    find_clusters,
    mark_continuation,
    narrow_broad,
    usual_spread,
)
from toolkit.frame import Frames
from toolkit.sensors.sensor import Sensor, SensorModel, is_return

MAX_SCENE_IMAGES = 128  # images kept of a sensor
SCENE_IMAGES = ("first", "spread", "share", "second", "second_spread", "second_share")
BLOCK_VALUES = 1 << 21  # about two million measurements are sorted together, to limit memory


@dataclass(frozen=True, eq=False)
class EmptyScene:
    """Measurements of one sensor when no road user is there.

    All images are float32 of the model's shape, in the unit of its measurements, and become
    read-only. Raises ValueError for an image that does not fit the model's shape, or is negative or
    infinite.

    Attributes:
        name: name of the sensor.
        model: model of the sensor.
        first: median measurement of each pixel's more frequent surface, 0 if nothing returns.
        spread: standard deviation of the measurements of `first`.
        share: share of the frames that show `first`, 0 to 1.
        second: median of the less frequent surface, 0 for no return, NaN without one.
        second_spread: standard deviation of the measurements of `second`, 0 without one.
        second_share: share of the frames that show `second`, 0 without one.
        frames: number of frames that the scene was learnt from.
    """

    name: str
    model: SensorModel
    first: ImageRanges
    spread: ImageRanges
    share: ImageRanges
    second: ImageRanges
    second_spread: ImageRanges
    second_share: ImageRanges
    frames: int

    def __post_init__(self) -> None:
        """Check the images of the empty scene, and make them read-only."""
        shape = self.model.shape
        for name in SCENE_IMAGES:
            image: Float[np.ndarray, "..."] = getattr(self, name)
            if image.shape != shape or image.dtype != np.float32:
                got = f"{image.dtype} of {image.shape}"
                raise ValueError(f"{name} of {self.name!r} must be float32 of {shape}, got {got}")
            # NaN only means that a pixel has no second surface
            values = image[~np.isnan(image)] if name == "second" else image
            if not (np.isfinite(values).all() and (values >= 0).all()):
                raise ValueError(
                    f"{name} of {self.name!r} must be finite and 0 or more: learn the scene again"
                )
            image.setflags(write=False)
        if self.frames < 1:
            raise ValueError(f"an empty scene needs at least one frame, got {self.frames}")

    @staticmethod
    def from_render(sensor: Sensor, image: ImageRanges) -> "EmptyScene":
        """Return the scene of a noise-free render: one surface for each pixel, always shown.

        image: measurements of the sensor; values that are no return become 0. The spread is the
        model's noise."""
        first = np.where(is_return(image, sensor.model.max_range), image, 0).astype(np.float32)
        spread = np.where(first > 0, sensor.model.deviation(first), 0).astype(np.float32)
        zeros = np.zeros_like(first)
        return EmptyScene(
            sensor.name,
            sensor.model,
            first=first,
            spread=spread,
            share=np.ones_like(first),
            second=np.full(first.shape, np.nan, np.float32),  # no second surface
            second_spread=zeros,
            second_share=zeros.copy(),
            frames=1,
        )

    @cached_property
    def digest(self) -> str:
        """SHA-256 of the scene's contents, in hexadecimal digits."""
        head = [self.name, describe_model(self.model), self.frames]
        digest = sha256(json.dumps(head, sort_keys=True).encode())
        for image in SCENE_IMAGES:
            digest.update(np.ascontiguousarray(getattr(self, image)).tobytes())
        return digest.hexdigest()

    def shows(
        self, measurement: Float[np.ndarray, "rows columns"], sigmas: float = SCENE_SIGMAS
    ) -> ImageMask:
        """Mark pixels that show the scene: within `sigmas` spreads of one of its medians.

        A pixel without a return shows it if one of its medians is no return. measurement: image
        by the same sensor."""
        self.check_shape(measurement)
        is_measured = is_return(measurement, self.model.max_range)
        is_scene = np.abs(measurement - self.first) <= sigmas * self.spread
        # never true if `second` is NaN
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
    """Learner of a sensor's empty scene from its images; at most `sample` are kept.

    Every image is kept at first; whenever they are too many, every other one is dropped and the
    step between kept images doubles.

    Attributes:
        sensor: sensor of the images.
        sample: largest number of images kept.
        frames: number of images added so far.
        images: images kept, at most `sample`."""

    def __init__(self, sensor: Sensor, sample: int = MAX_SCENE_IMAGES) -> None:
        """Begin without images; sample: most images to keep. Raises ValueError for less than 2."""
        if sample < 2:
            raise ValueError(f"sample must be at least 2 images, got {sample}")
        self.sensor = sensor
        self.sample = sample
        self.frames = 0
        self._step = 1  # frames from one kept image to the next, a power of two
        self.images = list[np.ndarray]()

    def add(self, measurement: Float[np.ndarray, "rows columns"]) -> None:
        """Add the next image of the sensor; it is kept if it is due.

        If `self.sample` images, the most that may be kept, are there already, every other one is
        dropped and the step between kept images doubles. Raises ValueError for an image of another
        shape."""
        shape = self.sensor.model.shape
        if measurement.shape != shape:
            raise ValueError(
                f"sensor {self.sensor.name!r} measures {shape} pixels, got {measurement.shape}"
            )
        if self.frames % self._step == 0:
            if len(self.images) == self.sample:
                self.images = self.images[::2]
                self._step = self._step * 2
            if self.frames % self._step == 0:  # again, since the step may have doubled
                self.images.append(np.array(measurement, np.float32))
        self.frames += 1

    def scene(self) -> EmptyScene:
        """Return the empty scene as known so far. Raises ValueError before the first image."""
        if not self.images:
            raise ValueError(
                f"no image of {self.sensor.name!r} yet: add one before asking for its empty scene"
            )
        model = self.sensor.model
        # far: each pixel's farthest cluster; near: the largest nearer one, if any
        far, near, flickers = self._find_modes()
        find_usual_spread = usual_spread(far, model)
        far = narrow_broad(far, find_usual_spread(far.median), self.images)
        near = narrow_broad(near, find_usual_spread(near.median), self.images)
        # A nearer cluster belongs to the scene if it flickers and continues a neighbour's surface,
        # or if nothing returns in the rest of the time.
        is_usual = near.share >= MIN_CLUSTER_SHARE
        before_nothing = (far.median == 0) & (near.share >= MIN_OPEN_SHARE)
        is_second = flickers & is_usual & (mark_continuation(near, far.median) | before_nothing)
        nothing = np.zeros(model.shape, np.float32)
        no_mode = PixelMode(
            median=np.full_like(nothing, np.nan),
            spread=nothing,
            share=nothing,
            least=nothing,
            greatest=nothing,
        )
        other = near.where(is_second, no_mode)
        is_swapped = other.share > far.share  # the more frequent one becomes `first`
        first = other.where(is_swapped, far)
        second = far.where(is_swapped, other)
        return EmptyScene(
            self.sensor.name,
            model,
            first=first.median,
            spread=first.spread,
            share=first.share,
            second=second.median,
            second_spread=second.spread,
            second_share=second.share,
            frames=self.frames,
        )

    def _find_modes(self) -> tuple[PixelMode, PixelMode, ImageMask]:
        """Find the farthest and the nearer cluster of all pixels, a block of rows at a time.

        Returns both, and a mask of the pixels whose nearer cluster comes and goes."""
        rows, columns = self.sensor.model.shape
        block_rows = max(1, BLOCK_VALUES // (len(self.images) * columns))
        images = np.stack(self.images)
        far_blocks = []
        near_blocks = []
        flicker_blocks = []
        for top in range(0, rows, block_rows):
            block = images[:, top : top + block_rows]
            far, near, flickers = find_clusters(block, self.sensor.model)
            far_blocks.append(far)
            near_blocks.append(near)
            flicker_blocks.append(flickers)
        return _stack_modes(far_blocks), _stack_modes(near_blocks), np.concatenate(flicker_blocks)


def _stack_modes(blocks: Sequence[PixelMode]) -> PixelMode:
    """Join the clusters of blocks of rows, top first, into clusters of the whole image."""
    # zip gathers the same image (medians, spreads, ...) of all blocks
    return PixelMode(*map(np.concatenate, zip(*blocks, strict=True)))


def learn_empty_scenes(
    recording: Frames, sample: int = MAX_SCENE_IMAGES, *, frames: int | None = None
) -> tuple[EmptyScene, ...]:
    """Learn the empty scene of every sensor of a recording of images, in order of the sensors.

    Args:
        recording: frames of images.
        sample: largest number of images of each sensor, evenly spread over the frames.
        frames: number of first frames to learn from, all if None.

    Raises ValueError without frames, and for frames of clouds."""
    count = min(len(recording), len(recording) if frames is None else frames)
    if count < 1:
        raise ValueError(
            f"there must be a frame to learn the empty scene from, got {frames} of {len(recording)}"
        )
    learners: list[SceneLearner] = []
    # evenly spread over the frames; np.unique removes repetitions
    for frame_index in np.unique(np.linspace(0, count - 1, min(sample, count)).astype(int)):
        frame = recording[int(frame_index)]
        if not learners:
            learners = [SceneLearner(sensor, max(sample, 2)) for sensor in frame.sensors]
        for learner, measurement in zip(learners, frame.images, strict=True):
            learner.add(measurement)
    return tuple(learner.scene() for learner in learners)


def describe_model(model: SensorModel) -> dict[str, object]:
    """Describe a sensor model by its class and its numbers (None left out), for files and
    digests."""
    numbers = {key: value for key, value in asdict(model).items() if value is not None}
    return {"class": type(model).__name__, **numbers}
