"""Bodies from mesh files of one's own: whatever Open3D reads, checked for units, orientation and class by their size.

Files are in metres, x forward, z up. glTF files are y up and z forward, as their standard says, unless only z up gives
a plausible body. The class is the name of a folder in the path (`vehicle/`, `cyclist/`, `pedestrian/`, `heavy/`) or the
beginning of the file's name (`cyclist_old_bicycle.ply`); without either it follows from the size, vehicle first.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import open3d as o3d

from toolkit.arrays import Float64, Int64
from toolkit.bodies.body import Body, centred
from toolkit.bodies.guarded_meshes import GUARDED, read_guarded_mesh
from toolkit.bodies.off_meshes import read_off_mesh
from toolkit.bodies.ply_meshes import read_ply_mesh
from toolkit.objects import CYCLIST, HEAVY, LABELS, PEDESTRIAN, VEHICLE

SUFFIXES = (".obj", ".ply", ".stl", ".off", *GUARDED)
_READERS: dict[str, Callable[[Path], tuple[np.ndarray, np.ndarray]]] = {
    ".ply": read_ply_mesh,
    ".off": read_off_mesh,
    **dict.fromkeys(GUARDED, read_guarded_mesh),
}

# Smallest and largest length, width and height (m) of a body of each class.
PLAUSIBLE = {
    VEHICLE: ((2.2, 6.6), (1.2, 2.7), (0.9, 2.9)),
    CYCLIST: ((0.9, 3.0), (0.25, 1.3), (0.8, 2.4)),
    PEDESTRIAN: ((0.15, 2.0), (0.15, 2.0), (0.6, 2.5)),
    HEAVY: ((4.0, 25.0), (1.7, 3.6), (1.7, 4.8)),
}
_Y_UP_Z_FORWARD = np.array([[0.0, 0, 1], [1, 0, 0], [0, 1, 0]])  # glTF
_Y_UP_X_FORWARD = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
_Y_FORWARD = np.array([[0.0, 1, 0], [-1, 0, 0], [0, 0, 1]])
_TURNS = {"y up and z": _Y_UP_Z_FORWARD, "y up and x": _Y_UP_X_FORWARD, "z up and y": _Y_FORWARD}
_UNITS = {"millimetres": 0.001, "centimetres": 0.01, "inches": 0.0254}


def load_meshes(folder: str | Path) -> tuple[Body, ...]:
    """A body per mesh file in `folder` and below, in the order of their paths; other files are left alone.

    Raises FileNotFoundError where there is no such folder; ValueError, naming the file, where a mesh cannot be read, is
    empty or broken, or has a size that no road user has.
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise FileNotFoundError(f"{folder} is no folder: give one that holds mesh files ({' '.join(SUFFIXES)})")
    paths = sorted(path for path in folder.rglob("*") if path.suffix.lower() in SUFFIXES and path.is_file())
    if not paths:
        raise ValueError(f"{folder} holds no mesh: put files in it that end in one of {' '.join(SUFFIXES)}")
    return tuple(load_mesh(path, path.relative_to(folder)) for path in paths)


def load_mesh(path: str | Path, called: str | Path | None = None) -> Body:
    """The body of one file; `called` is the path whose folders and name give its class and name."""
    path, called = Path(path), Path(called or Path(path).name)
    vertices, triangles = _read(path)
    named = _label_in(called)
    labels = tuple(PLAUSIBLE) if named is None else (named,)
    turns = [_Y_UP_Z_FORWARD, np.eye(3)] if path.suffix.lower() in (".glb", ".gltf") else [np.eye(3)]
    for turn in turns:
        turned = vertices @ turn.T
        for label in labels:
            if _plausible(np.ptp(turned, axis=0), label):
                return centred(called.with_suffix("").as_posix(), label, turned, triangles)
    size = " x ".join(f"{extent:.4g}" for extent in np.ptp(vertices, axis=0))
    wanted = f"a {LABELS[named]}" if named is not None else "any road user"
    raise ValueError(
        f"{path}: {size} (x, y, z) is no size of {wanted} in metres, x forward, z up: {_remedy(vertices, labels)}"
    )


def _read(path: Path) -> tuple[Float64[np.ndarray, "k 3"], Int64[np.ndarray, "m 3"]]:
    """Vertices in use and triangles of a file."""
    read = _READERS.get(path.suffix.lower())
    if read is not None:
        try:
            points, corners = read(path)
        except ValueError as error:
            raise ValueError(f"{path}: is damaged, empty or no mesh: {error}; export it again") from None
        mesh = o3d.geometry.TriangleMesh(o3d.utility.Vector3dVector(points), o3d.utility.Vector3iVector(corners))
        return _in_use(mesh, path)
    with o3d.utility.VerbosityContextManager(o3d.utility.VerbosityLevel.Error):
        try:
            mesh = o3d.io.read_triangle_mesh(path)
        except RuntimeError as error:
            raise ValueError(f"{path}: Open3D cannot read it ({error}): export it again") from None
    return _in_use(mesh, path)


def _in_use(mesh: o3d.geometry.TriangleMesh, path: Path) -> tuple[Float64[np.ndarray, "k 3"], Int64[np.ndarray, "m 3"]]:
    if not mesh.has_triangles():
        state = "has points but no triangles" if mesh.has_vertices() else "is damaged, empty or no mesh"
        raise ValueError(f"{path}: {state}: export it again as a triangle mesh")
    corners = np.asarray(mesh.triangles)
    if corners.min() < 0 or corners.max() >= len(mesh.vertices):  # which Open3D would follow out of its memory
        raise ValueError(f"{path}: a triangle has a corner that is not there: repair it or export it again")
    mesh.remove_unreferenced_vertices()
    vertices = np.asarray(mesh.vertices, np.float64)
    if not np.isfinite(vertices).all():
        raise ValueError(f"{path}: holds vertices that are NaN or infinite: repair it or export it again")
    return vertices, np.asarray(mesh.triangles, np.int64)


def _label_in(called: Path) -> int | None:
    """The class named by a folder of the path or by the beginning of the file's name."""
    for part in (*reversed(called.parent.parts), called.stem):
        for label, name in enumerate(LABELS):
            if part.lower().startswith(name):
                return label
    return None


def _plausible(size: Float64[np.ndarray, "3"], label: int) -> bool:
    return all(low <= extent <= high for extent, (low, high) in zip(size, PLAUSIBLE[label], strict=True))


def _remedy(vertices: Float64[np.ndarray, "k 3"], labels: tuple[int, ...]) -> str:
    """What would make it plausible: other units, another orientation, or both."""
    for what, size in _readings(np.ptp(vertices, axis=0)):
        if any(_plausible(size, label) for label in labels):
            return what
    return "check its units and axes, or move it to the folder of its class"


def _readings(size: Float64[np.ndarray, "3"]) -> Iterator[tuple[str, Float64[np.ndarray, "3"]]]:
    """The size read in other units and turned, with what to do about it."""
    turned = {axes: np.abs(turn) @ size for axes, turn in _TURNS.items()}
    for axes, other in turned.items():
        yield f"it seems to be {axes} forward, turn it", other
    for unit, metres in _UNITS.items():
        yield f"it seems to be in {unit}, scale it by {metres}", size * metres
        for axes, other in turned.items():
            yield f"it seems to be in {unit}, {axes} forward: scale it by {metres} and turn it", other * metres
