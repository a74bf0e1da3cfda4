"""`DifferenceSender` and `DifferenceReader`: foreground messages of one sensor, most of which say only what
differs from an image that arrived before.

A whole image, a foreground message as any other, comes at least every so-many messages; those between are differences.
Each names the message that it refers to, and a checksum of what sender and reader must know after that one: whoever
does not know it, having missed it or another before it, refuses the difference (`MissedReference`) and waits for the
next whole image. A difference refers to

    previous   the message before it: the smallest, but a lost message makes all useless up to the next whole image
    key        the last whole image: a lost difference is lost alone; for links that lose messages

On the wire a difference is, after the header, how many messages back the one lies that it refers to (uint8, from 1),
whether the next difference refers to this one (uint8: 1) or to the same as this (0), the checksum (uint32, CRC-32 of
`Reference`), the pixels (`toolkit.detection.link.difference_coding`), and missing pixels as in a foreground message.
"""

from __future__ import annotations

import struct
from typing import Literal, NamedTuple

import numpy as np

from toolkit.arrays import Bool
from toolkit.calibration.empty_scene import EmptyScene
from toolkit.detection.codec import RangeImage
from toolkit.detection.link.difference_coding import Reference, decode_difference, encode_difference, still_squares
from toolkit.detection.link.foreground import (
    Restored,
    checked_pixels,
    decode_missing,
    drawn_about,
    encode_missing,
    expected_header,
    read_foreground,
    scene_number,
)
from toolkit.detection.link.image_coding import encode_pixels
from toolkit.detection.link.message import MessageKind, check_header, read_message, step_in_mm, write_message
from toolkit.detection.link.range_images import image_header, to_steps

RefersTo = Literal["previous", "key"]
REFERS_TO: tuple[RefersTo, ...] = ("previous", "key")
KEY_EVERY = 10  # messages, a second at 10 Hz
MOST_BACK = 255  # messages
FEW_PIXELS = 200  # pixels that stand, below which a whole image may be smaller
_REFERS = struct.Struct("<BBI")


class MissedReference(ValueError):
    """A difference that refers to a message which the reader does not have: the next whole image can be read again."""


class _Difference(NamedTuple):
    """The content of a message, and how many pixels stand in it."""

    content: bytes
    stands: int


class DifferenceSender:
    """The messages of one sensor. scene: its empty scene; step: of what is measured (m); refers_to: see above;
    key_every: messages from one whole image to the next at most; 1 sends whole images only.

    Raises ValueError where it refers to anything else, and for key_every below 1 or above 255.
    """

    def __init__(
        self, scene: EmptyScene, *, step: float = 0.02, refers_to: RefersTo = "previous", key_every: int = KEY_EVERY
    ) -> None:
        check_differences(refers_to, key_every)
        self.scene, self.step, self.refers_to, self.key_every = scene, step, refers_to, key_every
        self._reference: Reference | None = None
        self._key = 0

    def write(self, image: RangeImage, missing: Bool[np.ndarray, "rows columns"] | None = None) -> bytes:
        """The next message, of what `toolkit.detection.link.foreground.encode_foreground` takes: whole where a whole
        image is due, where few pixels stand and it is smaller, and where the numbers of images do not go on."""
        sent, missing = checked_pixels(image, self.scene, missing)
        steps, mm = to_steps(image.measurement, sent, self.step), step_in_mm(self.step)
        less = self._difference(image, steps, sent)
        content = encode_pixels(steps, sent) if less is None or less.stands < FEW_PIXELS else b""
        if self._reference is None or less is None or 0 < len(content) <= len(less.content):
            kind, self._key = MessageKind.FOREGROUND, image.number
            self._reference = Reference.of(image.number, mm, steps, sent)
        else:
            kind, content = MessageKind.DIFFERENCE, less.content
            if self.refers_to == "previous":
                self._reference = self._reference.after(image.number, steps, sent)
        header = image_header(kind, image, self.step, scene_number(self.scene))
        return write_message(header, content + encode_missing(missing))

    def _difference(self, image: RangeImage, steps: np.ndarray, sent: np.ndarray) -> _Difference | None:
        """What an image differs in, None where it is to be sent whole."""
        reference = self._reference
        if reference is None or not reference.number < image.number < self._key + self.key_every:
            return None
        squares = still_squares(reference, steps, sent)
        if not squares.any():
            return None
        refers = image.number - reference.number, self.refers_to == "previous", reference.checksum
        content = _REFERS.pack(*refers) + encode_difference(steps, sent, reference, squares)
        return _Difference(content, int(reference.standing(steps, sent).sum()))


class DifferenceReader:
    """Reads what a `DifferenceSender` with the same empty scene writes, message after message."""

    def __init__(self, scene: EmptyScene) -> None:
        self.scene = scene
        self._reference: Reference | None = None

    def read(self, message: bytes) -> Restored:
        """The image of a message. Raises `MissedReference` for a difference from what never arrived; ValueError as
        `toolkit.detection.link.foreground.decode_foreground`; the reader stays as it was."""
        header, content = read_message(message)
        if header.kind == MessageKind.FOREGROUND:
            header, steps, sent, missing = read_foreground(message, self.scene)
            self._reference = Reference.of(header.number, header.step_mm, steps, sent)
            return drawn_about(header, self.scene, steps, sent, missing)
        check_header(header, MessageKind.DIFFERENCE, **expected_header(self.scene))
        if len(content) < _REFERS.size:
            raise ValueError(f"a difference has at least {_REFERS.size} bytes of content, got {len(content)}")
        back, goes_on, checksum = _REFERS.unpack_from(content)
        if not back or goes_on > 1:
            raise ValueError(
                f"a difference refers 1 to {MOST_BACK} messages back and goes on or not, got {back}, {goes_on}"
            )
        reference = self._reference
        if reference is None or reference.number != header.number - back or reference.checksum != checksum:
            has = "none" if reference is None else f"what message {reference.number} left"
            raise MissedReference(
                f"message {header.number} refers to message {header.number - back}, of which the reader has {has}: "
                "wait for the next whole image"
            )
        if header.step_mm != reference.step_mm:
            raise ValueError(
                f"a difference has steps of its reference, {reference.step_mm} mm, got {header.step_mm} mm"
            )
        steps, sent, end = decode_difference(content, _REFERS.size, reference)
        restored = drawn_about(header, self.scene, steps, sent, decode_missing(content, end, sent))
        if goes_on:
            self._reference = reference.after(header.number, steps, sent)
        return restored


def check_differences(refers_to: str, key_every: int) -> None:
    """ValueError where these are none of a `DifferenceSender`."""
    if refers_to not in REFERS_TO:
        raise ValueError(f"differences refer to {' or '.join(REFERS_TO)}, got {refers_to!r}")
    whole = isinstance(key_every, int | np.integer) and not isinstance(key_every, bool)
    if not (whole and 1 <= key_every <= MOST_BACK):
        raise ValueError(f"a whole image must come every 1 to {MOST_BACK} messages, got {key_every!r}: such as 10")
