"""Lossless coding of whole numbers and of the pixels of range images:
docs/reference/message-format.md.

A mask is coded by the places where it changes along the rows, or by those where it differs from its
left and upper neighbours, whichever takes less. Measurements are predicted from earlier pixels
(left, up, upper left) as in lossless JPEG (LOCO-I, Weinberger, Seroussi and Sapiro, IEEE
Transactions on Image Processing 9, 2000) if these are in the mask, else from those that are."""

import zlib

import numpy as np

from toolkit.arrays import ImageMask, ImageSteps, Int64

LARGEST = (1 << 32) - 1
# numbers that are their own symbol; bits of the smallest other number
_SMALL = 8
_FIRST_SIZE = 4
_STRATEGIES = (zlib.Z_DEFAULT_STRATEGY, zlib.Z_HUFFMAN_ONLY, zlib.Z_FIXED)


def pack_integers(values: Int64[np.ndarray, " n"]) -> bytes:
    """Pack numbers below 2^32, or raise ValueError."""
    if len(values) and not (values.min() >= 0 and values.max() <= LARGEST):
        raise ValueError(
            f"numbers from 0 to {LARGEST} are packed, got {values.min()} to {values.max()}"
        )
    size = np.frexp(values.astype(np.float64))[1].astype(np.int64)
    low = np.where(values < _SMALL, 0, size - 2)
    second = (values >> low) & 1
    symbols = np.where(values < _SMALL, values, _SMALL + 2 * (size - _FIRST_SIZE) + second)
    content = symbols.astype(np.uint8).tobytes()
    packers = (zlib.compressobj(9, zlib.DEFLATED, -15, 9, strategy) for strategy in _STRATEGIES)
    deflated = min((packer.compress(content) + packer.flush() for packer in packers), key=len)
    return _variable(len(values)) + _variable(len(deflated)) + deflated + write_bits(values, low)


def unpack_integers(data: bytes, start: int, most: int) -> tuple[Int64[np.ndarray, " n"], int]:
    """Unpack numbers that begin at `start`, and return their end. Raises ValueError for more than
    `most` numbers, or bytes that `pack_integers` does not write."""
    count, start = _read_variable(data, start)
    if count > most:
        raise ValueError(f"at most {most} packed numbers are possible, got {count}")
    length, start = _read_variable(data, start)
    opener = zlib.decompressobj(-15)
    try:
        content = opener.decompress(data[start : start + length], count + 1)
    except zlib.error as error:
        raise ValueError(f"packed numbers cannot be inflated ({error})") from None
    if len(content) != count or not opener.eof or opener.unused_data:
        raise ValueError(f"packed numbers inflate to {count} symbols, got {len(content)}")
    symbols = np.frombuffer(content, np.uint8).astype(np.int64)
    if len(symbols) and symbols.max() > _SMALL + 2 * (32 - _FIRST_SIZE) + 1:
        raise ValueError(f"packed numbers have symbols up to {_SMALL + 57}, got {symbols.max()}")
    half, second = np.divmod(symbols - _SMALL, 2)
    low = np.where(symbols < _SMALL, 0, half + _FIRST_SIZE - 2)
    bits, end = read_bits(data, start + length, low)
    return np.where(symbols < _SMALL, symbols, (2 + second << low) | bits), end


def write_bits(values: Int64[np.ndarray, " n"], width: int | Int64[np.ndarray, " n"]) -> bytes:
    """Write the lower `width` bits of each number, highest first."""
    width = np.broadcast_to(width, len(values))
    return np.packbits((np.repeat(values, width) >> _places(width)) & 1).tobytes()


def read_bits(
    data: bytes, start: int, width: Int64[np.ndarray, " n"]
) -> tuple[Int64[np.ndarray, " n"], int]:
    """Read numbers of `write_bits` and their end, or raise ValueError."""
    total = int(width.sum())
    end = start + -(-total // 8)
    if end > len(data):
        raise ValueError(
            f"{total} bits do not fit the {len(data) - start} bytes that follow: the message is "
            "cut off"
        )
    bits = np.unpackbits(np.frombuffer(data, np.uint8, end - start, start)).astype(np.int64)
    if bits[total:].any():
        raise ValueError("the last byte must be filled with zeros: the message is damaged")
    sums = np.concatenate([[0], np.cumsum(bits[:total] << _places(width))])
    ends = np.cumsum(width)
    return sums[ends] - sums[ends - width], end


def _places(width: np.ndarray) -> np.ndarray:
    """Place of every bit in its number, highest first."""
    ends = np.cumsum(width)
    return np.repeat(ends, width) - 1 - np.arange(int(width.sum()))


def _variable(number: int) -> bytes:
    """Write a number as 7 bits a byte, lowest first."""
    out = bytearray()
    while number > 127:
        out.append(number & 127 | 128)
        number >>= 7
    return bytes([*out, number])


def _read_variable(data: bytes, start: int) -> tuple[int, int]:
    number = 0
    for place in range(5):
        if start + place >= len(data):
            break
        byte = data[start + place]
        number |= (byte & 127) << 7 * place
        if byte < 128:
            return number, start + place + 1
    raise ValueError("a number of variable length does not end: the message is cut off or damaged")


MOST_STEPS = 1 << 24  # of a measurement; 2 cm make it 335 km
_ALONG_ROWS = 0
_LEFT_AND_UP = 1


def encode_pixels(steps: ImageSteps, mask: ImageMask) -> bytes:
    """Encode the mask's pixels; ValueError for steps from 2^24 on."""
    return encode_mask(mask) + encode_values(steps, mask)


def decode_pixels(content: bytes, shape: tuple[int, int]) -> tuple[ImageSteps, ImageMask]:
    """Decode steps and mask of pixels, or raise ValueError."""
    steps, mask, end = read_pixels(content, 0, shape)
    if end != len(content):
        raise ValueError(
            f"{mask.sum()} pixels must end the message, got {len(content) - end} bytes more"
        )
    return steps, mask


def read_pixels(
    content: bytes, start: int, shape: tuple[int, int]
) -> tuple[ImageSteps, ImageMask, int]:
    """Decode pixels that begin at `start`, and return their end."""
    mask, start = decode_mask(content, start, shape)
    steps, end = decode_values(content, start, mask)
    return steps, mask, end


def encode_mask(mask: ImageMask) -> bytes:
    """Encode a mask in the shorter of both ways."""
    across = mask.copy()
    across[1:] ^= mask[:-1]
    across[:, 1:] ^= across[:, :-1].copy()
    ways = {_ALONG_ROWS: np.diff(mask.ravel(), prepend=False), _LEFT_AND_UP: across.ravel()}
    packed = {
        way: pack_integers(np.diff(np.flatnonzero(changes), prepend=-1))
        for way, changes in ways.items()
    }
    return min((bytes([way]) + each for way, each in packed.items()), key=len)


def decode_mask(content: bytes, start: int, shape: tuple[int, int]) -> tuple[ImageMask, int]:
    """Decode a mask, and return its end, or raise ValueError."""
    rows, columns = shape
    if start >= len(content) or content[start] not in (_ALONG_ROWS, _LEFT_AND_UP):
        raise ValueError("the content of an image must begin with 0 or 1: it is damaged")
    distances, end = unpack_integers(content, start + 1, rows * columns)
    changes = np.zeros(rows * columns, bool)
    places = np.cumsum(distances) - 1
    if len(distances) and not (distances.min() > 0 and places[-1] < len(changes)):
        raise ValueError(f"changes of the mask lie outside its {rows} x {columns} pixels")
    changes[places] = True
    if content[start] == _ALONG_ROWS:
        return np.logical_xor.accumulate(changes).reshape(shape), end
    return np.logical_xor.accumulate(np.logical_xor.accumulate(changes.reshape(shape), axis=1)), end


def encode_values(steps: ImageSteps, mask: ImageMask, given: ImageMask | None = None) -> bytes:
    """Encode a mask's pixels. given: others, known to the reader. Raises ValueError for steps
    beyond 0 to 2^24 - 1."""
    values = steps[mask]
    if len(values) and not (values.min() >= 0 and values.max() < MOST_STEPS):
        raise ValueError(
            f"measurements must be 0 to {MOST_STEPS - 1} steps, got {values.min()} to "
            f"{values.max()}"
        )
    return pack_integers(fold(values - _predict(steps, mask, given)))


def decode_values(
    content: bytes, start: int, mask: ImageMask, given: tuple[ImageSteps, ImageMask] | None = None
) -> tuple[ImageSteps, int]:
    """Decode steps of a mask's pixels, 0 elsewhere, and return their end. given: steps and mask of
    other known pixels. Raises ValueError for bytes that `encode_values` does not write."""
    residuals, end = unpack_integers(content, start, mask.size)
    if len(residuals) != mask.sum():
        raise ValueError(f"{mask.sum()} pixels are marked, got {len(residuals)} residuals")
    return _add_up(mask, unfold(residuals), given), end


def fold(values: Int64[np.ndarray, " n"]) -> Int64[np.ndarray, " n"]:
    """Map whole numbers to those from 0 on, small first."""
    return np.where(values >= 0, 2 * values, -2 * values - 1)


def unfold(values: Int64[np.ndarray, " n"]) -> Int64[np.ndarray, " n"]:
    """Inverse of `fold`."""
    return np.where(values % 2 == 0, values // 2, -(values // 2) - 1)


def _predict(steps: np.ndarray, mask: np.ndarray, given: np.ndarray | None = None) -> np.ndarray:
    """Predict the mask's pixels at once, as `_add_up` does."""
    at, wide = _pad_places(mask)
    known = np.full((mask.shape[0] + 1) * wide, -1, np.int64)
    if given is not None:
        known[_pad_places(given)[0]] = steps[given]
    values = known[at] = steps[mask]
    left = known[at - 1]
    up = known[at - wide]
    upper_left = known[at - wide - 1]
    upper_right = known[at - wide + 1]
    last = np.concatenate([[0], values[:-1]])[: len(values)]
    less = np.minimum(left, up)
    more = np.maximum(left, up)
    median = np.clip(left + up - upper_left, less, more)
    corner = np.where(upper_right >= 0, upper_right, np.where(upper_left >= 0, upper_left, last))
    both = np.where(upper_left >= 0, median, (left + up) >> 1)
    single = np.where(up >= 0, up, left)
    return np.where(less >= 0, both, np.where(more >= 0, single, corner))


def _add_up(
    mask: np.ndarray, residuals: np.ndarray, given: tuple[np.ndarray, np.ndarray] | None = None
) -> np.ndarray:
    at, wide = _pad_places(mask)
    known = [-1] * ((mask.shape[0] + 1) * wide)
    if given is not None:
        for i, value in zip(
            _pad_places(given[1])[0].tolist(), given[0][given[1]].tolist(), strict=True
        ):
            known[i] = value
    values = list[int]()
    value = 0
    for i, residual in zip(at.tolist(), residuals.tolist(), strict=True):
        left = known[i - 1]
        up = known[i - wide]
        upper_left = known[i - wide - 1]
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
        else:
            value = next(
                (each for each in (up, left, known[i - wide + 1], upper_left) if each >= 0), value
            )
        value += residual
        if not 0 <= value < MOST_STEPS:
            raise ValueError(f"a measurement of {value} steps is none: the message is damaged")
        known[i] = value
        values.append(value)
    steps = np.zeros(mask.shape, np.int64)
    steps[mask] = values
    return steps


def _pad_places(mask: np.ndarray) -> tuple[np.ndarray, int]:
    """Places of a mask's pixels in a padded image, and width."""
    pixels = np.flatnonzero(mask)
    columns = mask.shape[1]
    return pixels + 2 * (pixels // columns) + columns + 3, columns + 2
