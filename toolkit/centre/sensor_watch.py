"""Watch over the sensors of a running centre: who is silent, late, frozen, blind or turned.

A sensor is silent if it has sent nothing for a while, and late if what arrives is old. Both show
without its contents, and end when a message arrives in time. Contents are read by `SensorMonitor`
for sensors with an empty scene, and by `TurnWatch` if one is given."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from toolkit.calibration.cloud_image import rasterize_cloud
from toolkit.calibration.recording_scenes import LearntScene
from toolkit.centre.sensor_message import SensorMessage
from toolkit.centre.sensor_monitor import Fault, SensorMonitor, Shown
from toolkit.centre.turn_watch import TurnWatch
from toolkit.frame import Image, SensorCloud
from toolkit.sensors.sensor import Sensor

SILENT_AFTER_S = 0.35  # without a message
LATE_AFTER_S = 0.15  # from a measurement, or from when one is due, to its arrival
_NEVER_S = 1e9  # the monitor itself leaves silence to the watch


@dataclass(frozen=True)
class FaultEvent:
    """Beginning or end of a sensor's fault.

    Attributes:
        time_s: Time at which it was noticed (s).
        sensor: Name of the sensor.
        fault: Fault that it has now, None if it works again.
    """

    time_s: float
    sensor: str
    fault: Fault | None

    def as_dict(self) -> dict[str, object]:
        """Return the event as plain values; fault is None if the sensor works again."""
        fault = None if self.fault is None else self.fault.value
        return {"time_s": round(self.time_s, 3), "sensor": self.sensor, "fault": fault}

    def __str__(self) -> str:
        state = "works again" if self.fault is None else f"is {self.fault.value}"
        return f"{self.time_s:.2f} s: sensor {self.sensor} {state}"


class _WatchedSensor:
    """One sensor: when it was heard, and what its contents show.

    start_s: time from which it should send (s); interval_s: time from one measurement to the next;
    learnt: its empty scene, None to watch its times only."""

    def __init__(self, start_s: float, interval_s: float, learnt: LearntScene | None) -> None:
        """Begin without messages.

        start_s: time from which it should send (s); interval_s: time between measurements (s);
        learnt: its empty scene, None to watch its times only."""
        self._late_after_s = interval_s + LATE_AFTER_S
        self._silent_after_s = max(SILENT_AFTER_S, interval_s + LATE_AFTER_S)
        self._arrival_s = start_s
        self._newest_s = start_s  # time of the newest measurement
        self._delay_s = 0.0  # from the newest measurement to its arrival
        self._is_overdue = False  # at the last look
        self._content_fault: Fault | None = None
        self._learnt = learnt
        self._monitor: SensorMonitor | None = None
        if learnt is not None:
            self._monitor = SensorMonitor(learnt.scene, start=start_s, silent_after=_NEVER_S)

    def hear(self, message: SensorMessage) -> None:
        """Note when a message was measured and arrived."""
        self._arrival_s = max(self._arrival_s, message.arrival_s)
        if message.time_s > self._newest_s:
            self._newest_s = message.time_s
            self._delay_s = message.arrival_s - message.time_s

    def read(self, message: SensorMessage, turn_watch: TurnWatch | None) -> None:
        """Read the contents of a message."""
        if self._monitor is None:
            return
        image = self._make_image(message.measurement)
        self._content_fault = self._monitor.look(message.time_s, Shown(message.time_s, image))
        if self._content_fault is not None or turn_watch is None:
            return
        if turn_watch.look(message.sensor, image, message.time_s):
            self._content_fault = Fault.SHIFTED

    def find_fault(self, now_s: float) -> Fault | None:
        """Return the fault at a time (s), None without one.

        Times do not go back from call to call."""
        is_silent = now_s - self._arrival_s > self._silent_after_s
        is_late = now_s - self._newest_s > self._late_after_s
        # a delayed message ends neither: the next one will be overdue too
        is_delayed = self._is_overdue and self._delay_s > LATE_AFTER_S
        self._is_overdue = is_silent or is_late or is_delayed
        if is_silent:
            return Fault.SILENT
        return Fault.LATE if self._is_overdue else self._content_fault

    def _make_image(self, measurement: Image | SensorCloud) -> Image:
        """Return a measurement as an image, a cloud in the grid of its scene."""
        if isinstance(measurement, np.ndarray):
            return np.asarray(measurement, np.float32)
        assert self._learnt is not None
        assert self._learnt.grid is not None
        return rasterize_cloud(measurement, self._learnt.grid).measurement


class SensorWatch:
    """Watch over all sensors of a centre.

    Args:
        sensors: Sensors by name.
        start_s: Time from which they should send (s).
        interval_s: Time from one measurement of a sensor to its next (s).
        scenes: Empty scenes by sensor; a sensor without one is watched by its times only.
        turn_watch: Finds sensors that were turned a little, None to leave that out.

    Attributes:
        faults: Present faults by sensor, without those that work.
    """

    def __init__(
        self,
        sensors: Mapping[str, Sensor],
        *,
        start_s: float,
        interval_s: float,
        scenes: Mapping[str, LearntScene] | None = None,
        turn_watch: TurnWatch | None = None,
    ) -> None:
        """Begin without faults.

        sensors: by name; start_s: time from which messages are expected (s); interval_s: time
        between two frames (s); scenes: what was learnt of each sensor's empty scene; turn_watch:
        registers the sensors to find those that were turned, None to leave that out."""
        scenes = scenes or {}
        self.faults: dict[str, Fault] = {}
        self._turn_watch = turn_watch
        self._sensors = {
            name: _WatchedSensor(start_s, interval_s, scenes.get(name)) for name in sensors
        }

    @property
    def in_time(self) -> list[str]:
        """Names of the sensors whose messages are waited for."""
        return [
            name
            for name in self._sensors
            if self.faults.get(name) not in (Fault.SILENT, Fault.LATE)
        ]

    def hear(self, message: SensorMessage) -> None:
        """Note when a message was measured and arrived."""
        self._sensors[message.sensor].hear(message)

    def read(self, message: SensorMessage) -> None:
        """Read the contents of a message."""
        self._sensors[message.sensor].read(message, self._turn_watch)

    def look(self, now_s: float) -> list[FaultEvent]:
        """Return the faults that began or ended since the last look."""
        events = []
        for name, sensor in self._sensors.items():
            fault = sensor.find_fault(now_s)
            if fault == self.faults.get(name):
                continue
            events.append(FaultEvent(now_s, name, fault))
            if fault is None:
                del self.faults[name]
            else:
                self.faults[name] = fault
        return events
