"""Recordings of clouds in every layout: one of their files is damaged, the others are sound, and
all is read.

A sound recording of each layout is written once for each process; reading a mutant puts it in the
place of its file there, reads every sample, lets the doctor look at them and writes them as one
file of clouds, as `coview survey`, `doctor` and `convert` do, and puts the sound file back.
"""

import json
import tempfile
from collections.abc import Callable
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np
from mutants import BYTES, HDF5, JSON, TEXT, Mutation
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from toolkit.datasets.layouts import rosbag
from toolkit.datasets.layouts.bag_messages import CLOUD, TF
from toolkit.datasets.recording_views import Part
from toolkit.datasets.recordings import open_recording, write_recording
from toolkit.detection.survey import survey
from toolkit.doctor.labels import diagnose_labels
from toolkit.exchange.instant import Instant
from toolkit.exchange.standards import open_writer
from toolkit.frame import Frame, SensorCloud
from toolkit.geometry import pose
from toolkit.objects import Objects
from toolkit.point_files.pcd import pcd_bytes

FILES: dict[
    str, tuple[str, str, tuple[Mutation, ...]]
] = {  # name of the format: layout, its file, what damages it
    "in-folder-labels": ("folder", "labels.json", JSON),
    "in-folder-placed": ("folder", "poses.txt", TEXT),
    "in-folder-cloud": ("folder", "north/000000.pcd", BYTES),
    "in-kitti-label_2": ("kitti", "training/label_2/000000.txt", TEXT),
    "in-kitti-calib": ("kitti", "training/calib/000000.txt", TEXT),
    "in-kitti-velodyne": ("kitti", "training/velodyne/000000.bin", BYTES),
    "in-openlabel": ("openlabel", "labels_point_clouds/000000.json", JSON),
    "in-dair-label": ("dair", "label/virtuallidar/000000.json", JSON),
    "in-dair-pair-index": ("pair", "cooperative/data_info.json", JSON),
    "in-dair-pair-label": ("pair", "cooperative/label_world/7.json", JSON),
    "in-dair-pair-calib": ("pair", "infrastructure-side/calib/virtuallidar_to_world/3.json", JSON),
    "in-opv2v": ("opv2v", "scenario/0/00000.yaml", TEXT),
    "in-v2xset": ("v2xset", "scenario/1/00000.yaml", TEXT),
    "in-v2xreal": ("v2xreal", "scenario/0/00000.yaml", TEXT),
    "in-v2xreal-cloud": ("v2xreal", "scenario/0/00000.pcd", BYTES),
    "in-rcooper-label": ("rcooper", "label/106-105/106/seq-1/1692685344.5.json", JSON),
    "in-rcooper-calib": ("rcooper", "calib/lidar2world/105.json", JSON),
    **{
        f"in-nuscenes-{table}": ("nuscenes", f"v1.0-coview/{table}.json", JSON)
        for table in (
            "sample_annotation",
            "sample_data",
            "calibrated_sensor",
            "ego_pose",
            "instance",
        )
    },
    "in-nuscenes-cloud": ("nuscenes", "samples/LIDAR_north/000000.pcd.bin", BYTES),
    "in-argoverse-annotations": ("argoverse", "annotations.feather", BYTES),
    "in-argoverse-calibration": ("argoverse", "calibration/egovehicle_SE3_sensor.feather", BYTES),
    "in-argoverse-sweep": ("argoverse", "sensors/lidar/1700000000000000000.feather", BYTES),
    "in-sustech-label": ("sustech", "label/000000.json", JSON),
    "in-rosbag-ros1": ("ros1", "one.bag", BYTES),
    "in-rosbag-mcap": ("ros2", "bag/bag.mcap", BYTES),
    "in-rosbag-metadata": ("ros2", "bag/metadata.yaml", TEXT),
    "in-rosbag-db3": ("sqlite", "bag/bag.db3", BYTES),
    "in-hdf5-clouds": ("hdf5", "clouds.hdf5", HDF5),
    "in-pcap": ("pcap", "turns.pcap", BYTES),
    "in-foxglove": ("foxglove", "clouds.mcap", BYTES),
    "in-tracking-label_02": ("kitti-tracking", "training/label_02/0000.txt", TEXT),
    "in-tracking-calib": ("kitti-tracking", "training/calib/0000.txt", TEXT),
}
# recordings that are not layouts
NAMED = {"pair": "dair", "ros1": "rosbag", "ros2": "rosbag", "sqlite": "rosbag"}


def samples(count: int = 3) -> list[Any]:
    """Two lidars above flat ground, over cars, a cyclist and a truck that drive."""
    rng = np.random.default_rng(5)
    sizes = np.tile([0.8, 4, 1.8, 1.6], (6, 1))
    boxes = np.column_stack(
        [np.linspace(-15, 15, 6), np.tile([-4.0, 4.0], 3), sizes, np.linspace(-3, 3, 6)]
    )
    made: list[Any] = []
    for k in range(count):
        clouds = []
        for name, height in (("north", 5.0), ("south", 6.0)):
            ground = np.column_stack(
                [rng.uniform(-20, 20, (250, 2)), rng.normal(-height, 0.01, 250)]
            )
            on_boxes = (
                boxes[rng.integers(6, size=100), :3] + rng.uniform(-1, 1, (100, 3)) - [0, 0, height]
            )
            points = np.concatenate([ground, on_boxes]).astype(np.float32)
            intensity = rng.uniform(0, 1, len(points)).astype(np.float32)
            clouds.append(
                SensorCloud(name, points, pose(0.0, 0.0, height, yaw=0.0), intensity=intensity)
            )
        moved = boxes + np.array([0.8 * k, 0, 0, 0, 0, 0, 0])
        objects = Objects(moved, np.array([0, 0, 3, 1, 0, 2]), np.arange(11, 17))
        made.append(
            Frame.of_clouds(
                str(k),
                tuple(clouds),
                objects,
                time=1.7e9 + 0.1 * k,
                map_SE3_world=pose(90.0, 40.0, 2.0, yaw=0.5),
            )
        )
    return made


def write(layout: str, folder: Path) -> Path:
    own: dict[str, Callable[[Path], Path]] = {
        "pair": _pair,
        "rcooper": _rcooper,
        "ros1": _ros1,
        "ros2": _ros2,
        "sqlite": partial(_ros2, sqlite=True),
        "pcap": _pcap,
        "foxglove": _foxglove,
        "kitti-tracking": _kitti_tracking,
    }
    if layout in own:
        return own[layout](folder)
    where = folder / "clouds.hdf5" if layout == "hdf5" else folder
    write_recording(samples(), where, layout)
    return where


def _pcap(folder: Path) -> Path:
    """Some turns of a Velodyne."""
    from tests.toolkit.datasets.layouts.test_pcap import capture, turning

    return capture(folder / "turns.pcap", turning(160))


def _foxglove(folder: Path) -> Path:
    path = folder / "clouds.mcap"
    with open_writer("mcap", path) as writer:
        for frame in samples():
            found = frame.objects
            scores = np.ones(len(found))
            writer.write(
                Instant(
                    frame.time, found.boxes, found.labels, scores, found.ids, clouds=frame.clouds
                )
            )
    return path


def _kitti_tracking(folder: Path) -> Path:
    from tests.toolkit.datasets.layouts import test_kitti_sequences as sequences

    rows = "\n".join([sequences.CAR, sequences.LATER, sequences.WALKER, sequences.DONT_CARE, ""])
    return sequences.folder(folder, rows, sequences=("0000",))


def read(layout: str, opened: Path) -> None:
    """All that commands do with a recording before they compute."""
    from formats import one_line

    some = list(open_recording(opened, NAMED.get(layout, layout)))
    for sample in some:
        if not (np.isfinite(sample.points()).all() and np.isfinite(sample.objects.boxes).all()):
            raise RuntimeError(f"sample {sample.name} has numbers that are none")
    if some:
        survey(Part(open_recording(opened, NAMED.get(layout, layout))))
    for finding in diagnose_labels(some):
        one_line(str(finding))
    with tempfile.TemporaryDirectory() as folder:
        write_recording(some, Path(folder, "again.hdf5"), "hdf5")


def maker(name: str) -> Callable[[Path], object]:
    layout, place, _ = FILES[name]
    return lambda path: path.write_bytes((_sound(layout)[0] / place).read_bytes())


def reader(name: str) -> Callable[[Path], None]:
    """Reads the recording with a file in the place of its own."""
    layout, place, _ = FILES[name]

    def read_mutant(path: Path) -> None:
        folder, opened, _ = _sound(layout)
        file = folder / place
        sound = file.read_bytes()
        try:
            if path.is_file() and not path.is_symlink():
                file.write_bytes(path.read_bytes())
            else:
                file.unlink()
                path.rename(file)
            read(layout, opened)
        finally:
            file.rmdir() if file.is_dir() else file.unlink()
            file.write_bytes(sound)

    return read_mutant


@cache
def _sound(layout: str) -> tuple[Path, Path, object]:
    """The folder of a sound recording, what of it is opened, and what removes it at the end of the
    process."""
    kept = tempfile.TemporaryDirectory()
    folder = Path(kept.name)
    return folder, write(layout, folder), kept


def _cloud(path: Path, seed: int = 0) -> None:
    rng = np.random.default_rng(seed)
    path.parent.mkdir(parents=True, exist_ok=True)
    points = np.column_stack([rng.uniform(-20, 20, (300, 2)), rng.normal(-5, 0.01, 300)]).astype(
        np.float32
    )
    path.write_bytes(pcd_bytes(dict(zip("xyz", points.T, strict=True))))


def _json(path: Path, content: object) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(content))


def _cars(count: int = 6) -> list[object]:
    return [
        {
            "type": "Car",
            "track_id": str(k),
            "3d_dimensions": {"h": "1.5", "w": 1.8, "l": 4.5},
            "3d_location": {"x": 4.0 * k, "y": str(-k), "z": -4.2},
            "rotation": 0.1 * k,
        }
        for k in range(count)
    ]


def _motion(*place: float) -> dict[str, object]:
    return {"rotation": np.eye(3).tolist(), "translation": [[each] for each in place]}


def _pair(folder: Path) -> Path:
    road, car = folder / "infrastructure-side", folder / "vehicle-side"
    index = {
        "infrastructure_pointcloud_path": "infrastructure-side/velodyne/3.pcd",
        "vehicle_pointcloud_path": "vehicle-side/velodyne/7.pcd",
        "system_error_offset": {"delta_x": 0.1, "delta_y": "0"},
    }
    _json(folder / "cooperative/data_info.json", [index])
    _json(folder / "cooperative/label_world/7.json", _cars())
    _cloud(road / "velodyne/3.pcd")
    _cloud(car / "velodyne/7.pcd", 1)
    _json(road / "calib/virtuallidar_to_world/3.json", _motion(1.0, 2.0, 0.0))
    _json(car / "calib/lidar_to_novatel/7.json", {"transform": _motion(0.0, 0.0, 1.0)})
    _json(car / "calib/novatel_to_world/7.json", _motion(8.0, 2.0, 0.0))
    return folder


def _rcooper(folder: Path) -> Path:
    for agent, x in (("106", 0.0), ("105", 20.0)):
        for stamp in ("1692685344.5", "1692685344.6"):
            _cloud(folder / "data/106-105" / agent / "seq-1/lidar" / f"{stamp}.pcd")
            _json(folder / "label/106-105" / agent / "seq-1" / f"{stamp}.json", _cars())
        _json(folder / "calib/lidar2world" / f"{agent}.json", _motion(x, 0.0, 5.0))
    return folder


def _ros2(folder: Path, sqlite: bool = False) -> Path:
    store, kinds = get_typestore(Stores.ROS2_HUMBLE), (TF, CLOUD)
    plugin = StoragePlugin.SQLITE3 if sqlite else StoragePlugin.MCAP
    with Writer(folder / "bag", version=9, storage_plugin=plugin) as writer:
        tf, cloud = (
            writer.add_connection(f"/{k}", kind, typestore=store) for k, kind in enumerate(kinds)
        )
        for k, sample in enumerate(samples()):
            stamp = (k + 1) * 10**8
            links = store.types[TF](
                transforms=[rosbag.make_link(store, each, stamp) for each in sample.clouds]
            )
            made = (links, rosbag.make_cloud_message(store, sample.clouds[0], stamp))
            for connection, message, kind in zip((tf, cloud), made, kinds, strict=True):
                writer.write(connection, stamp, store.serialize_cdr(message, kind))
    return folder / "bag"


def _ros1(folder: Path) -> Path:
    from rosbags.rosbag1 import Writer

    store, rng = get_typestore(Stores.ROS1_NOETIC), np.random.default_rng(0)
    types = store.types
    with Writer(folder / "one.bag") as writer:
        connection = writer.add_connection("/velodyne", CLOUD, typestore=store)
        for k in range(3):
            table = rng.uniform(-9, 9, (300, 3)).astype("<f4")
            time = types["builtin_interfaces/msg/Time"](sec=k + 1, nanosec=0)
            field = types["sensor_msgs/msg/PointField"]
            message = types[CLOUD](
                header=types["std_msgs/msg/Header"](seq=k, stamp=time, frame_id="velodyne"),
                height=1,
                width=300,
                fields=[
                    field(name=axis, offset=4 * i, datatype=7, count=1)
                    for i, axis in enumerate("xyz")
                ],
                is_bigendian=False,
                point_step=12,
                row_step=3600,
                data=np.frombuffer(table.tobytes(), np.uint8),
                is_dense=True,
            )
            writer.write(connection, (k + 1) * 10**9, store.serialize_ros1(message, CLOUD))
    return folder / "one.bag"
