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
    """Header of a PLY file's content. Raises ValueError for a wrong one."""
    first_line = re.match(rb"ply[ \t]*(\r\n|\r|\n)", content)
    if first_line is None:
        raise ValueError("it has no header from ply to end_header, is it a PLY file?")
    # all lines of the header must end alike
    line_end = first_line[1]
    end_line = re.compile(line_end + rb"end_header[ \t]*" + line_end).search(content)
    if end_line is None:
        raise ValueError("it has no header from ply to end_header, is it a PLY file?")
    order = None
    elements = list[PlyElement]()
    text = content[first_line.end() : end_line.start()].decode("ascii", "replace")
    for line in text.split(line_end.decode()):
        words = line.split()
        if not words or words[0] in ("comment", "obj_info"):
            warn_of_offset([line])
            continue
        if words[0] == "format" and len(words) == 3 and words[1] in _PLY_ORDERS and order is None:
            order = _PLY_ORDERS[words[1]]
        elif words[0] == "element" and len(words) == 3:
            elements.append(PlyElement(words[1], rows=whole_numbers(words[2:])[0], properties=[]))
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
    return PlyHeader(order, elements, size=end_line.end())


def _check_properties(elements: Sequence[PlyElement], vertex_index: int) -> None:
    """Raise ValueError for too many properties, a name twice in points, and no x, y and z.

    vertex_index: index of the points in `elements`."""
    point_names = [entry.name for entry in elements[vertex_index].properties]
    if sum(len(element.properties) for element in elements) > MAX_FIELDS:
        raise ValueError(f"its header names more than {MAX_FIELDS} properties")
    if len(set(point_names)) < len(point_names):
        raise ValueError(f"its points must have no name twice, got {', '.join(point_names)[:200]}")
    find_axes(point_names)  # raises if they lack x, y and z


def _parse_property(words: list[str], order: str) -> PlyProperty:
    """Parse a property of a PLY header: "float x" or "list uchar int vertex_index".

    words: words after "property"; order: byte order as NumPy's types state it, "" for text. Raises
    ValueError for an unknown type."""
    type_words = words[:-1]
    name = words[-1] if words else ""
    length_type = None
    if len(type_words) == 3 and type_words[0] == "list":
        length_type = _PLY_TYPES.get(type_words[1], "f")
    is_list = length_type is not None and length_type[0] != "f"  # lengths are whole numbers
    if not (is_list or len(type_words) == 1) or type_words[-1] not in _PLY_TYPES:
        raise ValueError(f"its header has a property of unknown type: {' '.join(words)[:80]!r}")
    return PlyProperty(
        name=name.lower() if len(name) == 1 else name,
        kind=np.dtype(order + _PLY_TYPES[type_words[-1]]),
        length=np.dtype(f"{order}{length_type}") if is_list else None,
    )
