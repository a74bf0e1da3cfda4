"""Cuboids of OpenLABEL's frames.

- A cuboid's `val` is x y z, then the quaternion **x y z w** of any length, then length, width,
  height; x y z is the centre. With 9 numbers it has Euler angles about x, y and z, turned in the
  order ZYX, in place of the quaternion.
- A cuboid, or its object, may name its `coordinate_system`; without one it is in the world's.
- `cuboid` is a list, in TUM Traffic a single object. The class is `type` of the object at the top,
  or, in TUM Traffic, of object_data. Objects at the top may have cuboids too, which hold in their
  frame_intervals.
- num_points among the attributes is the data set's count, -1 if nobody counted."""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from toolkit.arrays import BoxRows, Float64, Pose
from toolkit.datasets import box_frames, frame_labels
from toolkit.datasets.layouts.openlabel_systems import Systems
from toolkit.datasets.layouts.openlabel_transforms import turn_by_quaternion
from toolkit.datasets.problem_kinds import Problems, add_problem
from toolkit.datasets.record_values import Unchecked, as_number, entry, numbers
from toolkit.geometry import pose, transform

UNKNOWN_FRAME = "boxes in a coordinate system that nothing connects with the clouds'"
OTHER_SHAPES = "objects of other shapes than cuboids"
_SHAPES = (
    "bbox",
    "rbbox",
    "mesh",
    "poly2d",
    "poly3d",
    "mat",
    "binary",
    "point2d",
    "point3d",
    "area_reference",
)


@dataclass(frozen=True)
class CuboidRows:
    """Cuboids of one frame in the world frame.

    Attributes:
        boxes: box of each cuboid (m, rad).
        kinds: its class as the file names it.
        ids: id of its object.
        counts: the data set's number of points in it, -1 if unknown.
        unnamed: number of cuboids that name no coordinate system.
    """

    boxes: BoxRows
    kinds: list[str]
    ids: list[str]
    counts: list[int]
    unnamed: int

    @staticmethod
    def parse(
        content: Unchecked,
        frame: Unchecked,
        key: str,
        systems: Systems,
        root: str | None,
        problems: Problems,
    ) -> "CuboidRows":
        """Parse the cuboids of a frame, and the file's cuboids that are valid in it.

        Args:
            content: the whole file's content.
            frame: content of the frame.
            key: its key, a number as text.
            systems: coordinate systems of the frame.
            root: root system of the clouds, None if unknown.
            problems: counts of what is left out are added to it."""
        boxes = list[np.ndarray]()
        kinds = list[str]()
        ids = list[str]()
        counts = list[int]()
        turns: list[np.ndarray] = []
        names: list[str] = []  # coordinate system of each box
        poses: dict[str, Pose | None] = {}
        described_objects = content.get("objects") or {}
        for track, data in _list_object_data(described_objects, frame, key):
            cuboids = data.get("cuboid") or []
            add_problem(
                problems,
                OTHER_SHAPES,
                int(not cuboids and any(data.get(shape) for shape in _SHAPES)),
            )
            about = described_objects.get(track) or {}
            for cuboid in cuboids if isinstance(cuboids, list) else [cuboids]:
                system = cuboid.get("coordinate_system") or data.get("coordinate_system")
                system = system or about.get("coordinate_system")
                name = str(system or "")
                if name not in poses:
                    poses[name] = _place_box(systems, name, root)
                if poses[name] is None:
                    add_problem(problems, UNKNOWN_FRAME, 1)
                    continue
                parsed_box = _parse_box(entry(cuboid, "val"))
                frame_labels.count_full_turns(parsed_box.angles, problems)
                boxes.append(parsed_box.box)
                turns.append(parsed_box.rotation)
                names.append(name)
                kinds.append(
                    str(
                        data.get("type")
                        or entry({"objects": described_objects}, "objects", track, "type")
                    )
                )
                ids.append(track)
                counts.append(_count(cuboid))
        table = np.array(boxes, np.float64).reshape(-1, 7)
        turned_boxes = np.array(turns, np.float64).reshape(-1, 3, 3)
        for name, in_root in poses.items():
            rows = np.flatnonzero(np.array(names, str) == name)
            if in_root is not None and len(rows):
                table[rows, :3] = transform(in_root, table[rows, :3])
                turned_boxes[rows] = in_root[:3, :3] @ turned_boxes[rows]
        table[:, 6] = box_frames.find_headings(turned_boxes, problems)
        return CuboidRows(boxes=table, kinds=kinds, ids=ids, counts=counts, unnamed=names.count(""))


def _list_object_data(
    described: Unchecked, frame: Unchecked, key: str
) -> Iterable[tuple[str, Unchecked]]:
    """Yield id and object_data of the frame's objects, then of the file's objects valid in it.

    Objects of the file are valid in the frames of their frame_intervals, in all frames without any.

    described: objects at the top level of the file; frame: entries of the frame; key: the frame's
    key, a number as text."""
    for track, content in (frame.get("objects") or {}).items():
        about = content or {}
        inherited_entries = {
            name: about[name] for name in ("coordinate_system", "type") if about.get(name)
        }
        yield track, inherited_entries | (about.get("object_data") or {})
    for track, about in described.items():
        data = (about or {}).get("object_data") or {}
        if not data:
            continue
        is_valid = not about.get("frame_intervals")
        for interval in about.get("frame_intervals") or []:
            first = int(as_number(interval["frame_start"]))
            last = int(as_number(interval["frame_end"]))
            is_valid = is_valid or first <= int(key) <= last
        if is_valid:
            yield track, data


def _place_box(systems: Systems, system: str, root: str | None) -> Pose | None:
    """Return the pose in the world frame of the coordinate system that a cuboid names.

    It is the identity for "", and None if nothing connects the system with the clouds'. root: root
    system of the clouds, which is the world frame, None if unknown."""
    if not system or (root is None and system not in systems.known):
        return np.eye(4)
    system_root, root_SE3_system = systems.find_root(system)
    return root_SE3_system if system_root == root else None


def _count(cuboid: Unchecked) -> int:
    """Return the data set's number of points in a cuboid, -1 if it gives none."""
    for number in (cuboid.get("attributes") or {}).get("num") or ():
        if number.get("name") == "num_points":
            return int(as_number(entry(number, "val"), "num_points"))
    return -1


class _ParsedBox(NamedTuple):
    """Contents of a cuboid's `val`.

    box: with a yaw of 0; rotation: matrix; angles: the largest Euler angle (rad), none with a
    quaternion."""

    box: Float64[np.ndarray, "7"]
    rotation: Float64[np.ndarray, "3 3"]
    angles: Float64[np.ndarray, " n"]


def _parse_box(value: Unchecked) -> _ParsedBox:
    """Parse the 9 or 10 numbers of a cuboid's `val`: centre, rotation, and size.

    The rotation is three Euler angles (roll, pitch, yaw; rad) or a quaternion x y z w."""
    angles = np.zeros(0)
    if np.size(np.array(value, dtype=object)) == 9:
        values = numbers(value, 9, "cuboid val")
        roll, pitch, yaw = values[3:6]
        angles = np.array([max(roll, pitch, yaw, key=abs)])
        rotation = pose(roll=roll, pitch=pitch, yaw=yaw)[:3, :3]
    else:
        values = numbers(value, 10, "cuboid val")
        quaternion = np.array(values[3:7])
        rotation = turn_by_quaternion(quaternion)
    centre, size = values[:3], values[-3:]
    box = np.array([*centre, *size, 0.0])
    return _ParsedBox(box, rotation=rotation, angles=angles)
