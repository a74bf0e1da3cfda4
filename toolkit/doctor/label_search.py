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


def find_explanation(views: Sequence[GroundView], current_fits: np.ndarray) -> Explanation | None:
    """Find the mistake whose undoing raises the fits most, None if none does.

    Explanations with a choice for each box (a sensor, a heading) must fit clearly better.

    Args:
        views: frames with their points above the ground.
        current_fits: fit of each box as it is, frame after frame."""

    def undo_in_frames(
        mistake: LabelMistake, list_frames: Callable[[Frame], Sequence[np.ndarray]]
    ) -> Explanation:
        """Explain labels by a mistake that was made in some frame of coordinates.

        list_frames: returns, for a frame of the recording, the motion frame_SE3_world to each
        frame of coordinates in which the mistake may have been made."""

        def choose(sample: Frame) -> list[np.ndarray]:
            """Boxes of the frame without the mistake, an array for each frame of coordinates."""
            return [
                undo_mistake(mistake, sample.objects.boxes, frame_SE3_world)
                for frame_SE3_world in list_frames(sample)
            ]

        return undo_each(mistake, views, choose)

    def list_sensor_frames(sample: Frame) -> list[np.ndarray]:
        # sensor_SE3_world of each cloud
        return [invert(cloud.world_SE3_sensor) for cloud in sample.clouds] or [np.eye(4)]

    axes_mistakes = [mistake for mistake in LABEL_MISTAKES if mistake.depends_on_axes]
    samples = [view.sample for view in views]
    # explanations that treat all boxes alike
    frame_explanations = [
        undo_each(other_frame.mistake, views, other_frame.choose)
        for other_frame in other_frames(samples)
    ]
    explanations = [undo_in_frames(mistake, lambda _: [np.eye(4)]) for mistake in LABEL_MISTAKES]
    if any(not np.allclose(sample.map_SE3_world, np.eye(4)) for sample in samples):
        explanations += [
            undo_in_frames(mistake, lambda sample: [sample.map_SE3_world])
            for mistake in axes_mistakes
        ]
    best_common = find_nearly_best([*explanations, *frame_explanations], current_fits)
    # explanations that choose a sensor for each box
    sensor_explanations = [undo_in_frames(mistake, list_sensor_frames) for mistake in axes_mistakes]
    best_by_sensor = find_nearly_best(sensor_explanations, current_fits, MIN_CHOICE_GAIN)
    best = choose_clearer(best_common, best_by_sensor, MIN_CHOICE_GAIN)
    if best is None:
        return None
    return choose_clearer(
        best, turn_each(views), MIN_TURN_GAIN if best is best_common else MIN_CHOICE_GAIN
    )


def turn_each(views: Sequence[GroundView]) -> Explanation:
    """Turn each box to the heading that fits best, as if degrees had been taken for radians.

    views: frames with their points above the ground."""

    def list_turned_boxes(sample: Frame) -> list[np.ndarray]:
        """Boxes of the frame with each of the possible headings."""
        boxes = sample.objects.boxes
        centres_and_sizes = boxes[:, :6]
        stored_yaw = boxes[:, 6]
        return [np.column_stack([centres_and_sizes, yaw]) for yaw in possible_headings(stored_yaw)]

    return undo_each(LOST_DEGREES, views, list_turned_boxes)
