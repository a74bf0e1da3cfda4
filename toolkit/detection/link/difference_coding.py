"""Some pixels of a range image, in whole steps, as what differs from an image that sender and reader know, and back,
exactly.

Both keep a `Reference`: of every pixel that was sent last the mean of what it measured since it last changed, over 8
images at most, in 16ths of a step, so that noise averages out of the prediction. Who moves is predicted from his
neighbours as in an image alone; where somebody stands, the reference is the better prediction. The sender says which by
squares of 8 x 8 pixels. On the wire:

    squares    a bit for each square that holds a pixel of the reference, row after row, filled with zeros to a whole
               byte: 1 where it stands still
    mask       which pixels are sent otherwise than the reference says: those of the squares that stand still
    still      packed: measured less the reference, rounded (half up), of the sent pixels that it knows in these
               squares, as 2r for r >= 0 and -2r - 1 below, r counted towards where the reference was rounded from
    others     packed: the other sent pixels, predicted from the neighbours that are known

Mask and packed numbers are those of `toolkit.detection.link.image_coding`. All arithmetic is in whole numbers, so that
sender and reader agree on every machine.
"""

from __future__ import annotations

import zlib
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from toolkit.arrays import Bool, Int64
from toolkit.detection.link.bit_packing import pack_integers, read_fixed, unpack_integers, write_fixed
from toolkit.detection.link.image_coding import (
    MOST_STEPS,
    decode_mask,
    decode_values,
    encode_mask,
    encode_values,
    folded,
    unfolded,
)

SQUARE = 8  # pixels
STILL_MM = 80  # that a pixel may measure beside the reference and still stand
STILL_SHARE = 0.6  # of the reference's pixels in a square that stand, where it stands still
MOST_IMAGES = 8  # that a mean is of
_FINE = 16  # parts of a step


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

    @property
    def known(self) -> Bool[np.ndarray, "rows columns"]:
        """The pixels it has."""
        return self.images > 0

    @property
    def rounded(self) -> Int64[np.ndarray, "rows columns"]:
        """In whole steps."""
        return (self.fine + _FINE // 2) // _FINE

    def after(
        self, number: int, steps: Int64[np.ndarray, "rows columns"], sent: Bool[np.ndarray, "rows columns"]
    ) -> Reference:
        """After one more image: means go on where pixels stand, and begin anew where they do not."""
        stands = self.standing(steps, sent)
        images = np.where(stands, np.minimum(self.images + 1, MOST_IMAGES), sent)
        share = np.maximum(images, 1)
        moved = self.fine + (_FINE * steps - self.fine + share // 2) // share
        return Reference(number, self.step_mm, np.where(stands, moved, np.where(sent, _FINE * steps, 0)), images)

    def standing(
        self, steps: Int64[np.ndarray, "rows columns"], sent: Bool[np.ndarray, "rows columns"]
    ) -> Bool[np.ndarray, "rows columns"]:
        """The sent pixels that measure what it says."""
        most = max(1, (STILL_MM + self.step_mm // 2) // self.step_mm)
        return sent & self.known & (np.abs(steps - self.rounded) <= most)


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
    residuals = _towards(reference)[by_reference] * (steps - reference.rounded)[by_reference]
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
    steps[by_reference] = reference.rounded[by_reference] + _towards(reference)[by_reference] * unfolded(residuals)
    if by_reference.any() and not (steps[by_reference].min() >= 0 and steps[by_reference].max() < MOST_STEPS):
        raise ValueError("measurements of steps that cannot be: the message is damaged")
    others, end = decode_values(content, start, sent & ~still, (steps, by_reference))
    return steps + others, sent, end


def _towards(reference: Reference) -> np.ndarray:
    """1 where the reference was rounded down, else -1."""
    return np.where(reference.fine >= _FINE * reference.rounded, 1, -1)


def _counted(mask: np.ndarray) -> np.ndarray:
    """How many pixels of a mask lie in each square."""
    rows, columns = mask.shape
    down, across = -(-rows // SQUARE), -(-columns // SQUARE)
    padded = np.zeros((down * SQUARE, across * SQUARE), bool)
    padded[:rows, :columns] = mask
    return padded.reshape(down, SQUARE, across, SQUARE).sum(axis=(1, 3))


def _spread(squares: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    """The mask of all pixels of some squares."""
    return squares.repeat(SQUARE, axis=0).repeat(SQUARE, axis=1)[: shape[0], : shape[1]]
