"""Bodies from your own mesh files, checked for units, orientation and class.

Files are in metres, x forward, z up. glTF files are y up and z forward, as their standard says,
unless only z up gives a plausible body. The class is the name of a folder in the path (`vehicle/`,
`cyclist/`, `pedestrian/`, `heavy/`) or the beginning of the file's name
(`cyclist_old_bicycle.ply`); without either the shape must clearly be one's: a car or bus fills its
box and is close to the ground between wheels on both sides, a two-wheeler stands on a line, a
person stands upright and fills little. A mesh that seems to lie on its side, stand across or face
backwards is refused, and so is one whose class is unclear; nothing is turned or scaled on a guess.
A table, `meshes.toml`, overrides all this:

    [[mesh]]
    file = "models/bus_12m.obj"   # below the folder
    label = "heavy"               # vehicle, cyclist, pedestrian or heavy
    up = "y"                      # the file's axis that points up: x y z -x -y -z
    forward = "z"                 # and the one that points forward
    scale = 0.0254                # metres of one of its units

Only `file` must be there."""

from dataclasses import dataclass
from itertools import product
from os.path import lexists
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from toolkit.arrays import Bool, Float64, Int64
from toolkit.bodies.body import Body, make_body
from toolkit.mesh import Mesh, Span, scale_mesh
from toolkit.objects import CYCLIST, HEAVY, LABELS, PEDESTRIAN, VEHICLE
from toolkit.runtime.reading import name_errors, read_plain
from toolkit.runtime.text_values import parse_toml

_POINTS = 30_000  # number of points that are spread over a mesh to measure it
_CELLS = 32  # cells along an axis in which outlines are judged
_COARSE = 16  # cells along an axis in which symmetry is judged
# limits of the share of the surface without a counterpart: symmetric below, not symmetric above
SYMMETRIC = 0.06
ASKEW = 0.12
BACKWARDS = -0.18  # no car has as low a `Shape.ahead`: a pick-up has -0.14
TABLE = "meshes.toml"
# unit vector of each axis name, such as "x" and "-y"
_AXES = {
    sign + axis: (1 if not sign else -1) * np.eye(3)[i]
    for i, axis in enumerate("xyz")
    for sign in ("", "-")
}
SUFFIXES = (".obj", ".ply", ".stl", ".off", ".glb", ".gltf")

# Smallest and largest length, width and height (m) of a body of each class.
PLAUSIBLE = {
    VEHICLE: ((2.2, 6.6), (1.2, 2.7), (0.9, 2.9)),
    CYCLIST: ((0.9, 3.0), (0.25, 1.3), (0.8, 2.4)),
}
PLAUSIBLE |= {
    PEDESTRIAN: ((0.15, 2.0), (0.15, 2.0), (0.6, 2.5)),
    HEAVY: ((4.0, 25.0), (1.7, 3.6), (1.7, 4.8)),
}
# typical length, width, height (m), to choose between several possible units
_TYPICAL = {
    VEHICLE: (4.5, 1.85, 1.55),
    CYCLIST: (1.75, 0.6, 1.7),
    PEDESTRIAN: (0.5, 0.5, 1.7),
    HEAVY: (9.0, 2.45, 3.1),
}
_FRONT_CLEAR = 0.1  # `Shape.ahead` from which a vehicle's profile says where its front is
_Y_UP_Z_FORWARD = np.array([[0.0, 0, 1], [1, 0, 0], [0, 1, 0]])  # glTF
# rotations to x forward, y left, z up from other axes, by the words "... forward" in errors
_TURNS = {
    "y up and z": _Y_UP_Z_FORWARD,
    "y up and x": np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]]),
}
_TURNS["z up and y"] = np.array([[0.0, 1, 0], [-1, 0, 0], [0, 0, 1]])
_UNITS = {"millimetres": 0.001, "centimetres": 0.01, "inches": 0.0254, "feet": 0.3048}


class Shape(NamedTuple):
    """Shape of a mesh, measured on points of its surface."""

    size: Float64[np.ndarray, "3"]  # sides of the bounds (m)
    fills: Float64[np.ndarray, "3"]  # covered share of the box's outline, seen along x, y, z
    # share of the surface without a counterpart when mirrored along x, y, z
    asymmetry: Float64[np.ndarray, "3"]
    stance: tuple[float, float]  # length and width (m) of its contact with the ground
    clearance: float  # lowest height over the middle (m)
    ahead: float  # how much lower the front is than the rear, as a part of the height


def measure_shape(mesh: Mesh) -> Shape:
    """Measure a mesh (m) under the assumption that z is up and x forward.

    Raises ValueError for a flat one."""
    low = mesh.vertices.min(axis=0)
    size = np.ptp(mesh.vertices, axis=0)
    if not (size > 0).all():
        raise ValueError("has no volume")
    points = surface_points(mesh)
    # each coordinate from 0 to just below 1 over the mesh, so that cells are below their number
    unit_points = np.clip((points - low) / size, 0, 1 - 1e-9)
    x, y, z = unit_points.T
    cells = (unit_points * _CELLS).astype(np.int64)
    # share of the bounds' rectangle that the outline fills, seen along x, y and z
    fills = [_fill_outline(np.delete(cells, axis, axis=1)).mean() for axis in range(3)]
    # points in the lowest 4 % of the height touch the ground
    ground_points = points[z < 0.04]
    stance_length, stance_width = np.ptp(ground_points[:, :2], axis=0).tolist()
    # heights (parts of the mesh's height) of points near the middle of length and width
    middle_z = z[(np.abs(x - 0.5) < 0.1) & (np.abs(y - 0.5) < 0.25)]
    # highest point in each of 24 slices along the length: the first 8 are the rear third, the last
    # 8 the front third
    slices = (x * 24).astype(np.int64)
    tops = np.array([z[slices == k].max(initial=0.0) for k in range(24)])
    return Shape(
        size=size,
        fills=np.array(fills),
        asymmetry=_measure_asymmetry(unit_points),
        stance=(stance_length, stance_width),
        clearance=float(middle_z.min() * size[2]) if len(middle_z) else float(size[2]),
        ahead=float(tops[:8].mean() - tops[-8:].mean()),
    )


def is_clearly(shape: Shape, label: int) -> bool:
    """Return True if a shape clearly shows a class of `LABELS` without further hints."""
    left_right_asymmetry = shape.asymmetry[1]
    if left_right_asymmetry > ASKEW and label != PEDESTRIAN:  # a walking person is not symmetric
        return False
    shows_class = {  # function that returns True for a shape of the class
        VEHICLE: _is_clearly_car,
        HEAVY: _is_clearly_heavy,
        CYCLIST: _is_clearly_cyclist,
        PEDESTRIAN: _is_clearly_pedestrian,
    }
    return bool(label in shows_class and shows_class[label](shape))


def _is_clearly_car(shape: Shape) -> bool:
    """Return True for a shape with the size and proportions of a car, such as no van has."""
    length, width, height = shape.size.tolist()
    has_size = length < 6.1 and width < 2.4 and height < 2.1 and length > 1.25 * height
    has_proportions = length > 1.5 * width and shape.clearance < 0.55
    return _has_vehicle_body(shape) and has_size and has_proportions


def _is_clearly_heavy(shape: Shape) -> bool:
    length, width, height = shape.size.tolist()
    has_size = length > max(6.1, 1.9 * width) and height > 2.2
    return _has_vehicle_body(shape) and has_size and shape.clearance < 1.3


def _has_vehicle_body(shape: Shape) -> bool:
    """Return True if a shape fills its box and has wheels at the corners, as vehicles do."""
    length, width = shape.size[:2].tolist()
    fills_box = shape.fills[0] > 0.72 and shape.fills[1] > 0.55 and shape.fills[2] > 0.76
    has_wide_stance = shape.stance[0] > 0.4 * length and shape.stance[1] > 0.45 * width
    return bool(fills_box and has_wide_stance)


def _is_clearly_cyclist(shape: Shape) -> bool:
    """Return True for a long, thin shape with gaps that stands on a line, as on two wheels."""
    length, width = shape.size[:2].tolist()
    is_thin = width < 0.6 * length and shape.fills[1] < 0.75 and shape.fills[2] < 0.75
    is_on_a_line = shape.stance[1] < 0.22 and shape.stance[0] > 0.35 * length
    return is_thin and is_on_a_line and length < 2.8


def _is_clearly_pedestrian(shape: Shape) -> bool:
    """Return True for an upright shape of a person's height, with gaps."""
    length, width, height = shape.size.tolist()
    is_upright = height > 1.3 * max(length, width) and 1.35 < height < 2.15
    has_gaps = 0.22 < shape.fills[0] < 0.75 and shape.fills[1] < 0.8 and shape.fills[2] < 0.85
    return bool(is_upright and has_gaps)


def find_wrong_stand(shape: Shape, label: int) -> str | None:
    """Describe in words how a mesh of a class is turned wrongly; None if it seems right.

    shape: measured as if x were forward and z up; label: class number."""
    # share of the surface without a counterpart when mirrored along x, y and z
    x_asymmetry = shape.asymmetry[0]
    y_asymmetry = shape.asymmetry[1]
    z_asymmetry = shape.asymmetry[2]
    if label == PEDESTRIAN:
        height = shape.size[2]
        return "lies on the ground" if height < 0.7 * shape.size[:2].max() else None
    if z_asymmetry < SYMMETRIC and y_asymmetry > ASKEW:
        return "lies on its side: y or -y seems to be up"
    if x_asymmetry < SYMMETRIC and y_asymmetry > ASKEW:
        return "stands across: y or -y seems to be forward"
    # a front above the rear: `ahead` is by how much of the height it is lower
    if label == VEHICLE and shape.ahead < BACKWARDS:
        return "seems to face backwards: -x forward"
    return None


def surface_points(mesh: Mesh) -> Float64[np.ndarray, "n 3"]:
    """Points spread evenly over the triangles of a mesh, then all of its vertices.

    They are the same each time. Raises ValueError for a mesh without surface."""
    a, b, c = np.moveaxis(mesh.vertices[mesh.triangles], 1, 0)  # corners of each triangle
    areas = np.linalg.norm(np.cross(b - a, c - a), axis=1)  # doubled
    if not areas.sum() > 0:
        raise ValueError("has no surface")
    rng = np.random.default_rng(0)
    # triangle of each point, at even steps of the summed area
    steps = (np.arange(_POINTS) + 0.5) / _POINTS * areas.sum()
    triangle = np.searchsorted(np.cumsum(areas), steps).clip(max=len(a) - 1)
    # parts of both sides that start at corner a
    u, v = rng.random((2, _POINTS, 1))
    # reflect points of the parallelogram into the triangle
    is_beyond = u + v > 1
    u = np.where(is_beyond, 1 - u, u)
    v = np.where(is_beyond, 1 - v, v)
    points = a[triangle] + u * (b - a)[triangle] + v * (c - a)[triangle]
    return np.concatenate([points, mesh.vertices])


def mirror_span(mesh: Mesh) -> Span | None:
    """Range of y (m) of a vehicle's body without wing mirrors, right and left end.

    None if no mirror sticks out by 3 cm or more. A mirror sticks out within 30 cm of the outermost
    point, above the wheels, in the front six tenths. mesh: m, x forward, y left, z up."""
    points = surface_points(mesh)
    low = mesh.vertices.min(axis=0)
    length, width, height = np.ptp(mesh.vertices, axis=0)
    x, y, z = points.T
    rise = z - low[2]  # above the ground
    half_widths = []  # right and left half of the width, without mirrors
    for side in (-1.0, 1.0):
        outward = side * y
        tip_x = x[outward > outward.max() - 0.02]  # x in the outermost 2 cm
        is_tip_short = np.ptp(tip_x) < 0.4
        is_tip_in_front = tip_x.min() > low[0] + 0.4 * length
        is_near_tip = (np.abs(x - tip_x.mean()) < 0.3) & (rise > 0.35 * height)
        half_width = float(outward[~is_near_tip].max())
        has_mirror_size = 0.03 < outward.max() - half_width < 0.45
        if not (is_tip_in_front and is_tip_short and has_mirror_size):
            half_width = float(outward.max())
        half_widths.append(half_width)
    right = -half_widths[0]
    left = half_widths[1]
    return None if left - right > width - 0.03 else (right, left)


def _fill_outline(cells: Int64[np.ndarray, "n 2"]) -> Bool[np.ndarray, "a b"]:
    """Grid of the cells that are occupied or enclosed by occupied ones in both directions.

    cells: column and row of each occupied cell, from 0 to `_CELLS` - 1."""
    is_occupied = np.zeros((_CELLS, _CELLS), bool)
    is_occupied[tuple(cells.T)] = True
    is_inside = np.ones_like(is_occupied)
    for axis in (0, 1):
        # occupied at or before a cell along the axis, and at or after it
        is_inside &= np.logical_or.accumulate(is_occupied, axis)
        flipped = np.flip(is_occupied, axis)
        is_inside &= np.flip(np.logical_or.accumulate(flipped, axis), axis)
    return is_inside


def _measure_asymmetry(unit_points: Float64[np.ndarray, "n 3"]) -> Float64[np.ndarray, "3"]:
    """Share of the points without another point near their mirror image, mirrored along x, y, z.

    unit_points: points with each coordinate from 0 to below 1 over the mesh."""
    # the grid of cells has an empty border, so that all cells have neighbours
    is_occupied = np.zeros((_COARSE + 2,) * 3, bool)
    cells = (unit_points * _COARSE).astype(np.int64)
    is_occupied[tuple(cells.T + 1)] = True
    # cells that are occupied, or have an occupied neighbour
    is_near = np.zeros_like(is_occupied)
    inner = slice(1, -1)
    # 1: no shift along an axis
    for shift in np.ndindex(3, 3, 3):
        shifted_cells = tuple(slice(start, start + _COARSE) for start in shift)
        is_near[inner, inner, inner] |= is_occupied[shifted_cells]
    shares = []
    for axis in range(3):
        # True for the mirrored coordinate
        is_axis = np.eye(3, dtype=bool)[axis]
        mirrored_points = np.where(is_axis, 1 - 1e-9 - unit_points, unit_points)
        mirrored_cells = (mirrored_points * _COARSE).astype(np.int64)
        shares.append(1 - is_near[tuple(mirrored_cells.T + 1)].mean())
    return np.array(shares)


@dataclass(frozen=True)
class MeshEntry:
    """Entry of the table `meshes.toml` for a file; None for what it does not give."""

    label: int | None = None  # class number
    up: str | None = None  # axis of the file that points up, such as "-y"
    forward: str | None = None  # axis of the file that points forward
    scale: float | None = None  # metres of one unit of the file

    @property
    def has_frame(self) -> bool:
        """True if the entry gives the file's axis for up or forward."""
        return self.up is not None or self.forward is not None

    @property
    def turn(self) -> Float64[np.ndarray, "3 3"]:
        """Rotation (3, 3) from the file's axes to x forward, y left, z up."""
        forward = _AXES[self.forward or "x"]
        up = _AXES[self.up or "z"]
        return np.stack([forward, np.cross(up, forward), up])


def read_mesh_table(folder: Path) -> dict[Path, MeshEntry]:
    """Read `meshes.toml` in a folder; return its entries by file, relative to the folder.

    The result is empty without a table. Raises ValueError, naming the table and the entry, for
    damaged TOML and impossible entries."""
    path = folder / TABLE
    if not lexists(path):
        return {}
    content = read_plain(path)
    with name_errors(path):
        tables = parse_toml(content)
    rows = tables.get("mesh")
    if set(tables) != {"mesh"} or not isinstance(rows, list):
        raise ValueError(f"{path}: must hold [[mesh]] entries alone, got {sorted(tables)}")
    table: dict[Path, MeshEntry] = {}
    for number, row in enumerate(rows, 1):
        where = f"{path}, entry {number}"
        file = row.get("file") if isinstance(row, dict) else None
        if not isinstance(file, str) or not (folder / file).is_file():
            raise ValueError(f"{where}: file must name a mesh below {folder}, got {file!r}")
        if Path(file) in table:
            raise ValueError(f"{where}: {file} is there twice: keep one entry")
        table[Path(file)] = _read_entry(row, where)
    return table


def _read_entry(row: dict[str, Any], where: str) -> MeshEntry:
    """Check one row of the table and return it as an entry.

    where: table and number, for errors."""
    keys = {"file", "label", "up", "forward", "scale"}
    if not set(row) <= keys:
        raise ValueError(
            f"{where}: knows {', '.join(sorted(keys))}, got {', '.join(sorted(set(row) - keys))}"
        )
    for key in ("up", "forward"):
        if key in row and row[key] not in list(_AXES):
            raise ValueError(f"{where}: {key} must be one of {', '.join(_AXES)}, got {row[key]!r}")
    up = row.get("up")
    forward = row.get("forward")
    scale = row.get("scale")
    if (up or "z")[-1] == (forward or "x")[-1]:  # [-1]: the axis without its sign
        raise ValueError(
            f"{where}: up {up or 'z'} and forward {forward or 'x'} lie on one axis: say both"
        )
    if scale is not None and (
        isinstance(scale, bool) or not isinstance(scale, int | float) or not 0 < scale < 1e6
    ):
        raise ValueError(
            f"{where}: scale must be a number above 0, metres of one unit, got {scale!r}"
        )
    label = row.get("label")
    if label not in (None, *LABELS):
        raise ValueError(f"{where}: label must be one of {', '.join(LABELS)}, got {label!r}")
    return MeshEntry(
        label=None if label is None else LABELS.index(label),
        up=up,
        forward=forward,
        scale=None if scale is None else float(scale),
    )


class TakenMesh(NamedTuple):
    """Mesh file that was read.

    file: its path below the folder; body: the body it became; how: words on class, size and axes
    and why they were chosen."""

    file: str
    body: Body
    how: str


def take_meshes(folder: str | Path, *, mirrors: bool = False) -> tuple[TakenMesh, ...]:
    """Load the mesh files in a folder and below it as bodies, in order of their paths.

    mirrors: count visible wing mirrors into the ground truth boxes of vehicles. Raises
    FileNotFoundError for a missing folder; ValueError, naming the file, for a mesh that is damaged,
    implausibly large or small, or of no clear class.
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise FileNotFoundError(
            f"{folder} is not a folder: give one that holds mesh files ({' '.join(SUFFIXES)})"
        )
    paths = sorted(
        path for path in folder.rglob("*") if path.suffix.lower() in SUFFIXES and path.is_file()
    )
    if not paths:
        raise ValueError(
            f"{folder} holds no mesh: put files in it that end in one of {' '.join(SUFFIXES)}"
        )
    table = read_mesh_table(folder)
    taken_meshes = []
    for path in paths:
        name = path.relative_to(folder)
        entry = table.get(name, MeshEntry())
        taken_meshes.append(take_mesh(path, name, entry, mirrors=mirrors))
    return tuple(taken_meshes)


def take_mesh(path: Path, called: Path, entry: MeshEntry, *, mirrors: bool = False) -> TakenMesh:
    """Load one mesh file as a body.

    Args:
        path: the file.
        called: its path below the folder, which gives the body's name and may give its class.
        entry: what the table gives for it.
        mirrors: True to count visible wing mirrors into the box of a vehicle.

    Raises ValueError, naming the file, for a mesh that is damaged, implausibly large or small, or
    of no clear class."""
    mesh = scale_mesh(_read(path), entry.scale or 1.0)
    named_label = _find_label(called) if entry.label is None else entry.label
    labels = tuple(PLAUSIBLE) if named_label is None else (named_label,)
    # rotations to x forward, z up; the first that gives one clear class and no doubt is taken
    turns = [np.eye(3)]
    if entry.has_frame:
        turns = [entry.turn]
    elif path.suffix.lower() in (".glb", ".gltf"):
        turns = [_Y_UP_Z_FORWARD, np.eye(3)]
    doubts = []
    for turn in turns:
        turned = Mesh(mesh.vertices @ turn.T, mesh.triangles)
        fitting = [label for label in labels if _plausible(np.ptp(turned.vertices, axis=0), label)]
        if not fitting:
            continue
        try:
            shape = measure_shape(turned)
        except ValueError as error:
            raise ValueError(
                f"{path}: {error}: export it again as a closed triangle mesh"
            ) from None
        clear = [label for label in fitting if named_label is not None or is_clearly(shape, label)]
        doubt = find_wrong_stand(shape, clear[0]) if clear and not entry.has_frame else None
        if len(clear) == 1 and doubt is None:
            body = _make_taken_body(called.with_suffix("").as_posix(), clear[0], turned, mirrors)
            how = _describe_taken(body, shape, entry, named_label, turn)
            return TakenMesh(called.as_posix(), body, how)
        may_be = " or ".join(
            f"a {LABELS[label]}" if label != HEAVY else "a heavy vehicle" for label in fitting
        )
        doubts.append(
            doubt or f"by its size it may be {may_be}, but its shape is not clearly that of one"
        )
    size = " x ".join(f"{extent:.4g}" for extent in np.ptp(mesh.vertices, axis=0))
    remedy = _remedy(mesh, named_label)
    if doubts:
        folders = (
            f"put it into a folder {'/, '.join(LABELS)}/, or say in {TABLE} what it is, what is "
            "up and forward"
        )
        raise ValueError(f"{path}: {size} (x, y, z): {doubts[0]}: {remedy or folders}")
    expected = f"a {LABELS[named_label]}" if named_label is not None else "any road user"
    remedy = remedy or (
        f"check its units and axes, move it to the folder of its class, or say in {TABLE} "
        "what it is"
    )
    raise ValueError(
        f"{path}: {size} (x, y, z) does not fit {expected} in metres, x forward, z up: {remedy}"
    )


def _make_taken_body(name: str, label: int, mesh: Mesh, mirrors: bool) -> Body:
    """Body of a mesh in its final frame.

    label: class number; mirrors: True to count wing mirrors into the box; otherwise the box of a
    vehicle with mirrors is around the rest, and y = 0 is in its middle."""
    body = make_body(name, label, mesh.vertices, mesh.triangles)
    if mirrors or label not in (VEHICLE, HEAVY):
        return body
    span = mirror_span(Mesh(body.vertices.astype(np.float64), mesh.triangles))
    if span is None:
        return body
    right, left = span  # y of the body's sides
    middle = np.array([0, sum(span) / 2, 0], np.float32)
    length, height = body.size[0], body.size[2]
    return Body(
        name,
        label,
        vertices=body.vertices - middle,
        triangles=body.triangles,
        truth=(length, left - right, height),
    )


def _describe_taken(
    body: Body, shape: Shape, entry: MeshEntry, named_label: int | None, turn: np.ndarray
) -> str:
    """Describe class, size and axes of a body in words, and why they were chosen.

    named_label: class number by the table, folder or file name, None if the shape decided; turn:
    rotation from the file's axes, whose rows are forward, left and up."""
    class_source = "by its shape" if named_label is None else "by its folder or name"
    if entry.label is not None:
        class_source = f"as {TABLE} says"
    axis_names = {tuple(axis): name for name, axis in _AXES.items()}
    forward = axis_names[tuple(turn[0])]
    up = axis_names[tuple(turn[2])]
    frame = f"{up} up, {forward} forward"
    if not entry.has_frame and body.label == VEHICLE:
        agrees = shape.ahead > _FRONT_CLEAR
        frame += " (its profile agrees)" if agrees else " (assumed, its profile does not tell)"
    elif not entry.has_frame:
        frame += " (front assumed)"
    mirrors = "" if body.truth is None else ", mirrors left out of its box"
    scale = "" if entry.scale is None else f", scaled by {entry.scale:g}"
    size = " x ".join(f"{extent:.2f}" for extent in body.size)
    return f"{LABELS[body.label]} ({class_source}), {size} m, {frame}{scale}{mirrors}"


def _read(path: Path) -> Mesh:
    """Mesh of a file, in its units and axes, with only the vertices that triangles use.

    Raises ValueError, naming the file, for a damaged mesh."""
    import trimesh

    try:
        loaded = trimesh.load_mesh(path, process=False)
        triangles = np.asarray(loaded.faces, np.int64)
        vertices = np.asarray(loaded.vertices, np.float64)
    # in a damaged file its parsers meet anything: struct, key, index, recursion errors, ...
    except Exception as error:
        reason = " ".join(str(error).split())[:160] or type(error).__name__
        raise ValueError(
            f"{path}: the mesh is damaged or empty ({reason}): export it again"
        ) from None
    if not triangles.size:
        raise ValueError(f"{path}: has points but no triangles: export it again as a triangle mesh")
    if triangles.min() < 0 or triangles.max() >= len(vertices):
        raise ValueError(
            f"{path}: a triangle refers to a missing vertex: repair it or export it again"
        )
    # indices of the vertices that triangles use, and triangles by index in these
    used_indices, new_triangles = np.unique(triangles, return_inverse=True)
    used_vertices = vertices[used_indices]
    if not np.isfinite(used_vertices).all():
        raise ValueError(
            f"{path}: holds vertices that are NaN or infinite: repair it or export it again"
        )
    return Mesh(used_vertices, new_triangles.reshape(-1, 3))


def _find_label(called: Path) -> int | None:
    """Class number by the name of a folder in the path or the start of the file's name.

    Inner folders come first; None if nothing begins with the name of a class. called: path of the
    mesh file, relative to the folder of meshes."""
    for part in (*reversed(called.parent.parts), called.stem):
        for label, name in enumerate(LABELS):
            if part.lower().startswith(name):
                return label
    return None


def _plausible(size: Float64[np.ndarray, "3"], label: int) -> bool:
    """Return True if length, width and height (m) are within `PLAUSIBLE` for a class."""
    return all(
        low <= extent <= high for extent, (low, high) in zip(size, PLAUSIBLE[label], strict=True)
    )


def _remedy(mesh: Mesh, named_label: int | None) -> str:
    """Words on the unit or axes that would make a mesh plausible, "" if nothing does.

    mesh: as in the file; named_label: class number, None if unknown."""
    # smaller is better: first no change of scale, then the largest deviation from typical sizes
    best_penalty = (np.inf, np.inf)
    remedy = ""
    units = [("", 1.0), *_UNITS.items()]  # name, and metres of one
    axes_and_turns = [("", np.eye(3)), *_TURNS.items()]  # words, and rotation to x forward, z up
    for (unit, scale), (axes, turn) in product(units, axes_and_turns):
        changed_mesh = Mesh(mesh.vertices @ turn.T * scale, mesh.triangles)
        size = np.ptp(changed_mesh.vertices, axis=0)
        for label in PLAUSIBLE if named_label is None else (named_label,):
            deviation = float(np.abs(np.log(size / _TYPICAL[label])).max())
            penalty = (float(scale != 1), deviation)
            if not _plausible(size, label) or penalty >= best_penalty:
                continue
            shape = measure_shape(changed_mesh)
            has_class = named_label is not None or is_clearly(shape, label)
            if has_class and find_wrong_stand(shape, label) is None:
                best_penalty = penalty
                remedy = f"it seems to be {_describe_change(unit, scale, axes)}"
    return remedy


def _describe_change(unit: str, scale: float, axes: str) -> str:
    """Words for a file's unit and axes, and how to mend them.

    unit, axes: what is wrong, "" if it is right; scale: factor to metres."""
    if not unit:
        return f"{axes} forward, turn it"
    if not axes:
        return f"in {unit}, scale it by {scale}"
    return f"in {unit}, {axes} forward: scale it by {scale} and turn it"
