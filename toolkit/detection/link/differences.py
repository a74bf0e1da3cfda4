"""Differences: foreground messages that send only the changes since an earlier one:
docs/reference/message-format.md.

A whole image, an ordinary foreground message, is sent at least every `key_every` messages; those
in between are differences. Each names the message that it refers to, and a checksum of the
`Reference` that sender and reader share after it. A reader without that message refuses the
difference (`MissedReference`) and waits for the next whole image. A difference refers to

    previous   the message before it: the smallest, but a lost message makes all messages useless
               until the next whole image
    key        the last whole image: losing a difference affects no other; for links that lose
               messages

A `Reference` has for every pixel of the last message the mean of its measurements since it last
changed, so that noise averages out. Moving surfaces are better predicted from their neighbours,
still ones from the reference; the sender chooses by squares of 8 x 8 pixels. All arithmetic is in
whole numbers, so that both agree on every machine."""

import struct
import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np

from toolkit.arrays import Bool, ImageMask, ImageSteps
from toolkit.calibration.empty_scene import EmptyScene
from toolkit.calibration.pixel_clusters import SCENE_SIGMAS
from toolkit.detection.codec import RangeImage
from toolkit.detection.link import foreground, image_coding as coding
from toolkit.detection.link.foreground import Restored
from toolkit.detection.link.message import MessageKind, read_message, step_in_mm
from toolkit.detection.link.range_images import to_steps
from toolkit.detection.view import View

RefersTo = Literal["previous", "key"]
REFERS_TO: tuple[RefersTo, ...] = ("previous", "key")
DEFAULT_KEY_EVERY = 10  # messages from one whole image to the next, a second at 10 Hz
MAX_BACK = 255  # messages that a difference refers back
MIN_STILL_PX = 200  # with fewer, a whole image may be smaller
_REFERS = struct.Struct("<BBI")
SQUARE_PX = 8  # side of a square
MAX_STILL_MM = 80  # difference of a still pixel from the reference
MIN_STILL_SHARE = 0.6  # share of still pixels in a still square
MAX_MEAN_IMAGES = 8  # in a mean
_FINE_BITS = 4
_FINE = 1 << _FINE_BITS  # parts of a step


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
        self._reference: Reference | None = None
        self._key = 0

    def write(self, image: RangeImage, missing: ImageMask | None = None) -> bytes:
        """Write the next message. Arguments as in
        `toolkit.detection.link.foreground.encode_foreground`.

        The image is sent whole when due, when that is smaller because few pixels are still, and
        when numbers do not continue."""
        sent, missing = foreground.check_pixels(image, self.scene, missing)
        steps = to_steps(image.measurement, sent, self.step)
        reference = self._reference
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
            self._reference = Reference.of(image.number, step_in_mm(self.step), steps, sent)
        else:
            kind = MessageKind.DIFFERENCE
            content = difference
            if self.refers_to == "previous":
                self._reference = reference.after(image.number, steps, sent)
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
            self._reference = Reference.of(
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


@dataclass(frozen=True, eq=False)
class Reference:
    """Shared state of sender and reader after message `number`.

    fine: mean measurement of every pixel in 16ths of a step; images: number of averaged images, 0
    for pixels that the last message did not send."""

    number: int
    step_mm: int
    fine: ImageSteps
    images: ImageSteps

    @staticmethod
    def of(number: int, step_mm: int, steps: ImageSteps, sent: ImageMask) -> "Reference":
        """Start from an image that was sent whole."""
        return Reference(number, step_mm, _FINE * steps, sent.astype(np.int64))

    @cached_property
    def checksum(self) -> int:
        """CRC-32 of the state that sender and reader share."""
        pixels = np.flatnonzero(self.images)
        parts = (
            np.array([self.number, self.step_mm]),
            pixels,
            self.fine.ravel()[pixels],
            self.images.ravel()[pixels],
        )
        return zlib.crc32(np.concatenate(parts).astype("<i8").tobytes())

    @cached_property
    def known(self) -> ImageMask:
        """Mask of the pixels it has."""
        return self.images > 0

    @cached_property
    def whole_steps(self) -> ImageSteps:
        """Mean measurements in whole steps, halves rounded up."""
        return (self.fine + _FINE // 2) >> _FINE_BITS

    def after(self, number: int, steps: ImageSteps, sent: ImageMask) -> "Reference":
        """Return the state after one more image; means restart in pixels that moved."""
        is_still = self.standing(steps, sent)[sent]
        images = self.images[sent]
        measured = _FINE * steps[sent]
        images = np.where(is_still, np.minimum(images + 1, MAX_MEAN_IMAGES), 1)
        before = self.fine[sent]
        moved = np.where(is_still, before + (measured - before + images // 2) // images, measured)
        fine = np.zeros_like(self.fine)
        counts = np.zeros_like(self.images)
        fine[sent] = moved
        counts[sent] = images
        return Reference(number, self.step_mm, fine, counts)

    def standing(self, steps: ImageSteps, sent: ImageMask) -> ImageMask:
        """Mask of sent pixels that measure what the reference predicts."""
        max_steps = max(1, (MAX_STILL_MM + self.step_mm // 2) // self.step_mm)
        return sent & self.known & (np.abs(steps - self.whole_steps) <= max_steps)

    def predict(self, pixels: ImageMask) -> tuple[np.ndarray, np.ndarray]:
        """Mean in whole steps, and its rounding: 1 if rounded down, -1 if up."""
        fine = self.fine[pixels]
        mean_steps = self.whole_steps[pixels]
        return mean_steps, np.where(fine >= _FINE * mean_steps, 1, -1)


def still_squares(
    reference: Reference, steps: ImageSteps, sent: ImageMask
) -> Bool[np.ndarray, "down across"]:
    """Mark squares that the reference predicts better than neighbours do."""
    return _count_pixels(reference.standing(steps, sent)) > MIN_STILL_SHARE * _count_pixels(
        reference.known
    )


def encode_difference(
    steps: ImageSteps,
    sent: ImageMask,
    reference: Reference,
    squares: Bool[np.ndarray, "down across"],
) -> bytes:
    """Encode the sent pixels. squares: still squares.

    Raises ValueError for steps beyond 0 to 2^24 - 1, and for another shape."""
    if steps.shape != reference.fine.shape:
        raise ValueError(
            f"the reference is an image of {reference.fine.shape}, got one of {steps.shape}"
        )
    has_known = _count_pixels(reference.known) > 0
    is_still = reference.known & _spread(squares, steps.shape)
    by_reference = sent & is_still
    mean_steps, signs = reference.predict(by_reference)
    residuals = signs * (steps[by_reference] - mean_steps)
    return (
        coding.write_bits(squares[has_known].astype(np.int64), 1)
        + coding.encode_mask(sent ^ is_still)
        + coding.pack_integers(coding.fold(residuals))
        + coding.encode_values(steps, sent & ~is_still, by_reference)
    )


def decode_difference(
    content: bytes, start: int, reference: Reference
) -> tuple[ImageSteps, ImageMask, int]:
    """Decode the pixels that begin at `start`: steps (0 if not sent), mask of sent pixels, and end.

    Raises ValueError for bytes that `encode_difference` does not write."""
    shape = (int(reference.fine.shape[0]), int(reference.fine.shape[1]))
    has_known = _count_pixels(reference.known) > 0
    square_bits, start = coding.read_bits(content, start, np.ones(int(has_known.sum()), np.int64))
    squares = np.zeros(has_known.shape, bool)
    squares[has_known] = square_bits.astype(bool)
    is_still = reference.known & _spread(squares, shape)
    differs, start = coding.decode_mask(content, start, shape)
    sent = differs ^ is_still
    by_reference = sent & is_still
    residuals, start = coding.unpack_integers(content, start, sent.size)
    if len(residuals) != by_reference.sum():
        raise ValueError(f"{by_reference.sum()} pixels stand still, got {len(residuals)} residuals")
    steps = np.zeros(shape, np.int64)
    mean_steps, signs = reference.predict(by_reference)
    measured = steps[by_reference] = mean_steps + signs * coding.unfold(residuals)
    if len(measured) and not (measured.min() >= 0 and measured.max() < coding.MAX_RANGE_STEPS):
        raise ValueError("measurements out of range: the message is damaged")
    neighbour_steps, end = coding.decode_values(
        content, start, sent & ~is_still, (steps, by_reference)
    )
    return steps + neighbour_steps, sent, end


def _count_pixels(mask: np.ndarray) -> np.ndarray:
    """Count the pixels of a mask in each square."""
    rows, columns = mask.shape
    row, column = np.nonzero(mask)
    down = -(-rows // SQUARE_PX)
    across = -(-columns // SQUARE_PX)
    counts = np.bincount(row // SQUARE_PX * across + column // SQUARE_PX, minlength=down * across)
    return counts.reshape(down, across)


def _spread(squares: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    """Mask of all pixels of some squares."""
    return squares.repeat(SQUARE_PX, axis=0).repeat(SQUARE_PX, axis=1)[: shape[0], : shape[1]]


@dataclass(frozen=True)
class ForegroundDifferences(foreground.SendsForeground):
    """Foreground scheme whose messages send only changes: the same points arrive as with
    `Foreground`.

    Pass a memory from view to view (`toolkit.detection.view.View`) when frames are read in order;
    otherwise every image is sent whole. Fields as in `Foreground` and `DifferenceSender`; raises
    ValueError as these do."""

    step: float = 0.02
    refers_to: RefersTo = "previous"
    key_every: int = DEFAULT_KEY_EVERY
    sigmas: float = SCENE_SIGMAS
    name: str = "differences"

    def __post_init__(self) -> None:
        foreground.Foreground(self.step, self.sigmas)
        check_differences(self.refers_to, self.key_every)

    def dependencies(self, number: int, /) -> range:
        """Numbers of messages needed to read one, itself last."""
        key_number = number - number % self.key_every
        return range(
            key_number,
            number + 1,
            1 if self.refers_to == "previous" else max(number - key_number, 1),
        )

    def sent_bits(self, view: View, sensors: Sequence[int], /) -> list[int]:
        """Bits that sensors send of a frame, arrived or not."""
        return [self._send(view, sensor).bits for sensor in sensors]

    def _exchange(
        self, view: View, sensor: int, image: RangeImage, missing: ImageMask
    ) -> tuple[bytes, Restored]:
        def begin() -> tuple[DifferenceSender, DifferenceReader]:
            scene = view.scene(sensor)
            sender = DifferenceSender(
                scene, step=self.step, refers_to=self.refers_to, key_every=self.key_every
            )
            return sender, DifferenceReader(scene)

        sender, reader = view.remember(sensor, self.digest, begin)
        message = sender.write(image, missing)
        return message, reader.read(message)
