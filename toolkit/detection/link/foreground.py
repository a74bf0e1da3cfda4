"""`Foreground`: sensors send only what stands out from their empty scene.

The centre knows the empty scenes, draws them into all other pixels, and all points go through the
detector together, as in early fusion. A pixel in the crop stands out if its measurement is farther
than some spreads from both medians of the scene. A pixel is missing if the centre would draw a
point of the empty scene but the sensor measures no point in the crop: nothing returned, or an
object is close to the sensor. Single returns drop out in every image, and are better drawn than
sent. Missing pixels are therefore sent only if, within 5 x 5 pixels, at least half of the pixels
that should show the scene are missing too, and at least three or all; and everywhere if all pixels
are missing."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import ClassVar, NamedTuple

import numpy as np

from toolkit.arrays import Float32, ImageMask, ImageRanges, ImageSteps, Int64
from toolkit.calibration.empty_scene import EmptyScene
from toolkit.calibration.pixel_clusters import SCENE_SIGMAS
from toolkit.detection.link import message as wire
from toolkit.detection.link.image_coding import decode_mask, encode_mask, encode_pixels, read_pixels
from toolkit.detection.link.range_images import RangeImages, from_steps, sent_header, to_steps
from toolkit.detection.messages import RangeImage
from toolkit.detection.scheme import Counts, DetectsOnce
from toolkit.detection.view import Captured, Cloud, Fused, Lift, Sent, View
from toolkit.frame import unproject
from toolkit.points import Crop
from toolkit.sensors.sensor import Sensor, is_return

NEIGHBOUR_PX = 2  # to either side that are searched for other missing pixels
MIN_MISSING_NEIGHBOURS = 3  # counting the pixel itself, unless all are missing


class SendsForeground(DetectsOnce):
    """Base of schemes whose sensors send foreground and whose centre detects once in all points.

    step: step of measurements (m); sigmas: spreads of the empty scene within which a measurement
    shows it. Fusing raises ValueError if the view has no scenes or images."""

    # surrogate that predicts the scheme's AP, see `toolkit.detection.scheme.surrogate_name`
    predicted_as: ClassVar[str] = "early"
    step: float
    sigmas: float

    @property
    def codec(self) -> RangeImages:
        """Codec that estimates the mean bits of a foreground message from its points."""
        return RangeImages(self.step)

    def fuse(self, view: View, sensors: Sequence[int], /) -> Fused:
        """Detect in the clouds that the centre restores of the sensors (indices), joined."""
        return view.fuse_points([self.send(view, sensor) for sensor in sensors])

    def sent_points(self, counts: Counts, /) -> Float32[np.ndarray, "C F"]:
        """Return the points on objects that count: only foreground is sent.

        counts: numbers of points of C candidates in F frames."""
        return counts.on_objects

    def send(self, view: View, sensor: int) -> Sent[Cloud]:
        """Send the foreground of a sensor, and restore its cloud at the centre.

        sensor: index of the sensor in the view. The cloud that arrives has the measured points
        first, then the points of the sensor's empty scene (its image without objects) in all pixels
        that were neither sent nor missing."""

        def through() -> tuple[Float32[np.ndarray, "n 3"], int]:
            """Return the points (world frame, m) restored at the centre, and the bits sent."""
            captured = view.captured(sensor)
            scene = view.scene(sensor)
            foreground = standing_out(captured, scene, self.sigmas)
            image = captured.sending(foreground.pixels)
            message, restored = self.exchange(view, sensor, image, missing=foreground.missing)
            sent_points = captured.points(np.where(restored.sent, restored.image, np.float32(0)))
            drawn = draw_scene(captured, scene)
            # the centre draws the scene in all pixels that were neither sent nor missing
            shows_scene = ~(restored.sent | restored.missing).ravel()[drawn.pixels]
            return np.concatenate([sent_points, drawn.points[shows_scene]]), 8 * len(message)

        return view.transmit(sensor, name=self.digest, through=through)

    def exchange(
        self, view: View, sensor: int, image: RangeImage, missing: ImageMask
    ) -> "tuple[bytes, Restored]":
        """Return the message of a sensor, and the image that the centre restores from it.

        Each scheme defines how. sensor: index of the sensor in the view; image: measurements (m) to
        send, 0 in all other pixels; missing: mask of pixels in which the centre must not draw the
        empty scene (the sensor's image without objects)."""
        raise NotImplementedError


@dataclass(frozen=True)
class Foreground(SendsForeground):
    """Early fusion whose sensors send only what differs from a background known to the centre.

    step: step of measurements (m), in whole millimetres; sigmas: number of spreads (standard
    deviations) of the empty scene, above 0, within which a measurement shows it; name: name in
    tables. Raises ValueError for other values."""

    step: float = 0.02
    sigmas: float = SCENE_SIGMAS
    name: str = "foreground"

    def __post_init__(self) -> None:
        wire.step_in_mm(self.step)
        if not 0 < self.sigmas < np.inf:
            raise ValueError(
                f"sigmas must be above 0, got {self.sigmas}: 4 leaves one background pixel in 16000"
            )

    def exchange(
        self, view: View, sensor: int, image: RangeImage, missing: ImageMask
    ) -> "tuple[bytes, Restored]":
        """Return the message of a sensor's foreground, and the image decoded from it again.

        sensor: index of the sensor in the view; image: measurements (m) to send, 0 elsewhere;
        missing: mask of pixels in which the centre must not draw the empty scene."""
        scene = view.scene(sensor)
        message = encode_foreground(image, scene, missing, step=self.step)
        return message, decode_foreground(message, scene)


class Restored(NamedTuple):
    """Image that the centre restores from a message and the empty scene.

    header: header of the message; image: measurements (m), the empty scene's in all pixels that
    were neither sent nor missing, 0 in missing ones; sent, missing: masks of such pixels; steps:
    measurements of sent pixels in whole steps, 0 elsewhere."""

    header: wire.MessageHeader
    image: ImageRanges
    sent: ImageMask
    missing: ImageMask
    steps: ImageSteps


def encode_foreground(
    image: RangeImage, scene: EmptyScene, missing: ImageMask | None = None, *, step: float = 0.02
) -> bytes:
    """Encode the foreground of an image, and its missing pixels, as a message.

    image: measurements (m) of the foreground, every pixel that returns something; missing: mask of
    pixels in which the centre must not draw the empty scene, None for no such pixels; step: step of
    measurements (m). Raises ValueError for the empty scene of another sensor, and for a missing
    pixel that returns something."""
    sent, missing = check_pixels(image, scene, missing)
    steps = to_steps(image.measurement, sent, step)
    content = encode_pixels(steps, mask=sent)
    return write_scene_message(
        wire.MessageKind.FOREGROUND, image, scene, step=step, content=content, missing=missing
    )


def decode_foreground(message: bytes, scene: EmptyScene) -> Restored:
    """Restore an image from a message of `encode_foreground` and the empty scene.

    Raises ValueError for a message that is damaged, of another version or sensor, or made with
    another empty scene."""
    header, content = wire.read_message(message)
    check_scene(header, wire.MessageKind.FOREGROUND, scene)
    pixels = read_pixels(content, start=0, shape=scene.model.shape)
    return restore(header, content, scene, steps=pixels.steps, sent=pixels.mask, end=pixels.end)


def restore(
    header: wire.MessageHeader,
    content: bytes,
    scene: EmptyScene,
    steps: ImageSteps,
    sent: ImageMask,
    end: int,
) -> Restored:
    """Return an image with the empty scene in all pixels that were neither sent nor missing.

    header, content: message, header and the bytes after it; scene: the sensor's image without
    objects; steps: measurements in whole steps, 0 in pixels not sent; sent: mask of sent pixels;
    end: index in `content` at which the sent pixels end. A mask of missing pixels, in which the
    image stays 0, follows unless the content ends there. Raises ValueError if that mask is damaged,
    is empty, marks a sent pixel, or does not end the content."""
    missing = np.zeros(sent.shape, bool)
    if end < len(content):
        missing, end = decode_mask(content, end, sent.shape)
        if end != len(content) or not missing.any() or (missing & sent).any():
            rule = (
                f"missing pixels must not be sent and must end the message: got {missing.sum()} "
                "of them"
            )
            raise ValueError(
                f"{rule}, {(missing & sent).sum()} sent, and {len(content) - end} bytes more"
            )
    measured = from_steps(steps, sent, header.step, scene.model)
    return Restored(header, np.where(sent | missing, measured, scene.first), sent, missing, steps)


def check_pixels(
    image: RangeImage, scene: EmptyScene, missing: ImageMask | None
) -> tuple[ImageMask, ImageMask]:
    """Return two masks, of the pixels to send and of missing pixels, checked to be disjoint.

    image: every pixel that returns something is sent; missing: mask, None for no missing pixels.
    Raises ValueError for the empty scene of another sensor, a mask of another shape, or a missing
    pixel that returns something."""
    if (image.sensor.name, image.sensor.model) != (scene.name, scene.model):
        raise ValueError(
            f"the empty scene is of {scene.name!r}, {scene.model}, the image of "
            f"{image.sensor.name!r}"
        )
    sent = is_return(image.measurement, scene.model.max_range)
    missing = np.zeros(sent.shape, bool) if missing is None else missing
    if missing.shape != sent.shape or (missing & sent).any():
        raise ValueError(
            f"missing pixels are some of {sent.shape} that return nothing, got {missing.shape}: "
            "send 0"
        )
    return sent, missing


def write_scene_message(
    kind: wire.MessageKind,
    image: RangeImage,
    scene: EmptyScene,
    step: float,
    content: bytes,
    missing: np.ndarray,
) -> bytes:
    """Return the bytes of a message that refers to an empty scene.

    image: gives sensor, time and number of the header; step: step of measurements (m); content:
    coded pixels; missing: mask (rows, columns) of missing pixels, coded at the message's end if it
    marks any."""
    header = sent_header(kind, image, step, scene=scene_number(scene))
    coded_missing = encode_mask(missing) if missing.any() else b""
    return wire.write_message(header, content + coded_missing)


def check_scene(header: wire.MessageHeader, kind: wire.MessageKind, scene: EmptyScene) -> None:
    """Raise ValueError if a message has another kind, sensor, shape or empty scene."""
    rows, columns = scene.model.shape
    number = wire.sensor_number(scene.name)
    wire.check_header(
        header, kind, sensor=number, rows=rows, columns=columns, scene=scene_number(scene)
    )


def scene_number(scene: EmptyScene) -> int:
    """Number of an empty scene in messages, from the first 32 bits of its SHA-256."""
    return int(scene.digest[:8], 16)


class DrawnScene(NamedTuple):
    """Points of an empty scene in the crop, with their pixels.

    points: x, y, z (m), lifted like measured points; pixels: flat index (row by row) of each point,
    ascending."""

    points: Float32[np.ndarray, "n 3"]
    pixels: Int64[np.ndarray, " n"]


class StandsOut(NamedTuple):
    """Pixels of an image that differ from the sensor's empty scene.

    pixels: flat indices (row by row, ascending) of the pixels to send; missing: mask of the pixels
    in which the centre must not draw the empty scene."""

    pixels: Int64[np.ndarray, " n"]
    missing: ImageMask


def standing_out(captured: Captured, scene: EmptyScene, sigmas: float = SCENE_SIGMAS) -> StandsOut:
    """Return the pixels of an image that differ from its empty scene, as flat indices.

    The centre fills all other pixels from the scene. So it must also be told which ones the scene
    would show although nothing was measured there: these are `missing`, kept only if their
    neighbours are missing too.

    captured: image, with the crop that selects its points; scene: the sensor's image without
    objects; sigmas: a measurement within this many standard deviations of the scene shows it."""
    measurement = captured.measurement
    shows_scene = scene.shows(measurement, sigmas)
    # captured.pixels are flat indices of the points in the crop, so masks are raveled (as views)
    sent_pixels = np.sort(captured.pixels[~shows_scene.ravel()[captured.pixels]])
    is_drawn = np.zeros(measurement.shape, bool)
    is_drawn.ravel()[draw_scene(captured, scene).pixels] = True
    is_measured = np.zeros(measurement.shape, bool)
    is_measured.ravel()[captured.pixels] = True
    # the centre would draw the scene's point, but none was measured in the crop
    has_return = is_return(measurement, scene.model.max_range)
    is_gone = is_drawn & ~is_measured & (~shows_scene | ~has_return)
    # `shows_scene` is also True for no return if the scene has none now and then: such pixels are
    # no evidence of an object
    is_expected = is_drawn & ~(is_gone & shows_scene)
    return StandsOut(pixels=sent_pixels, missing=keep_neighbours(is_gone, is_expected))


def draw_scene(captured: Captured, scene: EmptyScene) -> DrawnScene:
    """Points that the centre draws for a sensor that sends nothing: its empty scene, cropped.

    captured: image that defines the sensor's pose, the crop and the lift. Results are cached."""
    crop = Crop.from_place(captured.area, captured.height)
    return _crop_scene(scene, captured.sensor, crop, lift=captured.lift)


@lru_cache(maxsize=64)
def _crop_scene(scene: EmptyScene, sensor: Sensor, crop: Crop, lift: Lift | None) -> DrawnScene:
    """Return the points of a sensor's empty scene that are in a crop, with their pixels.

    lift: applied to the points (m) before the crop, None to leave them. The result is cached, so
    its arrays are shared and must never be changed."""
    # xyz: (3, rows, columns); valid: pixels (rows, columns) that have a point
    xyz, valid = unproject(sensor, scene.first)
    points = np.ascontiguousarray(xyz[:, valid].T)
    lifted_points = points if lift is None else lift(points)
    is_kept = crop.holds(lifted_points)
    return DrawnScene(points=lifted_points[is_kept], pixels=np.flatnonzero(valid)[is_kept])


def keep_neighbours(is_gone: ImageMask, is_expected: ImageMask) -> np.ndarray:
    """Return the mask of the gone pixels that have enough gone neighbours within 5 x 5 pixels.

    is_gone: pixels in which the sensor lacks a point of the empty scene; is_expected: pixels that
    should show a point of the scene. Enough are at least half of the expected pixels around, and at
    least `MIN_MISSING_NEIGHBOURS` or all. All gone pixels are kept if every expected one is gone,
    and no pixel if every expected one shows a point."""
    is_missing = is_gone & is_expected
    if not is_missing.any():
        return np.zeros_like(is_gone)
    if is_missing.sum() == is_expected.sum():
        return is_gone
    missing_count = _count_around(is_missing)
    expected_count = _count_around(is_expected)
    is_enough = (missing_count >= MIN_MISSING_NEIGHBOURS) | (missing_count == expected_count)
    return is_gone & (missing_count > 0) & (2 * missing_count >= expected_count) & is_enough


def _count_around(mask: ImageMask) -> ImageSteps:
    """Number of mask pixels in the 5 x 5 square around each pixel, itself included.

    Pixels beyond the image's edges count as unmarked."""
    # Integral image (cumulative sums along both axes, with a row and a column of 0 in front): the
    # sum over a square is the difference of its values at the square's four corners.
    side = 2 * NEIGHBOUR_PX + 1
    padded = np.pad(mask, NEIGHBOUR_PX).astype(np.int64)
    sums = np.pad(padded.cumsum(axis=0).cumsum(axis=1), ((1, 0), (1, 0)))
    return sums[side:, side:] - sums[:-side, side:] - sums[side:, :-side] + sums[:-side, :-side]
