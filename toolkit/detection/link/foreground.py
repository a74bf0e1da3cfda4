"""`Foreground`: every sensor sends what stands out from its empty scene; the centre draws the empty scene, which it
knows, into all other pixels, and the points together go through the detector, as in early fusion.

What stands out: the pixels in the crop that return something which lies farther than `sigmas` spreads from both medians
of the scene. A pixel that returns nothing is not sent: the scene is drawn into it. What is sent arrives within half a
step, for every pixel of every image.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache, partial
from typing import ClassVar, NamedTuple

import numpy as np

from toolkit.arrays import Bool, Float32
from toolkit.calibration.empty_scene import SIGMAS, EmptyScene
from toolkit.detection.codec import RangeImage
from toolkit.detection.link.image_coding import decode_pixels, encode_pixels
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
from toolkit.detection.view import Captured, Lift, View
from toolkit.points import Crop, cropped, unproject
from toolkit.sensors.model import returned
from toolkit.sensors.sensor import Sensor


@dataclass(frozen=True)
class Foreground:
    """Early fusion of clouds whose background the centre knows. step: of what is measured (m); sigmas: spreads of the
    empty scene within which a measurement shows it. Raises ValueError for a step that messages cannot say, and sigmas
    not above 0."""

    step: float = 0.02
    sigmas: float = SIGMAS
    name: str = "foreground"
    sends_points: ClassVar[bool] = True
    sends_boxes: ClassVar[bool] = False
    predicted_as: ClassVar[str] = "early"

    def __post_init__(self) -> None:
        step_in_mm(self.step)
        if not 0 < self.sigmas < np.inf:
            raise ValueError(f"sigmas must be above 0, got {self.sigmas}: 4 leaves one background pixel in 16000")

    @property
    def digest(self) -> str:
        """Name and parameters."""
        return repr(self)

    @property
    def codec(self) -> RangeImages:
        """What says how many bits so many pixels take, in the mean."""
        return RangeImages(self.step)

    def fuse(self, view: View, sensors: Sequence[int], /) -> Fused:
        """Detect once in the restored clouds of all sensors together. Raises ValueError where a sensor's empty scene or
        image is not known."""
        sent = [view.transmit(sensor, self.digest, partial(self._through, view, sensor)) for sensor in sensors]
        centre = view.detect([each.arrived for each in sent])
        return fused(view.suppressed([centre]), [each.bits for each in sent])

    def sent_points(self, counts: Counts, /) -> Float32[np.ndarray, "C F"]:
        """The points on objects that count: others stand out as well, such as people where only vehicles do."""
        return counts.on_objects

    def pooled_beside(self, distance: Float32[np.ndarray, "C O"], radius: float, /) -> None:
        """No boxes are sent."""

    def _through(self, view: View, sensor: int) -> tuple[Float32[np.ndarray, "n 3"], int]:
        """The restored cloud of a sensor, and the bits of its message."""
        captured, scene = view.captured(sensor), view.scene(sensor)
        stands_out = ~scene.shows(captured.measurement, self.sigmas).ravel()[captured.pixels]
        message = encode_foreground(captured.sending(captured.pixels[stands_out]), scene, step=self.step)
        restored = decode_foreground(message, scene)
        return restored_points(captured, scene, restored.image, restored.sent)[0], 8 * len(message)


class Restored(NamedTuple):
    """What the centre has of an image: header of the message; the whole image, the empty scene where nothing was sent;
    which pixels were sent."""

    header: MessageHeader
    image: Float32[np.ndarray, "rows columns"]
    sent: Bool[np.ndarray, "rows columns"]


def encode_foreground(image: RangeImage, scene: EmptyScene, *, step: float = 0.02) -> bytes:
    """The message with all pixels of an image that return something. Raises ValueError where the empty scene is another
    sensor's."""
    if (image.sensor.name, image.sensor.model) != (scene.name, scene.model):
        raise ValueError(f"the empty scene is of {scene.name!r}, {scene.model}, the image of {image.sensor.name!r}")
    sent = returned(image.measurement, scene.model.max_range)
    header = image_header(MessageKind.FOREGROUND, image, step, scene_number(scene))
    return write_message(header, encode_pixels(to_steps(image.measurement, sent, step), sent))


def decode_foreground(message: bytes, scene: EmptyScene) -> Restored:
    """The image that a message and the empty scene make together. Raises ValueError for a message that is damaged, of
    another version or sensor, or was made with another empty scene."""
    header, content = read_message(message)
    rows, columns = scene.model.shape
    expected = {"sensor": sensor_number(scene.name), "rows": rows, "columns": columns, "scene": scene_number(scene)}
    check_header(header, MessageKind.FOREGROUND, **expected)
    steps, sent = decode_pixels(content, (rows, columns))
    return Restored(header, np.where(sent, from_steps(steps, sent, header.step, scene.model), scene.first), sent)


def restored_points(
    captured: Captured,
    scene: EmptyScene,
    image: Float32[np.ndarray, "rows columns"],
    sent: Bool[np.ndarray, "rows columns"],
) -> tuple[Float32[np.ndarray, "n 3"], Float32[np.ndarray, "m 3"]]:
    """The points of a sensor in its crop: of an image where it was sent, of the empty scene elsewhere; and the first of
    them, which were sent, alone. captured: for sensor and crop."""
    drawn, pixels = _drawn(scene, captured.sensor, Crop.of(captured.area, captured.height), captured.lift)
    measured = captured.points(np.where(sent, image, np.float32(0)))
    return np.concatenate([measured, drawn[~sent.ravel()[pixels]]]), measured


def scene_number(scene: EmptyScene) -> int:
    """By which messages say what they were made with."""
    return int(scene.digest[:8], 16)


@lru_cache(maxsize=64)
def _drawn(
    scene: EmptyScene, sensor: Sensor, crop: Crop, lift: Lift | None
) -> tuple[Float32[np.ndarray, "n 3"], np.ndarray]:
    """The points of the empty scene in the crop, and their pixels."""
    if lift is None:
        xyz, pixels = cropped(sensor, scene.first, crop)
        return np.ascontiguousarray(xyz[:, pixels].T), pixels
    xyz, valid = unproject(sensor, scene.first)
    points = lift(np.ascontiguousarray(xyz[:, valid].T))
    kept = crop.holds(points)
    return points[kept], np.flatnonzero(valid)[kept]
