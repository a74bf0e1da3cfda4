"""Shared reading tools of all layouts: records, poses, labels, clouds and files of boxes.

Damage becomes one line that names a file. Numbers may be strings (DAIR-V2X, and YAML's 1e-05), and
rotations may be slightly off; anything worse is a ValueError."""

import json
import re
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import cached_property
from hashlib import blake2b
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np

from toolkit.arrays import Float64, Int64, Pose, Shaped
from toolkit.class_names import CATEGORIES
from toolkit.datasets.cloud_files import check_extent, describe_rounding, read_recorded
from toolkit.datasets.origins import Middles, find_far_middle, translation
from toolkit.datasets.point_times import is_time, parse_point_times
from toolkit.frame import (
    DisplayedRecording,
    Frame,
    Frames,
    OtherObjects,
    RecordingView,
    SensorCloud,
)
from toolkit.geometry import MAX_COORDINATE_M, check_pose, invert, pose, transform
from toolkit.objects import LABELS, Detections, Objects
from toolkit.point_files import pcd_bytes
from toolkit.runtime.files import parse_json, read_bytes, replace_infinite, write_bytes, write_text
from toolkit.sites.site import Site

Unchecked = Any  # a value of a file
Problems = dict[str, int]  # number of labels and points left out, by kind

_WHOLE_NUMBER = re.compile(r"(?<![0-9])(?<![0-9]\.)([0-9]{1,300})")
MAX_ROTATION_ERROR = 0.05  # largest entry of R Rᵀ - 1 of a rotation
_DAMAGE = (
    ValueError,
    TypeError,
    KeyError,
    IndexError,
    AttributeError,
    OverflowError,
    ArithmeticError,
    RecursionError,
)
_LAST_ROW = (0.0, 0.0, 0.0, 1.0)  # last row of a pose's matrix
FULL_TURN_RAD = 2 * np.pi + 0.01  # no file in radians exceeds it
MAX_DOUBLED_GAP = 1e-3  # m and rad; two boxes that differ by less are one label given twice

NOT_FINITE = "labels with NaN or infinite numbers"
NO_SIZE = "boxes of no size"
TOO_LARGE = "boxes too large or too far away to be"
MIN_BOX_SIDE_M = 0.01  # no side of a road user is shorter
MAX_BOX_SIDE_M = 100.0  # no side of a road user is longer
OTHER_KINDS = "labels of other kinds than ours"
STRAY = "names, times or tokens of labels have no cloud"
UNLABELLED = "frames without labels among labelled ones, whose objects are unknown"
DOUBLED = "doubled labels"
DOUBLED_CLOUDS = "clouds that are there under another ending too, left out"
FULL_TURNS = "yaws beyond a full turn"
TILTED = "boxes tilted by more than 20 degrees, of which only the heading is kept"
MIN_LEVEL_COSINE = np.cos(np.deg2rad(8.0))  # of a road's slope, which tilts a vehicle's frame
MIN_UPRIGHT_COSINE = np.cos(np.deg2rad(20.0))  # of the tilt of a road user's box
COMMON_NAMES = {  # names of our classes in other layouts
    "vehicle": "Car",
    "cyclist": "Cyclist",
    "pedestrian": "Pedestrian",
    "heavy": "Truck",
}
MAX_TRACK = 10**16  # below it a number's text is short enough to stay a number
MACOS_FOLDER = "__MACOSX"
BAG_ENDINGS = (".bag", ".mcap", ".db3")
ENDINGS = (".pcd", ".bin", ".ply", ".npy", ".npz", ".feather", ".xyz", ".csv")
NOT_FINITE_POINTS = "points with NaN or infinite numbers"
NO_RETURN_POINTS = "points of no return"
FAR_POINTS = "points a kilometre from the middle of their cloud"
EMPTY = "clouds without points"
UNPLACED = "clouds far from their sensor's origin: the sensor counts as in their middle"
COARSE_POINTS = "clouds in float32 so far from their origin that it holds no centimetres"
MAX_POINT_DISTANCE_M = 1e5  # from the sensor or the cloud's middle; float32 holds centimetres
_FAR_POINT_M = 1000.0  # from the middle, beyond the range of traffic sensors
_INTENSITIES = ("intensity", "reflectivity", "i", "colors")
_RINGS = ("ring", "laser_number", "laser_id", "channel", "line", "beam")
_MAX_RINGS = 1 << 16  # in a column of floats, such as nuScenes writes
UNTIMED = "clouds whose points have times of an unknown unit, which were left out"
_VERSION = 1
_SIZES = ("x", "y", "z", "length", "width", "height")
_FORM = f'{{"coview": "boxes", "version": {_VERSION}, "samples": [{{"name", "objects": [...]}}]}}'


@dataclass(frozen=True)
class Listing(DisplayedRecording):
    """A recording of named frames, read on demand.

    The first frame counts in its problems the labels without a cloud, and what was noted.

    Attributes:
        names: names of the frames.
        load: reads a frame by its name.
        path: path of the recording, None if unknown.
        site: the site, None if unknown.
        labelled: names, times or tokens that labels refer to, also of missing clouds.
        known: names, times or tokens that have a cloud, `names` if None.
        noted: problems of the whole recording, by kind.
    """

    names: tuple[str, ...]
    load: Callable[[str], Frame]
    path: Path | None = None
    site: Site | None = None
    labelled: Collection[str] = ()
    known: Collection[str] | None = None
    noted: Mapping[str, int] = field(default_factory=dict)

    def __len__(self) -> int:
        return len(self.names)

    def __iter__(self) -> Iterator[Frame]:
        return map(self.__getitem__, range(len(self.names)))

    def __getitem__(self, index: int) -> Frame:
        frame = self.load(self.names[index])
        if index % len(self.names):
            return frame
        problems = dict(frame.problems)
        for kind, count in {STRAY: len(self.strays), **self.noted}.items():
            add_problem(problems, kind, count)
        return replace(frame, problems=problems) if problems != frame.problems else frame

    @cached_property
    def strays(self) -> tuple[str, ...]:
        """Samples that labels name and the recording lacks."""
        names = set(self.names if self.known is None else self.known)
        return tuple(name for name in dict.fromkeys(self.labelled) if name not in names)

    def describe_strays(self) -> str:
        """Return in one line how many labels have no cloud, with an example of each; empty without
        any."""
        if not self.strays:
            return ""
        count = len(self.strays)
        total = len(set(self.labelled))
        example = next(iter(self.names if self.known is None else self.known), "")
        return (
            f"{count} of the {total} {STRAY}, such as {self.strays[0][:60]!r}, where clouds have "
            f"{example[:60]!r}"
        )


def check_labels(recording: Frames, frames: int | None = None) -> None:
    """Raise ValueError if nothing can be scored.

    This is so if no label has a cloud, or if the first frames of an unknown site have no label."""
    count = len(recording) if frames is None else frames
    site = getattr(recording, "site", None)
    source = recording
    while isinstance(source, RecordingView):
        source = source.recording
    if (
        isinstance(source, Listing)
        and source.strays
        and len(source.strays) == len(set(source.labelled))
    ):
        strays = source.describe_strays()
        raise ValueError(f"no label can be used: {strays}; name both alike, times in the same unit")
    first_frames = (recording[k] for k in range(count))
    if site is None and not any(
        len(frame.objects) or len(frame.others.boxes) for frame in first_frames
    ):
        remedy = "take coview detect, or give labels, such as the labels.json of layout folder"
        raise ValueError(f"the recording has no label, so nothing can be scored: {remedy}")


@contextmanager
def named_damage(
    path: str | Path, what: str, kinds: tuple[type[Exception], ...] = _DAMAGE
) -> Iterator[None]:
    """Turn damage found in the block into one ValueError that names the file.

    Overflowing numbers give no warnings. kinds: errors that show damage; an OSError passes
    unchanged."""
    try:
        with np.errstate(all="ignore"):
            yield
    except OSError:
        raise
    except UnicodeDecodeError as error:
        raise ValueError(f"{path} is no {what}: byte {error.start} is not UTF-8") from None
    except kinds as error:
        text = f"it lacks {error}" if isinstance(error, KeyError) else str(error)
        reason = " ".join(text.split())[:200] or type(error).__name__
        raise ValueError(f"{path} is no {what} that can be read: {reason}") from None


def load_json(path: str | Path) -> Unchecked:
    """Values of a JSON file; call it in `named_damage`."""
    return parse_json(read_bytes(path).decode("utf-8-sig"))


def entry(record: Unchecked, *keys: str) -> Unchecked:
    """Return record[key][key]..., or raise ValueError that names the missing key."""
    value = record
    for k, key in enumerate(keys):
        if not isinstance(value, dict) or key not in value:
            raise ValueError(f"it has no entry {'.'.join(keys[: k + 1])}")
        value = value[key]
    return value


def as_number(value: Unchecked, name: str = "entry") -> float:
    """Return a number, also if it is written as a string."""
    try:
        return float(value)
    except (TypeError, ValueError, OverflowError):
        raise ValueError(f"{name} must be a number, got {str(value)[:40]!r}") from None


def numbers(values: Unchecked, count: int, name: str = "entry") -> Float64[np.ndarray, " count"]:
    """Return `count` numbers, nested or flat, also as strings. Raises ValueError for another
    count."""
    try:
        flat = np.array(values, dtype=np.float64).ravel()
    except (TypeError, ValueError, OverflowError):
        flat = np.zeros(0)
    if flat.size != count:
        raise ValueError(f"{name} must be {count} numbers, got {str(values)[:60]!r}")
    return flat


def xyz(record: Unchecked, name: str, axes: str = "xyz") -> Float64[np.ndarray, "3"]:
    """Numbers of an entry {x: .., y: .., z: ..}."""
    return np.array([as_number(entry(record, name, axis), f"{name}.{axis}") for axis in axes])


def as_list(content: Unchecked, name: str = "it") -> list[Unchecked]:
    """A list, or ValueError."""
    if not isinstance(content, list):
        raise ValueError(f"{name} must be a list, got {str(content)[:40]!r}")
    return content


def rigid(rotation: Unchecked, translation: Unchecked, name: str = "pose") -> Pose:
    """Pose of a 3×3 rotation and a translation.

    A rotation that is slightly off is replaced by the nearest true one (SVD)."""
    matrix = numbers(rotation, 9, f"rotation of {name}").reshape(3, 3)
    pose = np.eye(4)
    pose[:3, 3] = numbers(translation, 3, f"translation of {name}")
    if not np.isfinite(matrix).all() or np.abs(matrix).max() > 2 or np.linalg.det(matrix) <= 0:
        raise ValueError(f"{name} must turn by a rotation, got {matrix.tolist()}")
    if np.abs(matrix @ matrix.T - np.eye(3)).max() > MAX_ROTATION_ERROR:
        raise ValueError(
            f"{name} must turn by a rotation, got one that stretches: {matrix.tolist()}"
        )
    u, _, v = np.linalg.svd(matrix)
    pose[:3, :3] = u @ v
    return check_pose(pose, name)


def rigid_matrix(values: Unchecked, name: str = "pose") -> Pose:
    """Pose of 16 or 12 numbers by rows, as `rigid`."""
    flat = np.asarray(values, dtype=object).ravel()
    matrix = numbers(values, 16 if flat.size == 16 else 12, name).reshape(-1, 4)
    placed = rigid(matrix[:3, :3], matrix[:3, 3], name)
    if len(matrix) == 4 and not np.allclose(matrix[3], _LAST_ROW, atol=1e-3):
        raise ValueError(
            f"{name} must end with the row 0 0 0 1, got {matrix[3].tolist()}: give its transpose?"
        )
    return placed


def heading(target_SE3_source: Pose, yaw: object) -> Float64[np.ndarray, "*n"]:
    """Yaw (rad) in the target frame of source-frame headings.

    It is the direction of the turned forward axis, from above."""
    yaw = np.asarray(yaw, np.float64)
    forward = (
        np.stack([np.cos(yaw), np.sin(yaw), np.zeros_like(yaw)], axis=-1)
        @ target_SE3_source[:3, :3].T
    )
    return np.asarray(np.arctan2(forward[..., 1], forward[..., 0]))


class Labelled(NamedTuple):
    """Labels of one frame as `toolkit.frame.Frame` holds them.

    objects: the objects; categories: their names; counts: the data set's counts of points, None
    without any; others: objects of other classes."""

    objects: Objects
    categories: tuple[str, ...]
    counts: Int64[np.ndarray, " n"] | None
    others: OtherObjects


def labelled(
    boxes: Shaped[np.ndarray, "n 7"],
    categories: Sequence[str],
    ids: Sequence[object] | None,
    problems: Problems,
    counts: Sequence[int] | Int64[np.ndarray, " n"] | None = None,
) -> Labelled:
    """Turn label rows, world frame, into objects.

    Rows that are left out are added to `problems`. ids: track ids of any kind; row numbers if None.
    counts: the data set's counts of points, below 0 if nobody counted."""
    boxes = np.asarray(boxes, np.float64).reshape(-1, 7)
    names = [str(name).strip().lower().replace(" ", "") for name in categories]
    classes = np.array([CATEGORIES.get(name, -1) for name in names], np.int64)
    is_finite = np.isfinite(boxes).all(axis=1)
    is_sized = (boxes[:, 3:6] >= MIN_BOX_SIDE_M).all(axis=1)
    is_small = (boxes[:, 3:6] <= MAX_BOX_SIDE_M).all(axis=1)
    is_small &= (np.abs(boxes[:, :3]) <= MAX_COORDINATE_M).all(axis=1)
    is_kept = np.ones(len(boxes), bool)
    for problem, is_sound in ((NOT_FINITE, is_finite), (NO_SIZE, is_sized), (TOO_LARGE, is_small)):
        add_problem(problems, problem, int((is_kept & ~is_sound).sum()))
        is_kept &= is_sound
    rows = np.flatnonzero(is_kept)
    category_numbers = np.unique(np.array([*categories, ""], str), return_inverse=True)[1][:-1]
    compared = np.column_stack([boxes, category_numbers])
    by_x = rows[np.argsort(boxes[rows, 0], kind="stable")]
    is_near = np.diff(boxes[by_x, 0]) <= MAX_DOUBLED_GAP
    near = np.union1d(by_x[:-1][is_near], by_x[1:][is_near])  # no other row can be doubled
    unique: list[int] = []  # near rows that differ from every earlier one
    for row in near.tolist():
        differs = (np.abs(compared[unique] - compared[row]) > MAX_DOUBLED_GAP).any(axis=1)
        if not unique or differs.all():
            unique.append(row)
    add_problem(problems, DOUBLED, len(near) - len(unique))
    rows = np.setdiff1d(rows, np.setdiff1d(near, unique))
    yaws = np.where(is_finite, boxes[:, 6], 0.0)
    boxes = np.column_stack([boxes[:, :6], np.arctan2(np.sin(yaws), np.cos(yaws))])
    count_full_turns(yaws[rows], problems)
    row_counts = np.full(len(boxes), -1) if counts is None else np.asarray(counts, np.int64)
    other_rows = rows[classes[rows] < 0]
    rows = rows[classes[rows] >= 0]
    add_problem(problems, OTHER_KINDS, len(other_rows))
    tracks = np.array([track_number(k if ids is None else ids[k]) for k in rows.tolist()], np.int64)
    objects = Objects(boxes[rows], classes[rows], tracks)
    object_names = tuple(str(categories[k]) for k in rows.tolist())
    other_names = tuple(str(categories[k]) for k in other_rows.tolist())
    object_counts = None
    other_counts = None
    if counts is not None:
        object_counts = _known_counts(row_counts[rows])
        other_counts = _known_counts(row_counts[other_rows])
    others = OtherObjects(boxes[other_rows], other_names, other_counts)
    return Labelled(objects, object_names, object_counts, others)


def _known_counts(counts: Int64[np.ndarray, " n"]) -> Int64[np.ndarray, " n"] | None:
    """Counts of points, None if one is unknown."""
    return None if (counts < 0).any() else counts


def level_frame(map_SE3_frame: Pose) -> Pose:
    """Return the pose of a frame of boxes.

    It is turned level if it is so tilted that it is a sensor's rather than a vehicle's."""
    if map_SE3_frame[2, 2] >= MIN_LEVEL_COSINE:
        return map_SE3_frame
    return pose(*map_SE3_frame[:3, 3], yaw=float(heading(map_SE3_frame, 0.0)))


def move_boxes(target_SE3_source: Pose, boxes: Shaped[np.ndarray, "n 7"]) -> np.ndarray:
    """Boxes of the source frame in the target frame, whose z is up as well."""
    with np.errstate(all="ignore"):
        centres = transform(target_SE3_source, boxes[:, :3])
        return np.column_stack([centres, boxes[:, 3:6], heading(target_SE3_source, boxes[:, 6])])


def list_rows(objects: Objects, names: Mapping[str, str]) -> list[tuple[list[float], str, int]]:
    """Box, name and track of each object to write."""
    rows = zip(objects.boxes.tolist(), objects.labels.tolist(), objects.ids.tolist(), strict=True)
    return [(box, names[LABELS[label]], track) for box, label, track in rows]


def no_labels() -> Labelled:
    """Return the labels of a frame without any."""
    return labelled(np.zeros((0, 7)), [], None, {})


def add_problem(problems: Problems, kind: str, number: int) -> None:
    """Add to the count of a kind of problem."""
    if number:
        problems[kind] = problems.get(kind, 0) + number


def count_full_turns(yaws: Shaped[np.ndarray, " n"], problems: Problems) -> None:
    """Add to the problems the number of yaws that no file in radians has."""
    add_problem(problems, FULL_TURNS, int((np.abs(yaws) > FULL_TURN_RAD).sum()))


def find_headings(
    rotations: Float64[np.ndarray, "n 3 3"], problems: Problems
) -> Float64[np.ndarray, " n"]:
    """Headings (rad) of boxes' rotations, from above.

    Boxes with more tilt than any road are counted in `problems`."""
    with np.errstate(invalid="ignore"):
        add_problem(problems, TILTED, int((rotations[:, 2, 2] < MIN_UPRIGHT_COSINE).sum()))
    return np.asarray(np.arctan2(rotations[:, 1, 0], rotations[:, 0, 0]))


def track_number(name: object) -> int:
    """Track id as a number: an integer, also as text, stays itself, any other text becomes a
    number."""
    if type(name) is int and abs(name) < MAX_TRACK:
        return name
    text = str(name).strip()
    if text.removeprefix("-").isascii() and text.removeprefix("-").isdigit() and len(text) < 18:
        return int(text)
    return int.from_bytes(blake2b(text.encode(), digest_size=8).digest(), "big") >> 1


def list_files(folder: Path, pattern: str = "*", *, recursive: bool = False) -> list[Path]:
    """Files and folders in a folder in `natural_order`.

    Hidden ones are left out, and files that macOS adds to archives (`._NAME`)."""
    if not recursive:
        files = [file for file in folder.glob(pattern) if not _is_hidden((file.name,))]
    else:
        files = [
            file for file in folder.rglob(pattern) if not _is_hidden(file.relative_to(folder).parts)
        ]
    return sorted(files, key=_path_order)


def natural_order(name: str) -> tuple[str | int, ...]:
    """Sort key of a name: numbers in it count as numbers, so that frame 2 comes before frame 10.

    Digits after a decimal point stay text, as they are compared from their left.

    >>> sorted(["10", "9", "1"], key=natural_order)
    ['1', '9', '10']
    >>> sorted(["7.5", "7.25", "007"], key=natural_order)
    ['007', '7.25', '7.5']
    """
    pieces = _WHOLE_NUMBER.split(name)
    numbered = (int(piece) if index % 2 else piece for index, piece in enumerate(pieces))
    return (*numbered, name)


def _path_order(file: Path) -> tuple[tuple[str | int, ...], ...]:
    """Sort key of a path by its parts; the ending of a file's name comes last."""
    folders = tuple(natural_order(part) for part in file.parts[:-1])
    return (*folders, natural_order(file.stem), (file.suffix,))


def _is_hidden(parts: tuple[str, ...]) -> bool:
    return any(part.startswith(".") or part == MACOS_FOLDER for part in parts)


def list_bags(folder: Path) -> list[Path]:
    """Files of ROS bags in a folder, by name."""
    return [file for file in list_files(folder) if file.suffix.lower() in BAG_ENDINGS]


def read_cloud(
    path: str | Path,
    name: str,
    world_SE3_sensor: Pose,
    problems: Problems,
    *,
    stamp_s: float | None = None,
    middles: Middles | None = None,
) -> SensorCloud:
    """Read the cloud of a file, as `build_cloud`.

    Raises FileNotFoundError, and ValueError for a file without readable points."""
    attributes = read_recorded(path)
    return build_cloud(
        attributes, name, world_SE3_sensor, problems, stamp_s=stamp_s, middles=middles
    )


def build_cloud(
    attributes: Mapping[str, np.ndarray],
    name: str,
    world_SE3_sensor: Pose,
    problems: Problems,
    *,
    frame: Literal["sensor", "world"] = "sensor",
    stamp_s: float | None = None,
    middles: Middles | None = None,
) -> SensorCloud:
    """Build a cloud of `positions` and other columns.

    Points kilometres from their origin, such as in UTM without their sensor's pose, are counted
    from the middle of the sensor's first cloud, which moves into the pose. middles: middles of the
    recording's sensors. Raises ValueError for points that are too far apart to be metres."""
    recorded = np.asarray(attributes["positions"], np.float64)
    check_extent(recorded)
    is_returned = (recorded != 0).any(axis=1) if frame == "sensor" else np.ones(len(recorded), bool)
    middle = find_far_middle(recorded)
    if middle.any():
        add_problem(problems, COARSE_POINTS, int(describe_rounding(recorded) is not None))
        if frame == "world":
            recorded = transform(invert(world_SE3_sensor), recorded)
            frame = "sensor"
            middle = find_far_middle(recorded)
    if middle.any():
        add_problem(problems, UNPLACED, 1)
        origin = (middles or Middles()).find(name, middle)
        recorded = recorded - origin
        world_SE3_sensor = world_SE3_sensor @ translation(origin)
    with np.errstate(invalid="ignore"):
        is_sound = (np.abs(recorded) <= MAX_POINT_DISTANCE_M).all(axis=1)  # NaN is not
    is_kept = is_sound & is_returned
    add_problem(problems, NOT_FINITE_POINTS, int((~is_sound).sum()))
    add_problem(problems, NO_RETURN_POINTS, int((is_sound & ~is_returned).sum()))
    add_problem(problems, EMPTY, int(not is_kept.any()))
    if is_kept.any():
        middle = np.median(recorded[is_kept][:: int(is_kept.sum()) // 1000 + 1], axis=0)
        add_problem(
            problems,
            FAR_POINTS,
            int((np.linalg.norm(recorded[is_kept] - middle, axis=1) > _FAR_POINT_M).sum()),
        )

    def columns(names: Sequence[str], *, wide: bool = False) -> Iterator[np.ndarray]:
        """Columns with these names, or the first of their columns if `wide`."""
        for column in (np.asarray(attributes[key]) for key in names if key in attributes):
            if len(column) == len(is_kept) and (wide or column.size == len(is_kept)):
                yield (column if column.ndim == 1 else column[:, 0])[is_kept]

    intensity = next(columns(_INTENSITIES, wide=True), None)  # OPV2V keeps it in the red
    rings = (
        ring_column
        for ring_column in columns(_RINGS)
        if ring_column.dtype.kind in "iu" or (np.abs(ring_column) < _MAX_RINGS).all()
    )
    ring = next((ring_column for ring_column in rings if (ring_column % 1 == 0).all()), None)
    timed = [key for key in attributes if is_time(key) and np.size(attributes[key]) == len(is_kept)]
    seconds = parse_point_times(timed[0], next(columns(timed[:1]))) if timed else None
    add_problem(problems, UNTIMED, int(bool(timed) and seconds is None))
    geometry = recorded[is_kept].astype(np.float32), world_SE3_sensor, frame
    intensity = None if intensity is None else intensity.astype(np.float32)
    return SensorCloud(
        name,
        *geometry,
        seconds,
        intensity,
        None if ring is None else ring.astype(np.int64),
        stamp_s,
    )


def clock_time(frame: Frame, number: int) -> float:
    """Return the time (s) to write of a frame, `number` tenths for a frame without one.

    Raises ValueError for a time that is not since 1970, which no layout with clock times holds."""
    time = frame.time if np.isfinite(frame.time) else 0.1 * number
    if not 0 <= time < 2**31:
        raise ValueError(
            f"frame {frame.name!r} must have seconds since 1970, below 2^31, got {time:g}: mend "
            "its time"
        )
    return time


def cloud_time(cloud: SensorCloud, frame_time_s: float) -> float:
    """Return the time (s) to write of a cloud, its frame's if it lacks one."""
    return frame_time_s if cloud.stamp_s is None else cloud.stamp_s


def frame_time(clouds: Sequence[SensorCloud]) -> float:
    """Return the time (s) of a frame's first cloud, NaN if it is not known."""
    first = clouds[0].stamp_s if clouds else None
    return np.nan if first is None else first


def finite_time(value: Unchecked, name: str) -> float | None:
    """Return a time of a file (s), None if it is missing or empty.

    Raises ValueError for anything but a number."""
    if value is None or value == "":
        return None
    seconds = as_number(value, name)
    return seconds if np.isfinite(seconds) else None


def write_cloud(path: str | Path, cloud: SensorCloud) -> None:
    """Write x y z, intensity, and ring if known, of a cloud, in its frame, as a binary PCD file."""
    columns = dict(zip("xyz", cloud.points.astype(np.float32).T, strict=True))
    ring = {} if cloud.ring is None else {"ring": cloud.ring.astype(np.int32)}
    write_bytes(path, pcd_bytes(columns | {"intensity": get_intensity(cloud)} | ring))


def one_cloud(sample: Frame) -> SensorCloud:
    """Merge all clouds of a frame in its world frame. Intensities are kept if all clouds have
    them."""
    intensities = [cloud.intensity for cloud in sample.clouds if cloud.intensity is not None]
    is_complete = len(intensities) == len(sample.clouds) and len(intensities) > 0
    pose = sample.clouds[0].world_SE3_sensor if sample.clouds else np.eye(4)
    intensity = np.concatenate(intensities) if is_complete else None
    stamps = {cloud.stamp_s for cloud in sample.clouds}
    stamp = stamps.pop() if len(stamps) == 1 else None
    points = sample.points().astype(np.float32)
    return SensorCloud("lidar", points, pose, "world", intensity=intensity, stamp_s=stamp)


def get_intensity(cloud: SensorCloud) -> np.ndarray:
    """Intensity of each point, 0 if the sensor gives none."""
    return np.zeros(len(cloud.points), np.float32) if cloud.intensity is None else cloud.intensity


def boxes_record(
    name: str,
    time: float,
    boxes: Objects | Detections,
    *,
    counts: Sequence[int] | np.ndarray | None = None,
    stamps_s: Mapping[str, float] | None = None,
) -> str:
    """Return one frame's entry of the file as text, which thousands of frames can wait as.

    stamps_s: times of the sensors' clouds by name (`SensorCloud.stamp_s`)."""
    objects = []
    for k, (box, label) in enumerate(zip(boxes.boxes.tolist(), boxes.labels, strict=True)):
        row = {
            "label": LABELS[label],
            **dict(zip(_SIZES, box[:6], strict=True)),
            "yaw_deg": float(np.rad2deg(box[6])),
        }
        row |= (
            {"score": float(boxes.scores[k])}
            if isinstance(boxes, Detections)
            else {"id": int(boxes.ids[k])}
        )
        objects.append(row if counts is None else row | {"points": int(counts[k])})
    content = {
        "name": name,
        "time": time,
        **({"clouds": dict(stamps_s)} if stamps_s else {}),
        "objects": objects,
    }
    return json.dumps(replace_infinite(content), indent=1, allow_nan=False)


def write_boxes(path: str | Path, entries: Sequence[str], **more: object) -> None:
    """Write a file of frame entries (`boxes_record`), whole or not at all.

    more: further fields of the file."""
    content = {"coview": "boxes", "version": _VERSION, "frame": "world", **more, "samples": []}
    head = json.dumps(replace_infinite(content), indent=1, allow_nan=False).removesuffix("]\n}")
    rows = ",".join("\n  " + text.replace("\n", "\n  ") for text in entries)
    write_text(path, head + rows + "\n " * bool(entries) + "]\n}")


def read_entries(path: str | Path) -> dict[str, Unchecked]:
    """Entries of a file by the names of their frames. Raises ValueError, which names the file."""
    with named_damage(path, "file of boxes"):
        content = load_json(path)
        if not isinstance(content, dict) or (content.get("coview"), content.get("version")) != (
            "boxes",
            _VERSION,
        ):
            raise ValueError(f"its form must be {_FORM}, got {_describe_form(content)}")
        if (frame := content.get("frame", "world")) != "world":
            raise ValueError(
                f"its boxes must be in the frame world, got {str(frame)[:40]!r}: move them by "
                "poses.json"
            )
        entries = as_list(entry(content, "samples"), "samples")
        named_entries = {str(entry(sample, "name")): sample for sample in entries}
        if len(named_entries) < len(entries):
            raise ValueError("two of its samples have one name")
        return named_entries


def _describe_form(content: Unchecked) -> str:
    """Describe what a file holds in place of our boxes, and the layout that takes it."""
    if isinstance(content, list):
        rows = f"a list of {len(content)} rows"
        keyed = bool(content) and isinstance(content[0], dict) and "psr" in content[0]
        return f"{rows} of SUSTechPOINTS: give --layout sustech" if keyed else rows
    if not isinstance(content, dict):
        return str(content)[:40]
    if "openlabel" in content:
        return "OpenLABEL: give --layout openlabel"
    if content.get("coview") == "boxes":
        return f"version {content.get('version')!r:.20}"
    keys = ", ".join(map(str, content))
    return f"an object with the entries {keys[:80]}" if keys else "an empty object"


def parse_objects(path: str | Path, frame_entry: Unchecked, problems: Problems) -> Labelled:
    """The labels of one entry."""
    with named_damage(path, "file of boxes"):
        sample = f"sample {str(entry(frame_entry, 'name'))[:60]!r}"
        if "objects" not in frame_entry:
            raise ValueError(f'{sample} has no entry objects: write "objects": [] for an empty one')
        rows = as_list(frame_entry["objects"], f"objects of {sample}")
        parsed = []
        for k, row in enumerate(rows):
            try:
                parsed.append(_parse_object(row))
            except ValueError as error:
                raise ValueError(f"objects[{k}] of {sample}: {error}") from None
        boxes = np.array([box for box, _, _ in parsed]).reshape(-1, 7)
        boxes[:, 6] = np.deg2rad(boxes[:, 6])
        names = [name for _, name, _ in parsed]
        counts = [count for _, _, count in parsed]
        return labelled(
            boxes, names, [row.get("id", k) for k, row in enumerate(rows)], problems, counts
        )


def _parse_object(row: Unchecked) -> tuple[list[float], str, int]:
    """Box with its yaw in degrees, label and number of points of one object."""
    box = [as_number(entry(row, key), key) for key in (*_SIZES, "yaw_deg")]
    return box, str(entry(row, "label")), int(as_number(row.get("points", -1), "points"))
