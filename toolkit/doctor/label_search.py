"""Search for the mistake whose undoing makes labels fit best."""

from collections.abc import Callable, Sequence

import numpy as np

from toolkit.doctor.box_fits import GroundView
from toolkit.doctor.explanations import (
    MIN_CHOICE_GAIN,
    Explanation,
    choose_clearer,
    find_nearly_best,
    undo_each,
)
from toolkit.doctor.label_frames import other_frames
from toolkit.doctor.label_mistake import LabelMistake, possible_headings, undo_mistake
from toolkit.doctor.label_mistakes import LABEL_MISTAKES, LOST_DEGREES
from toolkit.frame import Frame
from toolkit.geometry import invert

# least gain in mean fit by explanations that turn each box freely, since chance helps them
MIN_TURN_GAIN = 0.15


def find_explanation(views: Sequence[GroundView], current: np.ndarray) -> Explanation | None:
    """Find the mistake whose undoing raises the fits most, None if none does.

    Explanations with a choice for each box (a sensor, a heading) must fit clearly better.

    Args:
        views: frames with their points above the ground.
        current: fit of each box as it is, frame after frame."""

    def undo(mistake: LabelMistake, frames: Callable[[Frame], Sequence[np.ndarray]]) -> Explanation:
        # `frames` gives, for a frame of the recording, motions frame_SE3_world to the frames of
        # coordinates in which the mistake may have been made: one choice for each
        def choose(sample: Frame) -> list[np.ndarray]:
            return [undo_mistake(mistake, sample.objects.boxes, frame) for frame in frames(sample)]

        return undo_each(mistake, views, choose)

    def in_sensors(sample: Frame) -> list[np.ndarray]:
        # sensor_SE3_world of each cloud
        return [invert(cloud.world_SE3_sensor) for cloud in sample.clouds] or [np.eye(4)]

    in_axes = [mistake for mistake in LABEL_MISTAKES if mistake.axes]
    samples = [view.sample for view in views]
    frames = [
        undo_each(other_frame.mistake, views, other_frame.choose)
        for other_frame in other_frames(samples)
    ]
    attempts = [undo(mistake, lambda _: [np.eye(4)]) for mistake in LABEL_MISTAKES]
    if any(not np.allclose(view.sample.map_SE3_world, np.eye(4)) for view in views):
        attempts += [undo(mistake, lambda sample: [sample.map_SE3_world]) for mistake in in_axes]
    # plain: without a choice for each box
    plain = find_nearly_best([*attempts, *frames], current)
    by_sensor = [undo(mistake, in_sensors) for mistake in in_axes]
    chosen_sensor = find_nearly_best(by_sensor, current, MIN_CHOICE_GAIN)
    best = choose_clearer(plain, chosen_sensor, MIN_CHOICE_GAIN)
    if best is None:
        return None
    return choose_clearer(
        best, turn_each(views), MIN_TURN_GAIN if best is plain else MIN_CHOICE_GAIN
    )


def turn_each(views: Sequence[GroundView]) -> Explanation:
    """Turn each box to the heading that fits best, as if degrees had been taken for radians.

    views: frames with their points above the ground."""

    def turn(sample: Frame) -> list[np.ndarray]:
        # the frame's boxes with each of the possible headings
        boxes = sample.objects.boxes
        without_yaw = boxes[:, :6]
        stored_yaw = boxes[:, 6]
        return [np.column_stack([without_yaw, yaw]) for yaw in possible_headings(stored_yaw)]

    return undo_each(LOST_DEGREES, views, turn)
