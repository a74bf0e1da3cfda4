"""`RunningCentre`: messages of sensors in; fused, detected, tracked and written frames out.

Every frame is fused from the messages of one moment (`toolkit.centre.synchroniser`), its points are
moved to one time (`toolkit.centre.sweep_motion`), road users are detected and tracked, and the
tracks are written. A centre that is too slow for that detects less often and predicts the tracks
between (`toolkit.centre.pace`). When frames still come faster than they can be worked on, the
oldest that wait are dropped and counted, so that what comes out stays new."""

from collections import deque
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from concurrent.futures import Future
from contextlib import closing
from dataclasses import dataclass
from time import perf_counter

import numpy as np

from toolkit.centre.clock import Clock
from toolkit.centre.detection_pool import Detection, DetectionPool
from toolkit.centre.message_queue import MessageSource
from toolkit.centre.pace import LagEvent, PaceEvent, PaceKeeper
from toolkit.centre.sensor_message import SensorMessage
from toolkit.centre.sensor_monitor import Fault
from toolkit.centre.sensor_watch import FaultEvent, SensorWatch
from toolkit.centre.sweep_motion import move_to_frame
from toolkit.centre.synchroniser import MessageGroup, Synchroniser
from toolkit.detection.detect import FrameDetections
from toolkit.exchange.instant import Instant
from toolkit.frame import Frame
from toolkit.objects import Detections, Objects
from toolkit.sensors.sensor import Sensor
from toolkit.tracking.tracker import Tracker
from toolkit.tracking.tracks import Tracks

MAX_WAITING_FRAMES = 2
MAX_PAUSE_S = 0.02  # longest wait for a message before the watch looks again
CentreEvent = FaultEvent | PaceEvent | LagEvent


@dataclass(frozen=True, eq=False)
class CentreFrame:
    """Frame as the centre gives it out.

    Attributes:
        frame: Measurements, all at `Frame.time`.
        detections: Detections, world frame; None if the tracks are predicted.
        tracks: Tracks after them.
        faults: Faults of sensors by name.
        stage_ms: Milliseconds of each stage: wait, fuse, level, detect, track, write; without
            level and detect if the tracks are predicted.
        latency_ms: Milliseconds from the last point to the written tracks.
    """

    frame: Frame
    detections: Detections | None
    tracks: Tracks
    faults: Mapping[str, Fault]
    stage_ms: Mapping[str, float]
    latency_ms: float


@dataclass(frozen=True)
class LeftOut:
    """Numbers of what the centre left out since it started.

    Attributes:
        frames: Frames that were dropped because later ones waited.
        messages: Messages that a full queue dropped, by sensor.
        late: Messages whose frame was out already, by sensor.
        predicted: Frames that came out without detection, with predicted tracks.
    """

    frames: int
    messages: Mapping[str, int]
    late: Mapping[str, int]
    predicted: int = 0

    def as_dict(self) -> dict[str, object]:
        """Return the numbers as plain values."""
        return {
            "dropped_frames": self.frames,
            "predicted_frames": self.predicted,
            "dropped_messages": dict(self.messages),
            "late_messages": dict(self.late),
        }


class RunningCentre:
    """Centre that works on messages until they end.

    Args:
        sensors: Sensors by name, at their poses.
        detection: Detector and place.
        synchroniser: Groups messages by time.
        watch: Names sensors that fail.
        clock: Time of the sensors.
        write: Called with the tracks of each frame.
        tick: Called with the time and new events, many times a second.
        with_clouds: True to pass clouds to `write`, too.

    Attributes:
        dropped_frames: Number of frames that were dropped because later ones waited.
        predicted_frames: Number of frames that came out with predicted tracks.
    """

    def __init__(
        self,
        sensors: Mapping[str, Sensor],
        detection: Detection,
        *,
        synchroniser: Synchroniser,
        watch: SensorWatch,
        clock: Clock,
        write: Callable[[Instant], None] = lambda instant: None,
        tick: Callable[[float, list[CentreEvent]], None] = lambda now_s, events: None,
        with_clouds: bool = False,
    ) -> None:
        """Begin without messages and tracks.

        write: called with each instant; tick: called with the time (s) and what happened since;
        with_clouds: True to pass clouds to `write`."""
        self.dropped_frames = 0
        self.predicted_frames = 0
        self._sensors = sensors
        self._detection = detection
        self._synchroniser = synchroniser
        self._watch = watch
        self._clock = clock
        self._write = write
        self._tick = tick
        self._with_clouds = with_clouds
        self._pace = PaceKeeper(
            synchroniser.interval_s, detection.detect_every, parallel=detection.parallel
        )
        self._pace_events: list[PaceEvent] = []  # since the last tick
        self._tracker = Tracker()
        self._has_area = False  # whether the tracker knows the area of detection
        self._last_time_s = -np.inf  # time of the last frame
        self._number = 0  # number of the next frame
        self._waiting: deque[MessageGroup] = deque()
        self._in_work: deque[_FrameInWork] = deque()

    def run(self, source: MessageSource) -> Iterator[CentreFrame]:
        """Yield the frames of a source's messages as they are done.

        Raises the errors of the detector and the writers."""
        with closing(DetectionPool(self._detection, source.wake)) as pool:
            while (messages := source.take(0.0 if self._can_begin() else MAX_PAUSE_S)) is not None:
                self._hear(messages)
                self._begin_frames(pool)
                while self._in_work and self._in_work[0].is_done():
                    yield from self._finish_first()
            self._waiting += self._synchroniser.flush()
            while self._waiting or self._in_work:
                self._begin_frames(pool)
                if self._in_work:
                    yield from self._finish_first()

    def _hear(self, messages: Iterable[SensorMessage]) -> None:
        """Take messages, look at the sensors, and put complete groups in the queue."""
        for message in messages:
            self._watch.hear(message)
            self._synchroniser.add(message)
        now_s = self._clock.now()
        self._tick(now_s, [*self._watch.look(now_s), *self._pace_events])
        self._pace_events.clear()
        self._waiting += self._synchroniser.take(now_s, self._watch.in_time)
        while len(self._waiting) > MAX_WAITING_FRAMES:
            self._waiting.popleft()
            self.dropped_frames += 1

    def _can_begin(self) -> bool:
        """Return True if a frame waits and a detection can begin."""
        detecting = sum(not entry.is_done() for entry in self._in_work)
        return bool(self._waiting) and detecting < self._detection.parallel

    def _begin_frames(self, pool: DetectionPool) -> None:
        """Fuse waiting frames and begin to detect in them, as many as the pool takes."""
        while self._can_begin():
            group = self._waiting.popleft()
            if group.time_s <= self._last_time_s:
                self.dropped_frames += 1
                continue
            self._last_time_s = group.time_s
            stages = _Stages(self._clock, group.time_s)
            frame = self._fuse(group)
            stages.end("fuse")
            detected = pool.submit(frame) if self._pace.is_due() else None
            messages = group.messages.values()
            self._in_work.append(_FrameInWork(frame, messages, stages, detected))
            if self._detection.parallel == 1:
                return  # new messages are heard first

    def _finish_first(self) -> Iterator[CentreFrame]:
        """Track, write and yield the oldest frame in work; then read its messages for faults."""
        entry = self._in_work.popleft()
        frame = entry.frame
        stages = entry.stages
        detections = None
        if entry.detected is None:
            self.predicted_frames += 1
            tracks = self._tracker.at(frame.time)
        else:
            result = entry.detected.result()
            stages.end_detection(result)
            detections = result.detections
            tracks = self._track(result)
        stages.end("track")
        clouds = frame.clouds if self._with_clouds else ()
        self._write(Instant.from_tracks(frame.time, tracks, clouds))
        stages.end("write")
        faults = dict(self._watch.faults)
        latency_ms = stages.latency_ms(frame.time)
        yield CentreFrame(
            frame, detections, tracks, faults, stage_ms=dict(stages.times_ms), latency_ms=latency_ms
        )
        for message in entry.messages:
            self._watch.read(message)
        if detections is not None:
            self._judge_pace(stages.work_s())

    def _track(self, result: FrameDetections) -> Tracks:
        """Return the tracks after the detections of a frame."""
        if not self._has_area:
            self._has_area = True
            self._tracker = Tracker(result.stand.corners.tolist())
        return self._tracker.update(result.detections, result.frame.time)

    def _judge_pace(self, work_s: float) -> None:
        """Let the pace follow from the work on a frame with detection (s)."""
        event = self._pace.add_work(work_s, self._clock.now())
        if event is not None:
            self._pace_events.append(event)

    def count_left_out(self, source: MessageSource) -> LeftOut:
        """Return the numbers of what was left out; source: source of the messages."""
        late = self._synchroniser.late
        return LeftOut(
            frames=self.dropped_frames,
            messages=source.drops,
            late=late,
            predicted=self.predicted_frames,
        )

    def _fuse(self, group: MessageGroup) -> Frame:
        """Return the messages of a group as one frame, with all points at its time."""
        messages = [group.messages[name] for name in self._sensors if name in group.messages]
        sensors = tuple(self._sensors[message.sensor] for message in messages)
        frame = Frame(
            sensors=sensors,
            measurements=tuple(message.measurement for message in messages),
            objects=Objects.empty(),
            time=group.time_s,
            index=self._number,
            name=f"{self._number:06d}",
        )
        self._number += 1
        times_s = np.array([message.time_s for message in messages])
        return move_to_frame(frame, times_s, self._tracker.at(frame.time))


@dataclass(frozen=True, eq=False)
class _FrameInWork:
    """Frame that has been fused and is not given out yet.

    Attributes:
        frame: Frame.
        messages: Messages that it was fused from.
        stages: Times of its stages so far.
        detected: Its detections, None if its tracks are to be predicted.
    """

    frame: Frame
    messages: Collection[SensorMessage]
    stages: "_Stages"
    detected: "Future[FrameDetections] | None"

    def is_done(self) -> bool:
        """Return True if it can be given out without a wait."""
        return self.detected is None or self.detected.done()


class _Stages:
    """Times of the stages of a frame, from the moment when work on it begins.

    clock: time of the sensors; time_s: time of the frame's last point.

    Attributes:
        times_ms: Milliseconds by stage.
    """

    def __init__(self, clock: Clock, time_s: float) -> None:
        self._clock = clock
        self._begin_s = clock.now()
        self._last_s = perf_counter()
        self.times_ms = {"wait": self.latency_ms(time_s)}

    def work_s(self) -> float:
        """Time since the frame was begun, on the clock of the sensors (s).

        At least 0, as the clock of a replay may have been set back."""
        return max(0.0, self._clock.now() - self._begin_s)

    def end(self, stage: str) -> None:
        """End a stage, which began when the last one ended."""
        now_s = perf_counter()
        self.times_ms[stage] = 1e3 * (now_s - self._last_s)
        self._last_s = now_s

    def end_detection(self, result: FrameDetections) -> None:
        """End detection, with the times of its parts."""
        self.times_ms["fuse"] += result.fuse_ms
        self.times_ms["level"] = result.stand.ms
        self.times_ms["detect"] = result.detect_ms
        self._last_s = perf_counter()

    def latency_ms(self, time_s: float) -> float:
        """Milliseconds since a time of the sensors."""
        return 1e3 * (self._clock.now() - time_s) / self._clock.speed
