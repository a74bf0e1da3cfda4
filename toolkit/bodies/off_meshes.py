"""Triangle meshes of OFF files, read in NumPy: Open3D follows a corner that is not there.

https://segeval.cs.princeton.edu/public/off_format.html
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from toolkit.arrays import Float64, Int64

_KINDS = ("OFF", "COFF", "NOFF", "CNOFF")


def read_off_mesh(path: str | Path) -> tuple[Float64[np.ndarray, "k 3"], Int64[np.ndarray, "m 3"]]:
    """Vertices and triangles; faces of more corners become fans. Raises ValueError where the file is damaged."""
    text = Path(path).read_bytes().decode("ascii", "replace")
    lines = [cells for line in text.splitlines() if (cells := line.split("#")[0].split())]
    if not lines or lines[0][0] not in _KINDS:
        raise ValueError(f"it does not begin with one of {', '.join(_KINDS)}")
    rest = [lines[0][1:], *lines[1:]] if len(lines[0]) > 1 else lines[1:]
    try:
        vertex_count, face_count = (int(cell) for cell in rest[0][:2])
        if not (vertex_count >= 0 and face_count >= 0 and vertex_count + face_count <= len(rest) - 1):
            raise ValueError("it is cut off")
        vertices = np.array([[float(cell) for cell in row[:3]] for row in rest[1 : 1 + vertex_count]], np.float64)
        faces = [[int(cell) for cell in row[1 : 1 + int(row[0])]] for row in rest[1 + vertex_count :][:face_count]]
    except (IndexError, ValueError) as error:
        raise ValueError(f"its numbers are damaged ({error})") from None
    fans = [(row[0], row[i], row[i + 1]) for row in faces for i in range(1, len(row) - 1)]
    triangles = np.array(fans, np.float64).reshape(-1, 3)
    if vertices.shape != (vertex_count, 3) or not np.isfinite(vertices).all():
        raise ValueError("its vertices are not three finite numbers each")
    if len(triangles) and not (triangles.min() >= 0 and triangles.max() < len(vertices)):
        raise ValueError("a triangle has a corner that is not there")
    return vertices, triangles.astype(np.int64)
