"""KITTI's tracking text: one row per object and frame.

A row is `frame id type truncated occluded alpha left top right bottom h w l x y z ry score`, a
label of the object benchmark (see `toolkit.datasets.layouts.kitti`) after frame and id: x y z is
the centre of the **floor** in a camera's frame (x right, y down, z forward), here one at the
world's origin that faces along x. Its image rectangle is the whole image of KITTI for every object:
the camera does not exist, and evaluation tools drop unmatched objects below 25 pixels. alpha is
-10, KITTI's number for unknown. A frame is the number of the instant from 0; the text has no
times."""

from pathlib import Path

import numpy as np

from toolkit.datasets.frame_labels import COMMON_NAMES
from toolkit.datasets.layouts.kitti import IMAGE_PX
from toolkit.datasets.problem_kinds import Problems
from toolkit.exchange.instant import Instant
from toolkit.objects import LABELS


class KittiTrackingWriter:
    """Writer of one sequence's rows."""

    def __init__(self, path: Path) -> None:
        self.problems: Problems = {}
        self._file = path.open("w", encoding="ascii", newline="\n")
        self._frame = 0

    def write(self, instant: Instant) -> None:
        """Write a row for each object: `frame id type truncated occluded alpha`, image rectangle
        `left top right bottom`, sizes `h w l`, floor centre `x y z` in the camera, `ry score`."""
        # the rectangle of every object is the whole image, as the camera does not exist
        image_width, image_height = IMAGE_PX
        rectangle = f"0.00 0.00 {image_width - 1:.2f} {image_height - 1:.2f}"
        rows = zip(
            instant.list_ids(), instant.labels, instant.scores, instant.boxes.tolist(), strict=True
        )
        for track_id, label, score, box in rows:
            x, y, z = box[:3]
            length, width = box[3:5]
            height, yaw = box[5:]
            sizes = f"{height:.6f} {width:.6f} {length:.6f}"
            # a camera at the world's origin that faces along x: its x is right, y down, z forward
            floor = f"{-y:.6f} {height / 2 - z:.6f} {x:.6f}"
            name = COMMON_NAMES[LABELS[label]]
            # not truncated, not occluded, alpha unknown
            self._file.write(
                f"{self._frame} {track_id} {name} 0 0 -10 {rectangle} {sizes} {floor} "
                f"{camera_turn(yaw):.6f} {score:.6f}\n"
            )
        self._frame += 1

    def close(self) -> None:
        """Complete the file."""
        self._file.close()


def camera_turn(yaw: float) -> float:
    """Return KITTI's ry (rad in -pi..pi) of a yaw: clockwise seen from above, from the right.

    >>> camera_turn(-np.pi / 2)
    0.0
    """
    turn = -yaw - np.pi / 2
    return float(np.arctan2(np.sin(turn), np.cos(turn)))
