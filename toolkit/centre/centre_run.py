"""Run of a centre: inputs started, frames worked on, faults reported, health written, all ended."""

from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from threading import Event
from typing import Any

from toolkit.calibration.recording_scenes import LearntScene
from toolkit.centre.centre_config import OutputConfig
from toolkit.centre.detection_pool import Detection, DetectionPool
from toolkit.centre.health import HealthLog
from toolkit.centre.input_process import read_in_process
from toolkit.centre.input_pumps import InputPumps, Reader
from toolkit.centre.message_queue import MessageQueue
from toolkit.centre.pace import LagEvent
from toolkit.centre.running_centre import CentreEvent, CentreFrame, RunningCentre
from toolkit.centre.sensor_message import SensorInput, SensorSetup, name_sensors
from toolkit.centre.sensor_watch import SensorWatch
from toolkit.centre.synchroniser import Synchroniser
from toolkit.centre.turn_watch import TurnFinder, TurnProcess, TurnWatch
from toolkit.exchange.instant import Instant
from toolkit.frame import Frame
from toolkit.sensors.sensor import Sensor
from toolkit.tracking.tracker import Tracker

_WARM_UPS = 2  # the first detection loads, the second one is as fast as any
PATIENCE_SHARE = 0.5  # share of the interval to wait for a sensor that should have sent


@dataclass(frozen=True)
class CentreParts:
    """Parts of a centre.

    Attributes:
        inputs: Sources of messages.
        detection: Detector and place.
        interval_s: Time from a sensor's measurement to its next (s).
        spread_s: Time from the first to the last measurement of sensors of one moment (s).
        setups: Poses and clock offsets by sensor.
        scenes: Empty scenes by sensor.
        output: Files of tracks.
        speed: Seconds of a replay in a second.
        sample: Frame to try detector and writers with before the clock starts, None for none.
        read: Reader of inputs that are not live.
    """

    inputs: Sequence[SensorInput]
    detection: Detection
    interval_s: float
    spread_s: float = 0.0
    setups: Mapping[str, SensorSetup] = field(default_factory=dict)
    scenes: Mapping[str, LearntScene] = field(default_factory=dict)
    output: OutputConfig = field(default_factory=OutputConfig)
    speed: float = 1.0
    sample: Frame | None = None
    read: Reader = read_in_process

    def place_sensors(self) -> dict[str, Sensor]:
        """Return the sensors of all inputs at their poses, by name.

        Raises ValueError for a name that two sensors have, and for a setup or an empty scene
        without a sensor."""
        sensors = name_sensors(self.inputs)
        for name in (*self.setups, *self.scenes):
            if name not in sensors:
                raise ValueError(
                    f"there is no sensor {name!r}: the inputs have {', '.join(sensors)}"
                )
        return {
            name: self.setups[name].place(sensor) if name in self.setups else sensor
            for name, sensor in sensors.items()
        }

    def make_synchroniser(self) -> Synchroniser:
        """Make the synchroniser of the inputs' messages."""
        patience_s = self.spread_s + PATIENCE_SHARE * self.interval_s
        return Synchroniser(self.interval_s, patience_s)

    def make_watch(
        self, sensors: Mapping[str, Sensor], start_s: float, finder: TurnFinder
    ) -> SensorWatch:
        """Make the watch over the sensors; start_s: time from which they should send (s)."""
        scenes = {name: learnt.scene for name, learnt in self.scenes.items()}
        return SensorWatch(
            sensors,
            start_s=start_s,
            interval_s=self.interval_s,
            scenes=self.scenes,
            turn_watch=TurnWatch(sensors, scenes, finder),
        )


def run_centre(
    parts: CentreParts,
    health: HealthLog,
    stop: Event,
    *,
    seconds: float | None = None,
    show: Callable[[CentreFrame], None] = lambda frame: None,
    report: Callable[[CentreEvent], None] = lambda event: None,
) -> dict[str, Any]:
    """Run a centre until its inputs end, `stop` is set or some seconds have passed.

    Args:
        parts: Parts of the centre.
        health: Log of its state.
        stop: Ends the run after the frame that it works on.
        seconds: Longest time of the sensors that it runs, None for no limit.
        show: Called with each frame.
        report: Called with each fault that begins or ends, and when the centre is too slow.

    Returns the figures of the run. Raises the errors of inputs, detector and writers, after the
    files are complete."""
    sensors = parts.place_sensors()
    queue = MessageQueue(stop)
    pumps = InputPumps(parts.inputs, parts.setups, queue, stop, speed=parts.speed, read=parts.read)
    with ExitStack() as stack:
        stack.callback(health.close)
        writer = parts.output.make_writer()
        stack.callback(writer.close)
        turn_process = TurnProcess()
        stack.callback(turn_process.close)
        stack.callback(pumps.stop)
        stack.callback(stop.set)
        warm_up(parts)
        pool = DetectionPool(parts.detection, queue.wake)
        stack.callback(pool.close)
        clock = pumps.start()
        start_s = clock.now()
        watch = parts.make_watch(sensors, start_s, turn_process)
        lag_watch = _LagWatch(pumps)

        def tick(now_s: float, events: list[CentreEvent]) -> None:
            """Report events, write health if it is due, and stop the run when its time is over.

            now_s: time of the sensors (s)."""
            for event in (*events, *lag_watch.look(now_s)):
                health.add_event(event)
                report(event)
            health.write_line(now_s, watch.faults, centre.count_left_out(queue))
            if seconds is not None and now_s - start_s >= seconds:
                stop.set()

        centre = RunningCentre(
            sensors,
            pool,
            synchroniser=parts.make_synchroniser(),
            watch=watch,
            clock=clock,
            write=writer.write,
            tick=tick,
            with_clouds=parts.output.clouds and writer.takes_clouds,
        )
        for frame in centre.run(queue):
            health.add(frame)
            show(frame)
        pumps.check()
        left_out = centre.count_left_out(queue)
        health.write_line(clock.now(), watch.faults, left_out, is_last=True)
    set_back_s = round(pumps.set_back_s, 3)
    return health.summarise() | left_out.as_dict() | {"set_back_s": set_back_s}


class _LagWatch:
    """Watch over the clock of a replay, which is set back if the inputs are too slow.

    pumps: inputs of the centre."""

    def __init__(self, pumps: InputPumps) -> None:
        """Begin with a clock that was never set back."""
        self._pumps = pumps
        self._reported_s = 0.0

    def look(self, now_s: float) -> list[LagEvent]:
        """Return an event when the clock was first set back, and whenever the sum has doubled.

        now_s: time of the clock (s)."""
        set_back_s = self._pumps.set_back_s  # in all since the start
        if set_back_s < 2 * self._reported_s or not set_back_s:
            return []
        self._reported_s = set_back_s
        return [LagEvent(now_s, set_back_s)]


def warm_up(parts: CentreParts) -> None:
    """Detect and track in the sample, and write it to a temporary folder.

    So the first frames do not wait for packages to load. Raises the errors of all."""
    if parts.sample is None:
        return
    tracker = Tracker()
    for number, result in enumerate(parts.detection.detect([parts.sample] * _WARM_UPS)):
        tracks = tracker.update(result.detections, float(number))
        instant = Instant.from_tracks(float(number), tracks, result.frame.clouds)
    with TemporaryDirectory() as folder:
        folders = {name: Path(folder) / name for name in parts.output.folders}
        writer = replace(parts.output, folders=folders).make_writer()
        writer.write(instant)
        writer.close()
