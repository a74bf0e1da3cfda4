"""Points in files: PCD of the Point Cloud Library, and named columns as a cloud's attributes.

PCD is read as text, binary and LZF-compressed, every field kept, and written as binary. Open3D's reader takes fields of
one name, such as the paddings `_` that PCL and ROS write, for one field, and writes past the end of its memory.
https://pointclouds.org/documentation/tutorials/pcd_file_format.html
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from toolkit.arrays import Shaped

Attributes = dict[str, np.ndarray]  # each (n, columns)

NORMALS = (("normal_x", "normal_y", "normal_z"), ("nx", "ny", "nz"))
COLOURS = (("red", "green", "blue"), ("r", "g", "b"))


def name_attributes(columns: Mapping[str, Shaped[np.ndarray, "..."]]) -> Attributes:
    """Turn named columns into a cloud's attributes: `positions` of x, y and z (float32 or float64), `normals` and
    `colors` where present, every other column of numbers under its own name.

    >>> {name: array.shape for name, array in name_attributes(dict.fromkeys(["x", "y", "z", "t"], np.zeros(5))).items()}
    {'positions': (5, 3), 't': (5, 1)}
    """
    left = {name: np.asarray(column) for name, column in columns.items()}
    made: Attributes = {"positions": _together(left, "x", "y", "z")}
    if made["positions"].dtype not in (np.float32, np.float64):
        made["positions"] = made["positions"].astype(np.float64)
    for three in NORMALS:
        if set(three) <= left.keys():
            made["normals"] = _together(left, *three).astype(made["positions"].dtype)
            break
    for packed in ("rgb", "rgba"):
        if packed in left and left[packed].dtype.itemsize == 4 and left[packed].shape[1:] in ((), (1,)):
            word = np.ascontiguousarray(left.pop(packed)).reshape(-1).view(np.uint32)
            made["colors"] = np.stack([word >> 16, word >> 8, word], axis=1).astype(np.uint8)
    for three in COLOURS:
        if "colors" not in made and set(three) <= left.keys():
            made["colors"] = _colours(_together(left, *three))
            break
    reserved = {"positions", "normals", "colors"}
    for name, column in left.items():
        if column.dtype.kind in "fiub" and column.ndim <= 2 and name and name not in reserved:
            made[name] = column if column.ndim == 2 else column[:, None]
    return made


def _together(left: dict[str, np.ndarray], *names: str) -> np.ndarray:
    return np.stack([left.pop(name).reshape(-1) for name in names], axis=1)


def _colours(values: np.ndarray) -> np.ndarray:
    """Colours as uint8 if they are whole numbers of 0..255."""
    whole = np.isfinite(values).all() and (values == np.trunc(values)).all() and ((values >= 0) & (values <= 255)).all()
    return values.astype(np.uint8 if whole else np.float32)


def missing_axes(names: Sequence[str]) -> list[str]:
    """Axes x, y, z that are not among the names."""
    return [axis for axis in "xyz" if axis not in names]


PADDING = "_"
MOST_LZF = 100  # times that LZF can make anything smaller: three bytes stand for 264 at most
_TYPES = {
    **{("F", size): f"<f{size}" for size in (4, 8)},
    **{("I", size): f"<i{size}" for size in (1, 2, 4, 8)},
    **{("U", size): f"<u{size}" for size in (1, 2, 4, 8)},
}


class _Header(NamedTuple):
    """Names, type of a point, number of points, storage."""

    names: tuple[str, ...]
    row: np.dtype
    points: int
    data: str

    def fields(self) -> Iterator[tuple[np.dtype, int]]:
        """Type and number of values of each field."""
        types = [self.row[name] for name in self.row.names or ()]
        return ((each.base, each.itemsize // each.base.itemsize) for each in types)


def read_pcd(path: str | Path) -> Attributes:
    """Read the attributes of a PCD file's points (`name_attributes`), colours as uint8. Raises ValueError, in one line,
    where the file is damaged, cut off or has no x, y and z.
    """
    content = Path(path).read_bytes()
    try:
        header, body = _header(content)
        reader = {"ascii": _read_ascii, "binary": _read_binary, "binary_compressed": _read_compressed}[header.data]
        columns = reader(header, body)
    except ValueError as error:
        raise ValueError(f"{path} holds no points that can be read: {error}") from None
    named = {name: column for name, column in zip(header.names, columns, strict=True) if name != PADDING}
    return name_attributes(named)


def pcd_bytes(columns: Mapping[str, Shaped[np.ndarray, " n"]]) -> bytes:
    """Format columns of one length, numbers of 1 to 8 bytes, as a binary PCD file.

    >>> pcd_bytes({"x": np.zeros(2, "f4"), "y": np.zeros(2, "f4"), "z": np.ones(2, "f4")})[-4:].hex()
    '0000803f'
    """
    kinds = {"f": "F", "i": "I", "u": "U"}
    arrays = {name: np.asarray(column) for name, column in columns.items()}
    count = len(next(iter(arrays.values())))
    table = np.zeros(count, [(name, column.dtype.newbyteorder("<")) for name, column in arrays.items()])
    for name, column in arrays.items():
        table[name] = column
    header = (
        "# .PCD v0.7 - Point Cloud Data file format",
        "VERSION 0.7",
        f"FIELDS {' '.join(arrays)}",
        f"SIZE {' '.join(str(column.itemsize) for column in arrays.values())}",
        f"TYPE {' '.join(kinds[column.dtype.kind] for column in arrays.values())}",
        f"COUNT {' '.join('1' for _ in arrays)}",
        f"WIDTH {count}",
        "HEIGHT 1",
        "VIEWPOINT 0 0 0 1 0 0 0",
        f"POINTS {count}",
        "DATA binary",
    )
    return "\n".join(header).encode() + b"\n" + table.tobytes()


def _header(content: bytes) -> tuple[_Header, bytes]:
    entries: dict[str, list[str]] = {}
    rest = content
    while "DATA" not in entries:
        line, newline, rest = rest.partition(b"\n")
        if not newline and not rest and not line.startswith(b"DATA"):
            raise ValueError("its header has no line DATA, is it a PCD file?")
        words = line.split(b"#")[0].decode("ascii", "replace").split()
        if words:
            entries[words[0]] = words[1:]
    names = tuple(name.lower() if len(name) == 1 else name for name in entries.get("FIELDS", ()))
    size, count = (_whole(entries.get(key, default)) for key, default in (("SIZE", []), ("COUNT", ["1"] * len(names))))
    if not len(names) == len(size) == len(count) == len(entries.get("TYPE", ())):
        raise ValueError("FIELDS, SIZE, TYPE and COUNT of its header are not of one length")
    if missing_axes(names):
        raise ValueError(f"it has no field {', '.join(missing_axes(names))}, but {', '.join(names)}")
    kept = [name for name in names if name != PADDING]
    if len(set(kept)) < len(kept):
        raise ValueError(f"two fields have one name: {', '.join(names)}")
    kinds = list(zip(entries["TYPE"], size, strict=True))
    if any(kind not in _TYPES for kind in kinds) or any(not 0 < k < 1 << 20 for k in count):
        raise ValueError(f"TYPE and SIZE of a field must be F, I or U and 1, 2, 4 or 8, got {kinds} and COUNT {count}")
    if any(count[names.index(axis)] != 1 for axis in "xyz"):
        raise ValueError("x, y and z must have COUNT 1")
    points = _whole(entries.get("POINTS", []) or ["0"])[0]
    if "POINTS" not in entries:
        points = int(np.prod(_whole([*entries.get("WIDTH", ["0"]), *entries.get("HEIGHT", ["1"])]), dtype=object))
    data = " ".join(entries["DATA"])
    if data not in ("ascii", "binary", "binary_compressed") or points < 0:
        raise ValueError(f"DATA must be ascii, binary or binary_compressed, got {data!r:.40} of {points} points")
    row = np.dtype([(f"{k}", _TYPES[kind], (count[k],)) for k, kind in enumerate(kinds)])
    return _Header(names, row, points, data), rest


def _whole(words: list[str]) -> list[int]:
    try:
        return [int(word) for word in words]
    except ValueError:
        raise ValueError(f"its header has {' '.join(words)[:40]!r} where whole numbers belong") from None


def _read_ascii(header: _Header, body: bytes) -> list[np.ndarray]:
    cells, width = body.split(), sum(count for _, count in header.fields())
    if len(cells) < header.points * width:
        raise ValueError(f"it is cut off, {len(cells)} of {header.points * width} numbers are there")
    table = np.array(cells[: header.points * width], "S").reshape(header.points, width)
    columns, first = [], 0
    for dtype, count in header.fields():
        cell = table[:, first : first + count]
        first += count
        try:
            with np.errstate(all="ignore"):
                if dtype.kind != "f":
                    try:
                        cell = cell.astype(np.int64)
                    except (ValueError, OverflowError):
                        cell = cell.astype(np.float64)  # whole numbers that are written as floats
                columns.append(cell.astype(dtype))
        except (ValueError, OverflowError):
            raise ValueError("a cell of its table is not a number") from None
    return columns


def _read_binary(header: _Header, body: bytes) -> list[np.ndarray]:
    needed = header.points * header.row.itemsize
    if len(body) < needed:
        raise ValueError(f"it is cut off, {len(body)} of {needed} bytes are there")
    rows = np.frombuffer(body[:needed], header.row)
    return [np.ascontiguousarray(rows[name]) for name in header.row.names or ()]


def _read_compressed(header: _Header, body: bytes) -> list[np.ndarray]:
    """Columns of a compressed file, one field after the other."""
    if len(body) < 8 and header.points:
        raise ValueError("it is cut off before its points")
    packed, size = (int(number) for number in np.frombuffer(body[:8].ljust(8, b"\0"), "<u4"))
    needed = header.points * header.row.itemsize
    if len(body) - 8 < packed and header.points:
        raise ValueError(f"it is cut off, {len(body) - 8} of {packed} compressed bytes are there")
    if size != needed or size > MOST_LZF * max(1, packed):
        raise ValueError(f"its points take {needed} bytes, but {size} are compressed in {packed}")
    plain = decompress_lzf(body[8 : 8 + packed], size)
    columns, first = [], 0
    for dtype, count in header.fields():
        length = header.points * count * dtype.itemsize
        columns.append(np.frombuffer(plain[first : first + length], dtype).reshape(header.points, count))
        first += length
    return columns


def decompress_lzf(packed: bytes, size: int) -> bytes:
    """Decompress LibLZF. Raises ValueError unless it makes `size` bytes.

    >>> decompress_lzf(bytes([1, 97, 98, 0xE0, 1, 1]), 12)
    b'abababababab'
    """
    out, i = bytearray(), 0
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
            start, length = len(out) - back, length + 2
            if start < 0 or len(out) > size:
                break
            out += (
                (out[start : start + length] * (length // back + 1))[:length]
                if length > back
                else out[start : start + length]
            )  # it may overlap its own output
    except IndexError:
        pass
    if i != len(packed) or len(out) != size:
        raise ValueError("its compressed points are damaged")
    return bytes(out)
