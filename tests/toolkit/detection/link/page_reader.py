"""A second reader of messages, written from docs/reference/message-format.md alone, pixel by pixel
and bit by bit."""

import struct
import zlib
from itertools import accumulate


def read_variable(data, at):
    number = place = 0
    while data[at] > 127:
        number, place, at = number | (data[at] & 127) << place, place + 7, at + 1
    return number | data[at] << place, at + 1


def read_packed(data, at):
    count, at = read_variable(data, at)
    length, at = read_variable(data, at)
    symbols, at = zlib.decompress(data[at : at + length], -15), at + length
    assert len(symbols) == count
    bits, used, numbers = "".join(f"{byte:08b}" for byte in data[at:]), 0, []
    for symbol in symbols:
        lower = 2 + (symbol - 8) // 2 if symbol > 7 else 0
        numbers.append(
            int(f"1{symbol % 2}{bits[used : used + lower]}", 2) if symbol > 7 else symbol
        )
        used += lower
    return numbers, at + -(-used // 8)


def unfold(number):
    return -(number + 1) // 2 if number % 2 else number // 2


def read_mask(data, at, rows, columns):
    way = data[at]
    distances, at = read_packed(data, at + 1)
    changes, mask = set(accumulate(distances, initial=-1)), set()
    for pixel in range(rows * columns):
        column, up = pixel % columns, pixel - columns
        before = [pixel - 1] if way == 0 else [up, *([pixel - 1, up - 1] if column else [])]
        if sum(each in mask for each in before) % 2 != (pixel in changes):
            mask.add(pixel)
    return mask, at


def read_values(data, at, mask, known, columns):
    residuals, at = read_packed(data, at)
    assert len(residuals) == len(mask)
    known, values, last = dict(known), {}, 0
    for pixel, residual in zip(sorted(mask), residuals, strict=True):
        column, above = pixel % columns, pixel - columns
        left, upper_left = (known.get(each) if column else None for each in (pixel - 1, above - 1))
        up, upper_right = known.get(above), known.get(above + 1) if column < columns - 1 else None
        there = [each for each in (left, up) if each is not None]
        if len(there) == 2 and upper_left is not None:
            guess = sorted([left, up, left + up - upper_left])[1]
        elif there:
            guess = sum(there) // len(there)
        else:
            guess = next((each for each in (upper_right, upper_left) if each is not None), last)
        last = known[pixel] = values[pixel] = guess + unfold(residual)
    return values, at


def read_header(message):
    """Fields of a message's header by name, after its checksum was compared."""
    names = ["magic", "version", "kind", "sensor", "number", "time_us"]
    names += ["step_mm", "rows", "columns", "scene"]
    fields = dict(zip(names, struct.unpack("<2sBBIIQHHHI", message[:30]), strict=True))
    assert (fields["magic"], fields["version"]) == (b"cv", 2)
    assert zlib.crc32(message[:-4]) == int.from_bytes(message[-4:], "little")
    return fields


def read_image(message):
    """Steps of the sent pixels, and the set of missing ones, of a range image or foreground."""
    fields = read_header(message)
    data, shape = message[30:-4], (fields["rows"], fields["columns"])
    sent, at = read_mask(data, 0, *shape)
    values, at = read_values(data, at, sent, {}, fields["columns"])
    missing = set()
    if fields["kind"] == 2 and at < len(data):
        missing, at = read_mask(data, at, *shape)
    assert at == len(data)
    return values, missing


def read_boxes(message):
    """Numbers of each box: x, y, z, length, width, height, yaw, score, label in their steps."""
    data = message[30:-4]
    count = int.from_bytes(data[:2], "little")
    heads = [struct.unpack_from("<Bi", data, 2 + 5 * k) for k in range(9)] if count else []
    at, columns = 2 + 5 * len(heads), []
    for width, least in heads:
        size = -(-count * width // 8)
        bits = "".join(f"{byte:08b}" for byte in data[at : at + size])
        parts = [f"0{bits[k * width : (k + 1) * width]}" for k in range(count)]
        columns.append([least + int(part, 2) for part in parts])
        at += size
    assert at == len(data)
    return [list(box) for box in zip(*columns, strict=True)]
