"""`SensorMessage`: measurement of one sensor, as the centre receives it."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from threading import Event
from typing import Protocol

import numpy as np

from toolkit.arrays import Pose
from toolkit.frame import Frame, Image, SensorCloud
from toolkit.sensors.sensor import Sensor


@dataclass(frozen=True, eq=False)
class SensorMessage:
    """Measurement of one sensor.

    Attributes:
        sensor: Name of the sensor.
        time_s: Time of its last point on the centre's clock (s).
        arrival_s: Time at which it reaches the centre (s).
        measurement: Image or cloud; a cloud's points have times from `time_s` back if known.
    """

    sensor: str
    time_s: float
    arrival_s: float
    measurement: Image | SensorCloud


class SensorInput(Protocol):
    """Source of messages: a recording, a simulated junction or a network port.

    It can be pickled, so that another process may read it."""

    @property
    def sensors(self) -> tuple[Sensor, ...]:
        """Sensors that send messages, at their poses."""

    @property
    def is_live(self) -> bool:
        """True if messages come at their time, False if the centre's clock must wait for it."""

    def messages(self, stop: Event) -> Iterator[SensorMessage]:
        """Yield messages in the order of their arrival, until `stop` is set."""


def list_messages(frame: Frame) -> list[SensorMessage]:
    """List the messages of a recorded frame in the order of their arrival.

    Each arrives at the time of its last point: a cloud's stamp and the time of its points, else the
    time of the frame. Raises ValueError for a frame without time."""
    messages = []
    for sensor, measurement in zip(frame.sensors, frame.measurements, strict=True):
        time_s = frame.time
        if isinstance(measurement, SensorCloud):
            if measurement.stamp_s is not None:
                time_s = measurement.stamp_s
            if measurement.time is not None and len(measurement.time):
                time_s += float(measurement.time.max())
        if not np.isfinite(time_s):
            raise ValueError(
                f"a replay needs the time of every frame, frame {frame.name or frame.index} has "
                "no time: name the clouds by their times"
            )
        messages.append(
            SensorMessage(
                sensor=sensor.name, time_s=time_s, arrival_s=time_s, measurement=measurement
            )
        )
    return sorted(messages, key=lambda message: message.arrival_s)


@dataclass(frozen=True, eq=False)
class SensorSetup:
    """Facts about a sensor that its input does not know, or knows wrongly.

    Attributes:
        pose: World_SE3_sensor, None for the pose of the input.
        clock_offset_s: Seconds by which the sensor's clock is ahead of the centre's.
    """

    pose: Pose | None = None
    clock_offset_s: float = 0.0

    def place(self, sensor: Sensor) -> Sensor:
        """Return a sensor at its pose."""
        return sensor if self.pose is None else Sensor(sensor.name, sensor.model, self.pose)

    def correct(self, message: SensorMessage) -> SensorMessage:
        """Return a message on the centre's clock, with its cloud at the sensor's pose."""
        measurement = message.measurement
        if self.pose is not None and isinstance(measurement, SensorCloud):
            measurement = replace(measurement.in_own_frame(), world_SE3_sensor=self.pose)
        time_s = message.time_s - self.clock_offset_s
        return replace(message, time_s=time_s, measurement=measurement)


def name_sensors(inputs: Sequence[SensorInput]) -> dict[str, Sensor]:
    """Return the sensors of all inputs by name. Raises ValueError for a name used twice."""
    sensors: dict[str, Sensor] = {}
    for source in inputs:
        for sensor in source.sensors:
            if sensor.name in sensors:
                raise ValueError(
                    f"two sensors have the name {sensor.name!r}: give each a different one"
                )
            sensors[sensor.name] = sensor
    return sensors
