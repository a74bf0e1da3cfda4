"""Sender and reader of differences: foreground messages with only the changes since another.

A whole image, an ordinary foreground message, is sent at least every `key_every` messages; those
in between are differences. Each names the message that it refers to, and a checksum of the
`Reference` that sender and reader share after it. A reader without that message refuses the
difference (`MissedReference`) and waits for the next whole image. A difference refers to

    previous   the message before it: the smallest, but a lost message makes all messages useless
               until the next whole image
    key        the last whole image: losing a difference affects no other; for links that lose
               messages"""

import struct
from typing import Literal

import numpy as np

from examples.differences.reference import (
    Reference,
    decode_difference,
    encode_difference,
    still_squares,
)
from toolkit.arrays import ImageMask
from toolkit.calibration.empty_scene import EmptyScene
from toolkit.detection.link import foreground, image_coding as coding
from toolkit.detection.link.foreground import Restored
from toolkit.detection.link.message import MessageKind, read_message, step_in_mm
from toolkit.detection.link.range_images import to_steps
from toolkit.detection.messages import RangeImage

RefersTo = Literal["previous", "key"]
REFERS_TO: tuple[RefersTo, ...] = ("previous", "key")
DEFAULT_KEY_EVERY = 10  # messages from one whole image to the next, a second at 10 Hz
MAX_BACK = 255  # messages that a difference refers back
MIN_STILL_PX = 200  # with fewer, a whole image may be smaller
_REFERS = struct.Struct("<BBI")


class MissedReference(ValueError):
    """Difference from a message that the reader does not have."""


class DifferenceSender:
    """Sender of one sensor's messages.

    scene: empty scene of the sensor; step: step of measurements (m); refers_to: see above;
    key_every: maximum number of messages, 1 to 255, from one whole image to the next. Raises
    ValueError for other values."""

    def __init__(
        self,
        scene: EmptyScene,
        *,
        step: float = 0.02,
        refers_to: RefersTo = "previous",
        key_every: int = DEFAULT_KEY_EVERY,
    ) -> None:
        check_differences(refers_to, key_every)
        self.scene = scene
        self.step = step
        self.refers_to = refers_to
        self.key_every = key_every
        self.reference: Reference | None = None
        self._key = 0

    def write(self, image: RangeImage, missing: ImageMask | None = None) -> bytes:
        """Write the next message. Arguments as in
        `toolkit.detection.link.foreground.encode_foreground`.

        The image is sent whole when due, when that is smaller because few pixels are still, and
        when numbers do not continue."""
        sent, missing = foreground.check_pixels(image, self.scene, missing)
        steps = to_steps(image.measurement, sent, self.step)
        reference = self.reference
        difference = b""
        still_count = 0
        if reference is not None and reference.number < image.number < self._key + self.key_every:
            squares = still_squares(reference, steps, sent)
            if squares.any():
                refers = (
                    image.number - reference.number,
                    self.refers_to == "previous",
                    reference.checksum,
                )
                difference = _REFERS.pack(*refers) + encode_difference(
                    steps, sent, reference, squares
                )
                still_count = int(reference.standing(steps, sent).sum())
        whole_image = coding.encode_pixels(steps, sent) if still_count < MIN_STILL_PX else b""
        if (
            reference is None
            or not difference
            or (whole_image and len(whole_image) <= len(difference))
        ):
            kind = MessageKind.FOREGROUND
            content = whole_image
            self._key = image.number
            self.reference = Reference.from_image(image.number, step_in_mm(self.step), steps, sent)
        else:
            kind = MessageKind.DIFFERENCE
            content = difference
            if self.refers_to == "previous":
                self.reference = reference.after(image.number, steps, sent)
        return foreground.write_scene_message(kind, image, self.scene, self.step, content, missing)


class DifferenceReader:
    """Reader of a `DifferenceSender`'s messages with its empty scene."""

    def __init__(self, scene: EmptyScene) -> None:
        self.scene = scene
        self._reference: Reference | None = None

    def read(self, message: bytes) -> Restored:
        """Read the image of a message.

        Raises `MissedReference` for a difference from a message that never arrived, and ValueError
        as `decode_foreground`; the reader then stays as it was."""
        header, content = read_message(message)
        if header.kind == MessageKind.FOREGROUND:
            restored = foreground.decode_foreground(message, self.scene)
            self._reference = Reference.from_image(
                header.number, header.step_mm, restored.steps, restored.sent
            )
            return restored
        foreground.check_scene(header, MessageKind.DIFFERENCE, self.scene)
        if len(content) < _REFERS.size:
            raise ValueError(
                f"a difference has at least {_REFERS.size} bytes of content, got {len(content)}"
            )
        back, goes_on, checksum = _REFERS.unpack_from(content)  # the three fields of a difference
        if not back or goes_on > 1:
            raise ValueError(
                f"a message refers 1 to {MAX_BACK} back and goes on or not, got {back}, {goes_on}"
            )
        reference = self._reference
        if (
            reference is None
            or reference.number != header.number - back
            or reference.checksum != checksum
        ):
            has = "none" if reference is None else f"what message {reference.number} left"
            rule = (
                f"message {header.number} refers to message {header.number - back}, of which the "
                f"reader has {has}"
            )
            raise MissedReference(f"{rule}: wait for the next whole image")
        if header.step_mm != reference.step_mm:
            raise ValueError(
                f"a message has steps of its reference, {reference.step_mm} mm, got "
                f"{header.step_mm} mm"
            )
        restored = foreground.restore(
            header, content, self.scene, *decode_difference(content, _REFERS.size, reference)
        )
        if goes_on:
            self._reference = reference.after(header.number, restored.steps, restored.sent)
        return restored


def check_differences(refers_to: str, key_every: int) -> None:
    """Raise ValueError unless a `DifferenceSender` takes these values."""
    if refers_to not in REFERS_TO:
        raise ValueError(f"differences refer to {' or '.join(REFERS_TO)}, got {refers_to!r}")
    is_whole = isinstance(key_every, int | np.integer) and not isinstance(key_every, bool)
    if not (is_whole and 1 <= key_every <= MAX_BACK):
        raise ValueError(
            f"a whole image must come every 1 to {MAX_BACK} messages, got {key_every!r}: such as 10"
        )
