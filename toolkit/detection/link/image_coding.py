"""Lossless coding of whole numbers and of the pixels of range images:
docs/reference/message-format.md.

A mask is coded by its changes along the rows, or by its differences from the left and upper
neighbours, whichever takes less. Measurements are predicted from earlier pixels (left, up, upper
left) as in lossless JPEG (LOCO-I, Weinberger, Seroussi and Sapiro, IEEE Transactions on Image
Processing 9, 2000) if these are in the mask, else from the ones that are."""

import zlib

import numpy as np

from toolkit.arrays import ImageMask, ImageSteps, Int64

MAX_PACKED = (1 << 32) - 1
_SMALL_NUMBERS = 8  # numbers below it are symbols themselves
_MIN_LARGE_BITS = 4  # bits of the smallest other number
_STRATEGIES = (zlib.Z_DEFAULT_STRATEGY, zlib.Z_HUFFMAN_ONLY, zlib.Z_FIXED)
MAX_RANGE_STEPS = 1 << 24  # in a measurement; 335 km in steps of 2 cm
_ALONG_ROWS = 0
_LEFT_AND_UP = 1


def pack_integers(values: Int64[np.ndarray, " n"]) -> bytes:
    """Pack numbers below 2^32, or raise ValueError."""
    if len(values) and not (values.min() >= 0 and values.max() <= MAX_PACKED):
        raise ValueError(
            f"numbers from 0 to {MAX_PACKED} are packed, got {values.min()} to {values.max()}"
        )
    size = np.frexp(values.astype(np.float64))[1].astype(np.int64)
    low = np.where(values < _SMALL_NUMBERS, 0, size - 2)
    second = (values >> low) & 1
    symbols = np.where(
        values < _SMALL_NUMBERS, values, _SMALL_NUMBERS + 2 * (size - _MIN_LARGE_BITS) + second
    )
    content = symbols.astype(np.uint8).tobytes()
    deflated = min((_deflate(content, strategy) for strategy in _STRATEGIES), key=len)
    return (
        write_varint(len(values)) + write_varint(len(deflated)) + deflated + write_bits(values, low)
    )


def _deflate(content: bytes, strategy: int) -> bytes:
    packer = zlib.compressobj(9, zlib.DEFLATED, -15, 9, strategy)
    return packer.compress(content) + packer.flush()


def unpack_integers(data: bytes, start: int, max_count: int) -> tuple[Int64[np.ndarray, " n"], int]:
    """Unpack numbers that begin at `start`, and return their end.

    Raises ValueError for more than `max_count` numbers, or bytes that `pack_integers` does not
    write."""
    count, start = read_varint(data, start)
    if count > max_count:
        raise ValueError(f"at most {max_count} packed numbers are possible, got {count}")
    length, start = read_varint(data, start)
    opener = zlib.decompressobj(-15)
    try:
        content = opener.decompress(data[start : start + length], count + 1)
    except zlib.error as error:
        raise ValueError(f"packed numbers cannot be inflated ({error})") from None
    if len(content) != count or not opener.eof or opener.unused_data:
        raise ValueError(f"packed numbers inflate to {count} symbols, got {len(content)}")
    symbols = np.frombuffer(content, np.uint8).astype(np.int64)
    if len(symbols) and symbols.max() > _SMALL_NUMBERS + 2 * (32 - _MIN_LARGE_BITS) + 1:
        raise ValueError(
            f"packed numbers have symbols up to {_SMALL_NUMBERS + 57}, got {symbols.max()}"
        )
    half, second = np.divmod(symbols - _SMALL_NUMBERS, 2)
    low = np.where(symbols < _SMALL_NUMBERS, 0, half + _MIN_LARGE_BITS - 2)
    bits, end = read_bits(data, start + length, low)
    return np.where(symbols < _SMALL_NUMBERS, symbols, (2 + second << low) | bits), end


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
    """Position of every bit in its number, highest first."""
    ends = np.cumsum(width)
    return np.repeat(ends, width) - 1 - np.arange(int(width.sum()))


def write_varint(number: int) -> bytes:
    """Write a number as 7 bits a byte, lowest first."""
    out = bytearray()
    while number > 127:
        out.append(number & 127 | 128)
        number >>= 7
    return bytes([*out, number])


def read_varint(data: bytes, start: int) -> tuple[int, int]:
    """Read a number of `write_varint`; return it and the index after it."""
    number = 0
    for byte_index in range(5):
        if start + byte_index >= len(data):
            break
        byte = data[start + byte_index]
        number |= (byte & 127) << 7 * byte_index
        if byte < 128:
            return number, start + byte_index + 1
    raise ValueError("a number of variable length does not end: the message is cut off or damaged")


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
    """Encode a mask by the shorter of the two methods."""
    across = mask.copy()
    across[1:] ^= mask[:-1]
    across[:, 1:] ^= across[:, :-1].copy()
    changes_by_method = {
        _ALONG_ROWS: np.diff(mask.ravel(), prepend=False),
        _LEFT_AND_UP: across.ravel(),
    }
    codes = []
    for method, changes in changes_by_method.items():
        distances = np.diff(np.flatnonzero(changes), prepend=-1)
        codes.append(bytes([method]) + pack_integers(distances))
    return min(codes, key=len)


def decode_mask(content: bytes, start: int, shape: tuple[int, int]) -> tuple[ImageMask, int]:
    """Decode a mask, and return its end, or raise ValueError."""
    rows, columns = shape
    if start >= len(content) or content[start] not in (_ALONG_ROWS, _LEFT_AND_UP):
        raise ValueError("the content of an image must begin with 0 or 1: it is damaged")
    distances, end = unpack_integers(content, start + 1, rows * columns)
    changes = np.zeros(rows * columns, bool)
    positions = np.cumsum(distances) - 1
    if len(distances) and not (distances.min() > 0 and positions[-1] < len(changes)):
        raise ValueError(f"changes of the mask lie outside its {rows} x {columns} pixels")
    changes[positions] = True
    if content[start] == _ALONG_ROWS:
        return np.logical_xor.accumulate(changes).reshape(shape), end
    return np.logical_xor.accumulate(np.logical_xor.accumulate(changes.reshape(shape), axis=1)), end


def encode_values(steps: ImageSteps, mask: ImageMask, known_mask: ImageMask | None = None) -> bytes:
    """Encode a mask's pixels. known_mask: other pixels, known to the reader.

    Raises ValueError for steps beyond 0 to 2^24 - 1."""
    values = steps[mask]
    if len(values) and not (values.min() >= 0 and values.max() < MAX_RANGE_STEPS):
        raise ValueError(
            f"measurements must be 0 to {MAX_RANGE_STEPS - 1} steps, got {values.min()} to "
            f"{values.max()}"
        )
    return pack_integers(fold(values - predict_residuals(steps, mask, known_mask)))


def decode_values(
    content: bytes,
    start: int,
    mask: ImageMask,
    known_pixels: tuple[ImageSteps, ImageMask] | None = None,
) -> tuple[ImageSteps, int]:
    """Decode steps of a mask's pixels, 0 elsewhere, and return their end.

    known_pixels: steps and mask of other known pixels. Raises ValueError for bytes that
    `encode_values` does not write."""
    residuals, end = unpack_integers(content, start, mask.size)
    if len(residuals) != mask.sum():
        raise ValueError(f"{mask.sum()} pixels are marked, got {len(residuals)} residuals")
    return add_residuals(mask, unfold(residuals), known_pixels), end


def fold(values: Int64[np.ndarray, " n"]) -> Int64[np.ndarray, " n"]:
    """Map whole numbers to those from 0 on, small magnitudes first."""
    return np.where(values >= 0, 2 * values, -2 * values - 1)


def unfold(values: Int64[np.ndarray, " n"]) -> Int64[np.ndarray, " n"]:
    """Inverse of `fold`."""
    return np.where(values % 2 == 0, values // 2, -(values // 2) - 1)


def predict_residuals(
    steps: np.ndarray, mask: np.ndarray, known_mask: np.ndarray | None = None
) -> np.ndarray:
    """Predict all of the mask's pixels together, as `add_residuals` does one by one."""
    positions, stride = _pad_places(mask)
    padded = np.full((mask.shape[0] + 1) * stride, -1, np.int64)
    if known_mask is not None:
        padded[_pad_places(known_mask)[0]] = steps[known_mask]
    values = padded[positions] = steps[mask]
    left = padded[positions - 1]
    up = padded[positions - stride]
    upper_left = padded[positions - stride - 1]
    upper_right = padded[positions - stride + 1]
    last = np.concatenate([[0], values[:-1]])[: len(values)]
    lower = np.minimum(left, up)
    higher = np.maximum(left, up)
    median = np.clip(left + up - upper_left, lower, higher)
    corner = np.where(upper_right >= 0, upper_right, np.where(upper_left >= 0, upper_left, last))
    both = np.where(upper_left >= 0, median, (left + up) >> 1)
    single = np.where(up >= 0, up, left)
    return np.where(lower >= 0, both, np.where(higher >= 0, single, corner))


def add_residuals(
    mask: np.ndarray,
    residuals: np.ndarray,
    known_pixels: tuple[np.ndarray, np.ndarray] | None = None,
) -> np.ndarray:
    """Undo `predict_residuals`, pixel by pixel."""
    positions, stride = _pad_places(mask)
    padded = [-1] * ((mask.shape[0] + 1) * stride)
    if known_pixels is not None:
        known_steps, known_mask = known_pixels
        known_positions = _pad_places(known_mask)[0].tolist()
        for position, value in zip(known_positions, known_steps[known_mask].tolist(), strict=True):
            padded[position] = value
    values = list[int]()
    value = 0
    for position, residual in zip(positions.tolist(), residuals.tolist(), strict=True):
        left = padded[position - 1]
        up = padded[position - stride]
        upper_left = padded[position - stride - 1]
        if left >= 0 and up >= 0:
            lower = min(left, up)
            higher = max(left, up)
            if upper_left < 0:
                value = (left + up) >> 1
            elif upper_left >= higher:
                value = lower
            elif upper_left <= lower:
                value = higher
            else:
                value = left + up - upper_left
        else:
            neighbours = (up, left, padded[position - stride + 1], upper_left)
            value = next((neighbour for neighbour in neighbours if neighbour >= 0), value)
        value += residual
        if not 0 <= value < MAX_RANGE_STEPS:
            raise ValueError(f"a measurement of {value} steps is none: the message is damaged")
        padded[position] = value
        values.append(value)
    steps = np.zeros(mask.shape, np.int64)
    steps[mask] = values
    return steps


def _pad_places(mask: np.ndarray) -> tuple[np.ndarray, int]:
    """Positions of a mask's pixels in a padded image, and its width."""
    pixels = np.flatnonzero(mask)
    columns = mask.shape[1]
    return pixels + 2 * (pixels // columns) + columns + 3, columns + 2
