"""Lossless coding of whole numbers and of the pixels of range images:
docs/reference/message-format.md.

A mask is coded by its changes along the rows, or by its differences from the left and upper
neighbours, whichever takes less. Measurements are predicted from earlier pixels (left, up, upper
left) as in lossless JPEG (LOCO-I, Weinberger, Seroussi and Sapiro, IEEE Transactions on Image
Processing 9, 2000) if these are in the mask, else from the ones that are."""

import zlib
from typing import NamedTuple

import numpy as np

from toolkit.arrays import ImageMask, ImageSteps, Int64

MAX_PACKED = (1 << 32) - 1  # largest number that `pack_integers` takes
# A number becomes a symbol of a byte, which is deflated, and low bits, which are not. Numbers below
# `_SMALL_NUMBERS` are symbols themselves. Symbols of larger numbers give the number of bits and the
# second highest bit; the bits below follow as they are.
_SMALL_NUMBERS = 8
_MIN_LARGE_BITS = 4  # bits of the smallest number that is not a symbol itself
# ways to deflate: the shortest result is sent, and all are inflated alike
_STRATEGIES = (zlib.Z_DEFAULT_STRATEGY, zlib.Z_HUFFMAN_ONLY, zlib.Z_FIXED)
MAX_RANGE_STEPS = 1 << 24  # in a measurement; 335 km in steps of 2 cm
# first byte of a coded mask: changes along the rows, or differences from the neighbours
_ALONG_ROWS = 0
_LEFT_AND_UP = 1


def pack_integers(values: Int64[np.ndarray, " n"]) -> bytes:
    """Pack whole numbers into bytes: count, length of the symbols, symbols, low bits.

    The symbol of a number is one byte, and symbols are deflated. Numbers below `_SMALL_NUMBERS` are
    their symbols. The symbol of a larger number states its count of bits and its second highest
    bit (the highest is 1), and the bits below that follow as they are. Raises ValueError for a
    number below 0 or from 2^32 on."""
    if len(values) and not (values.min() >= 0 and values.max() <= MAX_PACKED):
        raise ValueError(
            f"numbers from 0 to {MAX_PACKED} are packed, got {values.min()} to {values.max()}"
        )
    # number of bits of each value, which is the exponent of the value as a float64
    _, bit_count = np.frexp(values.astype(np.float64))
    bit_count = bit_count.astype(np.int64)
    is_small = values < _SMALL_NUMBERS
    low_count = np.where(is_small, 0, bit_count - 2)  # bits that are not in the symbol
    second_bit = (values >> low_count) & 1
    large_symbols = _SMALL_NUMBERS + 2 * (bit_count - _MIN_LARGE_BITS) + second_bit
    symbols = np.where(is_small, values, large_symbols)
    content = symbols.astype(np.uint8).tobytes()
    deflated_symbols = min((_deflate(content, strategy) for strategy in _STRATEGIES), key=len)
    low_bits = write_bits(values, width=low_count)
    return (
        write_varint(len(values))
        + write_varint(len(deflated_symbols))
        + deflated_symbols
        + low_bits
    )


def _deflate(content: bytes, strategy: int) -> bytes:
    """Deflate bytes in one of `_STRATEGIES`."""
    # greatest effort (level and memory 9), raw: -15 writes no zlib header or checksum
    packer = zlib.compressobj(9, zlib.DEFLATED, -15, 9, strategy)
    return packer.compress(content) + packer.flush()


def unpack_integers(data: bytes, start: int, max_count: int) -> tuple[Int64[np.ndarray, " n"], int]:
    """Return the numbers that `pack_integers` wrote, and the index after their last byte.

    start: index in `data` at which they begin. Raises ValueError for more than `max_count` numbers,
    or bytes that `pack_integers` does not write."""
    count, length_start = read_varint(data, start)
    if count > max_count:
        raise ValueError(f"at most {max_count} packed numbers are possible, got {count}")
    length, symbols_start = read_varint(data, length_start)
    symbols_end = symbols_start + length
    opener = zlib.decompressobj(-15)  # a bare deflate stream, without header and checksum
    try:
        # one byte more than expected: enough to notice excess, without inflating everything
        content = opener.decompress(data[symbols_start:symbols_end], count + 1)
    except zlib.error as error:
        raise ValueError(f"packed numbers cannot be inflated ({error})") from None
    if len(content) != count or not opener.eof or opener.unused_data:
        raise ValueError(f"packed numbers inflate to {count} symbols, got {len(content)}")
    symbols = np.frombuffer(content, np.uint8).astype(np.int64)
    # the largest symbol, for a number of 32 bits whose second highest bit is 1
    max_symbol = _SMALL_NUMBERS + 2 * (32 - _MIN_LARGE_BITS) + 1
    if len(symbols) and symbols.max() > max_symbol:
        raise ValueError(f"packed numbers have symbols up to {max_symbol}, got {symbols.max()}")
    # A small number is its symbol. The symbol of a large one holds how many bits it has, and the
    # second highest bit. (Values for small ones are discarded by both np.where.)
    is_small = symbols < _SMALL_NUMBERS
    extra_bits, second_bit = np.divmod(symbols - _SMALL_NUMBERS, 2)
    low_count = np.where(is_small, 0, extra_bits + _MIN_LARGE_BITS - 2)
    low_bits, end = read_bits(data, start=symbols_end, width=low_count)
    # 2 + second_bit are the two highest bits: the highest is always 1
    return np.where(is_small, symbols, (2 + second_bit << low_count) | low_bits), end


def write_bits(values: Int64[np.ndarray, " n"], width: int | Int64[np.ndarray, " n"]) -> bytes:
    """Write the lower `width` bits of each number, highest first, without gaps.

    width: bits of each number, or of all. The last byte is filled with zeros."""
    width = np.broadcast_to(width, len(values))
    return np.packbits((np.repeat(values, width) >> _bit_exponents(width)) & 1).tobytes()


def read_bits(
    data: bytes, start: int, width: Int64[np.ndarray, " n"]
) -> tuple[Int64[np.ndarray, " n"], int]:
    """Read the numbers that `write_bits` wrote.

    start: index in `data` of the first byte; width: bits of each number. Returns the numbers and
    the index after their last byte. Raises ValueError if the data end early, or the last byte is
    not filled with zeros."""
    total = int(width.sum())
    end = start + -(-total // 8)  # whole bytes, rounded up
    if end > len(data):
        raise ValueError(
            f"{total} bits do not fit the {len(data) - start} bytes that follow: the message is "
            "cut off"
        )
    coded_bytes = np.frombuffer(data, np.uint8, count=end - start, offset=start)
    bits = np.unpackbits(coded_bytes).astype(np.int64)
    if bits[total:].any():
        raise ValueError("the last byte must be filled with zeros: the message is damaged")
    # a number is the sum of its bits times their powers of two: a difference of cumulative sums
    sums = np.concatenate([[0], np.cumsum(bits[:total] << _bit_exponents(width))])
    ends = np.cumsum(width)
    return sums[ends] - sums[ends - width], end


def _bit_exponents(width: np.ndarray) -> np.ndarray:
    """Exponent of two of every bit (0 for the lowest), number after number, highest bit first.

    width: bits of each number."""
    ends = np.cumsum(width)
    return np.repeat(ends, width) - 1 - np.arange(int(width.sum()))


def write_varint(number: int) -> bytes:
    """Write a number from 0 on as 7 bits a byte, lowest first; the highest bit: more follow."""
    out = bytearray()
    while number > 127:
        out.append(number & 127 | 128)
        number >>= 7
    return bytes([*out, number])


def read_varint(data: bytes, start: int) -> tuple[int, int]:
    """Read the number of `write_varint` that begins at index `start`.

    A byte holds 7 bits, the lowest bits first; the highest bit of a byte is set if more
    follow. Returns the number and the index after it. Raises ValueError if it has no last byte."""
    number = 0
    for byte_index in range(5):  # 5 x 7 bits are enough for 32
        if start + byte_index >= len(data):
            break
        byte = data[start + byte_index]
        number |= (byte & 127) << 7 * byte_index
        if byte < 128:  # the highest bit is not set: this is the last byte
            return number, start + byte_index + 1
    raise ValueError("a number of variable length does not end: the message is cut off or damaged")


class CodedPixels(NamedTuple):
    """Pixels decoded from a message: measurements in whole steps, and their mask.

    steps: 0 outside the mask; end: index after the last byte of the pixels in the message."""

    steps: ImageSteps
    mask: ImageMask
    end: int


def encode_pixels(steps: ImageSteps, mask: ImageMask) -> bytes:
    """Encode a mask and the measurements of its pixels.

    steps: measurements in whole steps; mask: pixels to encode. Raises ValueError for steps below 0
    or from 2^24 on."""
    return encode_mask(mask) + encode_values(steps, mask)


def decode_pixels(content: bytes, shape: tuple[int, int]) -> tuple[ImageSteps, ImageMask]:
    """Decode the measurements (steps, 0 outside the mask) and the mask of `encode_pixels`.

    content: exactly the bytes written; shape: rows and columns of the image. Raises ValueError for
    other bytes."""
    pixels = read_pixels(content, start=0, shape=shape)
    if pixels.end != len(content):
        raise ValueError(
            f"{pixels.mask.sum()} pixels must end the message, got "
            f"{len(content) - pixels.end} bytes more"
        )
    return pixels.steps, pixels.mask


def read_pixels(content: bytes, start: int, shape: tuple[int, int]) -> CodedPixels:
    """Decode the pixels of `encode_pixels` that begin at index `start` of the content.

    shape: rows and columns of the image. Raises ValueError for bytes that `encode_pixels` does not
    write."""
    mask, mask_end = decode_mask(content, start, shape)
    steps, end = decode_values(content, mask_end, mask)
    return CodedPixels(steps, mask, end)


def encode_mask(mask: ImageMask) -> bytes:
    """Encode a mask by the shorter of two methods: a byte for the method, then packed distances.

    Either method turns the mask into a mask of changes, and codes the distance of each change from
    the previous one (in pixels, row after row). A change is a pixel that differs from the pixel
    before it, or whose exclusive or with its left, upper and upper left neighbours is True."""
    # the copy keeps the unchanged left neighbours
    neighbour_changes = mask.copy()
    neighbour_changes[1:] ^= mask[:-1]
    neighbour_changes[:, 1:] ^= neighbour_changes[:, :-1].copy()
    changes_by_method = {
        _ALONG_ROWS: np.diff(mask.ravel(), prepend=False),  # a difference of bools is their xor
        _LEFT_AND_UP: neighbour_changes.ravel(),
    }
    codes = []
    for method, changes in changes_by_method.items():
        distances = np.diff(np.flatnonzero(changes), prepend=-1)  # at least 1, also the first
        codes.append(bytes([method]) + pack_integers(distances))
    return min(codes, key=len)


def decode_mask(content: bytes, start: int, shape: tuple[int, int]) -> tuple[ImageMask, int]:
    """Decode the mask of `encode_mask` that begins at index `start` of the content.

    shape: rows and columns of the image. Returns the mask and the index after its last byte. Raises
    ValueError for other bytes."""
    rows, columns = shape
    if start >= len(content) or content[start] not in (_ALONG_ROWS, _LEFT_AND_UP):
        raise ValueError("the content of an image must begin with 0 or 1: it is damaged")
    distances, end = unpack_integers(content, start + 1, max_count=rows * columns)
    changes = np.zeros(rows * columns, bool)
    positions = np.cumsum(distances) - 1
    if len(distances) and not (distances.min() > 0 and positions[-1] < len(changes)):
        raise ValueError(f"changes of the mask lie outside its {rows} x {columns} pixels")
    changes[positions] = True
    # a pixel is set if an odd number of changes precede it, along the rows or left and above
    if content[start] == _ALONG_ROWS:
        return np.logical_xor.accumulate(changes).reshape(shape), end
    along_rows = np.logical_xor.accumulate(changes.reshape(shape), axis=1)
    return np.logical_xor.accumulate(along_rows, axis=0), end


def encode_values(steps: ImageSteps, mask: ImageMask, known_mask: ImageMask | None = None) -> bytes:
    """Encode the measurements of a mask's pixels as differences from their predictions.

    steps: measurements in whole steps, also of known pixels; mask: pixels to encode; known_mask:
    other pixels whose steps the reader knows already and can predict from, None for no such pixels.
    Raises ValueError for steps beyond 0 to 2^24 - 1."""
    values = steps[mask]
    if len(values) and not (values.min() >= 0 and values.max() < MAX_RANGE_STEPS):
        raise ValueError(
            f"measurements must be 0 to {MAX_RANGE_STEPS - 1} steps, got {values.min()} to "
            f"{values.max()}"
        )
    residuals = values - predict_steps(steps, mask, known_mask)
    return pack_integers(fold(residuals))  # packed numbers must not be below 0


def decode_values(
    content: bytes,
    start: int,
    mask: ImageMask,
    known_pixels: tuple[ImageSteps, ImageMask] | None = None,
) -> tuple[ImageSteps, int]:
    """Decode the measurements of a mask's pixels that `encode_values` wrote.

    start: index in `content` at which they begin; mask: pixels that were encoded; known_pixels:
    steps and mask of the other pixels that the writer took as known, None for no such pixels.
    Returns measurements in steps, 0 outside the mask, and the index after the last byte. Raises
    ValueError for bytes that `encode_values` does not write."""
    folded_residuals, end = unpack_integers(content, start, max_count=mask.size)
    if len(folded_residuals) != mask.sum():
        raise ValueError(f"{mask.sum()} pixels are marked, got {len(folded_residuals)} residuals")
    return add_residuals(mask, unfold(folded_residuals), known_pixels), end


def fold(values: Int64[np.ndarray, " n"]) -> Int64[np.ndarray, " n"]:
    """Map whole numbers to numbers from 0 on, small magnitudes first.

    0, -1, 1, -2, 2 become 0, 1, 2, 3, 4."""
    return np.where(values >= 0, 2 * values, -2 * values - 1)


def unfold(values: Int64[np.ndarray, " n"]) -> Int64[np.ndarray, " n"]:
    """Map numbers from 0 on to whole numbers, the inverse of `fold`.

    0, 1, 2, 3, 4 become 0, -1, 1, -2, 2."""
    return np.where(values % 2 == 0, values // 2, -(values // 2) - 1)


def predict_steps(
    steps: np.ndarray, mask: np.ndarray, known_mask: np.ndarray | None = None
) -> np.ndarray:
    """Predict the steps of a mask's pixels from the pixels before them, row after row.

    steps: measurements (rows, columns) in whole steps, 0 or more; mask: pixels (rows, columns) to
    predict; known_mask: other pixels whose steps the reader knows, None for no such pixels. Returns
    the prediction (n,) of each mask pixel, all computed together. The decoder's `add_residuals`
    computes the same numbers one by one: whoever changes one must change the other."""
    # flat image with a border of one pixel above and at both sides, so that all pixels have
    # neighbours; -1, which no measurement is, marks the border and pixels neither coded nor known
    positions, stride = _padded_positions(mask)
    padded = np.full((mask.shape[0] + 1) * stride, -1, np.int64)
    if known_mask is not None:
        known_positions, _ = _padded_positions(known_mask)
        padded[known_positions] = steps[known_mask]
    values = steps[mask]
    padded[positions] = values
    left = padded[positions - 1]
    up = padded[positions - stride]
    upper_left = padded[positions - stride - 1]
    upper_right = padded[positions - stride + 1]
    # the previous pixel of the mask, 0 for the first; cut to nothing for an empty mask
    last = np.concatenate([[0], values[:-1]])[: len(values)]
    lower = np.minimum(left, up)
    higher = np.maximum(left, up)
    # the median predictor of LOCO-I: the plane through the three neighbours, within left and up
    median = np.clip(left + up - upper_left, lower, higher)
    # predictions from both left and up, from one, or from neither
    from_both = np.where(upper_left >= 0, median, (left + up) >> 1)
    from_one = np.where(up >= 0, up, left)
    upper_left_or_last = np.where(upper_left >= 0, upper_left, last)
    from_neither = np.where(upper_right >= 0, upper_right, upper_left_or_last)
    return np.where(lower >= 0, from_both, np.where(higher >= 0, from_one, from_neither))


def add_residuals(
    mask: np.ndarray,
    residuals: np.ndarray,
    known_pixels: tuple[np.ndarray, np.ndarray] | None = None,
) -> np.ndarray:
    """Restore the steps of a mask's pixels from their differences from the predictions.

    mask: pixels (rows, columns) that were encoded; residuals: difference (n,) of each mask pixel
    from its prediction, row after row; known_pixels: steps and mask (rows, columns) of other known
    pixels, None for no such pixels. Returns steps (rows, columns), 0 outside the mask. Goes pixel
    by pixel, as each prediction needs the pixels before it, and predicts exactly what
    `predict_steps` does. Raises ValueError for a result beyond 0 to 2^24 - 1."""
    # flat image with a border of one pixel above and at both sides; -1, which no measurement is,
    # marks the border and all pixels that are neither restored nor known
    positions, stride = _padded_positions(mask)
    padded = [-1] * ((mask.shape[0] + 1) * stride)
    if known_pixels is not None:
        known_steps, known_mask = known_pixels
        known_positions, _ = _padded_positions(known_mask)
        known_values = known_steps[known_mask].tolist()
        for position, value in zip(known_positions.tolist(), known_values, strict=True):
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
            # the same predictor as in `predict_steps`
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
            # the first available neighbour, else the previous pixel of the mask
            value = next((neighbour for neighbour in neighbours if neighbour >= 0), value)
        value += residual
        if not 0 <= value < MAX_RANGE_STEPS:
            raise ValueError(f"a measurement of {value} steps is none: the message is damaged")
        padded[position] = value
        values.append(value)
    steps = np.zeros(mask.shape, np.int64)
    steps[mask] = values
    return steps


def _padded_positions(mask: np.ndarray) -> tuple[np.ndarray, int]:
    """Return the flat index of each mask pixel in a padded image, and the padded image's width.

    Padding is one row above and one column on either side, so neighbours of edge pixels exist."""
    pixels = np.flatnonzero(mask)
    column_count = mask.shape[1]
    padded_width = column_count + 2
    # before a pixel are the row above, a column at its left, and two columns for each earlier row
    return pixels + padded_width + 1 + 2 * (pixels // column_count), padded_width
