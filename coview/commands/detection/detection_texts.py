"""Detections of KITTI's tracking text, to follow road users through them."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from coview.commands.detection.detections_in_order import (
    DetectionsInOrder,
    check_times,
    find_frame_time,
)
from coview.tracks import number_frames
from toolkit.calibration.place import Place

if TYPE_CHECKING:
    from toolkit.frame import Recording

_MAX_FRAMES = 1_000_000  # a day at 10 Hz; a higher number is damage, and takes all memory


def read_text_alone(path: Path, rate_hz: float | None, frames: int | None) -> DetectionsInOrder:
    """Read detections of a text, whose frames are numbered from 0.

    Args:
        path: The text.
        rate_hz: Frames in a second.
        frames: Number of first frames to use, None for all.

    Raises ValueError without a rate, as the text has no times, without detections, and for a frame
    number of 1,000,000 or more."""
    from toolkit.exchange.track_text import read_detection_text
    from toolkit.objects import Detections, Objects

    if rate_hz is None:
        raise ValueError(f"{path} has no times: give --rate, the number of frames in a second")
    detections_by_frame = read_detection_text(path)
    if not detections_by_frame:
        raise ValueError(f"{path} has no detections: give another file")
    last = max(detections_by_frame)
    if last >= _MAX_FRAMES:
        raise ValueError(f"{path} has frame {last}: number the frames from 0 to {_MAX_FRAMES - 1}")
    count = last + 1
    if frames is not None:
        count = min(count, frames)
    in_order = DetectionsInOrder()
    for number in range(count):
        detections = detections_by_frame.get(number, Detections.empty())
        in_order.add(f"{number:06d}", number / rate_hz, detections, Objects.empty())
    check_times(in_order.times)
    return in_order


@dataclass(frozen=True)
class DetectionText:
    """Text of detections in the frames of a recording.

    Attributes:
        path: The text.
        place: Area of the detections.
        sequence: KITTI's sequence whose camera the boxes are in and whose frames are named by their
            numbers, None for a recording in the frame that coview writes.
        rate_hz: Frames in a second of a recording without times, None for its times."""

    path: Path
    place: Place
    sequence: Path | None
    rate_hz: float | None

    def read(self, opened: "Recording", frames: int | None) -> DetectionsInOrder:
        """Read the detections of the first frames of a recording.

        frames: number of first frames, None for all. Raises ValueError for detections in frames
        that the recording does not have, and for times that cannot be followed."""
        from toolkit.datasets.layouts.kitti_sequences import find_camera
        from toolkit.datasets.recording_views import Part
        from toolkit.exchange.track_text import read_detection_text
        from toolkit.geometry import BODY_SE3_CAMERA
        from toolkit.objects import Detections

        camera = BODY_SE3_CAMERA if self.sequence is None else find_camera(self.sequence)
        detections_by_frame = read_detection_text(self.path, camera)
        samples = Part(number_frames(opened, self.sequence), frames)
        in_order = DetectionsInOrder(area=self._find_area(opened))
        numbers = []
        for k in range(len(samples)):
            frame = samples[k]
            numbers.append(frame.index)
            time = find_frame_time(k, frame.time, self.rate_hz)
            detections = detections_by_frame.get(frame.index, Detections.empty())
            in_order.add(frame.name, time, detections, frame.objects)
        self._check_numbers(
            numbers, sorted(detections_by_frame), is_part=len(samples) < len(opened)
        )
        check_times(in_order.times)
        return in_order

    def _find_area(self, opened: "Recording") -> list[float] | None:
        """Border of the detections in a recording, None if unknown."""
        if opened.site is not None and self.place.uses_site(opened.site):
            return [float(edge) for edge in opened.site.area]
        return None if self.place.area is None else list(self.place.area)

    def _check_numbers(
        self, numbers: Sequence[int], text_numbers: Sequence[int], *, is_part: bool
    ) -> None:
        """Raise ValueError for frames of the text that the recording does not have.

        numbers: frames of the recording; text_numbers: frames of the text; is_part: True if the
        recording goes on."""
        # frames after the last one that was read may be in the recording's rest
        unknown_numbers = [number for number in text_numbers if number not in numbers]
        if unknown_numbers and not (is_part and unknown_numbers[0] > numbers[-1]):
            raise ValueError(
                f"{self.path} has frame {unknown_numbers[0]}, which is not among the recording's "
                f"{len(numbers)} frames from {numbers[0]} to {numbers[-1]}: are both of one "
                "recording?"
            )
