"""Recordings of any layout as an input that is replayed at its pace."""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from threading import Event

import numpy as np

from toolkit.centre.sensor_message import SensorMessage, list_messages
from toolkit.frame import Frame, Frames
from toolkit.sensors.sensor import Sensor

_FIRST_FRAMES = 20  # from which the interval and the sensors are known


@dataclass(frozen=True, eq=False)
class RecordingInput:
    """Recording whose frames arrive at their times.

    recording: frames in the order of time, from sensors that do not move. Raises ValueError for no
    frames, and for frames without times or out of order among the first ones."""

    recording: Frames
    is_live = False

    def __post_init__(self) -> None:
        """Raise ValueError for a recording of one frame, and for times that do not rise."""
        if len(self.recording) < 2:
            raise ValueError(f"a replay needs 2 frames or more, got {len(self.recording)}")
        times = [frame.time for frame in self._first_frames]
        if not (np.diff(times) > 0).all():
            raise ValueError(
                "a replay needs frames in the order of time, got "
                f"{', '.join(f'{time:g}' for time in times[:5])} s: name the clouds by their times"
            )

    @cached_property
    def _first_frames(self) -> list[Frame]:
        """First frames of the recording."""
        return [self.recording[k] for k in range(min(_FIRST_FRAMES, len(self.recording)))]

    @property
    def interval_s(self) -> float:
        """Median time between frames (s)."""
        return float(np.median(np.diff([frame.time for frame in self._first_frames])))

    @property
    def spread_s(self) -> float:
        """Longest time from the first to the last message of a frame (s)."""
        spreads = []
        for frame in self._first_frames:
            times = [message.time_s for message in list_messages(frame)]
            spreads.append(max(times) - min(times) if times else 0.0)
        return max(spreads)

    @property
    def sensors(self) -> tuple[Sensor, ...]:
        """Sensors of the first frames, by their first appearance."""
        sensors = {
            sensor.name: sensor
            for frame in reversed(self._first_frames)
            for sensor in frame.sensors
        }
        return tuple(sensors.values())

    def messages(self, stop: Event) -> Iterator[SensorMessage]:
        """Yield the messages of all frames."""
        for number in range(len(self.recording)):
            if stop.is_set():
                return
            yield from list_messages(self.recording[number])

    def __getstate__(self) -> dict[str, object]:
        return {"recording": self.recording}  # another process reads the frames again
