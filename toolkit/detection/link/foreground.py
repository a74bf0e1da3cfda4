"""`Foreground`: sensors send only what stands out from their empty scene.

The centre knows the empty scenes, draws them into all other pixels, and all points go through the
detector together, as in early fusion. `toolkit.detection.link.foreground_pixels` defines the pixels
that are sent. A message is to fit one packet of the radio: if it does not in the finest step,
`encode_in_packet` takes the next coarser one in which it fits."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar, NamedTuple

import numpy as np

from toolkit.arrays import Float32, ImageMask, ImageRanges, ImageSteps
from toolkit.calibration.empty_scene import EmptyScene
from toolkit.calibration.pixel_clusters import SCENE_SIGMAS
from toolkit.detection.link import message as wire
from toolkit.detection.link.foreground_pixels import draw_scene, standing_out
from toolkit.detection.link.image_coding import decode_mask, encode_mask, encode_pixels, read_pixels
from toolkit.detection.link.range_images import (
    BITS_PER_PIXEL,
    RangeImages,
    from_steps,
    sent_header,
    to_steps,
)
from toolkit.detection.messages import RangeImage
from toolkit.detection.scheme import Counts, DetectsOnce
from toolkit.detection.view import Cloud, Fused, Sent, View
from toolkit.exchange.geonetworking import PACKET_BYTES
from toolkit.sensors.sensor import is_return

MAX_STEP_M = 0.32  # coarsest step of a message that does not fit one packet otherwise
FULL_PACKET_PX = 8 * (PACKET_BYTES - wire.OVERHEAD_BYTES) / BITS_PER_PIXEL  # expected, at 2 cm
STEPS_PER_DOUBLING = 2  # from one tried step to the next, the step grows by this root of 2


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

    def sent_points(self, counts: Counts, /) -> Float32[np.ndarray, "candidates frames"]:
        """Return the points on objects that count: only foreground is sent.

        counts: numbers of points of candidates in frames."""
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
            # `pixels`: those to send, which differ from the scene. `missing`: those without a
            # return, in which the centre must be told not to draw the scene
            foreground = standing_out(captured, scene, self.sigmas)
            image = captured.sending(foreground.pixels)
            message, restored = self.exchange(view, sensor, image, missing=foreground.missing)
            sent_points = captured.points(np.where(restored.sent, restored.image, np.float32(0)))
            drawn_scene = draw_scene(captured, scene)
            # the centre draws the scene in all pixels that were neither sent nor missing
            shows_scene = ~(restored.sent | restored.missing).ravel()[drawn_scene.pixels]
            return np.concatenate([sent_points, drawn_scene.points[shows_scene]]), 8 * len(message)

        # calls `through` unless the view has the result for this sensor and digest already
        return view.transmit(sensor, name=self.digest, through=through)

    def exchange(
        self, view: View, sensor: int, image: RangeImage, missing: ImageMask
    ) -> "tuple[bytes, Restored]":
        """Return the message of a sensor, and the image that the centre restores from it.

        Each scheme defines how. sensor: index of the sensor in the view; image: measurements (m) to
        send, 0 in all other pixels; missing: mask of pixels in which the receiver must not restore
        the empty scene (the sensor's image without objects)."""
        raise NotImplementedError


@dataclass(frozen=True)
class Foreground(SendsForeground):
    """Early fusion whose sensors send only what differs from a background known to the centre.

    step: finest step of measurements (m), in whole millimetres; sigmas: number of spreads (standard
    deviations) of the empty scene, above 0, within which a measurement shows it; name: name in
    tables; max_step: coarsest step (m) of messages that do not fit one packet, in whole
    millimetres; `step` or less for one step in all messages. Raises ValueError for other values."""

    step: float = 0.02
    sigmas: float = SCENE_SIGMAS
    name: str = "foreground"
    max_step: float = MAX_STEP_M

    def __post_init__(self) -> None:
        """Raise ValueError for wrong values."""
        wire.step_in_mm(self.step)  # raises for other than whole millimetres
        wire.step_in_mm(self.max_step)
        if not 0 < self.sigmas < np.inf:
            raise ValueError(
                f"sigmas must be above 0, got {self.sigmas}: 4 leaves one background pixel in 16000"
            )

    def sent_points(self, counts: Counts, /) -> Float32[np.ndarray, "candidates frames"]:
        """Return the points on objects that count, at most as many as fill a packet.

        More points are sent in coarser steps, and still take about one packet in all. counts:
        numbers of points of candidates in frames."""
        points = super().sent_points(counts)
        if self.max_step <= self.step:
            return points
        return np.minimum(points, np.float32(FULL_PACKET_PX))

    def exchange(
        self, view: View, sensor: int, image: RangeImage, missing: ImageMask
    ) -> "tuple[bytes, Restored]":
        """Return the message of a sensor's foreground, and the image decoded from it again.

        sensor: index of the sensor in the view; image: measurements (m) to send, 0 elsewhere;
        missing: mask of pixels in which the receiver must not restore the empty scene."""
        scene = view.scene(sensor)
        message = encode_in_packet(image, scene, missing, step=self.step, max_step=self.max_step)
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
    pixels in which the receiver must not restore the empty scene, None for none; step: step of
    measurements (m). Raises ValueError for the empty scene of another sensor, and for a missing
    pixel that returns something."""
    sent, missing = check_pixels(image, scene, missing)
    steps = to_steps(image.measurement, sent, step)
    content = encode_pixels(steps, mask=sent)
    return write_scene_message(
        wire.MessageKind.FOREGROUND, image, scene, step=step, content=content, missing=missing
    )


def encode_in_packet(
    image: RangeImage,
    scene: EmptyScene,
    missing: ImageMask | None = None,
    *,
    step: float = 0.02,
    max_step: float = MAX_STEP_M,
) -> bytes:
    """Encode a foreground in the finest step in which the message fits one packet of the radio.

    Args:
        image: Measurements (m) of the foreground, every pixel that returns something.
        scene: Empty scene of the sensor.
        missing: Mask of pixels in which the centre must not draw the empty scene, None for none.
        step: Finest step of measurements (m).
        max_step: Coarsest step (m), taken if the message fits in no step.

    The step is in the message. Raises ValueError for the empty scene of another sensor, and for a
    missing pixel that returns something."""
    message = b""
    for candidate_step in list_steps(step, max_step):
        message = encode_foreground(image, scene, missing, step=candidate_step)
        if len(message) <= PACKET_BYTES:
            break
    return message


def list_steps(step: float, max_step: float) -> list[float]:
    """Return the steps (m) that a message may have, from the finest to the coarsest.

    step: finest step; max_step: coarsest step, ignored if it is not above the finest. Each is in
    whole millimetres, as are those between.

    >>> list_steps(0.02, 0.05), list_steps(0.08, 0.02)
    ([0.02, 0.028, 0.04, 0.05], [0.08])
    """
    finest_mm = wire.step_in_mm(step)
    coarsest_mm = wire.step_in_mm(max_step)
    steps_mm = [finest_mm]
    while steps_mm[-1] < coarsest_mm:
        next_mm = round(finest_mm * 2 ** (len(steps_mm) / STEPS_PER_DOUBLING))
        steps_mm.append(min(max(next_mm, steps_mm[-1] + 1), coarsest_mm))
    return [step_mm / 1000 for step_mm in steps_mm]


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
    return Restored(
        header,
        image=np.where(sent | missing, measured, scene.first),
        sent=sent,
        missing=missing,
        steps=steps,
    )


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

    kind: kind of message; image: gives sensor, time and number of the header; step: step of
    measurements (m); content: coded pixels; missing: mask (rows, columns) of missing pixels, coded
    at the message's end if it marks any."""
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
