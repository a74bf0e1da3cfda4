"""HDF5 files of images (`toolkit.datasets.dataset`), ours or the paper's, or of recorded clouds.

Recorded clouds are kept in one file without loss. Each frame is a group:

    coview                      attribute "clouds", version 1
    names                       JSON: the frames' names, in order
    samples/K/about             JSON: time, sensors (name, frame, stamp_s), categories, complete,
                                others, problems
    samples/K/map_SE3_world     float64 [4, 4]
    samples/K/boxes             float64 [m, 7]    x y z of the centre, length width height, yaw
                                                  (m, rad), world frame
    samples/K/labels, ids       int64 [m]         class and track; counts int64 [m] if the set has
                                                  them
    samples/K/others            float64 [o, 7]    boxes of other classes; others_counts int64 [o]
                                                  if it has some
    samples/K/clouds/S/points   float32 [n, 3]    in the frame that `about` names
    samples/K/clouds/S/pose     float64 [4, 4]    world_SE3_sensor; intensity float32 [n], time
                                                  float64 [n] and ring int64 [n] if known"""

import json
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from functools import partial
from pathlib import Path

import h5py
import numpy as np

from toolkit.arrays import BoxRows, Pose
from toolkit.datasets.dataset import CoopDataset
from toolkit.datasets.frame_times import finite_time
from toolkit.datasets.image_file import CLOUDS_KIND
from toolkit.datasets.listing import Listing
from toolkit.datasets.record_values import (
    Unchecked,
    as_list,
    as_number,
    entry,
    name_damage,
    rigid_matrix,
)
from toolkit.frame import Frame, OtherObjects, Recording, SensorCloud, parse_region
from toolkit.objects import Objects
from toolkit.runtime import hdf5 as reader
from toolkit.runtime.text_values import parse_json, replace_infinite
from toolkit.runtime.writing import writing
from toolkit.sites.site import Site

_VERSION = 1


def holds_clouds(path: str | Path) -> bool:
    """Return True for an HDF5 file of recorded clouds, False for other HDF5 files.

    Raises OSError for any other kind of file."""
    with _open(path) as file:
        return str(reader.read_node_attributes(file, "the file").get("coview", "")) == CLOUDS_KIND


@contextmanager
def _open(path: str | Path) -> Iterator[h5py.File]:
    """Open a file to read. Any damage is reported in one line, which names the file."""
    with reader.open_hdf5(path) as file, name_damage(path, "recording of clouds"):
        try:
            yield file
        except OSError as error:
            raise OSError(f"{path}: {error}") from None


def hdf5_clouds(path: Path) -> Listing:
    """Open a file of recorded clouds. Raises ValueError, in one line, for a damaged file."""
    with _open(path) as file:
        version = reader.read_node_attributes(file, "the file").get("version")
        if version != _VERSION:
            raise ValueError(f"its version is {version}: this coview reads version {_VERSION}")
        names = [str(name) for name in as_list(parse_json(reader.text(file, "names")), "names")]
        if len(set(names)) < len(names):
            raise ValueError("samples have the same name")
    numbers = {name: number for number, name in enumerate(names)}
    return Listing(tuple(names), partial(_load, path, numbers))


def _load(path: Path, numbers: Mapping[str, int], name: str) -> Frame:
    with _open(path) as file:
        return _read_frame(file, f"samples/{numbers[name]}", name)


def _read_frame(file: h5py.File, path: str, name: str) -> Frame:
    """Read a frame. Raises ValueError for damaged values.

    path: path of its group in the file; name: name of the frame."""
    about = parse_json(reader.text(file, f"{path}/about"))
    sensors = enumerate(as_list(entry(about, "sensors"), "sensors"))
    clouds = tuple(_read_cloud(file, f"{path}/clouds/{k}", sensor) for k, sensor in sensors)
    labels = reader.array(file, f"{path}/labels", axes=1, kinds="iu").astype(np.int64)
    ids = reader.array(file, f"{path}/ids", axes=1, kinds="iu").astype(np.int64)
    objects = Objects(_read_boxes(file, f"{path}/boxes"), labels=labels, ids=ids)
    other_objects = OtherObjects(
        boxes=_read_boxes(file, f"{path}/others"),
        categories=tuple(map(str, as_list(entry(about, "others"), "others"))),
        counts=_read_counts(file, f"{path}/others_counts"),
    )
    if other_objects.categories and len(other_objects.categories) != len(other_objects.boxes):
        raise ValueError(
            f"{len(other_objects.boxes)} other boxes but {len(other_objects.categories)} names"
        )
    time = entry(about, "time")
    map_SE3_world = reader.array(file, f"{path}/map_SE3_world", axes=2)
    problems = entry(about, "problems")
    return Frame.of_clouds(
        name,
        clouds,
        objects,
        categories=tuple(map(str, as_list(entry(about, "categories"), "categories"))),
        counts=_read_counts(file, f"{path}/counts"),
        others=other_objects,
        complete=parse_region(entry(about, "complete")),
        time=float("nan") if time is None else as_number(time, "time"),
        map_SE3_world=rigid_matrix(map_SE3_world, "map_SE3_world"),
        problems={str(kind): int(as_number(count)) for kind, count in problems.items()},
    )


def _read_cloud(file: h5py.File, path: str, about: Unchecked) -> SensorCloud:
    """Read the cloud of the group at `path`.

    about: its name, frame and time, from the entry "about" of its frame. Raises ValueError for
    damaged values."""
    points = reader.array(file, f"{path}/points", axes=2).astype(np.float32)
    if points.shape[1] != 3 or not np.isfinite(points).all():
        raise ValueError(f"{path}/points must be finite, 3 to a row, got shape {points.shape}")
    columns: dict[str, np.ndarray] = {}
    # name, type in the cloud, and NumPy kinds of types that the file may have: f floats, i and u
    # whole numbers
    for name, dtype, kinds in (
        ("time", np.float64, "fiu"),
        ("intensity", np.float32, "fiu"),
        ("ring", np.int64, "iu"),
    ):
        column = reader.find_array(file, f"{path}/{name}", axes=1, kinds=kinds)
        if column is None:
            continue
        if len(column) != len(points):
            raise ValueError(f"{path}/{name} must be of {len(points)} points, got {len(column)}")
        columns[name] = column.astype(dtype)
    frame = entry(about, "frame")
    if frame not in ("sensor", "world"):
        raise ValueError(f"{path} must be in the frame of the sensor or the world, got {frame!r}")
    return SensorCloud(
        name=str(entry(about, "name")),
        points=points,
        world_SE3_sensor=_read_stored_pose(file, f"{path}/pose"),
        frame=frame,
        stamp_s=finite_time(about.get("stamp_s"), "stamp_s"),
        **columns,
    )


def _read_stored_pose(file: h5py.File, name: str) -> Pose:
    """Read the pose in a dataset, to the bit if it is a rigid motion, else mended a little."""
    stored_matrix = reader.array(file, name, axes=2)
    pose = rigid_matrix(stored_matrix, name)
    return stored_matrix.astype(np.float64) if np.allclose(pose, stored_matrix, atol=1e-9) else pose


def _read_boxes(file: h5py.File, name: str) -> BoxRows:
    """Read the boxes (n, 7) in a dataset; ValueError for numbers that are no boxes."""
    boxes = reader.array(file, name, axes=2).astype(np.float64)
    sizes = boxes[:, 3:6]
    if boxes.shape[1] != 7 or not np.isfinite(boxes).all() or not (sizes > 0).all():
        raise ValueError(f"{name} must be finite boxes of seven numbers with positive sizes")
    return boxes


def _read_counts(file: h5py.File, name: str) -> np.ndarray | None:
    """Read the numbers of points in a dataset, None if it is missing."""
    column = reader.find_array(file, name, axes=1, kinds="iu")
    return None if column is None else column.astype(np.int64)


def write_hdf5(samples: Iterable[Frame], path: Path) -> None:
    """Write frames as one file, whole or not at all. Raises ValueError for two frames of the same
    name."""
    names: list[str] = []
    with writing(path) as unfinished, reader.hdf5_file(unfinished) as (file, _):
        file.attrs["coview"] = CLOUDS_KIND
        file.attrs["version"] = _VERSION
        for sample in samples:
            _write(file.create_group(f"samples/{len(names)}"), sample)
            names.append(sample.name)
        if len(set(names)) < len(names):
            raise ValueError("samples must have different names to stand in one file")
        file["names"] = json.dumps(names)


def _write(group: h5py.Group, sample: Frame) -> None:
    """Write a frame into its group, which is empty.

    Texts and single numbers go into the JSON text "about"; arrays become datasets, the longer ones
    compressed. Missing arrays are left out."""
    sensors = [
        {"name": cloud.name, "frame": cloud.frame, "stamp_s": cloud.stamp_s}
        for cloud in sample.clouds
    ]
    about = {
        "time": sample.time,
        "sensors": sensors,
        "categories": sample.categories,
        "complete": sample.complete.record(),
        "others": sample.others.categories,
        "problems": dict(sample.problems),
    }
    group["about"] = json.dumps(replace_infinite(about))
    arrays: dict[str, np.ndarray | None] = {
        "map_SE3_world": sample.map_SE3_world,
        **vars(sample.objects),
        "counts": sample.counts,
        "others": sample.others.boxes,
        "others_counts": sample.others.counts,
    }
    for k, cloud in enumerate(sample.clouds):
        arrays[f"clouds/{k}/points"] = cloud.points
        arrays[f"clouds/{k}/pose"] = cloud.world_SE3_sensor
        arrays[f"clouds/{k}/time"] = cloud.time
        arrays[f"clouds/{k}/intensity"] = cloud.intensity
        arrays[f"clouds/{k}/ring"] = cloud.ring
    for name, array in arrays.items():
        if array is not None and array.size > 100:
            group.create_dataset(
                name, data=array, compression="gzip", compression_opts=1, shuffle=True
            )
        elif array is not None:
            group.create_dataset(name, data=array)


def hdf5(path: Path, *, site: Site | None = None, drop_invalid: bool = False) -> Recording:
    """Open a file of images or of recorded clouds.

    site: site of a file of images, None for the one that it names; drop_invalid: True to leave out
    impossible objects of a file of images instead of refusing it. Raises the errors of
    `CoopDataset` and `hdf5_clouds`."""
    if path.is_file() and holds_clouds(path):
        return hdf5_clouds(path)
    return CoopDataset(path, site, drop_invalid=drop_invalid)
