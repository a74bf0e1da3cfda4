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
    return invert(MAP_FROM_CARLA @ map_SE3_site @ site_SE3_sensor @ _OPENCV_FROM_PUBLISHED)


def parse_extrinsic(
    published: Float[np.ndarray, "rows columns"], map_SE3_site: Pose, name: str = "extrinsic"
) -> Pose:
    """Pose site_SE3_sensor (x right, y down, z forward) of a camera with this published extrinsic.

    It undoes `extrinsic`. name: what errors call the matrix. Raises ValueError unless it is
    a rigid motion."""
    matrix = np.asarray(published, np.float64)
    if matrix.shape == (4, 4) and np.isfinite(matrix).all() and abs(np.linalg.det(matrix)) < 1e-6:
        raise ValueError(
            f"{name} is singular (determinant {np.linalg.det(matrix):.3g}): it belongs to no camera"
        )
    return (
        invert(map_SE3_site)
        @ MAP_FROM_CARLA
        @ invert(check_pose(matrix, name))
        @ _OPENCV_FROM_PUBLISHED.T
    )


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

    height, width: pixels of the full image; name: what errors call the matrix.
    Raises ValueError unless the matrix is a forward-first one with one focal length."""
    matrix = np.asarray(published, np.float64)
    form = "[[cu, f, 0], [cv, 0, -f], [1, 0, 0]]"
    if matrix.shape != (3, 3) or not np.isfinite(matrix).all() or not matrix[0, 1] > 0:
        raise ValueError(
            f"{name} must be a finite 3×3 matrix {form} with f > 0, got {matrix.tolist()}"
        )
    centre = (float(matrix[0, 0]), float(matrix[1, 0]))
    if not (0 <= centre[0] <= width and 0 <= centre[1] <= height):
        raise ValueError(
            f"{name} must have its centre (cu, cv) in the image of {width}×{height} pixels, got "
            f"{centre}"
        )
    central = np.allclose(centre, (width / 2, height / 2))
    fov = 2 * float(np.arctan(width / 2 / matrix[0, 1]))
    camera = DepthCamera(width, height, fov=fov, centre=None if central else centre)
    if not np.allclose(matrix, intrinsic(camera), rtol=1e-3):
        rows = matrix.round(3).tolist()
        raise ValueError(
            f"{name} must be {form}, forward first and one f for both axes, got {rows}"
        )
    return camera


def format_objects(objects: Objects, map_SE3_site: Pose) -> Float64[np.ndarray, "n 10"]:
    """Return objects of the site frame as published rows, see `OBJECT_COLUMNS`."""
    rows = np.zeros((len(objects), len(OBJECT_COLUMNS)))
    rows[:, :3] = transform(MAP_FROM_CARLA @ map_SE3_site, objects.boxes[:, :3])
    rows[:, 5] = -np.rad2deg(objects.boxes[:, 6] + map_turn(map_SE3_site))
    rows[:, 6:9] = objects.boxes[:, 3:6] / 2
    rows[:, 9] = objects.labels
    return rows


def parse_rows(
    rows: Shaped[np.ndarray, "..."],
    map_SE3_site: Pose,
    ids: np.ndarray | None = None,
    name: str = "objects",
) -> Objects:
    """Turn published rows into objects of the site frame.

    Pitch and roll are lost, yaw is in -pi..pi. ids: track id of each row, None for row numbers;
    name: what errors call the table. Raises ValueError if the rows have another
    width, and InvalidObjects for a row that is no object, see `wrong_rows`."""
    if np.asarray(rows).dtype.kind not in "fiub":
        raise ValueError(f"{name} must hold numbers, got {np.asarray(rows).dtype}")
    rows = np.asarray(rows, np.float64)
    if rows.size == 0:
        return Objects.empty()
    if rows.ndim != 2 or rows.shape[1] != len(OBJECT_COLUMNS):
        columns = f"{len(OBJECT_COLUMNS)} columns ({', '.join(OBJECT_COLUMNS)})"
        raise ValueError(f"{name} must have {columns}, got {rows.shape}")
    wrong = wrong_rows(rows)
    if (wrong != "").any():
        row = int((wrong != "").argmax())
        raise InvalidObjects(f"{name} row {row} {wrong[row]}; repair it, or drop what is invalid")
    centres = transform(invert(map_SE3_site) @ MAP_FROM_CARLA, rows[:, :3])
    yaw = -np.deg2rad(rows[:, 5]) - map_turn(map_SE3_site)
    yaw = np.arctan2(np.sin(yaw), np.cos(yaw))
    ids = np.arange(len(rows)) if ids is None else ids
    return Objects(
        np.column_stack([centres, 2 * rows[:, 6:9], yaw]), rows[:, 9].astype(np.int64), ids
    )


def wrong_rows(rows: Shaped[np.ndarray, "..."]) -> Shaped[np.ndarray, " n"]:
    """Fault of each row in words, "" without one; tables of another width have no wrong rows.

    Faults are NaN or infinity, an unknown class, a size that is not positive or above
    `MAX_EXTENT_M`, a position beyond `MAX_COORDINATE_M`, and a yaw beyond `MAX_YAW_DEG`."""
    words = np.full(len(rows) if np.ndim(rows) else 0, "", dtype=object)
    if np.ndim(rows) != 2 or np.shape(rows)[1] != len(OBJECT_COLUMNS):
        return words
    rows = np.asarray(rows, np.float64)
    extents = f"has half extents {{}}: they must be positive and at most {MAX_EXTENT_M:g} m"
    classes = f"has class {{}}: there are classes 0..{len(LABELS) - 1} {LABELS}"
    with np.errstate(invalid="ignore"):
        half = rows[:, 6:9]
        far = np.abs(rows[:, :3]) > MAX_COORDINATE_M
        rules = (
            (~np.isfinite(rows).all(axis=1), slice(None), "holds NaN or infinity: {}"),
            (~((half > 0) & (half <= MAX_EXTENT_M)).all(axis=1), slice(6, 9), extents),
            (far.any(axis=1), slice(3), f"lies at {{}}, beyond {MAX_COORDINATE_M:g} m"),
            (
                np.abs(rows[:, 5]) > MAX_YAW_DEG,
                slice(5, 6),
                f"has yaw {{}}, beyond {MAX_YAW_DEG:g} degrees",
            ),
            (~np.isin(rows[:, 9], range(len(LABELS))), slice(9, 10), classes),
        )
    for wrong, columns, what in rules:
        for row in np.flatnonzero(wrong & (words == "")):
            words[row] = what.format(rows[row, columns].tolist())
    return words


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
    # NaN is none either
    return [np.where((depth > 0) & (depth < NO_RETURN_M), depth, np.float32(0)) for depth in depths]


def round_measurement(measurement: ImageRanges) -> ImageRanges:
    """Round a measurement to `DEPTH_STEP_M`; no return becomes 0."""
    finite = np.where(np.isfinite(measurement), measurement, np.float32(0))
    return np.round(finite / np.float32(DEPTH_STEP_M)) * np.float32(DEPTH_STEP_M)
