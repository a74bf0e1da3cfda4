"""Labels in another frame than the world."""

from collections.abc import Callable, Sequence
from functools import partial
from typing import NamedTuple

import numpy as np

from toolkit.arrays import BoxRows, Pose
from toolkit.datasets import box_frames
from toolkit.doctor.label_mistake import LabelMistake
from toolkit.frame import Frame
from toolkit.geometry import invert


class OtherFrame(NamedTuple):
    """Mistake of labels in another frame of coordinates than the world.

    Attributes:
        mistake: the words for the mistake and its remedy.
        choose: returns a recording frame's boxes in the world without it, in a list of one array,
            as `toolkit.doctor.explanations.undo_each` needs."""

    mistake: LabelMistake
    choose: Callable[[Frame], list[BoxRows]]


def other_frames(samples: Sequence[Frame]) -> list[OtherFrame]:
    """Return the frames of coordinates that labels may be in by mistake.

    These are each sensor's frame; the result of applying a sensor's pose to labels that were in
    the world already; and the map. samples: frames of the recording."""
    sensor_names = sorted({cloud.name for sample in samples for cloud in sample.clouds})
    frames = []  # frames of coordinates
    for name in sensor_names:
        frames.append(
            _make_other_frame(
                partial(_find_pose, name),
                name=f"labels are in the frame of sensor {name}, not in the world",
                remedy=f"move them by the pose of {name}, or name their frame",
            )
        )
    for name in sensor_names:
        frames.append(
            _make_other_frame(
                partial(_find_inverse_pose, name),
                name=(
                    f"labels in the world were moved by the pose of sensor {name}, as if in its "
                    "frame"
                ),
                remedy="leave them in the world",
            )
        )
    frames.append(
        _make_other_frame(
            lambda sample: invert(sample.map_SE3_world),
            name="labels are in the map, not in the world",
            remedy="move them by the pose of the vehicle",
        )
    )
    return frames


def _find_pose(name: str, sample: Frame) -> Pose:
    """Pose world_SE3_sensor of a sensor by name in a frame, identity if the frame lacks it."""
    return next(
        (cloud.world_SE3_sensor for cloud in sample.clouds if cloud.name == name), np.eye(4)
    )


def _find_inverse_pose(name: str, sample: Frame) -> Pose:
    """Pose sensor_SE3_world of a sensor by name in a frame, identity if the frame lacks it.

    It undoes the sensor's pose in labels that were in the world before."""
    return invert(_find_pose(name, sample))


def _make_other_frame(
    world_SE3_labels: Callable[[Frame], Pose], name: str, remedy: str
) -> OtherFrame:
    """Return the mistake of labels in some frame of coordinates, and how to undo it.

    Args:
        world_SE3_labels: returns, for a frame of the recording, the motion from the labels' frame
            of coordinates to the world.
        name: the mistake in words.
        remedy: what the user should do about it, in words."""

    def move_to_world(sample: Frame) -> list[BoxRows]:
        return [box_frames.move_boxes(world_SE3_labels(sample), sample.objects.boxes)]

    return OtherFrame(mistake=LabelMistake(name, remedy), choose=move_to_world)
