"""KITTI's tracking benchmark: velodyne/SEQUENCE/*.bin, label_02/SEQUENCE.txt, calib/SEQUENCE.txt.

They are in the folder or in training/. A recording is one sequence: the folder, if it has only one,
or the folder of the sequence's clouds, such as training/velodyne/0007.

- A label is a row of the object benchmark (`toolkit.datasets.layouts.kitti`) after the number of
  its frame and its track; a DontCare has the track -1.
- World frame: the lidar's, which moves. There are no times: the set is of 10 Hz, but no file states
  it.
- One calibration serves the whole sequence; its names are R_rect, Tr_velo_cam and Tr_imu_velo."""

from collections.abc import Mapping
from functools import partial
from os.path import lexists
from pathlib import Path
from typing import NamedTuple

import numpy as np

from toolkit.arrays import Pose
from toolkit.datasets import (
    cloud_records,
    folders,
    frame_labels,
    listing,
    problem_kinds,
    record_values,
)
from toolkit.datasets.layouts.kitti import (
    SENSOR,
    KittiCalibration,
    LabelledView,
    LabelRows,
    read_calibration,
    read_image_size,
)
from toolkit.datasets.layouts.kitti_track_rows import parse_whole, read_track_rows
from toolkit.datasets.origins import Middles
from toolkit.frame import Frame
from toolkit.geometry import invert

MISSING_CLOUDS = "frames that labels refer to and that have no cloud"


class _Sequence(NamedTuple):
    """Files of one sequence.

    folder: the folder with velodyne/, label_02/ and calib/; name: name of the sequence."""

    folder: Path
    name: str

    @property
    def clouds(self) -> Path:
        """Folder of its clouds."""
        return self.folder / "velodyne" / self.name

    @property
    def labels(self) -> Path:
        """File of its labels, which may be missing."""
        return self.folder / "label_02" / f"{self.name}.txt"

    @property
    def calibration(self) -> Path:
        """File of its calibration."""
        return self.folder / "calib" / f"{self.name}.txt"


def kitti_sequence(path: Path) -> listing.Listing:
    """Open a sequence of KITTI's tracking benchmark.

    Raises FileNotFoundError for any other folder, ValueError for one of several sequences and
    damaged labels."""
    sequence = _find_sequence(path)
    names = tuple(file.stem for file in folders.list_files(sequence.clouds, "*.bin"))
    if not names:
        raise FileNotFoundError(f"{sequence.clouds} holds no *.bin")
    # number of the frame in the labels, by the name of its cloud
    numbers = {}
    with record_values.name_damage(sequence.clouds, "folder of numbered clouds"):
        for name in names:
            numbers[name] = parse_whole(name, "the name of a cloud")
    labels: dict[int, LabelRows] | None = None
    calibration = None
    if lexists(sequence.labels):
        labels = read_track_rows(sequence.labels)
        if not lexists(sequence.calibration):
            raise FileNotFoundError(
                f"no calibration {sequence.calibration}: the boxes of {sequence.labels.name} are "
                "in a camera's frame, add it"
            )
        calibration = read_calibration(sequence.calibration)
    # labelled frames without a cloud
    strays = set(labels or ()) - set(numbers.values())
    middles = Middles({SENSOR: sequence.clouds / f"{names[0]}.bin"})
    load = partial(_load, sequence, numbers, labels, calibration, middles)
    return listing.Listing(names, load, noted={MISSING_CLOUDS: len(strays)})


def find_camera(path: Path) -> Pose:
    """Return the pose world_SE3_camera of the labelled camera of a sequence.

    Raises the errors of `kitti_sequence`, and OSError for a missing calibration."""
    calibration = read_calibration(_find_sequence(path).calibration)
    return invert(calibration.camera_SE3_lidar)


def _find_sequence(path: Path) -> _Sequence:
    """Return the sequence at a path: velodyne/SEQUENCE itself, or a folder with only one such.

    Raises ValueError for several sequences, and FileNotFoundError for none."""
    if path.parent.name == "velodyne" and any(path.glob("*.bin")):
        return _Sequence(path.parent.parent, path.name)
    for folder in (path, path / "training", path / "testing"):
        names = [entry.name for entry in folders.list_files(folder / "velodyne") if entry.is_dir()]
        if len(names) > 1:
            raise ValueError(
                f"{path} holds {len(names)} sequences, {', '.join(names[:6])}: give one, such as "
                f"{folder / 'velodyne' / names[0]}"
            )
        if names:
            return _Sequence(folder, names[0])
    raise FileNotFoundError(
        f"{path} is no sequence of KITTI's tracking: it has no velodyne/SEQUENCE/*.bin"
    )


def _load(
    sequence: _Sequence,
    numbers: Mapping[str, int],
    labels: Mapping[int, LabelRows] | None,
    calibration: KittiCalibration | None,
    middles: Middles,
    name: str,
) -> Frame:
    """Read a frame.

    numbers: number of each frame, by name; labels: labels of each frame, by number, None without a
    file; name: name of the frame."""
    problems: problem_kinds.Problems = {}
    file = sequence.clouds / f"{name}.bin"
    cloud = cloud_records.read_cloud(file, SENSOR, np.eye(4), problems, middles=middles)
    if labels is None or calibration is None:
        return Frame.of_clouds(name, (cloud,), *frame_labels.no_labels(), problems=problems)
    image = sequence.folder / "image_02" / sequence.name / f"{name}.png"
    view = LabelledView(calibration, read_image_size(image))
    rows = labels.get(numbers[name], LabelRows.parse(rows=[], ids=[]))
    return view.frame(name, cloud, rows, problems)
