"""Bodies from mesh files of one's own: whatever Open3D reads, checked for units, orientation and class.

Files are in metres, x forward, z up. glTF files are y up and z forward, as their standard says, unless only z up gives
a plausible body. The class is the name of a folder in the path (`vehicle/`, `cyclist/`, `pedestrian/`, `heavy/`) or the
beginning of the file's name (`cyclist_old_bicycle.ply`); without either the shape must clearly be one's. A table,
`meshes.toml`, says otherwise, file by file: see `toolkit.bodies.mesh_table`. What can be seen to lie on its side, stand
across or face backwards is refused, and so is what cannot be told; nothing is turned or scaled on a guess.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
import open3d as o3d

from toolkit.arrays import Float64, Int64
from toolkit.bodies.body import Body, centred
from toolkit.bodies.guarded_meshes import GUARDED, read_guarded_mesh
from toolkit.bodies.mesh_shapes import Shape, clear_class, measured_shape, mirror_span, wrong_stand
from toolkit.bodies.mesh_table import NOTHING_SAID, TABLE, MeshEntry, read_mesh_table
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
_TYPICAL = {
    VEHICLE: (4.5, 1.85, 1.55), CYCLIST: (1.75, 0.6, 1.7), PEDESTRIAN: (0.5, 0.5, 1.7), HEAVY: (9.0, 2.45, 3.1)
}  # fmt: skip
_FRONT_CLEAR = 0.1  # `Shape.ahead` from which a vehicle's profile says where its front is
_Y_UP_Z_FORWARD = np.array([[0.0, 0, 1], [1, 0, 0], [0, 1, 0]])  # glTF
_Y_UP_X_FORWARD = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
_Y_FORWARD = np.array([[0.0, 1, 0], [-1, 0, 0], [0, 0, 1]])
_TURNS = {"y up and z": _Y_UP_Z_FORWARD, "y up and x": _Y_UP_X_FORWARD, "z up and y": _Y_FORWARD}
_UNITS = {"millimetres": 0.001, "centimetres": 0.01, "inches": 0.0254, "feet": 0.3048}


class TakenMesh(NamedTuple):
    """A file below the folder, the body it became, and how it was taken, in words: class, size, frame."""

    file: str
    body: Body
    how: str


def load_meshes(folder: str | Path) -> tuple[Body, ...]:
    """A body per mesh file in `folder` and below, in the order of their paths; other files are left alone.

    Raises what `taken_meshes` raises.
    """
    return tuple(taken.body for taken in taken_meshes(folder))


def taken_meshes(folder: str | Path, *, mirrors: bool = False) -> tuple[TakenMesh, ...]:
    """The mesh files in `folder` and below, in the order of their paths, each with how it was taken.

    mirrors: whether the ground truth boxes of vehicles hold the wing mirrors that can be seen to stick out of them.
    Raises FileNotFoundError where there is no such folder; ValueError, naming the file, where a mesh cannot be read, is
    empty or broken, has a size that no road user has, or is not clearly one.
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise FileNotFoundError(f"{folder} is no folder: give one that holds mesh files ({' '.join(SUFFIXES)})")
    paths = sorted(path for path in folder.rglob("*") if path.suffix.lower() in SUFFIXES and path.is_file())
    if not paths:
        raise ValueError(f"{folder} holds no mesh: put files in it that end in one of {' '.join(SUFFIXES)}")
    table = read_mesh_table(folder)
    called = [path.relative_to(folder) for path in paths]
    return tuple(
        _taken(path, name, table.get(name, NOTHING_SAID), mirrors) for path, name in zip(paths, called, strict=True)
    )


def load_mesh(path: str | Path, called: str | Path | None = None) -> Body:
    """The body of one file; `called` is the path whose folders and name give its class and name."""
    path = Path(path)
    return _taken(path, Path(called or path.name), NOTHING_SAID, mirrors=False).body


def _taken(path: Path, called: Path, entry: MeshEntry, mirrors: bool) -> TakenMesh:
    vertices, triangles = _read(path)
    vertices = vertices * (entry.scale or 1.0)
    named = _label_in(called) if entry.label is None else entry.label
    labels = tuple(PLAUSIBLE) if named is None else (named,)
    gltf = path.suffix.lower() in (".glb", ".gltf")
    turns = [entry.turn] if entry.framed else [_Y_UP_Z_FORWARD, np.eye(3)] if gltf else [np.eye(3)]
    doubts = []
    for turn in turns:
        turned = vertices @ turn.T
        fitting = [label for label in labels if _plausible(np.ptp(turned, axis=0), label)]
        if not fitting:
            continue
        shape = _shape(path, turned, triangles)
        clear = [label for label in fitting if named is not None or clear_class(shape, label)]
        doubt = wrong_stand(shape, clear[0]) if clear and not entry.framed else None
        if len(clear) == 1 and doubt is None:
            body = _body(called.with_suffix("").as_posix(), clear[0], turned, triangles, mirrors)
            return TakenMesh(called.as_posix(), body, _how(body, shape, entry, named, turn))
        doubts.append(doubt or f"by its size it may be {_either(fitting)}, but its shape is not clearly that of one")
    size = " x ".join(f"{extent:.4g}" for extent in np.ptp(vertices, axis=0))
    remedy = _remedy(vertices, triangles, named)
    if doubts:
        say = (
            remedy
            or f"put it into a folder {'/, '.join(LABELS)}/, or say in {TABLE} what it is, what is up and forward"
        )
        raise ValueError(f"{path}: {size} (x, y, z): {doubts[0]}: {say}")
    wanted = f"a {LABELS[named]}" if named is not None else "any road user"
    remedy = remedy or f"check its units and axes, move it to the folder of its class, or say in {TABLE} what it is"
    raise ValueError(f"{path}: {size} (x, y, z) is no size of {wanted} in metres, x forward, z up: {remedy}")


def _body(name: str, label: int, vertices: np.ndarray, triangles: np.ndarray, mirrors: bool) -> Body:
    whole = centred(name, label, vertices, triangles)
    span = (
        None if mirrors or label not in (VEHICLE, HEAVY) else mirror_span(whole.vertices.astype(np.float64), triangles)
    )
    if span is None:
        return whole
    aside = np.array([0, sum(span) / 2, 0], np.float32)
    truth = whole.size[0], span[1] - span[0], whole.size[2]
    return Body(name, label, whole.vertices - aside, whole.triangles, truth)


def _how(body: Body, shape: Shape, entry: MeshEntry, named: int | None, turn: np.ndarray) -> str:
    """Class, size and frame of a body, and what each was told by."""
    known = (
        f"as {TABLE} says"
        if entry.label is not None
        else "by its folder or name"
        if named is not None
        else "by its shape"
    )
    axes = {
        tuple(sign * row): ("-" if sign < 0 else "") + "xyz"[i] for i, row in enumerate(np.eye(3)) for sign in (1, -1)
    }
    forward, _, up = (axes[tuple(row)] for row in turn)
    frame = f"{up} up, {forward} forward"
    if not entry.framed and body.label == VEHICLE:
        frame += " (its profile agrees)" if shape.ahead > _FRONT_CLEAR else " (assumed, its profile does not tell)"
    elif not entry.framed:
        frame += " (front assumed)"
    mirrors = "" if body.truth is None else ", mirrors left out of its box"
    scale = "" if entry.scale is None else f", scaled by {entry.scale:g}"
    size = " x ".join(f"{extent:.2f}" for extent in body.size)
    return f"{LABELS[body.label]} ({known}), {size} m, {frame}{scale}{mirrors}"


def _either(labels: list[int]) -> str:
    return " or ".join(f"a {LABELS[label]}" if label != HEAVY else "a heavy vehicle" for label in labels)


def _shape(path: Path, vertices: np.ndarray, triangles: np.ndarray) -> Shape:
    try:
        return measured_shape(vertices, triangles)
    except ValueError as error:
        raise ValueError(f"{path}: {error}: export it again as a closed triangle mesh") from None


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


def _remedy(vertices: np.ndarray, triangles: np.ndarray, named: int | None) -> str:
    """What would make it plausible: other units, another orientation, or both; empty where nothing would."""
    best, remedy = (np.inf, np.inf), ""
    for what, turn, scale in _readings():
        read = vertices @ turn.T * scale
        size = np.ptp(read, axis=0)
        for label in PLAUSIBLE if named is None else (named,):
            if not _plausible(size, label):
                continue
            off = (float(scale != 1), float(np.abs(np.log(size / _TYPICAL[label])).max()))
            if off >= best:
                continue
            shape = measured_shape(read, triangles)
            if wrong_stand(shape, label) is None and (named is not None or clear_class(shape, label)):
                best, remedy = off, what
    return remedy


def _readings() -> Iterator[tuple[str, Float64[np.ndarray, "3 3"], float]]:
    """Ways to read a file that is not as documented: what to do about it, its rotation, its scale."""
    for axes, turn in _TURNS.items():
        yield f"it seems to be {axes} forward, turn it", turn, 1.0
    for unit, metres in _UNITS.items():
        yield f"it seems to be in {unit}, scale it by {metres}", np.eye(3), metres
        for axes, turn in _TURNS.items():
            what = f"it seems to be in {unit}, {axes} forward: scale it by {metres} and turn it"
            yield what, turn, metres
