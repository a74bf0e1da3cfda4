"""`SensorMonitor`: sensor faults that the fusion centre notices by what the sensor sends.

    silent    the newest measurement is older than `silent_after`, not counting one more than
              `CLOCK_AHEAD` from now
    frozen    `REPEATS` messages have the same pixels with the same distances as the one before
              them: noise makes no two images alike, not even in steps of 8 cm, once they have
              `LEAST_REPEATED` pixels
    blinded   of the pixels where its empty scene returns something, most return nothing, or a
              message of foreground says that they are missing. Also if foreground has hardly a
              pixel although objects that others see stand before its empty scene; so a sensor is
              found that froze while the place was empty.
    shifted   many pixels measure farther than the empty scene. Road users stand before it, never
              behind it, so it is another scene, or seen from elsewhere

The last two need `MESSAGES` messages in a row. An alarm stays until the sensor shows otherwise."""

from collections.abc import Callable
from enum import Enum
from typing import NamedTuple

import numpy as np

from toolkit.arrays import BoxRows, ImageMask, ImageRanges
from toolkit.calibration.empty_scene import HALF, SIGMAS, EmptyScene
from toolkit.sensors.sensor import Sensor, is_return

SILENT_AFTER = 0.5  # s
CLOCK_AHEAD = 0.1  # s, by which a sensor's clock may be ahead of the centre's
LEAST_REPEATED = 50  # pixels of a message whose repetition counts; below this, ask other sensors
REPEATS = 2  # messages that repeat another
MESSAGES = 3  # in a row that show a sensor blind or shifted
BLIND_SHARE = 0.5  # of the pixels that should return something
SHIFTED_SHARE = 0.1  # of the pixels that return something
LEAST_COVERED = (
    100  # pixels that others' objects must cover before a sensor can be found blind to them
)
SEEN_SHARE = 0.1  # share of these pixels below which it shows none
_INSIDE = 0.2  # m: a body may be this much smaller than its box on each side
_BEFORE = 1.0  # m between an object and the scene behind it


class Fault(Enum):
    """Kinds of failure of a sensor."""

    SILENT = "silent"
    FROZEN = "frozen"
    BLINDED = "blinded"
    SHIFTED = "shifted"


class Shown(NamedTuple):
    """Newest data of a sensor, measured at `time` (s). image: 0 where nothing returned or nothing
    was sent; sent: mask of the pixels of a foreground, None for a whole image; missing: mask of
    those it says are missing."""

    time: float
    image: ImageRanges
    sent: ImageMask | None = None
    missing: ImageMask | None = None


class SensorMonitor:
    """Monitor of one sensor.

    scene: its empty scene; start: time from which it should send (s); silent_after: age of its
    newest data (s), above 0, from which it is silent; view: mask of the pixels that it sends at
    all, such as those of its crop, None for all.
    """

    def __init__(
        self,
        scene: EmptyScene,
        *,
        start: float = 0.0,
        silent_after: float = SILENT_AFTER,
        view: ImageMask | None = None,
    ) -> None:
        if not 0 < silent_after < np.inf:
            raise ValueError(
                f"silent_after must be seconds above 0, got {silent_after}: such as {SILENT_AFTER}"
            )
        self._scene = scene
        self._silent_after = silent_after
        self._newest = start
        self._returns = (scene.first > 0) & (scene.share >= HALF)
        self._returns &= True if view is None else view
        self._pixels: ImageRanges | None = None
        self._repeats = self._blind = self._shifted = 0

    def look(
        self, now: float, shown: Shown | None, covered: Callable[[], ImageMask] | None = None
    ) -> Fault | None:
        """Return the fault of the sensor at a time, None without one. shown: newest data, None
        before the first; covered: returns the mask of the pixels where objects that others see
        stand before its empty scene, called only if foreground has hardly a pixel. Raises
        ValueError for an image of another size than the empty scene."""
        if shown is not None and shown.image.shape != self._scene.first.shape:
            size = self._scene.first.shape
            raise ValueError(
                f"sensor {self._scene.name!r} measures {size} pixels, got an image of "
                f"{shown.image.shape}"
            )
        fresh = shown is not None and shown.time <= now + CLOCK_AHEAD
        if shown is not None and fresh and (self._pixels is None or shown.time > self._newest):
            self._newest = shown.time
            there = is_return(shown.image, self._scene.model.max_range)
            there &= True if shown.sent is None else shown.sent
            pixels = np.where(there, shown.image, np.float32(0))
            count = int(there.sum())
            enough = count >= LEAST_REPEATED
            same = self._pixels is not None and enough and np.array_equal(pixels, self._pixels)
            self._repeats = self._repeats + 1 if same else 0
            self._pixels = pixels
            missing = ~there if shown.sent is None else shown.missing
            blind = missing is not None and bool(
                (missing & self._returns).sum() > BLIND_SHARE * self._returns.sum()
            )
            if not blind and shown.sent is not None and covered is not None and not enough:
                expected = covered()
                blind = bool(
                    expected.sum() >= LEAST_COVERED
                    and (there & expected).sum() < SEEN_SHARE * expected.sum()
                )
            self._blind = self._blind + 1 if blind else 0
            shifted = (
                shown.sent is None
                and enough
                and farther(self._scene, pixels).sum() > SHIFTED_SHARE * count
            )
            self._shifted = self._shifted + 1 if shifted else 0
        if not now - self._newest <= self._silent_after + 1e-9:
            return Fault.SILENT
        if self._repeats >= REPEATS:
            return Fault.FROZEN
        if self._blind >= MESSAGES:
            return Fault.BLINDED
        return Fault.SHIFTED if self._shifted >= MESSAGES else None


def farther(scene: EmptyScene, image: ImageRanges) -> ImageMask:
    """Mask of pixels that measure beyond the empty scene."""
    last = np.fmax(scene.first, np.nan_to_num(scene.second))
    spread = np.where(np.nan_to_num(scene.second) > scene.first, scene.second_spread, scene.spread)
    solid = (scene.first > 0) & (np.isnan(scene.second) | (scene.second > 0))
    return np.asarray(solid & (image > last + SIGMAS * spread))


def standing_before(scene: EmptyScene, sensor: Sensor, boxes: BoxRows) -> ImageMask:
    """Mask of pixels in which a sensor must see one of these boxes, or something nearer, before its
    empty scene."""
    nothing = np.float32(np.inf)
    behind = np.where(
        scene.first > 0,
        np.fmin(scene.first, np.where(scene.second > 0, scene.second, nothing)),
        nothing,
    )
    rays = sensor.world_rays.astype(np.float64)
    hit = np.zeros(behind.size, bool)
    for x, y, z, *size, yaw in boxes:
        cos, sin = np.cos(yaw), np.sin(yaw)
        turn = np.array([[cos, sin, 0.0], [-sin, cos, 0.0], [0.0, 0.0, 1.0]])
        start = turn @ (sensor.position - [x, y, z])
        along = turn @ rays
        half = np.maximum(np.array(size) / 2 - _INSIDE, 0.05)[:, None]
        along = np.where(np.abs(along) < 1e-9, 1e-9, along)
        ends = np.stack([(-half - start[:, None]) / along, (half - start[:, None]) / along])
        near = ends.min(axis=0).max(axis=0)
        far = ends.max(axis=0).min(axis=0)
        hit |= (
            (near < far)
            & (near > 0)
            & (near < sensor.model.max_range)
            & (near + _BEFORE < behind.ravel())
        )
    return hit.reshape(behind.shape)
