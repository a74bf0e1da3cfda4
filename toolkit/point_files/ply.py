"""PLY files, as text and in both orders of bytes.

Open3D's reader ends the process at a long comment, and takes whatever its memory holds for points
if there is a word among the numbers. http://paulbourke.net/dataformats/ply/"""

from pathlib import Path

import numpy as np

from toolkit.point_columns import Attributes, name_attributes
from toolkit.point_files.ply_header import PlyElement, PlyHeader, parse_ply_header
from toolkit.point_files.rows import read_binary, read_rows
from toolkit.runtime.reading import read_plain

_MAX_LISTS = 1_000_000  # rows with lists before the points, which are walked one by one


def read_ply(path: str | Path) -> Attributes:
    """Read the attributes of a PLY file's points (`name_attributes`), its `vertex` element.

    Raises ValueError, in one line, if the file is damaged, cut off, longer than its header
    states, or has no x, y and z."""
    content = read_plain(path)
    try:
        header = parse_ply_header(content)
        vertex_index = [element.name for element in header.elements].index("vertex")
        vertex = header.elements[vertex_index]
        columns = _read_vertices(Path(path), content, header, vertex_index)
    except ValueError as error:
        raise ValueError(f"{path} holds no points that can be read: {error}") from None
    named_columns = {}
    for entry, column in zip(vertex.properties, columns, strict=True):
        native_type = entry.kind.newbyteorder("=")  # the file may have the other order of bytes
        named_columns[entry.name] = column.astype(native_type, copy=False)
    return name_attributes(named_columns)


def _read_vertices(
    path: Path, content: bytes, header: PlyHeader, vertex_index: int
) -> list[np.ndarray]:
    """Column of each property of a PLY file's vertices.

    path, content: the file and its bytes; vertex_index: index of the vertices in
    `header.elements`."""
    vertex = header.elements[vertex_index]
    earlier_elements = header.elements[:vertex_index]
    is_last = vertex_index == len(header.elements) - 1
    if vertex.row is None:
        raise ValueError("its vertices have lists: export it again as points")
    if not header.order:  # text
        header_lines = len(content[: header.size].splitlines())
        earlier_lines = sum(element.rows for element in earlier_elements)
        return read_rows(
            path,
            skipped=header_lines + earlier_lines,
            row=vertex.row,
            rows=vertex.rows,
            last=is_last,
        )
    # byte at which the vertices begin; with lists, earlier elements have rows of different sizes
    start = header.size
    for element in earlier_elements:
        start = _find_end(element, content, start)
    end = None if is_last else start + vertex.rows * vertex.row.itemsize
    return read_binary(content[start:end], vertex.row, vertex.rows)


def _find_end(element: PlyElement, content: bytes, start: int) -> int:
    """Index in a binary file's content of the byte after an element, which begins at `start`.

    Lists have lengths of their own, so elements with lists are walked value by value."""
    if element.row is not None:
        return start + element.rows * element.row.itemsize
    if element.rows > _MAX_LISTS:
        raise ValueError(f"it has {element.rows} lists before its points: write the points first")
    end = start
    for _ in range(element.rows):
        for entry in element.properties:
            count = 1
            if entry.length is not None:  # a list: the number of its values comes first
                count = -1
                if end + entry.length.itemsize <= len(content):
                    count = int(np.frombuffer(content, entry.length, count=1, offset=end)[0])
                end += entry.length.itemsize
            if count < 0:
                raise ValueError("a list before its points is damaged or cut off")
            end += count * entry.kind.itemsize
    return end
