"""Mistakes that boxes may have, and how to undo them."""

from dataclasses import dataclass

import numpy as np

from toolkit.arrays import BoxRows, Float64, Pose
from toolkit.datasets import box_frames
from toolkit.geometry import invert


@dataclass(frozen=True)
class LabelMistake:
    """Mistake that boxes may have, and how to undo it: reorder columns, multiply, turn.

    Columns are x, y, z, length, width, height and yaw.

    Attributes:
        name: words for the mistake.
        remedy: what the user should do about it, in words.
        depends_on_axes: True if it depends on the frame's axes, so that it is tried in several
            frames.
        column_order: for each column of the right boxes, the column of the mistaken ones to take.
        column_factors: factor of each column after that.
        yaw_turn: angle (rad) that is added to yaw in the end.
    """

    name: str
    remedy: str
    depends_on_axes: bool = False
    column_order: tuple[int, ...] = (0, 1, 2, 3, 4, 5, 6)
    column_factors: tuple[int | float, ...] = (1, 1, 1, 1, 1, 1, 1)
    yaw_turn: float = 0.0

    def undo(self, boxes: BoxRows) -> BoxRows:
        """Return the boxes without the mistake, in the frame in which it was made."""
        turn = np.array([0, 0, 0, 0, 0, 0, self.yaw_turn])
        return boxes[:, list(self.column_order)] * np.array(self.column_factors) + turn


def undo_mistake(mistake: LabelMistake, boxes: BoxRows, frame_SE3_world: Pose) -> BoxRows:
    """Return boxes (world frame) without a mistake that was made in another frame.

    frame_SE3_world: motion from the world to the frame whose axes the mistake depends on."""
    if np.array_equal(frame_SE3_world, np.eye(4)):
        return mistake.undo(boxes)
    boxes_in_frame = mistake.undo(box_frames.move_boxes(frame_SE3_world, boxes))
    return box_frames.move_boxes(invert(frame_SE3_world), boxes_in_frame)


def possible_headings(yaw: Float64[np.ndarray, " n"]) -> Float64[np.ndarray, "k n"]:
    """Headings (rad, modulo half a turn) that become `yaw` if degrees are taken for radians.

    A file that stores sine and cosine, or a quaternion, of a wrong angle has lost its full
    turns. Returns 31 possible headings of each box, a row for each choice."""
    # The lost full turns were 2 pi degrees (about 6.3) each; 15 such turns are about a quarter
    # turn, so 15 either way cover half a turn.
    lost_turns = np.arange(-15, 16)[:, None]  # a row for each choice
    angle_deg = np.mod(yaw, 2 * np.pi)[None] + 2 * np.pi * lost_turns
    return np.deg2rad(angle_deg)
