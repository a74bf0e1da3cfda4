"""KITTI's object detection: velodyne/*.bin, label_2/*.txt, calib/*.txt in the folder or training/.

World frame: the lidar's, x forward, y left, z up, about 1.73 m above the ground.

- A label is `type truncated occluded alpha left top right bottom h w l x y z ry [score]`: sizes in
  the order height, width, length; x y z is the centre of the **floor** in the **rectified
  camera's** frame (x right, y down, z forward); ry turns about its y, which points down, from its
  x, so that a car ahead with ry = 0 faces right.
- Rectified camera ← lidar is R0_rect · Tr_velo_to_cam, and neither rotation is exactly one.
- Only what camera 2 shows is labelled, the lidar sees all round. `DontCare` marks regions of the
  image in which nobody labelled: its box is -1 -1 -1 -1000 -1000 -1000 -10 and no object.
- KITTI has no place for the lidar's pose in a map. coview writes it as the last line of calib,
  Tr_velo_to_world, which other readers pass over: they take lines by number or by name.
- calib names differ between the benchmarks (R0_rect: and R_rect, Tr_velo_to_cam: and
  Tr_velo_cam)."""

import struct
from collections.abc import Iterable
from functools import partial
from os.path import lexists
from pathlib import Path
from typing import NamedTuple

import numpy as np

from toolkit.arrays import BoxRows, Float64, Pose
from toolkit.datasets import (
    cloud_records,
    folders,
    frame_labels,
    listing,
    problem_kinds,
    record_values,
)
from toolkit.datasets.origins import Middles, near_frames
from toolkit.frame import Frame, ImageWedge, Region, SensorCloud
from toolkit.geometry import BODY_SE3_CAMERA, invert, transform
from toolkit.objects import LABELS, Detections
from toolkit.runtime.reading import read_bytes
from toolkit.runtime.writing import write_bytes, write_text

SENSOR = "velodyne"
DONT_CARE = "DontCare"
_PLACE = "Tr_velo_to_world"
_OTHER_NAMES = {"R_rect": "R0_rect", "R_rect_00": "R0_rect", "Tr_velo_cam": "Tr_velo_to_cam"}
IMAGE_PX = 1242, 375  # width and height if there is no image
NONE_SHOWN = "labels lie all outside the image: P2, R0_rect or Tr_velo_to_cam are of another camera"
_CAMERA = invert(BODY_SE3_CAMERA)  # camera_SE3_lidar of what is written
_FOCAL_PX = 721.5377  # camera that is written if a recording has no camera
_KITTI_KINDS = {"Car", "Van", "Truck", "Pedestrian", "Person_sitting", "Cyclist", "Tram", "Misc"}


def kitti(path: Path) -> listing.Listing:
    """Open a folder in the layout of KITTI as a recording, whose frames are read on demand.

    Raises FileNotFoundError for any other folder."""
    candidates = (path, path / "training", path / "testing")
    folder = next((folder for folder in candidates if (folder / "velodyne").is_dir()), None)
    if folder is None:
        raise FileNotFoundError(
            f"{path} is no KITTI folder: it has no velodyne/ nor training/velodyne/"
        )
    names = tuple(file.stem for file in folders.list_files(folder / "velodyne", "*.bin"))
    if not names:
        raise FileNotFoundError(f"{folder / 'velodyne'} holds no *.bin")
    labelled = [file.stem for file in folders.list_files(folder / "label_2", "*.txt")]
    # clouds far from their sensor's origin are counted from the middle of the first one
    middles = Middles({SENSOR: folder / "velodyne" / f"{names[0]}.bin"})
    load = partial(_read_frame, folder, middles, bool(labelled))
    return listing.Listing(names, load, labelled=labelled)


def _read_frame(folder: Path, middles: Middles, is_labelled: bool, name: str) -> Frame:
    """Read a frame of KITTI: its cloud, and its labels, moved from the camera's frame.

    Args:
        folder: Folder with `velodyne`, `label_2` and `calib`.
        middles: Origins of clouds that are far from their sensor's.
        is_labelled: True if any frame has labels, so that a missing file is a problem.
        name: Name of the frame's files without their ending."""
    problems: problem_kinds.Problems = {}
    file = folder / "velodyne" / f"{name}.bin"
    cloud = cloud_records.read_cloud(file, SENSOR, np.eye(4), problems, middles=middles)
    labels = folder / "label_2" / f"{name}.txt"
    calib = folder / "calib" / f"{name}.txt"
    if not lexists(labels):
        problem_kinds.add_problem(problems, problem_kinds.UNLABELLED, int(is_labelled))
        return Frame.of_clouds(name, (cloud,), *frame_labels.no_labels(), problems=problems)
    if not lexists(calib):
        raise FileNotFoundError(
            f"no calibration {calib}: the boxes of {labels.name} are in a camera's frame, add it"
        )
    calibration = read_calibration(calib)
    with record_values.name_damage(labels, "list of labels"):
        rows = [
            line.split()
            for line in read_bytes(labels).decode("utf-8-sig").splitlines()
            if line.strip()
        ]
        for row in rows:
            if len(row) not in (15, 16):
                is_tracking = len(row) in (17, 18) and row[0].isdigit()
                remedy = ""
                if is_tracking:
                    remedy = (
                        ": it is KITTI's tracking, read the sequence with the layout kitti-tracking"
                    )
                raise ValueError(f"a line must have 15 or 16 entries, got {len(row)}{remedy}")
        label_rows = LabelRows.parse(rows)
    view = LabelledView(calibration, read_image_size(folder / "image_2" / f"{name}.png"))
    return view.frame(name, cloud, label_rows, problems)


class LabelRows(NamedTuple):
    """Labels of one frame.

    kinds: their types, DontCare too; values: the 14 numbers after each; ids: track of each label,
    None if the labels have no tracks; scores: scores of detections, NaN for a row without one, None
    if they were not read."""

    kinds: list[str]
    values: Float64[np.ndarray, "n 14"]
    ids: list[str] | None = None
    scores: Float64[np.ndarray, " n"] | None = None

    @staticmethod
    def parse(rows: list[list[str]], ids: list[str] | None = None) -> "LabelRows":
        """Parse rows that begin with their types."""
        values = np.array([_parse_values(row) for row in rows]).reshape(-1, 14)
        return LabelRows([row[0] for row in rows], values, ids)


class LabelledView(NamedTuple):
    """Camera whose image is labelled.

    calibration: calibration of the camera; size_px: width and height of its image."""

    calibration: "KittiCalibration"
    size_px: tuple[int, int]

    def frame(
        self, name: str, cloud: SensorCloud, labels: LabelRows, problems: problem_kinds.Problems
    ) -> Frame:
        """Return the frame of a cloud and its labels; counts are added to `problems`.

        The world is the frame of the lidar. labels: rows of a file, whose boxes are in the frame of
        the camera. Objects beyond the camera's view are unlabelled."""
        calibration = self.calibration
        # the numbers of a row behind its class
        values = labels.values
        is_real = np.array([kind != DONT_CARE for kind in labels.kinds], bool)
        ids = None
        if labels.ids is not None:
            ids = [labels.ids[row] for row in np.flatnonzero(is_real)]
        with np.errstate(all="ignore"):
            boxes = parse_camera_boxes(values[is_real], invert(calibration.camera_SE3_lidar))
            frame_labels.count_full_turns(values[is_real, 13], problems)  # yaw
        kinds = [kind for kind in labels.kinds if kind != DONT_CARE]
        labels_in_frame = frame_labels.make_labels(boxes, kinds, ids, problems)
        width, height = self.size_px
        # left, top, right, bottom (px) of the rectangles without labels
        ignored_rectangles = tuple(
            (left, top, right, bottom)
            for left, top, right, bottom in values[~is_real, 3:7].tolist()
        )
        projection = calibration.projection @ calibration.camera_SE3_lidar
        wedge = ImageWedge(projection, width, height, ignored_rectangles)
        if len(labels_in_frame.objects) and not wedge.covers(labels_in_frame.objects.boxes).any():
            problem_kinds.add_problem(problems, NONE_SHOWN, len(labels_in_frame.objects))
        return Frame.of_clouds(
            name,
            (cloud,),
            *labels_in_frame,
            complete=wedge,
            map_SE3_world=calibration.map_SE3_lidar,
            problems=problems,
        )


def read_calibration(path: Path) -> "KittiCalibration":
    """Read a calibration file. Raises ValueError that names it, OSError if it is missing."""
    with record_values.name_damage(path, "calibration"):
        return _parse_calibration(read_bytes(path).decode("utf-8-sig"))


def _parse_values(row: list[str]) -> list[float]:
    # The 14 numbers of a label after its type.
    return [record_values.as_number(cell) for cell in row[1:15]]


def parse_camera_boxes(values: np.ndarray, lidar_SE3_camera: Pose) -> BoxRows:
    """Boxes in the lidar's frame from labels, whose places are in the camera's frame.

    values: the 14 numbers of each label after its type: h w l in columns 7 to 9, x y z of the floor
    in 10 to 12, ry in 13."""
    height, width, length = values[:, 7:10].T
    floor, turn = values[:, 10:13], values[:, 13]
    # y points down, so the centre is half the height above the floor
    zeros = 0 * height
    centre = floor - np.stack([zeros, height / 2, zeros], axis=1)
    # ry = 0 is the camera's x: turned about y, which points down, forward is (cos ry, 0, -sin ry)
    camera_forward = np.stack([np.cos(turn), 0 * turn, -np.sin(turn)], axis=1)
    forward = camera_forward @ lidar_SE3_camera[:3, :3].T
    yaw = np.arctan2(forward[:, 1], forward[:, 0])
    return np.column_stack([transform(lidar_SE3_camera, centre), length, width, height, yaw])


class KittiCalibration(NamedTuple):
    """Contents of a calibration file.

    camera_SE3_lidar: pose of the lidar in the rectified camera's frame; projection: (3, 4) from
    there to the pixels of camera 2; map_SE3_lidar: pose of the lidar in the map, the identity if
    the file lacks it."""

    camera_SE3_lidar: Pose
    projection: np.ndarray
    map_SE3_lidar: Pose


def _parse_calibration(text: str) -> KittiCalibration:
    """Parse the text of a calibration file; ValueError if an entry is missing or damaged."""
    # the numbers of each line, as text, by its first word, which has other names in some files
    entries = {}
    for line in text.splitlines():
        if line.strip():
            words = line.split()
            name = words[0].removesuffix(":")
            entries[_OTHER_NAMES.get(name, name)] = words[1:]
    rectification = record_values.rigid(
        record_values.entry(entries, "R0_rect"), translation=np.zeros(3), name="R0_rect"
    )
    unrectified_SE3_lidar = record_values.rigid_matrix(
        record_values.entry(entries, "Tr_velo_to_cam"), "Tr_velo_to_cam"
    )
    projection = record_values.numbers(record_values.entry(entries, "P2"), 12, "P2").reshape(3, 4)
    if not np.isfinite(projection).all():
        raise ValueError("P2 holds NaN or infinite numbers")
    map_SE3_lidar = np.eye(4)
    if _PLACE in entries:
        map_SE3_lidar = record_values.rigid_matrix(entries[_PLACE], _PLACE)
    return KittiCalibration(
        camera_SE3_lidar=rectification @ unrectified_SE3_lidar,
        projection=projection,
        map_SE3_lidar=map_SE3_lidar,
    )


def read_image_size(image: Path) -> tuple[int, int]:
    """Width and height (pixels) in the header of a PNG, `IMAGE_PX` without a readable file."""
    head = image.open("rb").read(24) if image.is_file() else b""
    if len(head) < 24 or head[:8] != b"\x89PNG\r\n\x1a\n":
        return IMAGE_PX
    width, height = struct.unpack(">II", head[16:24])
    is_plausible = 0 < width < 1 << 16 and 0 < height < 1 << 16
    return (width, height) if is_plausible else IMAGE_PX


def write_kitti(samples: Iterable[Frame], folder: Path) -> None:
    """Write frames as training/ of KITTI, numbered from 000000.

    The clouds of a frame become one, in its world frame. The camera is the one of the frame's
    labels, else one at the origin that faces along x."""
    training = folder / "training"
    for number, sample in enumerate(near_frames(samples)):
        name = f"{number:06d}"
        points = [
            np.column_stack([cloud.in_world(), cloud_records.get_intensity(cloud)])
            for cloud in sample.clouds
        ]
        cloud = np.concatenate([np.zeros((0, 4)), *points]).astype("<f4")
        write_bytes(training / "velodyne" / f"{name}.bin", cloud.tobytes())
        write_text(training / "label_2" / f"{name}.txt", kitti_text(sample))
        # 3 x 4, from the camera's frame to pixels
        _, projection = _choose_camera(sample.complete)
        # the format has four cameras; all are the same one here
        entries = {f"P{k}": projection for k in range(4)}
        entries |= {
            "R0_rect": np.eye(3),
            "Tr_velo_to_cam": _CAMERA[:3],
            "Tr_imu_to_velo": np.eye(4)[:3],
        }
        if not np.array_equal(sample.map_SE3_world, np.eye(4)):
            entries[_PLACE] = sample.map_SE3_world[:3]
        lines = []
        for key, matrix in entries.items():
            numbers = " ".join(f"{value:.12e}" for value in matrix.ravel())
            lines.append(f"{key}: {numbers}\n")
        write_text(training / "calib" / f"{name}.txt", "".join(lines))


def kitti_text(sample: Frame, *, found: Detections | None = None) -> str:
    """Format a frame's labels, or its detections with their scores, as lines of KITTI's label_2.

    found: detections instead of the frame's objects. An object whose category is one of KITTI's
    keeps that name."""
    wedge, _ = _choose_camera(sample.complete)
    objects = sample.objects if found is None else found
    names = [frame_labels.COMMON_NAMES[LABELS[label]] for label in objects.labels]
    if found is None and sample.categories:
        names = [
            category if category in _KITTI_KINDS else name
            for category, name in zip(sample.categories, names, strict=True)
        ]
    scores = [""] * len(names) if found is None else [f" {score:.6f}" for score in found.scores]
    lines = []
    for name, box, rectangle, score in zip(
        names, objects.boxes, wedge.rectangles(objects.boxes), scores, strict=True
    ):
        lines.append(f"{name} 0 0 {_format_box(box, rectangle)}{score}\n")
    # regions without labels: type; values for no truncation, occlusion and angle; rectangle; values
    # for no box
    for left, top, right, bottom in wedge.ignored if found is None else ():
        edges = f"{left:.2f} {top:.2f} {right:.2f} {bottom:.2f}"
        lines.append(f"DontCare -1 -1 -10 {edges} -1 -1 -1 -1000 -1000 -1000 -10\n")
    return "".join(lines)


def _format_box(box: Float64[np.ndarray, "7"], rectangle: Float64[np.ndarray, "4"]) -> str:
    """Format a box as a label of KITTI: alpha, left top right bottom, h w l, x y z, ry.

    box: world frame; rectangle: its edges in the image (pixels)."""
    centre, yaw = box[:3], box[6]
    length, width, height = box[3:6].tolist()  # m
    # in the camera's frame: x to the right, y down, z forward
    x, y, z = transform(_CAMERA, centre[None])[0]
    forward = _CAMERA[:3, :3] @ [np.cos(yaw), np.sin(yaw), 0.0]
    # KITTI's ry, about the y axis, 0 along +x
    turn = np.arctan2(-forward[2], forward[0])
    # alpha is the turn against the ray from the camera to the box, from -pi to pi
    ray_turn = np.arctan2(x, z)
    alpha = np.arctan2(np.sin(turn - ray_turn), np.cos(turn - ray_turn))
    edges = " ".join(f"{edge:.2f}" for edge in rectangle)
    size = f"{height:.6f} {width:.6f} {length:.6f}"
    floor = f"{x:.6f} {y + height / 2:.6f} {z:.6f}"  # y points down
    return f"{alpha:.6f} {edges} {size} {floor} {turn:.6f}"


def _choose_camera(complete: Region) -> tuple[ImageWedge, Float64[np.ndarray, "3 4"]]:
    """Return the region that a camera sees, and its projection from the written camera's frame.

    complete: region in which labels are complete. If it is an image, that is the region; otherwise
    it is the view of a camera at the origin that faces along x."""
    if isinstance(complete, ImageWedge):
        return complete, complete.projection @ invert(_CAMERA)
    width, height = IMAGE_PX
    projection = np.array(
        [[_FOCAL_PX, 0, width / 2, 0], [0, _FOCAL_PX, height / 2, 0], [0, 0, 1, 0]]
    )
    return ImageWedge(projection @ _CAMERA, width=width, height=height), projection
