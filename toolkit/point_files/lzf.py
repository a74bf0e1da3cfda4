"""LibLZF's compression, which PCD files may have."""


def decompress_lzf(packed: bytes, size: int) -> bytes:
    """Decompress LibLZF. Raises ValueError unless it makes `size` bytes."""
    out = bytearray()
    i = 0
    try:
        while i < len(packed):
            control = packed[i]
            if control < 32:  # control + 1 plain bytes
                out += packed[i + 1 : i + 2 + control]
                i += 2 + control
                continue
            length = control >> 5
            if length == 7:
                i += 1
                length += packed[i]
            back = ((control & 31) << 8) + packed[i + 1] + 1  # bytes ago that the same was there
            i += 2
            start = len(out) - back
            length = length + 2
            if start < 0 or len(out) > size:
                break
            same = out[start : start + length]
            out += (same * (length // back + 1))[:length]  # it may overlap its output
    except IndexError:
        pass
    if i != len(packed) or len(out) != size:
        raise ValueError("its compressed points are damaged")
    return bytes(out)
