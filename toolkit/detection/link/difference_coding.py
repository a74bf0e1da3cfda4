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
