"""SUSTechPOINTS, folders of the labelling tool: lidar/*.pcd (or .bin), label/*.json.

World frame: the lidar's, as recorded; z up, which way is forward differs between recordings.

- A label is {"obj_id", "obj_type", "psr": {"position", "rotation", "scale"}}: position is the
  centre of the box, scale x y z its length, width and height, rotation x y z in radians about the
  turned axes, in this order; only the heading of a box is kept.
- obj_id is a string, and the same through a scene.
- A cloud's name may be its time, seconds or smaller units since 1970.
- Frames nobody has labelled yet have no file: their objects are unknown, not none."""

import json
from collections.abc import Iterable
from functools import partial
from os.path import lexists
from pathlib import Path

import numpy as np

from toolkit.arrays import Float64
from toolkit.datasets import (
    box_frames,
    cloud_records,
    folders,
    frame_labels,
    frame_times,
    problem_kinds,
    record_values,
)
from toolkit.datasets.clock_times import find_epoch
from toolkit.datasets.folders import ENDINGS
from toolkit.datasets.listing import Listing
from toolkit.datasets.origins import Middles, near_frames, warn_of_origin
from toolkit.datasets.record_values import entry, xyz
from toolkit.frame import Frame
from toolkit.runtime.writing import write_text

_NAMES = frame_labels.COMMON_NAMES | {"cyclist": "Bicycle"}


def sustech(path: Path) -> Listing:
    """Open the folder of a scene as a recording, whose frames are read on demand.

    Raises FileNotFoundError if it is not a scene."""
    clouds = [file for file in folders.list_files(path / "lidar") if file.suffix.lower() in ENDINGS]
    file_by_name: dict[str, Path] = {}
    # a name with several files gets the one whose ending comes first in ENDINGS
    for file in sorted(clouds, key=lambda file: ENDINGS.index(file.suffix.lower())):
        file_by_name.setdefault(file.stem, file)
    names = sorted(file_by_name, key=folders.natural_order)
    files = {name: file_by_name[name] for name in names}
    if not files:
        raise FileNotFoundError(f"{path} is no SUSTechPOINTS scene: it has no lidar/*.pcd")
    labelled = [file.stem for file in folders.list_files(path / "label", "*.json")]
    # clouds far from their sensor's origin are counted from the middle of the first one
    middles = Middles({"lidar": next(iter(files.values()))})
    load = partial(_read_frame, path, files, middles, bool(labelled))
    noted = {problem_kinds.DOUBLED_CLOUDS: len(clouds) - len(files)}
    return Listing(tuple(files), load, labelled=labelled, noted=noted)


def _read_frame(
    folder: Path, files: dict[str, Path], middles: Middles, is_labelled: bool, name: str
) -> Frame:
    """Read the frame of a name: its cloud and its labels.

    files: cloud file of each frame by name; is_labelled: True if the folder has labels, so that a
    frame without them counts as a problem."""
    problems: problem_kinds.Problems = {}
    cloud = cloud_records.read_cloud(
        files[name], "lidar", np.eye(4), problems, stamp_s=find_epoch(name), middles=middles
    )
    path = folder / "label" / f"{name}.json"
    has_labels = lexists(path)
    problem_kinds.add_problem(
        problems, problem_kinds.UNLABELLED, int(is_labelled and not has_labels)
    )
    with record_values.name_damage(path, "list of labels"):
        labels = record_values.as_list(record_values.load_json(path)) if has_labels else []
        # "psr" is position, scale, rotation
        poses = [entry(label, "psr") for label in labels]
        angles = np.array([xyz(psr, "rotation") for psr in poses]).reshape(-1, 3)
        centres_and_sizes = [[*xyz(psr, "position"), *xyz(psr, "scale")] for psr in poses]
        categories = [str(entry(label, "obj_type")) for label in labels]
        ids = [label.get("obj_id", k) for k, label in enumerate(labels)]
    frame_labels.count_full_turns(angles[:, 2], problems)
    headings = box_frames.find_headings(_make_rotations(angles), problems)
    boxes = np.column_stack([np.array(centres_and_sizes).reshape(-1, 6), headings])
    labels_in_frame = frame_labels.make_labels(boxes, categories, ids, problems)
    return Frame.of_clouds(
        name,
        (cloud,),
        *labels_in_frame,  # objects, categories, counts, others
        time=frame_times.frame_time([cloud]),
        problems=problems,
    )


def _make_rotations(angles: Float64[np.ndarray, "n 3"]) -> Float64[np.ndarray, "n 3 3"]:
    """Rotation matrices of angles (rad) about x, then the turned y, then the turned z.

    They are NaN for angles that are not finite."""
    from scipy.spatial.transform import Rotation

    is_finite = np.isfinite(angles).all(axis=1)
    rotations = np.full((len(angles), 3, 3), np.nan)
    if is_finite.any():
        # capital letters are SciPy's for turned axes
        rotations[is_finite] = Rotation.from_euler("XYZ", angles[is_finite]).as_matrix()
    return rotations


def write_sustech(samples: Iterable[Frame], folder: Path) -> None:
    """Write frames as a scene, numbered from 000000. The clouds of a frame become one.

    A scene has no place for an origin: a warning names the one taken off coordinates that are far
    from zero."""
    for number, sample in enumerate(near_frames(samples)):
        name = f"{number:06d}"
        if not number:
            warn_of_origin(sample, "SUSTechPOINTS")
        cloud_records.write_cloud(folder / "lidar" / f"{name}.pcd", cloud_records.one_cloud(sample))
        content = []
        for box, kind, track in frame_labels.list_rows(sample.objects, _NAMES):
            centre, size = box[:3], box[3:6]
            yaw = box[6]
            # the format's name for position, scale and rotation
            psr = {
                "position": dict(zip("xyz", centre, strict=True)),
                "rotation": {"x": 0.0, "y": 0.0, "z": yaw},
                "scale": dict(zip("xyz", size, strict=True)),
            }
            content.append({"obj_id": str(track), "obj_type": kind, "psr": psr})
        write_text(folder / "label" / f"{name}.json", json.dumps(content, indent=1))
