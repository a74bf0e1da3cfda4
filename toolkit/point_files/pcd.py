"""PCD files of the Point Cloud Library.

They are read as text, binary and LZF-compressed, every field kept, and written as binary. Open3D's
reader takes fields of one name, such as the paddings `_` that PCL and ROS write, for one field, and
writes past the end of its memory.
https://pointclouds.org/documentation/tutorials/pcd_file_format.html"""

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from toolkit.arrays import Shaped
from toolkit.point_columns import Attributes, name_attributes
from toolkit.point_files.lzf import decompress_lzf
from toolkit.point_files.pcd_header import PADDING, PcdHeader, parse_pcd_header
from toolkit.point_files.rows import read_binary, read_rows
from toolkit.runtime.array_files import MAX_CLOUD_BYTES, check_unpacked
from toolkit.runtime.reading import read_plain

MAX_LZF_RATIO = 100  # plain over packed bytes: three packed bytes give 264 at most


def read_pcd(path: str | Path) -> Attributes:
    """Read the attributes of a PCD file's points (`name_attributes`), colours as uint8.

    Raises ValueError, in one line, if the file is damaged, cut off or has no x, y and z."""
    content = read_plain(path)
    try:
        header, body = parse_pcd_header(content)
        if header.data == "ascii":
            header_lines = content.count(b"\n", 0, len(content) - len(body))
            columns = read_rows(
                Path(path), skipped=header_lines, row=header.row, rows=header.points
            )
        elif header.data == "binary":
            columns = read_binary(body, header.row, header.points)
        else:
            columns = _read_compressed(header, body)
    except ValueError as error:
        raise ValueError(f"{path} holds no points that can be read: {error}") from None
    pairs = zip(header.names, columns, strict=True)
    named_columns = {name: column for name, column in pairs if name != PADDING}
    attributes = name_attributes(named_columns)
    if header.origin is not None:
        attributes["positions"] = attributes["positions"].astype(np.float64) + header.origin
    return attributes


def pcd_bytes(columns: Mapping[str, Shaped[np.ndarray, " n"]], comment: str = "") -> bytes:
    """Format columns of one length, numbers of 1 to 8 bytes, as a binary PCD file.

    columns: by the name of the field; comment: a line of the header, "" for none."""
    kinds = {"f": "F", "i": "I", "u": "U"}  # NumPy's letters for types and PCD's
    arrays = {name: np.asarray(column) for name, column in columns.items()}
    little_endian = [column.astype(column.dtype.newbyteorder("<")) for column in arrays.values()]
    table = np.rec.fromarrays(little_endian)
    sizes = [str(column.itemsize) for column in arrays.values()]
    types = [kinds[column.dtype.kind] for column in arrays.values()]
    comment_line = f"{comment}\n" if comment else ""
    header = f"""# .PCD v0.7 - Point Cloud Data file format
{comment_line}VERSION 0.7
FIELDS {" ".join(arrays)}
SIZE {" ".join(sizes)}
TYPE {" ".join(types)}
COUNT {" ".join("1" for _ in arrays)}
WIDTH {len(table)}
HEIGHT 1
VIEWPOINT 0 0 0 1 0 0 0
POINTS {len(table)}
DATA binary
"""
    return header.encode() + table.tobytes()


def _read_compressed(header: PcdHeader, body: bytes) -> list[np.ndarray]:
    """Columns (points, values) of a PCD file with compressed points, in the order of its fields.

    body: content after the header. Raises ValueError for damaged or missing points."""
    if len(body) < 8 and header.points:
        raise ValueError("it is cut off before its points")
    # the body begins with its compressed and its uncompressed size in bytes
    packed, size = (int(number) for number in np.frombuffer(body[:8].ljust(8, b"\0"), "<u4"))
    needed = header.points * header.row.itemsize
    if len(body) - 8 < packed and header.points:
        raise ValueError(f"it is cut off, {len(body) - 8} of {packed} compressed bytes are there")
    check_unpacked(size, MAX_CLOUD_BYTES)
    if size != needed or size > MAX_LZF_RATIO * max(1, packed):
        raise ValueError(f"its points take {needed} bytes, but {size} are compressed in {packed}")
    unpacked = decompress_lzf(body[8 : 8 + packed], size)
    columns = []
    start = 0
    # unpacked, the values of one field of all points come before the next field
    for dtype, count in header.fields():
        length = header.points * count * dtype.itemsize
        values = np.frombuffer(unpacked[start : start + length], dtype)
        columns.append(values.reshape(header.points, count))
        start += length
    return columns
