"""Some pixels of a range image, in whole steps, as bytes and back, exactly.

Which pixels: the places where the mask, read row after row, changes, or those where it differs from both its left
neighbour's and the upper ones' in the same way, whichever takes less; their distances are packed. What they measure is
predicted from pixels before them (left, up, upper left) as in lossless JPEG (LOCO-I, Weinberger, Seroussi and Sapiro,
IEEE Transactions on Image Processing 9, 2000) where these are in the mask too, and else from those that are. On the
wire:

    way        uint8: 0 changes along the rows, 1 changes against left and up
    mask       packed: distance from each change to the next, the first from the pixel before the first
    residuals  packed: measured less predicted, as 2r for r >= 0 and -2r - 1 below, pixel after pixel of the mask

Packed numbers are those of `toolkit.detection.link.bit_packing`.
"""

from __future__ import annotations

import numpy as np

from toolkit.arrays import Bool, Int64
from toolkit.detection.link.bit_packing import pack_integers, unpack_integers

MOST_STEPS = 1 << 24  # of a measurement; 2 cm make it 335 km
_ALONG_ROWS, _LEFT_AND_UP = 0, 1


def encode_pixels(steps: Int64[np.ndarray, "rows columns"], mask: Bool[np.ndarray, "rows columns"]) -> bytes:
    """The pixels of the mask as bytes. Raises ValueError for steps below 0 or from 2^24 on."""
    return encode_mask(mask) + encode_values(steps, mask)


def decode_pixels(
    content: bytes, shape: tuple[int, int]
) -> tuple[Int64[np.ndarray, "rows columns"], Bool[np.ndarray, "rows columns"]]:
    """Steps, 0 outside the mask, and the mask. Raises ValueError for bytes that `encode_pixels` does not write."""
    steps, mask, end = read_pixels(content, 0, shape)
    if end != len(content):
        raise ValueError(
            f"{mask.sum()} pixels are marked, got {mask.sum()} residuals and {len(content) - end} bytes more"
        )
    return steps, mask


def read_pixels(
    content: bytes, start: int, shape: tuple[int, int]
) -> tuple[Int64[np.ndarray, "rows columns"], Bool[np.ndarray, "rows columns"], int]:
    """The same of pixels that begin at `start`, and where they end."""
    mask, start = decode_mask(content, start, shape)
    steps, end = decode_values(content, start, mask)
    return steps, mask, end


def encode_mask(mask: Bool[np.ndarray, "rows columns"]) -> bytes:
    """Which pixels are marked, in the shorter of both ways."""
    ways = [bytes([way]) + pack_integers(_distances(_changes(mask, way))) for way in (_ALONG_ROWS, _LEFT_AND_UP)]
    return min(ways, key=len)


def decode_mask(content: bytes, start: int, shape: tuple[int, int]) -> tuple[Bool[np.ndarray, "rows columns"], int]:
    """The mask that begins at `start`, and where it ends. Raises ValueError for bytes that `encode_mask` does not
    write."""
    rows, columns = shape
    if start >= len(content) or content[start] not in (_ALONG_ROWS, _LEFT_AND_UP):
        raise ValueError("the content of an image begins with 0 or 1: it is damaged or none")
    distances, end = unpack_integers(content, start + 1, rows * columns)
    changes = np.zeros(rows * columns, bool)
    places = np.cumsum(distances) - 1
    if len(distances) and not (distances.min() > 0 and places[-1] < len(changes)):
        raise ValueError(f"changes of the mask lie outside its {rows} x {columns} pixels")
    changes[places] = True
    return _from_changes(changes.reshape(shape), content[start]), end


def encode_values(
    steps: Int64[np.ndarray, "rows columns"],
    mask: Bool[np.ndarray, "rows columns"],
    given: Bool[np.ndarray, "rows columns"] | None = None,
) -> bytes:
    """What the pixels of a mask measure; given: other pixels, which the reader knows already. Raises ValueError for
    steps below 0 or from 2^24 on."""
    values = steps[mask]
    if len(values) and not (values.min() >= 0 and values.max() < MOST_STEPS):
        raise ValueError(f"measurements must be 0 to {MOST_STEPS - 1} steps, got {values.min()} to {values.max()}")
    return pack_integers(folded(values - _predicted(steps, mask, given)))


def decode_values(
    content: bytes,
    start: int,
    mask: Bool[np.ndarray, "rows columns"],
    given: tuple[Int64[np.ndarray, "rows columns"], Bool[np.ndarray, "rows columns"]] | None = None,
) -> tuple[Int64[np.ndarray, "rows columns"], int]:
    """Steps of the pixels of a mask, 0 elsewhere, that begin at `start`, and where they end; given: steps and mask of
    other pixels, which are known. Raises ValueError for bytes that `encode_values` does not write."""
    residuals, end = unpack_integers(content, start, mask.size)
    if len(residuals) != mask.sum():
        raise ValueError(f"{mask.sum()} pixels are marked, got {len(residuals)} residuals")
    return _added_up(mask, unfolded(residuals), given), end


def folded(values: Int64[np.ndarray, " n"]) -> Int64[np.ndarray, " n"]:
    """Whole numbers as such from 0 on, those near 0 first.

    >>> folded(np.array([0, -1, 1, -2]))
    array([0, 1, 2, 3])
    """
    return np.where(values >= 0, 2 * values, -2 * values - 1)


def unfolded(values: Int64[np.ndarray, " n"]) -> Int64[np.ndarray, " n"]:
    """What `folded` made these of."""
    return np.where(values % 2 == 0, values // 2, -(values // 2) - 1)


def _changes(mask: np.ndarray, way: int) -> np.ndarray:
    if way == _ALONG_ROWS:
        return np.diff(mask.ravel(), prepend=False)
    changed = mask.copy()
    changed[1:] ^= mask[:-1]
    up = changed.copy()
    changed[:, 1:] ^= up[:, :-1]
    return changed.ravel()


def _from_changes(changes: np.ndarray, way: int) -> np.ndarray:
    if way == _ALONG_ROWS:
        return np.logical_xor.accumulate(changes.ravel()).reshape(changes.shape)
    return np.logical_xor.accumulate(np.logical_xor.accumulate(changes, axis=1), axis=0)


def _distances(changes: np.ndarray) -> np.ndarray:
    return np.diff(np.flatnonzero(changes), prepend=-1)


def _predicted(steps: np.ndarray, mask: np.ndarray, given: np.ndarray | None = None) -> np.ndarray:
    """Of every pixel of the mask; see `_added_up`, which does the same one after another."""
    at, wide = _padded_places(mask)
    known = np.full((mask.shape[0] + 1) * wide, -1, np.int64)
    if given is not None:
        known[_padded_places(given)[0]] = steps[given]
    values = known[at] = steps[mask]
    left, up, upper_left, upper_right = known[at - 1], known[at - wide], known[at - wide - 1], known[at - wide + 1]
    last = np.concatenate([[0], values[:-1]])[: len(values)]
    less, more = np.minimum(left, up), np.maximum(left, up)
    median = np.clip(left + up - upper_left, less, more)
    corner = np.where(upper_right >= 0, upper_right, np.where(upper_left >= 0, upper_left, last))
    both = np.where(upper_left >= 0, median, (left + up) >> 1)
    single = np.where(up >= 0, up, left)
    return np.where(less >= 0, both, np.where(more >= 0, single, corner))


def _added_up(
    mask: np.ndarray, residuals: np.ndarray, given: tuple[np.ndarray, np.ndarray] | None = None
) -> np.ndarray:
    """Steps from what they differ by from their prediction: each pixel needs those before it."""
    at, wide = _padded_places(mask)
    known = [-1] * ((mask.shape[0] + 1) * wide)
    if given is not None:
        for i, value in zip(_padded_places(given[1])[0].tolist(), given[0][given[1]].tolist(), strict=True):
            known[i] = value
    values = []
    value = 0
    for i, residual in zip(at.tolist(), residuals.tolist(), strict=True):
        left, up, upper_left = known[i - 1], known[i - wide], known[i - wide - 1]
        if left >= 0 and up >= 0:
            less, more = (left, up) if left < up else (up, left)
            if upper_left < 0:
                value = (left + up) >> 1
            elif upper_left >= more:
                value = less
            elif upper_left <= less:
                value = more
            else:
                value = left + up - upper_left
        elif up >= 0:
            value = up
        elif left >= 0:
            value = left
        elif known[i - wide + 1] >= 0:
            value = known[i - wide + 1]
        elif upper_left >= 0:
            value = upper_left
        value += residual
        if not 0 <= value < MOST_STEPS:
            raise ValueError(f"a measurement of {value} steps is none: the message is damaged")
        known[i] = value
        values.append(value)
    steps = np.zeros(mask.shape, np.int64)
    steps[mask] = values
    return steps


def _padded_places(mask: np.ndarray) -> tuple[np.ndarray, int]:
    """Where the pixels of a mask stand, row after row, in an image with a row before and a column on either side, and
    how wide that is."""
    pixels, columns = np.flatnonzero(mask), mask.shape[1]
    return pixels + 2 * (pixels // columns) + columns + 3, columns + 2
