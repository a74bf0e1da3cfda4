"""State that sender and reader share, and the coding of an image against it.

A `Reference` has for every pixel of the last message the mean of its measurements since it last
changed, so that noise averages out. Moving surfaces are better predicted from their neighbours,
still ones from the reference; the sender chooses by squares of 8 x 8 pixels. All arithmetic is in
whole numbers, so that both agree on every machine.

The bytes of a difference, after the header that docs/reference/message-format.md describes:

1. How many messages back its reference is (1 byte); 1 if the next difference refers to this
   message, 0 if it refers to the same reference (1 byte); CRC-32 of the reference (4 bytes). The
   CRC is taken over signed 8-byte numbers: number of the reference's last message, step (mm), its
   pixels counted row by row, their means in sixteenths of a step, and the number of images in each
   mean.
2. One bit per square of 8 x 8 pixels that holds a pixel of the reference, row by row, padded to a
   byte: 1 if the square is still.
3. The pixels that are sent, as a mask of the deviations from the reference's pixels in those
   squares.
4. For each sent pixel that is still, its value less the mean rounded half up, folded, counted
   downwards if the mean was rounded up.
5. The other sent pixels, as in an image, predicted from every pixel known by then.
6. Missing pixels, as in a foreground.

After a whole image, each mean is that image. After a difference marked 1, the mean of a pixel that
measures within 8 cm of it (rounded to steps, at least one) moves towards the new value by their
difference in sixteenths, divided by the number of images (at most 8) and rounded half up. Any other
sent pixel restarts, and a pixel that was not sent is forgotten."""

import zlib
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from toolkit.arrays import Bool, ImageMask, ImageSteps
from toolkit.detection.link import image_coding as coding

SQUARE_PX = 8  # side of a square
MAX_STILL_MM = 80  # difference of a still pixel from the reference
MIN_STILL_SHARE = 0.6  # share of still pixels in a still square
MAX_MEAN_IMAGES = 8  # in a mean
_FINE_BITS = 4
_FINE = 1 << _FINE_BITS  # parts of a step


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
    def from_image(number: int, step_mm: int, steps: ImageSteps, sent: ImageMask) -> "Reference":
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
