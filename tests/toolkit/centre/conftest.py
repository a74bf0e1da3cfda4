"""Clock and messages of a centre that takes no time, and a small junction of two cameras."""

import socket
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Executor, Future
from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from toolkit.calibration.empty_scene import EmptyScene
from toolkit.calibration.place import Place, Stand
from toolkit.calibration.recording_scenes import LearntScene
from toolkit.centre.detection_pool import Detection, DetectionPool
from toolkit.centre.pace import PaceEvent
from toolkit.centre.packet_port import PacketPort
from toolkit.centre.running_centre import CentreEvent, CentreFrame, RunningCentre
from toolkit.centre.sensor_message import SensorMessage
from toolkit.centre.sensor_watch import FaultEvent, SensorWatch
from toolkit.centre.synchroniser import Synchroniser
from toolkit.frame import Frame
from toolkit.geometry import look
from toolkit.objects import Detections
from toolkit.sensors.models import DepthCamera
from toolkit.sensors.sensor import Sensor
from toolkit.sites.site import Site

INTERVAL_S = 0.1
MODEL = DepthCamera(width=80, height=60, stride=1)
SENSORS = {
    name: Sensor(name, MODEL, look((x, 0.0, 6.0), 0.0, 0.5))
    for name, x in (("a", -8.0), ("b", 0.0), ("c", 8.0))
}
EMPTY = np.full(MODEL.shape, 20.0, np.float32)
EMPTY[:10] = 0  # sky


class LevelPlace(Place):
    """Place whose ground is known to be level, so that no frame's ground is looked for."""

    def stands(
        self, frames: Iterable[Frame], site: Site | None = None
    ) -> Iterator[tuple[Frame, Stand]]:
        half_x, half_y = self.half
        area = np.array([-half_x, -half_y, half_x, half_y])
        for frame in frames:
            yield frame, Stand(area, self.find_middle(frame))


class ManualClock:
    """Clock that stands until it is moved."""

    speed = 1.0

    def __init__(self, time_s: float = 0.0, speed: float = 1.0) -> None:
        self.time_s = time_s
        self.speed = speed
        self._alarms: list[tuple[float, Callable[[], None]]] = []

    def now(self) -> float:
        return self.time_s

    def wait(self, time_s: float, stop: object) -> None:
        self.move(time_s)

    def ring(self, time_s: float, call: Callable[[], None]) -> None:
        """Call at a time."""
        self._alarms.append((time_s, call))
        self._alarms.sort(key=lambda alarm: alarm[0])

    def move(self, time_s: float) -> None:
        """Show a time that is not before the present one, or the time of an alarm before it."""
        if self._alarms:
            time_s = min(time_s, self._alarms[0][0])
        self.time_s = max(self.time_s, time_s)
        while self._alarms and self._alarms[0][0] <= self.time_s:
            self._alarms.pop(0)[1]()


class ManualThreads(Executor):
    """Threads whose work takes a time of a manual clock.

    detect_s: seconds that each detection takes, in the order of frames; the last one goes on."""

    def __init__(self, clock: ManualClock, detect_s: Sequence[float]) -> None:
        self._clock = clock
        self._detect_s = list(detect_s)

    def submit(self, detect, /, *arguments, **options):  # type: ignore[no-untyped-def]
        future = Future()
        detect_s = self._detect_s[0] / self._clock.speed
        if len(self._detect_s) > 1:
            self._detect_s.pop(0)
        try:
            result = detect(*arguments, **options)
        except ZeroDivisionError as error:
            finish = partial(future.set_exception, error)
        else:
            stand = replace(result.stand, ms=0.0)
            result = replace(result, stand=stand, detect_ms=1e3 * detect_s, fuse_ms=0.0)
            finish = partial(future.set_result, result)
        if detect_s:
            self._clock.ring(self._clock.time_s + detect_s * self._clock.speed, finish)
        else:
            finish()
        return future


class ScriptedSource:
    """Messages that arrive at their time on a manual clock, which a wait moves on."""

    def __init__(
        self, messages: Sequence[SensorMessage], clock: ManualClock, tail_s: float = 1.0
    ) -> None:
        self.drops: Counter[str] = Counter()
        self._messages = sorted(messages, key=lambda message: message.arrival_s)
        self._clock = clock
        self._end_s = self._messages[-1].arrival_s + tail_s

    def wake(self) -> None:
        """Nothing to do, as nobody waits on a manual clock."""

    def take(self, wait_s: float) -> list[SensorMessage] | None:
        if self._clock.time_s > self._end_s:
            return None
        next_s = self._messages[0].arrival_s if self._messages else np.inf
        self._clock.move(min(next_s, self._clock.time_s + wait_s * self._clock.speed))
        now = [m for m in self._messages if m.arrival_s <= self._clock.time_s + 1e-9]
        self._messages = self._messages[len(now) :]
        return now

    def rest(self, wait_s: float) -> None:
        self._clock.move(self._clock.time_s + wait_s * self._clock.speed)


def measure(name: str, k: int, image: np.ndarray = EMPTY, delay_s: float = 0.0) -> SensorMessage:
    """Message k of a camera, with its noise."""
    rng = np.random.default_rng([k, ord(name)])
    time_s = INTERVAL_S * k
    return SensorMessage(name, time_s, time_s + delay_s, MODEL.noisy(image, rng))


def nobody(points: np.ndarray) -> Detections:
    return Detections.empty()


class Run:
    """Frames and events of a centre over scripted messages.

    detect_s: seconds that a detection takes, of all frames or of one after the other; tail_s:
    seconds from the last message to the end of the source."""

    def __init__(
        self,
        messages: Sequence[SensorMessage],
        detector: Callable[[np.ndarray], Detections] = nobody,
        clock: ManualClock | None = None,
        patience_s: float = 0.05,
        detect_s: float | Sequence[float] = 0.0,
        tail_s: float = 1.0,
        deadline_s: float = 0.09,
        **detection: int,
    ) -> None:
        clock = clock or ManualClock()
        times_s = [detect_s] if isinstance(detect_s, int | float) else detect_s
        self.events: list[FaultEvent] = []
        self.pace_events: list[PaceEvent] = []
        scenes = {
            name: LearntScene(EmptyScene.from_render(sensor, EMPTY))
            for name, sensor in SENSORS.items()
        }
        self.written: list[float] = []
        self.synchroniser = Synchroniser(INTERVAL_S, patience_s)
        place = LevelPlace("none", area=(-20.0, -20.0, 20.0, 20.0))
        settings = Detection(detector, place, deadline_s=deadline_s, **detection)
        self.centre = RunningCentre(
            SENSORS,
            DetectionPool(settings, threads=ManualThreads(clock, times_s)),
            synchroniser=self.synchroniser,
            watch=SensorWatch(SENSORS, start_s=0.0, interval_s=INTERVAL_S, scenes=scenes),
            clock=clock,
            write=lambda instant: self.written.append(instant.time_s),
            tick=self._take_events,
        )
        source = ScriptedSource(messages, clock, tail_s)
        self.frames: list[CentreFrame] = list(self.centre.run(source))

    def _take_events(self, now_s: float, events: list[CentreEvent]) -> None:
        for event in events:
            if isinstance(event, FaultEvent):
                self.events.append(event)
            elif isinstance(event, PaceEvent):
                self.pace_events.append(event)

    def named(self) -> list[tuple[str, str | None, float]]:
        """Sensor, fault and time of each event before the source fell silent."""
        end_s = self.frames[-1].frame.time + 0.2
        return [
            (event.sensor, event.fault and event.fault.value, round(event.time_s, 3))
            for event in self.events
            if event.time_s < end_s
        ]


@pytest.fixture(scope="session")
def scripted():
    """Makes a run of a centre over messages."""
    return Run


@pytest.fixture(scope="session")
def message():
    """Makes message k of camera a, b or c."""
    return measure


@pytest.fixture(scope="session")
def manual_clock():
    """Clock that stands until it is moved."""
    return ManualClock


@pytest.fixture(scope="session")
def empty_image():
    """Image of each camera without road users."""
    return EMPTY


@pytest.fixture(scope="session")
def car():
    """Box of a standing car (a row)."""
    return np.array([[3.0, 1.0, 0.8, 4.5, 1.8, 1.6, 0.0]])


@pytest.fixture
def free_port():
    """UDP port of this machine that nobody listens at."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as port:
        port.bind(("127.0.0.1", 0))
        return PacketPort(port.getsockname()[1], "127.0.0.1", "127.0.0.1")
