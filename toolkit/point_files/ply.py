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
    table = {}
    for entry, column in zip(vertex.properties, columns, strict=True):
        table[entry.name] = column.astype(entry.kind.newbyteorder("="), copy=False)
    return name_attributes(table)


def _read_vertices(
    path: Path, content: bytes, header: PlyHeader, vertex_index: int
) -> list[np.ndarray]:
    """Columns of the vertices, after the elements before them."""
    vertex = header.elements[vertex_index]
    earlier = header.elements[:vertex_index]
    last = vertex_index == len(header.elements) - 1
    if vertex.row is None:
        raise ValueError("its vertices have lists: export it again as points")
    if not header.order:
        header_lines = len(content[: header.size].splitlines())
        skipped = header_lines + sum(element.rows for element in earlier)
        return read_rows(path, skipped, vertex.row, vertex.rows, last=last)
    start = header.size
    for element in earlier:
        start = _skip(element, content, start)
    end = None if last else start + vertex.rows * vertex.row.itemsize
    return read_binary(content[start:end], vertex.row, vertex.rows)


def _skip(element: PlyElement, content: bytes, start: int) -> int:
    """End of an element of a binary file (bytes)."""
    if element.row is not None:
        return start + element.rows * element.row.itemsize
    if element.rows > _MAX_LISTS:
        raise ValueError(f"it has {element.rows} lists before its points: write the points first")
    end = start
    for _ in range(element.rows):
        for entry in element.properties:
            count = 1
            if entry.length is not None:
                count = -1
                if end + entry.length.itemsize <= len(content):
                    count = int(np.frombuffer(content, entry.length, 1, end)[0])
                end += entry.length.itemsize
            if count < 0:
                raise ValueError("a list before its points is damaged or cut off")
            end += count * entry.kind.itemsize
    return end
