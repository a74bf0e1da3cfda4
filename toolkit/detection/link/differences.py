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
`Reference`), the pixels (`toolkit.detection.link.differences`), and missing pixels as in a foreground message.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Literal, NamedTuple

import numpy as np

from toolkit.arrays import Bool, Float32, Int64
from toolkit.calibration.empty_scene import SIGMAS, EmptyScene
from toolkit.detection.codec import RangeImage
from toolkit.detection.link.foreground import (
    Foreground,
    Restored,
    SendsForeground,
    checked_pixels,
    decode_missing,
    drawn_about,
    encode_missing,
    expected_header,
    read_foreground,
    restored_points,
    scene_number,
    standing_out,
)
from toolkit.detection.link.image_coding import (
    MOST_STEPS,
    decode_mask,
    decode_values,
    encode_mask,
    encode_pixels,
    encode_values,
    folded,
    pack_integers,
    read_fixed,
    unfolded,
    unpack_integers,
    write_fixed,
)
from toolkit.detection.link.message import MessageKind, check_header, read_message, step_in_mm, write_message
from toolkit.detection.link.range_images import image_header, to_steps
from toolkit.detection.view import View

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


SQUARE = 8  # pixels
STILL_MM = 80  # that a pixel may measure beside the reference and still stand
STILL_SHARE = 0.6  # of the reference's pixels in a square that stand, where it stands still
MOST_IMAGES = 8  # that a mean is of
_FINE_BITS = 4
_FINE = 1 << _FINE_BITS  # parts of a step


@dataclass(frozen=True, eq=False)
class Reference:
    """What sender and reader know. number: of the last message in it; step_mm: of its numbers; fine: mean measurement
    of every pixel in 16ths of a step; images: that it is the mean of, 0 where the last message sent nothing."""

    number: int
    step_mm: int
    fine: Int64[np.ndarray, "rows columns"]
    images: Int64[np.ndarray, "rows columns"]

    @staticmethod
    def of(
        number: int, step_mm: int, steps: Int64[np.ndarray, "rows columns"], sent: Bool[np.ndarray, "rows columns"]
    ) -> Reference:
        """After an image that was sent whole."""
        return Reference(number, step_mm, np.where(sent, _FINE * steps, 0), sent.astype(np.int64))

    @cached_property
    def checksum(self) -> int:
        """CRC-32 of all it holds: sender and reader have the same reference where it is equal."""
        pixels = np.flatnonzero(self.images)
        parts = (np.array([self.number, self.step_mm]), pixels, self.fine.ravel()[pixels], self.images.ravel()[pixels])
        return zlib.crc32(np.concatenate(parts).astype("<i8").tobytes())

    @cached_property
    def known(self) -> Bool[np.ndarray, "rows columns"]:
        """The pixels it has."""
        return self.images > 0

    @cached_property
    def rounded(self) -> Int64[np.ndarray, "rows columns"]:
        """In whole steps."""
        return _rounded(self.fine)

    def after(
        self, number: int, steps: Int64[np.ndarray, "rows columns"], sent: Bool[np.ndarray, "rows columns"]
    ) -> Reference:
        """After one more image: means go on where pixels stand, and begin anew where they do not."""
        stands, images, measured = self.standing(steps, sent)[sent], self.images[sent], _FINE * steps[sent]
        images = np.where(stands, np.minimum(images + 1, MOST_IMAGES), 1)
        before = self.fine[sent]
        moved = np.where(stands, before + (measured - before + images // 2) // images, measured)
        fine, counts = np.zeros_like(self.fine), np.zeros_like(self.images)
        fine[sent], counts[sent] = moved, images
        return Reference(number, self.step_mm, fine, counts)

    def standing(
        self, steps: Int64[np.ndarray, "rows columns"], sent: Bool[np.ndarray, "rows columns"]
    ) -> Bool[np.ndarray, "rows columns"]:
        """The sent pixels that measure what it says."""
        most = max(1, (STILL_MM + self.step_mm // 2) // self.step_mm)
        both = sent & self.known
        stands = both.copy()
        stands[both] = np.abs(steps[both] - _rounded(self.fine[both])) <= most
        return stands


def still_squares(
    reference: Reference, steps: Int64[np.ndarray, "rows columns"], sent: Bool[np.ndarray, "rows columns"]
) -> Bool[np.ndarray, "down across"]:
    """In which squares the reference predicts better than neighbours do."""
    stands = _counted(reference.standing(steps, sent))
    return (stands > 0) & (stands > STILL_SHARE * _counted(reference.known))


def encode_difference(
    steps: Int64[np.ndarray, "rows columns"],
    sent: Bool[np.ndarray, "rows columns"],
    reference: Reference,
    squares: Bool[np.ndarray, "down across"],
) -> bytes:
    """The sent pixels as bytes; squares: those that stand still. Raises ValueError for steps below 0 or from 2^24 on,
    and for an image of another shape."""
    if steps.shape != reference.fine.shape:
        raise ValueError(f"the reference is an image of {reference.fine.shape}, got one of {steps.shape}")
    there = _counted(reference.known) > 0
    still = reference.known & _spread(squares & there, steps.shape)
    by_reference = sent & still
    whole, towards = _predictions(reference, by_reference)
    residuals = towards * (steps[by_reference] - whole)
    return (
        write_fixed(squares[there].astype(np.int64), 1)
        + encode_mask(sent ^ still)
        + pack_integers(folded(residuals))
        + encode_values(steps, sent & ~still, by_reference)
    )


def decode_difference(
    content: bytes, start: int, reference: Reference
) -> tuple[Int64[np.ndarray, "rows columns"], Bool[np.ndarray, "rows columns"], int]:
    """Steps, 0 where none is sent, and which pixels are, that begin at `start`, and where they end. Raises ValueError
    for bytes that `encode_difference` does not write."""
    shape = (int(reference.fine.shape[0]), int(reference.fine.shape[1]))
    there = _counted(reference.known) > 0
    chosen, start = read_fixed(content, start, int(there.sum()), 1)
    squares = np.zeros(there.shape, bool)
    squares[there] = chosen.astype(bool)
    still = reference.known & _spread(squares, shape)
    otherwise, start = decode_mask(content, start, shape)
    sent = otherwise ^ still
    by_reference = sent & still
    residuals, start = unpack_integers(content, start, sent.size)
    if len(residuals) != by_reference.sum():
        raise ValueError(f"{by_reference.sum()} pixels stand still, got {len(residuals)} residuals")
    steps = np.zeros(shape, np.int64)
    whole, towards = _predictions(reference, by_reference)
    measured = steps[by_reference] = whole + towards * unfolded(residuals)
    if len(measured) and not (measured.min() >= 0 and measured.max() < MOST_STEPS):
        raise ValueError("measurements of steps that cannot be: the message is damaged")
    others, end = decode_values(content, start, sent & ~still, (steps, by_reference))
    return steps + others, sent, end


def _rounded(fine: np.ndarray) -> np.ndarray:
    """In whole steps, halves up."""
    return (fine + _FINE // 2) >> _FINE_BITS


def _predictions(reference: Reference, pixels: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Of some pixels the reference in whole steps, and 1 where it was rounded down, else -1."""
    fine = reference.fine[pixels]
    whole = _rounded(fine)
    return whole, np.where(fine >= _FINE * whole, 1, -1)


def _counted(mask: np.ndarray) -> np.ndarray:
    """How many pixels of a mask lie in each square."""
    (rows, columns), (row, column) = mask.shape, np.nonzero(mask)
    down, across = -(-rows // SQUARE), -(-columns // SQUARE)
    counts = np.bincount(row // SQUARE * across + column // SQUARE, minlength=down * across)
    return counts.reshape(down, across)


def _spread(squares: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    """The mask of all pixels of some squares."""
    return squares.repeat(SQUARE, axis=0).repeat(SQUARE, axis=1)[: shape[0], : shape[1]]


@dataclass(frozen=True)
class ForegroundDifferences(SendsForeground):
    """step, sigmas: as of `Foreground`; refers_to, key_every: as of `DifferenceSender`. Raises ValueError as these."""

    step: float = 0.02
    refers_to: RefersTo = "previous"
    key_every: int = KEY_EVERY
    sigmas: float = SIGMAS
    name: str = "differences"

    def __post_init__(self) -> None:
        Foreground(self.step, self.sigmas)
        check_differences(self.refers_to, self.key_every)

    def needed(self, number: int, /) -> range:
        """Which messages, counted from a whole image, must have arrived for one to be read, itself the last.

        >>> ForegroundDifferences(key_every=10).needed(12), ForegroundDifferences(refers_to="key").needed(12)
        (range(10, 13), range(10, 13, 2))
        """
        whole = number - number % self.key_every
        return range(whole, number + 1, 1 if self.refers_to == "previous" else max(number - whole, 1))

    def sent_bits(self, view: View, sensors: Sequence[int], /) -> list[int]:
        """The bits that sensors send of a frame, whether or not they arrive."""
        return [self._transmitted(view, sensor).bits for sensor in sensors]

    def _through(self, view: View, sensor: int) -> tuple[Float32[np.ndarray, "n 3"], int]:
        """The restored cloud of a sensor, and the bits of its message."""
        captured, scene = view.captured(sensor), view.scene(sensor)
        sender, reader = view.remembered(sensor, self.digest, lambda: self._begun(view, sensor))
        out = standing_out(captured, scene, self.sigmas)
        message = sender.write(captured.sending(out.pixels), out.missing)
        return restored_points(captured, scene, reader.read(message))[0], 8 * len(message)

    def _begun(self, view: View, sensor: int) -> tuple[DifferenceSender, DifferenceReader]:
        scene = view.scene(sensor)
        sender = DifferenceSender(scene, step=self.step, refers_to=self.refers_to, key_every=self.key_every)
        return sender, DifferenceReader(scene)
