"""LibLZF's compression, which PCD files may have."""


def decompress_lzf(packed: bytes, size: int) -> bytes:
    """Decompress bytes that LibLZF has packed. Raises ValueError unless they make `size` bytes."""
    out = bytearray()
    position = 0  # in `packed`
    try:
        while position < len(packed):
            control = packed[position]
            if control < 32:  # control + 1 plain bytes follow
                out += packed[position + 1 : position + 2 + control]
                position += 2 + control
                continue
            # else a copy of earlier output: its length in the upper three bits, and its distance in
            # the other five and the next byte
            length = control >> 5
            if length == 7:  # a further byte of length
                position += 1
                length += packed[position]
            distance = ((control & 31) << 8) + packed[position + 1] + 1
            position += 2
            start = len(out) - distance
            length = length + 2
            # damaged, refused below
            if start < 0 or len(out) > size:
                break
            # if it is longer than its distance, it repeats what it copies
            source = out[start : start + length]
            out += (source * (length // distance + 1))[:length]
    except IndexError:  # cut off
        pass
    if position != len(packed) or len(out) != size:
        raise ValueError("its compressed points are damaged")
    return bytes(out)
