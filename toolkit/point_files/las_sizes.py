"""Sizes that a LAS or LAZ file declares, checked before a library reserves memory for them.

A few damaged bytes can declare billions of records or of compressed chunks. laspy 2.7.0 reads such
records until the last, and lazrs ends the process when the memory for such chunks cannot be had.

https://github.com/ASPRSorg/LAS, and https://github.com/tmontaigu/laz-rs for the table of chunks."""

import struct
from typing import Any

_HEADER_SIZE_BYTE = 94  # bytes of the header, then byte of the first point
_RECORD_COUNT_BYTE = 100
_EXTENDED_BYTE = 235  # byte of the first extended record, and their number, from LAS 1.4 on
_MIN_HEADER_BYTES = 227
_EXTENDED_HEADER_BYTES = 375
_RECORD_BYTES = 54  # header of a variable length record
_EXTENDED_RECORD_BYTES = 60


def check_records(content: bytes) -> None:
    """Raise ValueError for more variable length records than a LAS file has room for.

    content: whole file, which begins with LASF."""
    if len(content) < _MIN_HEADER_BYTES:
        raise ValueError(f"it is cut off in its header, after {len(content)} bytes")
    header_bytes, first_point = struct.unpack_from("<HI", content, _HEADER_SIZE_BYTE)
    (records,) = struct.unpack_from("<I", content, _RECORD_COUNT_BYTE)
    if not _MIN_HEADER_BYTES <= header_bytes <= first_point <= len(content):
        raise ValueError(
            f"its header is said to have {header_bytes} bytes and its points to begin at byte "
            f"{first_point}, of {len(content)}"
        )
    if records * _RECORD_BYTES > first_point - header_bytes:
        raise ValueError(
            f"{records} records are said to be between its header and its points, where "
            f"{first_point - header_bytes} bytes are"
        )
    # only such a header knows extended records
    if header_bytes >= _EXTENDED_HEADER_BYTES:
        first_extended, extended = struct.unpack_from("<QI", content, _EXTENDED_BYTE)
        if extended and first_extended + extended * _EXTENDED_RECORD_BYTES > len(content):
            raise ValueError(
                f"{extended} extended records are said to begin at byte {first_extended}, of "
                f"{len(content)}"
            )


def check_chunks(content: bytes, header: Any) -> None:
    """Raise ValueError if the compressed chunks of a LAZ file cannot be what they are said to be.

    content: whole file; header: its `laspy.LasHeader`. The points begin with the byte of the table
    of chunks, or with -1 if that is in the last 8 bytes; the table begins with its version and the
    number of chunks, each of which holds a whole point at least."""
    import lazrs

    point_bytes = int(header.point_format.size)
    first = int(header.offset_to_point_data)
    (vlr,) = header.vlrs.get("LasZipVlr")
    packed_bytes = int(lazrs.LazVlr(vlr.record_data).item_size())
    if packed_bytes != point_bytes:
        raise ValueError(
            f"its compressed points are said to have {packed_bytes} bytes, others {point_bytes}"
        )
    if not header.point_count:
        return
    if first + 8 > len(content):
        raise ValueError("it is cut off before its table of chunks")
    (table,) = struct.unpack_from("<q", content, first)
    if table <= first:
        (table,) = struct.unpack_from("<q", content, len(content) - 8)
    if not first < table <= len(content) - 8:
        raise ValueError(f"its table of chunks is said to begin at byte {table}, of {len(content)}")
    _, chunks = struct.unpack_from("<II", content, table)
    if chunks * point_bytes > table - first:
        raise ValueError(
            f"{chunks} chunks are said to be in the {table - first} bytes of its points"
        )
