"""The classic mistakes of boxes, each with what undoes it, in the frame in which it may have been made.

A file whose boxes are in a map, or in a sensor's frame, has its mistakes there: what mirrors y of a map moves boxes far
away in the frame of a vehicle. So those that depend on the axes are undone in the world's frame, in the map's, and in
that of each sensor.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from toolkit.arrays import Float64
from toolkit.geometry import invert, transform

Change = Callable[[np.ndarray], np.ndarray]


@dataclass(frozen=True)
class LabelMistake:
    """What may be wrong with boxes, (n, 7), and how it is undone; axes: whether it depends on the frame's axes."""

    name: str
    remedy: str
    undo: Change
    axes: bool = False


def _changed(**columns: Callable[[np.ndarray], np.ndarray]) -> Change:
    places = {name: k for k, name in enumerate(("x", "y", "z", "length", "width", "height", "yaw"))}

    def undo(boxes: np.ndarray) -> np.ndarray:
        made = boxes.copy()
        for name, column in columns.items():
            made[:, places[name]] = column(boxes)
        return made

    return undo


def _sized(factor: float) -> Change:
    sizes = (("length", 3), ("width", 4), ("height", 5))
    return _changed(**{name: lambda boxes, k=k: boxes[:, k] * factor for name, k in sizes})


YAW_SIGN = LabelMistake("yaw counted the other way round", "negate yaw", _changed(yaw=lambda b: -b[:, 6]), axes=True)

LOST_DEGREES = LabelMistake(  # of which undo knows nothing: `degrees_of_turns` says what is left of them
    "yaw in degrees where radians belong, of which only sine and cosine are left",
    "multiply yaw by pi / 180 before its sine and cosine are taken", lambda boxes: boxes,
)  # fmt: skip

LABEL_MISTAKES = (
    LabelMistake(
        "mirrored: y points the other way", "negate y and yaw",
        _changed(y=lambda b: -b[:, 1], yaw=lambda b: -b[:, 6]), axes=True,
    ),
    LabelMistake(
        "mirrored: x points the other way", "negate x, and take 180 degrees minus yaw",
        _changed(x=lambda b: -b[:, 0], yaw=lambda b: np.pi - b[:, 6]), axes=True,
    ),
    LabelMistake("y of the positions alone negated", "negate y", _changed(y=lambda b: -b[:, 1]), axes=True),
    LabelMistake(
        "x and y swapped", "swap x and y, and take 90 degrees minus yaw",
        _changed(x=lambda b: b[:, 1], y=lambda b: b[:, 0], yaw=lambda b: np.pi / 2 - b[:, 6]), axes=True,
    ),
    LabelMistake("half extents where full ones belong: the boxes are half as large", "double the sizes", _sized(2.0)),
    LabelMistake("doubled extents: the boxes are twice as large", "halve the sizes", _sized(0.5)),
    LabelMistake(
        "length and width swapped, or yaw a quarter turn off", "swap length and width, or add 90 degrees to yaw",
        _changed(length=lambda b: b[:, 4], width=lambda b: b[:, 3]),
    ),
    YAW_SIGN,
    LabelMistake(
        "yaw in radians where degrees belong", "multiply yaw by 180 / pi",
        _changed(yaw=lambda b: np.rad2deg(b[:, 6])), axes=True,
    ),
)  # fmt: skip


def undone_in(
    mistake: LabelMistake, boxes: Float64[np.ndarray, "n 7"], frame_SE3_world: Float64[np.ndarray, "4 4"]
) -> Float64[np.ndarray, "n 7"]:
    """Boxes of the world frame without a mistake that was made in another, whose z is up as well."""
    if np.array_equal(frame_SE3_world, np.eye(4)):
        return mistake.undo(boxes)
    return boxes_through(mistake.undo(boxes_through(boxes, frame_SE3_world)), invert(frame_SE3_world))


def boxes_through(boxes: Float64[np.ndarray, "n 7"], motion: Float64[np.ndarray, "4 4"]) -> Float64[np.ndarray, "n 7"]:
    """Boxes in another frame, whose z is up as well.

    >>> boxes_through(np.array([[1.0, 2, 3, 4, 2, 1, 0.5]]), np.diag([-1.0, -1, 1, 1])).round(3).tolist()
    [[-1.0, -2.0, 3.0, 4.0, 2.0, 1.0, -2.642]]
    """
    headings = np.column_stack([np.cos(boxes[:, 6]), np.sin(boxes[:, 6]), np.zeros(len(boxes))]) @ motion[:3, :3].T
    yaw = np.arctan2(headings[:, 1], headings[:, 0])
    return np.column_stack([transform(motion, boxes[:, :3]), boxes[:, 3:6], yaw])


def degrees_of_turns(yaw: Float64[np.ndarray, " n"]) -> Float64[np.ndarray, "k n"]:
    """All headings (rad, half a turn alike) that, in degrees and taken for radians, point where `yaw` does.

    A file that stores sine and cosine, or a quaternion, of a wrong angle has lost its full turns.

    >>> yaw = np.deg2rad(np.array([30.0]))
    >>> bool(np.any(np.abs(degrees_of_turns(np.array([30.0])) - yaw) < 1e-9))
    True
    """
    turns = np.arange(-15, 16)[:, None]  # of 2 pi "degrees" each: a quarter turn either way
    return np.deg2rad(np.mod(yaw, 2 * np.pi)[None] + 2 * np.pi * turns)
