"""Header of a PLY file: the order of its bytes and its elements."""

import re
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from toolkit.point_columns import find_axes, warn_of_offset
from toolkit.point_files.rows import MAX_FIELDS, whole_numbers

_PLY_TYPES = {
    **dict.fromkeys(("char", "int8"), "i1"),
    **dict.fromkeys(("uchar", "uint8"), "u1"),
    **dict.fromkeys(("short", "int16"), "i2"),
    **dict.fromkeys(("ushort", "uint16"), "u2"),
    **dict.fromkeys(("int", "int32"), "i4"),
    **dict.fromkeys(("uint", "uint32"), "u4"),
    **dict.fromkeys(("float", "float32"), "f4"),
    **dict.fromkeys(("double", "float64"), "f8"),
}
_PLY_ORDERS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}


class PlyProperty(NamedTuple):
    """Property of an element: its name, its type and, for a list, the type of its length."""

    name: str
    kind: np.dtype
    length: np.dtype | None


class PlyElement(NamedTuple):
    """Element of a PLY file: its name, its number of rows, and its properties."""

    name: str
    rows: int
    properties: list[PlyProperty]

    @property
    def row(self) -> np.dtype | None:
        """Type of a row; None if it has lists."""
        if any(entry.length is not None for entry in self.properties):
            return None
        return np.dtype([(f"{k}", entry.kind) for k, entry in enumerate(self.properties)])


class PlyHeader(NamedTuple):
    """Header of a PLY file: order of bytes ("" for text), elements, and its length in bytes."""

    order: str
    elements: list[PlyElement]
    size: int


def parse_ply_header(content: bytes) -> PlyHeader:
    """Header of a file's content. Raises ValueError for a wrong one."""
    first = re.match(rb"ply[ \t]*(\r\n|\r|\n)", content)
    end = first and re.compile(first[1] + rb"end_header[ \t]*" + first[1]).search(content)
    if first is None or end is None:
        raise ValueError("it has no header from ply to end_header, is it a PLY file?")
    order = None
    elements = list[PlyElement]()
    text = content[first.end() : end.start()].decode("ascii", "replace")
    for line in text.split(first[1].decode()):
        words = line.split()
        if not words or words[0] in ("comment", "obj_info"):
            warn_of_offset([line])
            continue
        if words[0] == "format" and len(words) == 3 and words[1] in _PLY_ORDERS and order is None:
            order = _PLY_ORDERS[words[1]]
        elif words[0] == "element" and len(words) == 3:
            elements.append(PlyElement(words[1], whole_numbers(words[2:])[0], []))
        elif words[0] == "property" and elements and order is not None:
            elements[-1].properties.append(_parse_property(words[1:], order))
        else:
            raise ValueError(f"its header has a line that PLY does not know: {line[:80]!r}")
    names = [element.name for element in elements]
    if order is None or names.count("vertex") != 1 or any(element.rows < 0 for element in elements):
        raise ValueError(
            "its header must have one format and one element vertex, and no count below 0"
        )
    _check_properties(elements, names.index("vertex"))
    return PlyHeader(order, elements, end.end())


def _check_properties(elements: Sequence[PlyElement], vertex_index: int) -> None:
    """Raise ValueError for too many properties, a name twice in points, and no x, y and z."""
    point_names = [entry.name for entry in elements[vertex_index].properties]
    if sum(len(element.properties) for element in elements) > MAX_FIELDS:
        raise ValueError(f"its header names more than {MAX_FIELDS} properties")
    if len(set(point_names)) < len(point_names):
        raise ValueError(f"its points must have no name twice, got {', '.join(point_names)[:200]}")
    find_axes(point_names)


def _parse_property(words: list[str], order: str) -> PlyProperty:
    """Property of the words after "property"."""
    *kinds, name = words or [""]
    is_list = kinds[:1] == ["list"] and len(kinds) == 3 and _PLY_TYPES.get(kinds[1], "f")[0] != "f"
    if not (is_list or len(kinds) == 1) or kinds[-1] not in _PLY_TYPES:
        raise ValueError(f"its header has a property of unknown type: {' '.join(words)[:80]!r}")
    kind = np.dtype(order + _PLY_TYPES[kinds[-1]])
    length = np.dtype(order + _PLY_TYPES[kinds[1]]) if is_list else None
    return PlyProperty(name.lower() if len(name) == 1 else name, kind, length)
