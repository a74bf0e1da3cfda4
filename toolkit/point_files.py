"""Points in files: PCD of the Point Cloud Library, PLY, and named columns as a cloud's attributes.

PCD is read as text, binary and LZF-compressed, every field kept, and written as binary. Open3D's
reader takes fields of one name, such as the paddings `_` that PCL and ROS write, for one field, and
writes past the end of its memory. PLY is read as text and in both orders of bytes; Open3D's reader
ends the process at a long comment, and takes whatever its memory holds for points where a word
stands among the numbers. https://pointclouds.org/documentation/tutorials/pcd_file_format.html
http://paulbourke.net/dataformats/ply/"""

import math
import re
import warnings
from collections.abc import Iterator, Mapping
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

import numpy as np

from toolkit.arrays import Shaped
from toolkit.geometry import MAX_COORDINATE_M
from toolkit.point_columns import Attributes, find_axes, name_attributes, warn_of_offset
from toolkit.runtime.files import MAX_CLOUD_BYTES, check_unpacked, read_plain

ORIGIN_COMMENT = "# coview origin:"  # in a PCD file, before what to add to x, y and z (m)
PADDING = "_"
_MOST_FIELDS = 1000
MOST_LZF = 100  # times that LZF can make anything smaller: three bytes stand for 264 at most
_TYPES = {
    (kind, size): f"<{kind.lower()}{size}"
    for kind in "FIU"
    for size in (1, 2, 4, 8)
    if kind != "F" or size > 2
}


class _Header(NamedTuple):
    """Names, type of a point, number of points, storage, and the origin that coview took off
    (m)."""

    names: tuple[str, ...]
    row: np.dtype
    points: int
    data: str
    origin: np.ndarray | None = None

    def fields(self) -> Iterator[tuple[np.dtype, int]]:
        """Type and number of values of each field."""
        types = [self.row[name] for name in self.row.names or ()]
        return ((kind.base, kind.itemsize // kind.base.itemsize) for kind in types)


def read_pcd(path: str | Path) -> Attributes:
    """Read the attributes of a PCD file's points (`name_attributes`), colours as uint8. Raises
    ValueError, in one line, where the file is damaged, cut off or has no x, y and z."""
    content = read_plain(path)
    try:
        header, body = _header(content)
        if header.data == "ascii":
            skipped = content.count(b"\n", 0, len(content) - len(body))
            columns = _read_rows(Path(path), skipped, header.row, header.points)
        else:
            columns = (_read_binary if header.data == "binary" else _read_compressed)(header, body)
    except ValueError as error:
        raise ValueError(f"{path} holds no points that can be read: {error}") from None
    named_columns = {
        name: column for name, column in zip(header.names, columns, strict=True) if name != PADDING
    }
    attributes = name_attributes(named_columns)
    if header.origin is not None:
        attributes["positions"] = attributes["positions"].astype(np.float64) + header.origin
    return attributes


def pcd_bytes(columns: Mapping[str, Shaped[np.ndarray, " n"]], comment: str = "") -> bytes:
    """Format columns of one length, numbers of 1 to 8 bytes, as a binary PCD file. comment: a line
    of its header."""
    kinds = {"f": "F", "i": "I", "u": "U"}
    arrays = {name: np.asarray(column) for name, column in columns.items()}
    table = np.rec.fromarrays(
        [column.astype(column.dtype.newbyteorder("<")) for column in arrays.values()]
    )
    sizes = [str(column.itemsize) for column in arrays.values()]
    types = [kinds[c.dtype.kind] for c in arrays.values()]
    remark = f"{comment}\n" if comment else ""
    header = f"""# .PCD v0.7 - Point Cloud Data file format
{remark}VERSION 0.7
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


def _header(content: bytes) -> tuple[_Header, bytes]:
    data_line = re.search(rb"^DATA[^\n]*\n?", content, re.MULTILINE)
    if data_line is None:
        raise ValueError("its header has no line DATA, is it a PCD file?")
    entries: dict[str, list[str]] = {}
    for line in content[: data_line.end()].split(b"\n"):
        if words := line.split(b"#")[0].decode("ascii", "replace").split():
            if words[0] in entries:
                raise ValueError(f"its header has two lines {words[0]:.40}")
            entries[words[0]] = words[1:]
    if "FIELDS" in entries and "COLUMNS" in entries:
        raise ValueError("its header has both FIELDS and COLUMNS")
    fields = entries.get("FIELDS", entries.get("COLUMNS", []))  # COLUMNS until version 0.5
    names = tuple(name.lower() if len(name) == 1 else name for name in fields)
    if entries.get("DATA") == ["ascii"] and "SIZE" not in entries and "TYPE" not in entries:
        entries |= {"SIZE": ["4"] * len(names), "TYPE": ["F"] * len(names)}  # so did version 0.5
    size = _whole(entries.get("SIZE", []))
    count = _whole(entries.get("COUNT", ["1"] * len(names)))
    if not len(names) == len(size) == len(count) == len(entries.get("TYPE", ())):
        raise ValueError("FIELDS, SIZE, TYPE and COUNT of its header are not of one length")
    # SUSTechPOINTS writes fields of COUNT 0: nothing
    kept_columns = [k for k, values_a_point in enumerate(count) if values_a_point != 0]
    entries["TYPE"] = [entries["TYPE"][k] for k in kept_columns]
    names = tuple(names[k] for k in kept_columns)
    size = [size[k] for k in kept_columns]
    count = [count[k] for k in kept_columns]
    if len(names) > _MOST_FIELDS:
        raise ValueError(f"its header names {len(names)} fields, more than {_MOST_FIELDS}")
    point_names = [name for name in names if name != PADDING]
    if len(set(point_names)) < len(point_names):
        raise ValueError(f"two fields have one name: {', '.join(names)[:200]}")
    axes = find_axes(names).names
    kinds = list(zip(entries["TYPE"], size, strict=True))
    if any(kind not in _TYPES for kind in kinds) or any(not 0 < k < 1 << 20 for k in count):
        got = f"{kinds} and COUNT {count}"[:300]
        raise ValueError(f"TYPE and SIZE of a field must be F, I or U and 1, 2, 4 or 8, got {got}")
    if any(count[names.index(axis)] != 1 for axis in axes):
        raise ValueError(f"{', '.join(axes)} must have COUNT 1")
    point_counts = [math.prod(_whole(entries[key])) for key in ("POINTS",) if key in entries]
    if "WIDTH" in entries:
        point_counts.append(math.prod(_whole([*entries["WIDTH"], *entries.get("HEIGHT", ["1"])])))
    if not point_counts or len(set(point_counts)) > 1:
        raise ValueError(
            (
                "POINTS and WIDTH x HEIGHT of its header must say one number of points, got "
                f"{point_counts}"
            )[:200]
        )
    if "VIEWPOINT" in entries and [word.strip("-0.") for word in entries["VIEWPOINT"]] != [
        "",
        "",
        "",
        "1",
        "",
        "",
        "",
    ]:
        warnings.warn(
            "the VIEWPOINT of a PCD file is not applied, its points stay as they are", stacklevel=2
        )
    points = point_counts[0]
    data = " ".join(entries["DATA"])
    if data not in ("ascii", "binary", "binary_compressed") or points < 0:
        raise ValueError(
            f"DATA must be ascii, binary or binary_compressed, got {data!r:.40} of {points} points"
        )
    row = np.dtype([(f"{k}", _TYPES[kind], (count[k],)) for k, kind in enumerate(kinds)])
    origin = _read_origin(content[: data_line.start()])
    if origin is None:
        lines = content[: data_line.start()].decode("ascii", "replace").splitlines()
        warn_of_offset(line for line in lines if line.startswith("#"))
    return _Header(names, row, points, data, origin), content[data_line.end() :]


def _read_origin(header: bytes) -> np.ndarray | None:
    """Origin of a cloud that coview wrote (m), None if its header states none."""
    line = re.search(rb"^" + ORIGIN_COMMENT.encode() + rb"([^\n]*)$", header, re.MULTILINE)
    if line is None:
        return None
    words = line[1].decode("ascii", "replace").split()
    try:
        origin = np.array([float(word) for word in words])
    except ValueError:
        origin = np.full(0, np.nan)
    if origin.shape != (3,) or not (np.abs(origin) <= MAX_COORDINATE_M).all():
        raise ValueError(
            f"its origin must be three numbers of metres, got {' '.join(words)[:60]!r}"
        )
    return origin


def _whole(words: list[str]) -> list[int]:
    try:
        return [int(word) for word in words]
    except ValueError:
        raise ValueError(
            f"its header has {' '.join(words)[:40]!r} where whole numbers belong"
        ) from None


def _read_rows(
    path: Path, skipped: int, row: np.dtype, rows: int, *, last: bool = True
) -> list[np.ndarray]:
    """Columns of a file's text after so many lines, a row a line. last: no further lines may
    follow."""
    kinds = [(row[name].base, row[name].shape) for name in row.names or ()]
    plain = [(name, "f8", shape) for name, (_, shape) in zip(row.names or (), kinds, strict=True)]
    types = [kind if kind.itemsize == 8 else "f8" for kind, _ in kinds]
    exact = [(name, kind, shape) for (name, _, shape), kind in zip(plain, types, strict=True)]
    table = None
    for row_type in (exact, plain):  # whole numbers may be written as floats
        with warnings.catch_warnings(), suppress(ValueError, OverflowError, DeprecationWarning):
            warnings.simplefilter("error", DeprecationWarning)
            warnings.simplefilter("ignore", UserWarning)  # no rows at all
            max_rows = None if last else rows
            table = np.loadtxt(
                path,
                np.dtype(row_type),
                comments=None,
                encoding="latin-1",
                skiprows=skipped,
                max_rows=max_rows,
                ndmin=1,
            )
            break
    if table is None:
        width = sum(math.prod(shape) for _, shape in kinds)
        raise ValueError(
            f"it is damaged or cut off: a row has not {width} cells, or one is not a number"
        )
    if len(table) != rows:
        cut = "it is cut off, " if len(table) < rows else ""
        raise ValueError(f"{cut}{len(table)} of {rows} rows are there")
    return [_fit(table[name], kind) for name, (kind, _) in zip(row.names or (), kinds, strict=True)]


def _fit(column: np.ndarray, kind: np.dtype) -> np.ndarray:
    if kind.kind in "iu" and column.dtype.kind == "f":
        limits = np.iinfo(kind)
        if not ((column >= limits.min) & (column <= limits.max)).all():
            raise ValueError(f"a number of its table does not fit its type {kind}")
    with np.errstate(all="ignore"):
        return column.astype(kind)


def _read_binary(header: _Header, body: bytes) -> list[np.ndarray]:
    needed = header.points * header.row.itemsize
    if len(body) < needed:
        raise ValueError(f"it is cut off, {len(body)} of {needed} bytes are there")
    if len(body) >= needed + header.row.itemsize:
        raise ValueError(
            f"its header says {header.points} points, {needed} bytes, but {len(body)} are there"
        )
    rows = np.frombuffer(body, header.row, header.points)
    return [np.ascontiguousarray(rows[name]) for name in header.row.names or ()]


def _read_compressed(header: _Header, body: bytes) -> list[np.ndarray]:
    """Columns of a compressed file, one field after the other."""
    if len(body) < 8 and header.points:
        raise ValueError("it is cut off before its points")
    packed, size = (int(number) for number in np.frombuffer(body[:8].ljust(8, b"\0"), "<u4"))
    needed = header.points * header.row.itemsize
    if len(body) - 8 < packed and header.points:
        raise ValueError(f"it is cut off, {len(body) - 8} of {packed} compressed bytes are there")
    check_unpacked(size, MAX_CLOUD_BYTES)
    if size != needed or size > MOST_LZF * max(1, packed):
        raise ValueError(f"its points take {needed} bytes, but {size} are compressed in {packed}")
    plain = decompress_lzf(body[8 : 8 + packed], size)
    columns = []
    first = 0
    for dtype, count in header.fields():
        length = header.points * count * dtype.itemsize
        columns.append(
            np.frombuffer(plain[first : first + length], dtype).reshape(header.points, count)
        )
        first += length
    return columns


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
            out += (same * (length // back + 1))[:length]  # it may overlap its own output
    except IndexError:
        pass
    if i != len(packed) or len(out) != size:
        raise ValueError("its compressed points are damaged")
    return bytes(out)


_PLY_KINDS = (
    "i1 char int8, u1 uchar uint8, i2 short int16, u2 ushort uint16, i4 int int32, u4 uint uint32"
)
_PLY_KINDS += ", f4 float float32, f8 double float64"
_PLY_TYPES = {
    name: kind for kind, *names in map(str.split, _PLY_KINDS.split(",")) for name in names
}
_PLY_ORDERS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
_MOST_LISTS = 1_000_000  # rows with lists before the points, which are walked one by one


class _Element(NamedTuple):
    """Name, number of rows, and of each property its name, its type and, for a list, the type of
    its length."""

    name: str
    rows: int
    properties: list[tuple[str, np.dtype, np.dtype | None]]

    @property
    def row(self) -> np.dtype | None:
        """Type of a row; None if it has lists."""
        if any(length is not None for _, _, length in self.properties):
            return None
        return np.dtype([(f"{k}", kind) for k, (_, kind, _) in enumerate(self.properties)])


def read_ply(path: str | Path) -> Attributes:
    """Read the attributes of a PLY file's points (`name_attributes`), its `vertex` element. Raises
    ValueError, in one line, where the file is damaged, cut off, longer than its header says, or has
    no x, y and z."""
    content = read_plain(path)
    try:
        order, elements, start = _ply_header(content)
        vertex_index = [element.name for element in elements].index("vertex")
        vertex = elements[vertex_index]
        last = vertex_index == len(elements) - 1
        if vertex.row is None:
            raise ValueError("its vertices have lists: export it again as points")
        if not order:
            skipped = len(content[:start].splitlines()) + sum(
                element.rows for element in elements[:vertex_index]
            )
            columns = _read_rows(Path(path), skipped, vertex.row, vertex.rows, last=last)
        else:
            for element in elements[:vertex_index]:
                start = _skip(element, content, start)
            end = None if last else start + vertex.rows * vertex.row.itemsize
            columns = _read_binary(_Header((), vertex.row, vertex.rows, ""), content[start:end])
    except ValueError as error:
        raise ValueError(f"{path} holds no points that can be read: {error}") from None
    kinds = (kind.newbyteorder("=") for _, kind, _ in vertex.properties)
    native = [column.astype(kind, copy=False) for column, kind in zip(columns, kinds, strict=True)]
    return name_attributes(dict(zip((name for name, *_ in vertex.properties), native, strict=True)))


def _ply_header(content: bytes) -> tuple[str, list[_Element], int]:
    """Order of bytes ("" for text), elements, and where the header ends."""
    first = re.match(rb"ply[ \t]*(\r\n|\r|\n)", content)
    end = first and re.compile(first[1] + rb"end_header[ \t]*" + first[1]).search(content)
    if first is None or end is None:
        raise ValueError("it has no header from ply to end_header, is it a PLY file?")
    order = None
    elements = list[_Element]()
    for line in (
        content[first.end() : end.start()].decode("ascii", "replace").split(first[1].decode())
    ):
        words = line.split()
        if not words or words[0] in ("comment", "obj_info"):
            warn_of_offset([line])
            continue
        if words[0] == "format" and len(words) == 3 and words[1] in _PLY_ORDERS and order is None:
            order = _PLY_ORDERS[words[1]]
        elif words[0] == "element" and len(words) == 3:
            elements.append(_Element(words[1], _whole(words[2:])[0], []))
        elif words[0] == "property" and elements and order is not None:
            elements[-1].properties.append(_ply_property(words[1:], order))
        else:
            raise ValueError(f"its header has a line that PLY does not know: {line[:80]!r}")
    names = [element.name for element in elements]
    if order is None or names.count("vertex") != 1 or any(element.rows < 0 for element in elements):
        raise ValueError(
            "its header must have one format and one element vertex, and no count below 0"
        )
    point_names = [name for name, _, _ in elements[names.index("vertex")].properties]
    if sum(len(element.properties) for element in elements) > _MOST_FIELDS:
        raise ValueError(f"its header names more than {_MOST_FIELDS} properties")
    if len(set(point_names)) < len(point_names):
        raise ValueError(f"its points must have no name twice, got {', '.join(point_names)[:200]}")
    find_axes(point_names)
    return order, elements, end.end()


def _ply_property(words: list[str], order: str) -> tuple[str, np.dtype, np.dtype | None]:
    *kinds, name = words or [""]
    is_list = kinds[:1] == ["list"] and len(kinds) == 3 and _PLY_TYPES.get(kinds[1], "f")[0] != "f"
    if not (is_list or len(kinds) == 1) or kinds[-1] not in _PLY_TYPES:
        raise ValueError(f"its header has a property of unknown type: {' '.join(words)[:80]!r}")
    length, kind = (
        np.dtype(order + _PLY_TYPES[type_name])
        for type_name in (kinds[1] if is_list else "char", kinds[-1])
    )
    return name.lower() if len(name) == 1 else name, kind, length if is_list else None


def _skip(element: _Element, content: bytes, at: int) -> int:
    """Place after an element of a binary file that begins at a place."""
    if element.row is not None:
        return at + element.rows * element.row.itemsize
    if element.rows > _MOST_LISTS:
        raise ValueError(f"it has {element.rows} lists before its points: write the points first")
    for _ in range(element.rows):
        for _, kind, length in element.properties:
            count = 1
            if length is not None:
                count = (
                    int(np.frombuffer(content, length, 1, at)[0])
                    if at + length.itemsize <= len(content)
                    else -1
                )
                at += length.itemsize
            if count < 0:
                raise ValueError("a list before its points is damaged or cut off")
            at += count * kind.itemsize
    return at
