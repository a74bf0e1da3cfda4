"""Transforms of OpenLABEL: matrices, or a rotation and a translation."""

import numpy as np

from toolkit.arrays import Float64, Pose
from toolkit.datasets import frame_labels, record_values
from toolkit.datasets.record_values import Unchecked, entry, numbers


def find_transform(transform: Unchecked) -> Unchecked:
    """Return the data of a frame's transform, for `parse_transform`.

    VCD 4.3 has a matrix under another name."""
    older = transform.get("transform_src_to_dst_4x4")
    return entry(transform, "transform_src_to_dst") if older is None else older


def parse_transform(value: Unchecked, name: str) -> Pose:
    """Parse OpenLABEL's transform data: a matrix, or a rotation and a translation.

    value: parsed JSON; name: what errors call the transform. Raises ValueError for anything
    else."""
    if isinstance(value, list):  # TUM Traffic, without a name
        return record_values.rigid_matrix(value, name)
    if "matrix4x4" in value:
        return record_values.rigid_matrix(value["matrix4x4"], name)
    if "quaternion" in value:
        rotation = turn_by_quaternion(numbers(value["quaternion"], 4, f"quaternion of {name}"))
    elif "euler_angles" in value:
        rotation = turn_by_angles(value, name)
    else:
        forms = "matrix4x4, quaternion and translation, or euler_angles and translation"
        raise ValueError(f"{name} must be {forms}, got {', '.join(value)[:60]}")
    translation = numbers(entry(value, "translation"), 3, f"translation of {name}")
    return record_values.rigid(rotation, translation, name)


def turn_by_angles(value: Unchecked, name: str) -> Float64[np.ndarray, "3 3"]:
    """Return the rotation matrix of a transform's euler_angles (rad).

    They turn in the order of its `sequence`, each about the axes turned so far. value: the
    transform's data; name: what errors call it."""
    from scipy.spatial.transform import Rotation

    angles = numbers(value["euler_angles"], 3, f"euler_angles of {name}")
    sequence = str(value.get("sequence") or "ZYX").upper()
    if len(sequence) != 3 or not set(sequence) <= set("XYZ") or not np.isfinite(angles).all():
        raise ValueError(
            f"{name} must turn by three finite angles about a sequence of X, Y and Z, got "
            f"{sequence!r:.40}"
        )
    if np.abs(angles).max() > frame_labels.FULL_TURN_RAD:
        raise ValueError(
            f"euler_angles of {name} must be radians, got {angles.tolist()}: give degrees times "
            "pi / 180"
        )
    return np.asarray(Rotation.from_euler(sequence, angles).as_matrix())


def turn_by_quaternion(xyzw: Float64[np.ndarray, "4"]) -> Float64[np.ndarray, "3 3"]:
    """Return the rotation matrix of a quaternion x y z w of any length, NaN for length 0."""
    from scipy.spatial.transform import Rotation

    norm = np.linalg.norm(xyzw)
    if not (np.isfinite(norm) and norm > 0):
        return np.full((3, 3), np.nan)
    return np.asarray(Rotation.from_quat(xyzw / norm).as_matrix())
