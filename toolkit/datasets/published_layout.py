"""Conventions of the published dataset.

They are CARLA's left-handed world, forward-first cameras, and boxes in degrees and half extents.

    world   x, y, z up, metres, left-handed: y is minus the y of a right-handed map of the same
            place
    camera  X forward, Y right, Z up; a pixel (u, v) of depth d is X = d, Y = (u - cu) d / f,
            Z = -(v - cv) d / f
    K       [[cu, f, 0], [cv, 0, -f], [1, 0, 0]]
    object  x y z (centre), pitch roll yaw (degrees), half extents (m), class

Nothing foreign leaves this file: other modules see poses `world_SE3_sensor` in the site's frame and
`Objects`."""

from collections.abc import Iterable

import numpy as np

from toolkit.arrays import Float, Float32, Float64, ImageRanges, Pose, Shaped
from toolkit.geometry import MAX_COORDINATE_M, check_pose, invert, transform
from toolkit.objects import LABELS, Objects
from toolkit.sensors.models import DepthCamera
from toolkit.sites.georeference import map_turn

OBJECT_COLUMNS = (
    "x",
    "y",
    "z",
    "pitch",
    "roll",
    "yaw",
    "half length",
    "half width",
    "half height",
    "class",
)
# places of the columns
_CENTRE = slice(0, 3)
_YAW = 5
_HALF_EXTENTS = slice(6, 9)
_CLASS = 9
NO_RETURN_M = 1000.0  # CARLA's far plane, the depth of the sky
DEPTH_STEP_M = 1 / 1024  # to which stored depth is rounded, so that it compresses
MAX_EXTENT_M = 500.0  # half of a length, width or height
MAX_YAW_DEG = 1e6

MAP_FROM_CARLA = np.diag([1.0, -1.0, 1.0, 1.0])  # equal to its inverse; a mirror, so not an SE3
# turns axes X forward, Y right, Z up of a published camera into x right, y down, z forward
_OPENCV_FROM_PUBLISHED = np.array([[0.0, 1, 0, 0], [0, 0, -1, 0], [1, 0, 0, 0], [0, 0, 0, 1]])


class InvalidObjects(ValueError):
    """A table row that no object can have, see `wrong_rows`."""


def extrinsic(site_SE3_sensor: Pose, map_SE3_site: Pose) -> Pose:
    """Published extrinsic (4, 4) of a camera: CARLA world → camera with X forward, Y right, Z up.

    site_SE3_sensor: pose of the camera (x right, y down, z forward) in the site; map_SE3_site:
    pose of the site in the map, whose y is minus CARLA's."""
    # MAP_FROM_CARLA is its own inverse: here it leads from the map to CARLA's world
    return invert(MAP_FROM_CARLA @ map_SE3_site @ site_SE3_sensor @ _OPENCV_FROM_PUBLISHED)


def parse_extrinsic(
    published: Float[np.ndarray, "rows columns"], map_SE3_site: Pose, name: str = "extrinsic"
) -> Pose:
    """Pose site_SE3_sensor (x right, y down, z forward) of a camera with this published extrinsic.

    published: matrix (4, 4) from CARLA's world to the camera with X forward, Y right, Z up;
    map_SE3_site: pose of the site in the map, whose y is minus CARLA's; name: what errors call the
    matrix. Raises ValueError unless it is a rigid motion."""
    matrix = np.asarray(published, np.float64)
    if matrix.shape == (4, 4) and np.isfinite(matrix).all() and abs(np.linalg.det(matrix)) < 1e-6:
        raise ValueError(
            f"{name} is singular (determinant {np.linalg.det(matrix):.3g}): it belongs to no camera"
        )
    carla_SE3_camera = invert(check_pose(matrix, name))
    return invert(map_SE3_site) @ MAP_FROM_CARLA @ carla_SE3_camera @ _OPENCV_FROM_PUBLISHED.T


def intrinsic(camera: DepthCamera) -> Float64[np.ndarray, "3 3"]:
    """Published intrinsic matrix of a camera, [[cu, f, 0], [cv, 0, -f], [1, 0, 0]]."""
    focal = camera.intrinsic[0, 0]
    cu = camera.intrinsic[0, 2]
    cv = camera.intrinsic[1, 2]
    return np.array([[cu, focal, 0.0], [cv, 0.0, -focal], [1.0, 0.0, 0.0]])


def parse_intrinsic(
    published: Float[np.ndarray, "rows columns"], height: int, width: int, name: str = "intrinsic"
) -> DepthCamera:
    """Camera with this published intrinsic matrix and image size, that measures every second pixel.

    published: (3, 3) matrix whose columns are x forward, y and z, in pixels; height, width: full
    image (pixels); name: what errors call the matrix. Raises ValueError unless the matrix is
    such a forward-first one with one focal length."""
    matrix = np.asarray(published, np.float64)
    form = "[[cu, f, 0], [cv, 0, -f], [1, 0, 0]]"
    if matrix.shape != (3, 3) or not np.isfinite(matrix).all() or not matrix[0, 1] > 0:
        raise ValueError(
            f"{name} must be a finite 3×3 matrix {form} with f > 0, got {matrix.tolist()}"
        )
    centre_u, centre_v = float(matrix[0, 0]), float(matrix[1, 0])
    centre = (centre_u, centre_v)
    focal = matrix[0, 1]
    if not (0 <= centre_u <= width and 0 <= centre_v <= height):
        raise ValueError(
            f"{name} must have its centre (cu, cv) in the image of {width}×{height} pixels, got "
            f"{centre}"
        )
    is_central = np.allclose(centre, (width / 2, height / 2))
    fov = 2 * float(np.arctan(width / 2 / focal))
    # a DepthCamera measures every second pixel by default
    camera = DepthCamera(width, height, fov=fov, centre=None if is_central else centre)
    # the other entries of the matrix must follow from these
    if not np.allclose(matrix, intrinsic(camera), rtol=1e-3):
        rows = matrix.round(3).tolist()
        raise ValueError(
            f"{name} must be {form}, forward first and one f for both axes, got {rows}"
        )
    return camera


def format_objects(objects: Objects, map_SE3_site: Pose) -> Float64[np.ndarray, "n 10"]:
    """Return objects of the site frame as published rows, in CARLA's left-handed world.

    The columns are `OBJECT_COLUMNS`: x, y, z (m), pitch, roll, yaw (degrees), half length, width
    and height (m), and class. map_SE3_site: pose of the site in the map."""
    boxes = objects.boxes
    centres, extents = boxes[:, :3], boxes[:, 3:6]
    yaw = boxes[:, 6]
    rows = np.zeros((len(objects), len(OBJECT_COLUMNS)))  # pitch and roll stay 0
    rows[:, _CENTRE] = transform(MAP_FROM_CARLA @ map_SE3_site, centres)
    # CARLA's y is mirrored, so turns have the other sign
    rows[:, _YAW] = -np.rad2deg(yaw + map_turn(map_SE3_site))
    rows[:, _HALF_EXTENTS] = extents / 2
    rows[:, _CLASS] = objects.labels
    return rows


def parse_rows(
    rows: Shaped[np.ndarray, "..."],
    map_SE3_site: Pose,
    ids: np.ndarray | None = None,
    name: str = "objects",
) -> Objects:
    """Turn published rows into objects of the site frame.

    Pitch and roll are lost, yaw is in -pi..pi.

    Args:
        rows: A row for each object, with the columns `OBJECT_COLUMNS`.
        map_SE3_site: Pose of the site in the map.
        ids: Track id of each row, None for row numbers.
        name: What errors call the table.

    Raises ValueError if the rows have another width, and InvalidObjects for a row that no object
    can have."""
    if np.asarray(rows).dtype.kind not in "fiub":
        raise ValueError(f"{name} must hold numbers, got {np.asarray(rows).dtype}")
    rows = np.asarray(rows, np.float64)
    if rows.size == 0:
        return Objects.empty()
    if rows.ndim != 2 or rows.shape[1] != len(OBJECT_COLUMNS):
        columns = f"{len(OBJECT_COLUMNS)} columns ({', '.join(OBJECT_COLUMNS)})"
        raise ValueError(f"{name} must have {columns}, got {rows.shape}")
    faults = wrong_rows(rows)
    if (faults != "").any():
        row = int((faults != "").argmax())
        raise InvalidObjects(f"{name} row {row} {faults[row]}; repair it, or drop what is invalid")
    centres = transform(invert(map_SE3_site) @ MAP_FROM_CARLA, rows[:, _CENTRE])
    yaw = -np.deg2rad(rows[:, _YAW]) - map_turn(map_SE3_site)
    yaw = np.arctan2(np.sin(yaw), np.cos(yaw))  # into -pi..pi
    boxes = np.column_stack([centres, 2 * rows[:, _HALF_EXTENTS], yaw])
    ids = np.arange(len(rows)) if ids is None else ids
    return Objects(boxes, labels=rows[:, _CLASS].astype(np.int64), ids=ids)


def wrong_rows(rows: Shaped[np.ndarray, "..."]) -> Shaped[np.ndarray, " n"]:
    """Fault of each row in words, "" without one; tables of another width have no wrong rows.

    Faults are NaN or infinity, an unknown class, a size that is not positive or above
    `MAX_EXTENT_M`, a position beyond `MAX_COORDINATE_M`, and a yaw beyond `MAX_YAW_DEG`."""
    faults = np.full(len(rows) if np.ndim(rows) else 0, "", dtype=object)
    if np.ndim(rows) != 2 or np.shape(rows)[1] != len(OBJECT_COLUMNS):
        return faults
    rows = np.asarray(rows, np.float64)
    with np.errstate(invalid="ignore"):
        half_extents = rows[:, _HALF_EXTENTS]
        has_numbers = np.isfinite(rows).all(axis=1)
        has_size = ((half_extents > 0) & (half_extents <= MAX_EXTENT_M)).all(axis=1)
        is_far = (np.abs(rows[:, _CENTRE]) > MAX_COORDINATE_M).any(axis=1)
        is_turned_far = np.abs(rows[:, _YAW]) > MAX_YAW_DEG
        has_class = np.isin(rows[:, _CLASS], range(len(LABELS)))
    size_rule = f"they must be positive and at most {MAX_EXTENT_M:g} m"
    class_rule = f"there are classes 0..{len(LABELS) - 1} {LABELS}"
    # mask of the wrong rows, columns to show, and the fault in words, {} for the columns' values;
    # the first fault of a row counts
    rules = (
        (~has_numbers, slice(None), "holds NaN or infinity: {}"),
        (~has_size, _HALF_EXTENTS, f"has half extents {{}}: {size_rule}"),
        (is_far, _CENTRE, f"lies at {{}}, beyond {MAX_COORDINATE_M:g} m"),
        (is_turned_far, slice(_YAW, _YAW + 1), f"has yaw {{}}, beyond {MAX_YAW_DEG:g} degrees"),
        (~has_class, slice(_CLASS, _CLASS + 1), f"has class {{}}: {class_rule}"),
    )
    for is_wrong, columns, template in rules:
        for row in np.flatnonzero(is_wrong & (faults == "")):
            faults[row] = template.format(rows[row, columns].tolist())
    return faults


def expand_image(depth: ImageRanges, camera: DepthCamera) -> Float32[np.ndarray, "height width"]:
    """Expand measured pixels to the full published image, 0 between them."""
    image = np.zeros((camera.height, camera.width), np.float32)
    depth = round_measurement(depth)
    image[:: camera.stride, :: camera.stride] = np.where(depth > 0, depth, np.float32(NO_RETURN_M))
    return image


def measure_images(images: Iterable[tuple[Float[np.ndarray, "_ _"], int]]) -> list[ImageRanges]:
    """Take the measured pixels out of published depth images (m, 0 for no return).

    images: each full image, and the step from one measured pixel to the next."""
    with np.errstate(over="ignore"):
        depths = [np.asarray(image[::stride, ::stride], np.float32) for image, stride in images]
    # NaN is no return either
    return [np.where((depth > 0) & (depth < NO_RETURN_M), depth, np.float32(0)) for depth in depths]


def round_measurement(measurement: ImageRanges) -> ImageRanges:
    """Round a measurement to `DEPTH_STEP_M`; NaN and infinity become 0, no return."""
    finite = np.where(np.isfinite(measurement), measurement, np.float32(0))
    return np.round(finite / np.float32(DEPTH_STEP_M)) * np.float32(DEPTH_STEP_M)
