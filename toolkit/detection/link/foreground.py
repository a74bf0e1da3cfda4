"""`Foreground`: every sensor sends what stands out from its empty scene; the centre draws the empty scene, which it
knows, into all other pixels, and the points together go through the detector, as in early fusion.

What stands out, and what is missing of the empty scene, says `toolkit.detection.link.foreground`. What is sent
arrives within half a step, for every pixel of every image. On the wire the missing pixels, where there are any, follow
the measurements, as a mask (`toolkit.detection.link.image_coding`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache, partial
from typing import ClassVar, NamedTuple

import numpy as np

from toolkit.arrays import Bool, Float32, Int64
from toolkit.calibration.empty_scene import SIGMAS, EmptyScene
from toolkit.detection.codec import RangeImage
from toolkit.detection.link.image_coding import decode_mask, encode_mask, encode_pixels, read_pixels
from toolkit.detection.link.message import (
    MessageHeader,
    MessageKind,
    check_header,
    read_message,
    sensor_number,
    step_in_mm,
    write_message,
)
from toolkit.detection.link.range_images import RangeImages, from_steps, image_header, to_steps
from toolkit.detection.scheme import Counts, Fused, fused
from toolkit.detection.view import Captured, Lift, SentCloud, View
from toolkit.points import Crop, cropped, unproject
from toolkit.sensors.sensor import Sensor, returned


class SendsForeground:
    """A scheme whose sensors send what stands out, and whose centre detects once in all of it together."""

    sends_points: ClassVar[bool] = True
    sends_boxes: ClassVar[bool] = False
    predicted_as: ClassVar[str] = "early"

    @property
    def step(self) -> float:
        """Of what is measured (m)."""
        raise NotImplementedError

    @property
    def digest(self) -> str:
        """Name and parameters."""
        return repr(self)

    @property
    def codec(self) -> RangeImages:
        """What says how many bits so many pixels take, in the mean; of a whole image, whatever was sent before."""
        return RangeImages(self.step)

    def fuse(self, view: View, sensors: Sequence[int], /) -> Fused:
        """Detect once in the restored clouds of all sensors together. Raises ValueError where a sensor's empty scene or
        image is not known."""
        sent = [self._transmitted(view, sensor) for sensor in sensors]
        centre = view.detect([each.arrived for each in sent])
        return fused(view.suppressed([centre]), [each.bits for each in sent])

    def sent_points(self, counts: Counts, /) -> Float32[np.ndarray, "C F"]:
        """The points on objects that count: others stand out as well, such as people where only vehicles do."""
        return counts.on_objects

    def pooled_beside(self, distance: Float32[np.ndarray, "C O"], radius: float, /) -> None:
        """No boxes are sent."""

    def _transmitted(self, view: View, sensor: int) -> SentCloud:
        return view.transmit(sensor, self.digest, partial(self._through, view, sensor))

    def _through(self, view: View, sensor: int) -> tuple[Float32[np.ndarray, "n 3"], int]:
        """The restored cloud of a sensor, and the bits of its message."""
        raise NotImplementedError


@dataclass(frozen=True)
class Foreground(SendsForeground):
    """Early fusion of clouds whose background the centre knows. step: of what is measured (m); sigmas: spreads of the
    empty scene within which a measurement shows it. Raises ValueError for a step that messages cannot say, and sigmas
    not above 0."""

    step: float = 0.02
    sigmas: float = SIGMAS
    name: str = "foreground"

    def __post_init__(self) -> None:
        step_in_mm(self.step)
        if not 0 < self.sigmas < np.inf:
            raise ValueError(f"sigmas must be above 0, got {self.sigmas}: 4 leaves one background pixel in 16000")

    def _through(self, view: View, sensor: int) -> tuple[Float32[np.ndarray, "n 3"], int]:
        """The restored cloud of a sensor, and the bits of its message."""
        captured, scene = view.captured(sensor), view.scene(sensor)
        out = standing_out(captured, scene, self.sigmas)
        message = encode_foreground(captured.sending(out.pixels), scene, out.missing, step=self.step)
        return restored_points(captured, scene, decode_foreground(message, scene))[0], 8 * len(message)


class Restored(NamedTuple):
    """What the centre has of an image: header of the message; the whole image, the empty scene where nothing was sent;
    which pixels were sent; which are missing, 0 in the image."""

    header: MessageHeader
    image: Float32[np.ndarray, "rows columns"]
    sent: Bool[np.ndarray, "rows columns"]
    missing: Bool[np.ndarray, "rows columns"]


def encode_foreground(
    image: RangeImage,
    scene: EmptyScene,
    missing: Bool[np.ndarray, "rows columns"] | None = None,
    *,
    step: float = 0.02,
) -> bytes:
    """The message with all pixels of an image that return something, and with those where nothing of the scene is to be
    drawn. Raises ValueError where the empty scene is another sensor's, and a pixel is missing and returns something."""
    sent, missing = checked_pixels(image, scene, missing)
    header = image_header(MessageKind.FOREGROUND, image, step, scene_number(scene))
    content = encode_pixels(to_steps(image.measurement, sent, step), sent)
    return write_message(header, content + encode_missing(missing))


def decode_foreground(message: bytes, scene: EmptyScene) -> Restored:
    """The image that a message and the empty scene make together. Raises ValueError for a message that is damaged, of
    another version or sensor, or was made with another empty scene."""
    header, steps, sent, missing = read_foreground(message, scene)
    return drawn_about(header, scene, steps, sent, missing)


def read_foreground(
    message: bytes, scene: EmptyScene
) -> tuple[
    MessageHeader,
    Int64[np.ndarray, "rows columns"],
    Bool[np.ndarray, "rows columns"],
    Bool[np.ndarray, "rows columns"],
]:
    """Header, measurements in steps, which pixels were sent, and which are missing. Raises ValueError as
    `decode_foreground`."""
    header, content = read_message(message)
    check_header(header, MessageKind.FOREGROUND, **expected_header(scene))
    steps, sent, end = read_pixels(content, 0, scene.model.shape)
    return header, steps, sent, decode_missing(content, end, sent)


def checked_pixels(
    image: RangeImage, scene: EmptyScene, missing: Bool[np.ndarray, "rows columns"] | None
) -> tuple[Bool[np.ndarray, "rows columns"], Bool[np.ndarray, "rows columns"]]:
    """Which pixels of an image are sent, and which are missing. Raises ValueError as `encode_foreground`."""
    if (image.sensor.name, image.sensor.model) != (scene.name, scene.model):
        raise ValueError(f"the empty scene is of {scene.name!r}, {scene.model}, the image of {image.sensor.name!r}")
    sent = returned(image.measurement, scene.model.max_range)
    missing = np.zeros(sent.shape, bool) if missing is None else missing
    if missing.shape != sent.shape or (missing & sent).any():
        raise ValueError(
            f"missing pixels must be some of {sent.shape} that return nothing, got {missing.shape}: send 0 there"
        )
    return sent, missing


def expected_header(scene: EmptyScene) -> dict[str, int]:
    """What the header of every message says that was made with an empty scene."""
    rows, columns = scene.model.shape
    return {"sensor": sensor_number(scene.name), "rows": rows, "columns": columns, "scene": scene_number(scene)}


def encode_missing(missing: Bool[np.ndarray, "rows columns"]) -> bytes:
    """The end of a content: a mask, or nothing where no pixel is missing."""
    return encode_mask(missing) if missing.any() else b""


def decode_missing(content: bytes, start: int, sent: Bool[np.ndarray, "rows columns"]) -> np.ndarray:
    """The missing pixels that begin at `start`. Raises ValueError for bytes that `encode_missing` does not write."""
    if start == len(content):
        return np.zeros(sent.shape, bool)
    missing, end = decode_mask(content, start, sent.shape)
    if end != len(content) or not missing.any() or (missing & sent).any():
        raise ValueError(
            f"missing pixels are some that are not sent, and end the message: got {missing.sum()} of them, "
            f"{(missing & sent).sum()} sent, and {len(content) - end} bytes more"
        )
    return missing


def drawn_about(
    header: MessageHeader,
    scene: EmptyScene,
    steps: Int64[np.ndarray, "rows columns"],
    sent: Bool[np.ndarray, "rows columns"],
    missing: Bool[np.ndarray, "rows columns"],
) -> Restored:
    """The image of what was sent, and of the empty scene where nothing was and nothing is missing."""
    measured = from_steps(steps, sent, header.step, scene.model)
    return Restored(header, np.where(sent | missing, measured, scene.first), sent, missing)


def restored_points(
    captured: Captured, scene: EmptyScene, restored: Restored | None
) -> tuple[Float32[np.ndarray, "n 3"], Float32[np.ndarray, "m 3"]]:
    """The points of a sensor in its crop, of the empty scene where nothing was sent and nothing is missing, or where
    nothing arrived at all (None); and the first of them, which were sent, alone. captured: for sensor and crop."""
    drawn = drawn_scene(captured, scene)
    if restored is None:
        return drawn.points, drawn.points[:0]
    measured = captured.points(np.where(restored.sent, restored.image, np.float32(0)))
    empty = ~(restored.sent | restored.missing).ravel()[drawn.pixels]
    return np.concatenate([measured, drawn.points[empty]]), measured


def scene_number(scene: EmptyScene) -> int:
    """By which messages say what they were made with."""
    return int(scene.digest[:8], 16)


COMPANY = 2  # pixels to either side, among which a missing pixel is looked for company
LEAST_COMPANY = 3  # missing pixels, itself among them, unless all are


class DrawnScene(NamedTuple):
    """The points of an empty scene in the crop (world frame), and their pixels, counted row after row."""

    points: Float32[np.ndarray, "n 3"]
    pixels: Int64[np.ndarray, " n"]


class StandsOut(NamedTuple):
    """pixels: those to be sent, counted row after row, ascending; missing: where nothing is of what the scene has."""

    pixels: Int64[np.ndarray, " n"]
    missing: Bool[np.ndarray, "rows columns"]


def standing_out(captured: Captured, scene: EmptyScene, sigmas: float = SIGMAS) -> StandsOut:
    """What a sensor sends of an image."""
    measured, shows = captured.measurement, scene.shows(captured.measurement, sigmas)
    pixels = np.sort(captured.pixels[~shows.ravel()[captured.pixels]])
    drawn = np.zeros(measured.shape, bool)
    drawn.ravel()[drawn_scene(captured, scene).pixels] = True
    here = np.zeros(measured.shape, bool)
    here.ravel()[captured.pixels] = True
    gone = drawn & ~here & (~shows | ~returned(measured, scene.model.max_range))
    return StandsOut(pixels, _in_company(gone, drawn & ~(gone & shows)))


def drawn_scene(captured: Captured, scene: EmptyScene) -> DrawnScene:
    """What the centre draws of the empty scene of a sensor that sends nothing; captured: for sensor and crop."""
    return _drawn(scene, captured.sensor, Crop.of(captured.area, captured.height), captured.lift)


@lru_cache(maxsize=64)
def _drawn(scene: EmptyScene, sensor: Sensor, crop: Crop, lift: Lift | None) -> DrawnScene:
    if lift is None:
        xyz, pixels = cropped(sensor, scene.first, crop)
        return DrawnScene(np.ascontiguousarray(xyz[:, pixels].T), pixels)
    xyz, valid = unproject(sensor, scene.first)
    points = lift(np.ascontiguousarray(xyz[:, valid].T))
    kept = crop.holds(points)
    return DrawnScene(points[kept], np.flatnonzero(valid)[kept])


def _in_company(gone: Bool[np.ndarray, "rows columns"], expected: Bool[np.ndarray, "rows columns"]) -> np.ndarray:
    """The pixels that are gone together with at least half of the expected ones about them."""
    certain = gone & expected
    if not certain.any():
        return np.zeros_like(gone)
    if certain.sum() == expected.sum():
        return gone
    missing, there = _about(certain), _about(expected)
    enough = (missing >= LEAST_COMPANY) | (missing == there)
    return gone & (missing > 0) & (2 * missing >= there) & enough


def _about(mask: Bool[np.ndarray, "rows columns"]) -> Int64[np.ndarray, "rows columns"]:
    """How many pixels of a mask lie in the square about each pixel."""
    side = 2 * COMPANY + 1
    sums = np.pad(np.pad(mask, COMPANY).astype(np.int64).cumsum(axis=0).cumsum(axis=1), ((1, 0), (1, 0)))
    return sums[side:, side:] - sums[:-side, side:] - sums[side:, :-side] + sums[:-side, :-side]
