"""`SensorMonitor`: sensor faults that the fusion centre recognises in a sensor's messages.

    silent    the newest measurement is older than `silent_after`, not counting one more than
              `MAX_CLOCK_AHEAD_S` from now
    frozen    `MIN_REPEATS` messages have the same pixels with the same distances as the one before
              them: noise makes no two images alike, not even in steps of 8 cm, once they have
              `MIN_REPEATED_PX` pixels
    blinded   most of the pixels in which its empty scene returns something return nothing, or a
              message of foreground marks them as missing. Also if foreground has hardly a pixel
              although objects that others see are in front of its empty scene; so a sensor is
              found that froze while the site was empty.
    shifted   many pixels measure farther than the empty scene. Road users are in front of it, never
              behind it, so it is another scene, or seen from another position

The last two need `MIN_FAULTY_MESSAGES` messages in a row. An alarm stays until the sensor shows
otherwise."""

from collections.abc import Callable
from enum import Enum
from typing import NamedTuple

import numpy as np

from toolkit.arrays import BoxRows, ImageMask, ImageRanges
from toolkit.calibration.empty_scene import EmptyScene
from toolkit.calibration.pixel_clusters import MIN_OPEN_SHARE, SCENE_SIGMAS
from toolkit.sensors.sensor import Sensor, is_return

DEFAULT_SILENT_AFTER_S = 0.5
MAX_CLOCK_AHEAD_S = 0.1  # by which a sensor's clock may be ahead of the centre's
MIN_REPEATED_PX = 50  # pixels of a message whose repetition counts; below this, ask other sensors
MIN_REPEATS = 2  # messages in a row that repeat the one before them
MIN_FAULTY_MESSAGES = 3  # messages in a row that show a sensor blind or shifted
MIN_BLIND_SHARE = 0.5  # share of the pixels that should return something
MIN_SHIFTED_SHARE = 0.1  # share of the pixels that return something
MIN_COVERED_PX = 100  # pixels covered by others' objects, for a sensor to be blind to them
MIN_SEEN_SHARE = 0.1  # share of the covered pixels that a sensor must show
_BODY_MARGIN_M = 0.2  # by which a body may be smaller than its box on each side
_SCENE_GAP_M = 1.0  # between an object and the scene behind it


class Fault(Enum):
    """Kinds of failure of a sensor."""

    SILENT = "silent"
    LATE = "late"
    FROZEN = "frozen"
    BLINDED = "blinded"
    SHIFTED = "shifted"


class Shown(NamedTuple):
    """Newest data of a sensor.

    Attributes:
        time: Time of measurement (s).
        image: Measurement of each pixel (m), 0 if it returned nothing or was not sent.
        sent: Mask of the pixels of a foreground, None for a whole image.
        missing: Mask of the pixels that a foreground marks as missing, None for none.
    """

    time: float
    image: ImageRanges
    sent: ImageMask | None = None
    missing: ImageMask | None = None


class SensorMonitor:
    """Monitor of one sensor.

    scene: its empty scene; start: time from which it should send (s); silent_after: age of its
    newest data (s), above 0, from which it is silent; view: mask of the pixels that it ever sends,
    such as the pixels of its crop, None for all."""

    def __init__(
        self,
        scene: EmptyScene,
        *,
        start: float = 0.0,
        silent_after: float = DEFAULT_SILENT_AFTER_S,
        view: ImageMask | None = None,
    ) -> None:
        """Begin without data.

        start: time (s) from which the sensor should send; silent_after: seconds without data after
        which it is silent; view: mask of the pixels to look at, None for all."""
        if not 0 < silent_after < np.inf:
            raise ValueError(
                f"silent_after must be seconds above 0, got {silent_after}: such as "
                f"{DEFAULT_SILENT_AFTER_S}"
            )
        self._scene = scene
        self._silent_after = silent_after
        self._newest_s = start  # time of the newest data
        # pixels that should return something
        self._returns = (scene.first > 0) & (scene.share >= MIN_OPEN_SHARE)
        self._returns &= True if view is None else view
        self._pixels: ImageRanges | None = None
        # numbers of messages in a row
        self._repeats = 0
        self._blind = 0
        self._shifted = 0

    def look(
        self, now: float, newest: Shown | None, covered: Callable[[], ImageMask] | None = None
    ) -> Fault | None:
        """Return the fault of the sensor at a time, None without one.

        now: time (s); newest: newest data, None before the first; covered: returns the mask of the
        pixels in which other sensors see objects between this sensor and its empty scene. It is
        called only if the sensor sent a foreground with hardly a pixel. Raises ValueError for an
        image of another size than the empty scene."""
        if newest is not None and newest.image.shape != self._scene.first.shape:
            size = self._scene.first.shape
            raise ValueError(
                f"sensor {self._scene.name!r} measures {size} pixels, got an image of "
                f"{newest.image.shape}"
            )
        if newest is not None and self._is_new(newest, now):
            self._read(newest, covered)
        # `not <=`, so that a time of NaN is silence, too
        if not now - self._newest_s <= self._silent_after + 1e-9:
            return Fault.SILENT
        if self._repeats >= MIN_REPEATS:
            return Fault.FROZEN
        if self._blind >= MIN_FAULTY_MESSAGES:
            return Fault.BLINDED
        return Fault.SHIFTED if self._shifted >= MIN_FAULTY_MESSAGES else None

    def _is_new(self, newest: Shown, now: float) -> bool:
        """Return True for data that were not read yet, unless they are from the future."""
        if not newest.time <= now + MAX_CLOCK_AHEAD_S:
            return False
        return self._pixels is None or newest.time > self._newest_s

    def _read(self, newest: Shown, covered: Callable[[], ImageMask] | None) -> None:
        """Read new data, and count messages in a row that show the sensor frozen, blind or shifted.

        With `sent`, only part of the pixels was sent (a foreground). covered: returns the mask of
        the pixels in which objects that others see are in front of the empty scene."""
        self._newest_s = newest.time
        is_returned = is_return(newest.image, self._scene.model.max_range)
        is_returned &= True if newest.sent is None else newest.sent
        pixels = np.where(is_returned, newest.image, np.float32(0))
        count = int(is_returned.sum())
        is_enough = count >= MIN_REPEATED_PX
        is_same = self._pixels is not None and is_enough and np.array_equal(pixels, self._pixels)
        self._repeats = self._repeats + 1 if is_same else 0
        self._pixels = pixels
        is_blind = self._misses_returns(newest, is_returned)
        if not is_blind and newest.sent is not None and covered is not None and not is_enough:
            is_blind = _misses_objects(is_returned, covered())
        self._blind = self._blind + 1 if is_blind else 0
        is_shifted = False
        if newest.sent is None and is_enough:
            is_shifted = farther(self._scene, pixels).sum() > MIN_SHIFTED_SHARE * count
        self._shifted = self._shifted + 1 if is_shifted else 0

    def _misses_returns(self, newest: Shown, is_returned: ImageMask) -> bool:
        """Return True if most pixels that should return something are missing.

        is_returned: mask of the pixels with a return. A foreground counts only the pixels that it
        marks as missing."""
        is_missing = ~is_returned if newest.sent is None else newest.missing
        if is_missing is None:
            return False
        missing = (is_missing & self._returns).sum()
        return bool(missing > MIN_BLIND_SHARE * self._returns.sum())


def _misses_objects(is_returned: ImageMask, is_covered: ImageMask) -> bool:
    """Return True if hardly any of the covered pixels returns something.

    is_covered: mask of the pixels in which objects that others see must be; below `MIN_COVERED_PX`
    of them nothing is concluded."""
    if is_covered.sum() < MIN_COVERED_PX:
        return False
    return bool((is_returned & is_covered).sum() < MIN_SEEN_SHARE * is_covered.sum())


def farther(scene: EmptyScene, image: ImageRanges) -> ImageMask:
    """Mask of pixels of an image (m) that measure beyond the empty scene.

    Pixels in which the empty scene does not always return something are left out."""
    # the farther of the two distances that a pixel of the scene may have, and its spread
    last = np.fmax(scene.first, np.nan_to_num(scene.second))
    spread = np.where(np.nan_to_num(scene.second) > scene.first, scene.second_spread, scene.spread)
    solid = (scene.first > 0) & (np.isnan(scene.second) | (scene.second > 0))
    return np.asarray(solid & (image > last + SCENE_SIGMAS * spread))


def standing_before(scene: EmptyScene, sensor: Sensor, boxes: BoxRows) -> ImageMask:
    """Mask of pixels in which a sensor must see a box, or something nearer.

    The empty scene is at least `_SCENE_GAP_M` behind the box there.

    scene: empty scene of the sensor; boxes: rows of centre, size (m) and yaw (rad) in the site's
    frame."""
    nothing = np.float32(np.inf)
    # the nearer of a pixel's two surfaces, of which `first` is only the more frequent
    behind = np.where(
        scene.first > 0,
        np.fmin(scene.first, np.where(scene.second > 0, scene.second, nothing)),
        nothing,
    )
    rays = sensor.world_rays.astype(np.float64)  # ray for a measurement of 1 m; axes: xyz, pixel
    is_hit = np.zeros(behind.size, bool)
    for x, y, z, *size, yaw in boxes:
        cos = np.cos(yaw)
        sin = np.sin(yaw)
        turn = np.array([[cos, sin, 0.0], [-sin, cos, 0.0], [0.0, 0.0, 1.0]])
        # sensor and rays in the frame of the box, then measurements at which rays meet its planes
        start = turn @ (sensor.position - [x, y, z])
        along = turn @ rays
        half = np.maximum(np.array(size) / 2 - _BODY_MARGIN_M, 0.05)[:, None]
        along = np.where(np.abs(along) < 1e-9, 1e-9, along)
        ends = np.stack([(-half - start[:, None]) / along, (half - start[:, None]) / along])
        near = ends.min(axis=0).max(axis=0)
        far = ends.max(axis=0).min(axis=0)
        is_hit |= (
            (near < far)
            & (near > 0)
            & (near < sensor.model.max_range)
            & (near + _SCENE_GAP_M < behind.ravel())
        )
    return is_hit.reshape(behind.shape)
