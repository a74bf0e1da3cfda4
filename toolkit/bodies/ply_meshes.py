"""Triangle meshes of PLY files, text and binary, read in NumPy: Open3D follows a corner that is not there.

http://paulbourke.net/dataformats/ply/
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from toolkit.arrays import Float64, Int64

_TYPES = {"char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4"}
_TYPES |= {"float": "f4", "double": "f8", "float32": "f4", "float64": "f8", "int8": "i1", "uint8": "u1"}
_TYPES |= {"int16": "i2", "uint16": "u2", "int32": "i4", "uint32": "u4"}
_FACES = ("vertex_indices", "vertex_index")


@dataclass(frozen=True)
class _Property:
    name: str
    dtype: np.dtype
    length: np.dtype | None  # of the number before a list, None where it is no list


@dataclass(frozen=True)
class _Element:
    name: str
    count: int
    properties: list[_Property]


def read_ply_mesh(path: str | Path) -> tuple[Float64[np.ndarray, "k 3"], Int64[np.ndarray, "m 3"]]:
    """Vertices and triangles; faces of more corners become fans. Raises ValueError where the file is damaged."""
    elements, body, ascii_text = _header(Path(path).read_bytes())
    tokens = body.split() if ascii_text else []
    vertices, faces, place = np.zeros((0, 3)), [], 0
    for element in elements:
        if all(each.length is None for each in element.properties):
            table, place = _plain(element, tokens if ascii_text else body, place)
            if element.name == "vertex":
                if not set("xyz") <= table.keys():
                    raise ValueError("its vertices have no x, y and z")
                vertices = np.stack([table[axis] for axis in "xyz"], axis=1)
            continue
        rows, place = _lists(element, tokens if ascii_text else body, place)
        faces += rows if element.name == "face" else []
    fans = [(row[0], row[i], row[i + 1]) for row in faces for i in range(1, len(row) - 1)]
    triangles = np.array(fans, np.int64).reshape(-1, 3)
    if len(triangles) and not (triangles.min() >= 0 and triangles.max() < len(vertices)):
        raise ValueError("a triangle has a corner that is not there")
    return vertices.astype(np.float64), triangles


def _header(content: bytes) -> tuple[list[_Element], bytes, bool]:
    head, end, body = content.partition(b"end_header")
    lines = [line.split() for line in head.decode("ascii", "replace").splitlines()]
    form = next((line[1] for line in lines if line[:1] == ["format"] and len(line) > 1), "")
    if lines[:1] != [["ply"]] or not end or form not in ("ascii", "binary_little_endian", "binary_big_endian"):
        raise ValueError("it has no header of a PLY file")
    order = ">" if form == "binary_big_endian" else "<"
    elements: list[_Element] = []
    try:
        for line in lines:
            if line[:1] == ["element"]:
                elements.append(_Element(line[1], int(line[2]), []))
            elif line[:2] == ["property", "list"]:
                length, dtype = (np.dtype(order + _TYPES[kind]) for kind in line[2:4])
                elements[-1].properties.append(_Property(line[4], dtype, length))
            elif line[:1] == ["property"]:
                elements[-1].properties.append(_Property(line[2], np.dtype(order + _TYPES[line[1]]), None))
    except (IndexError, KeyError, ValueError) as error:
        raise ValueError(f"its header has a line that is none ({error})") from None
    if any(element.count < 0 for element in elements):
        raise ValueError("its header counts fewer than no elements")
    return elements, body.removeprefix(b"\r").removeprefix(b"\n"), form == "ascii"


def _plain(element: _Element, source: bytes | Sequence[bytes], place: int) -> tuple[dict[str, np.ndarray], int]:
    """The columns of an element without lists, and where it ends."""
    names = [each.name for each in element.properties]
    if isinstance(source, bytes):
        row = np.dtype([(f"{i}", each.dtype) for i, each in enumerate(element.properties)])
        end = place + element.count * row.itemsize
        if end > len(source):
            raise ValueError("it is cut off")
        table = np.frombuffer(source[place:end], row) if element.count else np.zeros(0, row)
        return {name: table[f"{i}"] for i, name in enumerate(names)}, end
    end = place + element.count * len(names)
    if end > len(source):
        raise ValueError("it is cut off")
    numbers = _floats(source[place:end]).reshape(element.count, len(names))
    return dict(zip(names, numbers.T, strict=True)), end


def _lists(element: _Element, source: bytes | Sequence[bytes], place: int) -> tuple[list[list[int]], int]:
    """The corners of each face of an element that has lists, and where it ends."""
    rows: list[list[int]] = []
    for _ in range(element.count):
        for each in element.properties:
            count = 1
            if each.length is not None:
                (number,), place = _numbers(source, place, 1, each.length)
                count = int(number) if number == number // 1 else -1
            values, place = _numbers(source, place, count, each.dtype)
            if each.name in _FACES:
                rows.append([int(value) for value in values])
    return rows, place


def _numbers(source: bytes | Sequence[bytes], place: int, count: int, dtype: np.dtype) -> tuple[list[int | float], int]:
    size = dtype.itemsize if isinstance(source, bytes) else 1
    end = place + count * size
    if count < 0 or end > len(source):
        raise ValueError("it is cut off")
    if isinstance(source, bytes):
        return np.frombuffer(source[place:end], dtype).tolist(), end
    return _floats(source[place:end]).tolist(), end


def _floats(cells: Sequence[bytes]) -> np.ndarray:
    try:
        numbers = np.array([float(cell) for cell in cells], np.float64)
    except ValueError:
        raise ValueError("it has a word where a number belongs") from None
    if not np.isfinite(numbers).all():
        raise ValueError("it holds numbers that are NaN or infinite")
    return numbers
