"""`RunningCentre`: messages of sensors in; fused, detected, tracked and written frames out.

Every frame is fused from the messages of one moment (`toolkit.centre.synchroniser`), its points are
moved to one time (`toolkit.centre.sweep_motion`), road users are detected and tracked, and the
tracks are written. Threads detect (`toolkit.centre.detection_pool`), and a frame is given out at
its deadline at the latest. Without its detections, its tracks are predicted. Detections that come
later update the tracks of the frames that follow, so nothing that was detected is lost."""

from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from time import perf_counter

import numpy as np

from toolkit.centre.clock import Clock
from toolkit.centre.detection_pool import DetectionPool
from toolkit.centre.message_queue import MessageSource
from toolkit.centre.pace import LagEvent, PaceEvent, PaceWatch
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

MAX_PAUSE_S = 0.02  # longest wait for a message before the watch looks again
_TOLERANCE_S = 1e-6  # rounding of a frame's deadline
CentreEvent = FaultEvent | PaceEvent | LagEvent


@dataclass(frozen=True, eq=False)
class CentreFrame:
    """Frame as the centre gives it out.

    Attributes:
        frame: Measurements, all at `Frame.time`.
        detections: Detections, world frame; None if the tracks are predicted.
        tracks: Tracks after them.
        faults: Faults of sensors by name.
        stage_ms: Milliseconds of each stage: wait, fuse, hold, level, detect, track, write; without
            level and detect if the tracks are predicted. It is on hold until detection in it
            begins, or else until it is given out.
        latency_ms: Milliseconds from the last point to the written tracks.
        detection_age_s: Age of the newest detections behind the tracks (s), 0 for the frame's;
            None before the first ones.
        late_detections: Detections in frames that were out already, which came since the frame
            before, the oldest first.
    """

    frame: Frame
    detections: Detections | None
    tracks: Tracks
    faults: Mapping[str, Fault]
    stage_ms: Mapping[str, float]
    latency_ms: float
    detection_age_s: float | None = None
    late_detections: Sequence[FrameDetections] = ()


@dataclass(frozen=True)
class LeftOut:
    """Numbers of what the centre left out since it started.

    Attributes:
        frames: Frames that were dropped because their time did not go on.
        messages: Messages that a full queue dropped, by sensor.
        late: Messages whose frame was out already, by sensor.
        predicted: Frames that came out without their detections, with predicted tracks.
        late_detections: Predicted frames whose detections came later.
    """

    frames: int
    messages: Mapping[str, int]
    late: Mapping[str, int]
    predicted: int = 0
    late_detections: int = 0

    def as_dict(self) -> dict[str, object]:
        """Return the numbers as plain values."""
        return {
            "dropped_frames": self.frames,
            "predicted_frames": self.predicted,
            "late_detections": self.late_detections,
            "dropped_messages": dict(self.messages),
            "late_messages": dict(self.late),
        }


class RunningCentre:
    """Centre that works on messages until they end.

    Args:
        sensors: Sensors by name, at their poses.
        pool: Detects in frames.
        synchroniser: Groups messages by time.
        watch: Names sensors that fail.
        clock: Time of the sensors.
        write: Called with the tracks of each frame.
        tick: Called with the time and new events, many times a second.
        with_clouds: True to pass clouds to `write`, too.

    Attributes:
        dropped_frames: Number of frames that were dropped because their time did not go on.
        predicted_frames: Number of frames that came out with predicted tracks.
        late_detections: Number of predicted frames whose detections came later.
    """

    def __init__(
        self,
        sensors: Mapping[str, Sensor],
        pool: DetectionPool,
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
        self.late_detections = 0
        self._sensors = sensors
        self._pool = pool
        self._detect_every = pool.detection.detect_every
        self._deadline_s = pool.detection.deadline_s * clock.speed  # on the clock of the sensors
        self._synchroniser = synchroniser
        self._watch = watch
        self._clock = clock
        self._write = write
        self._tick = tick
        self._with_clouds = with_clouds
        due_ms = 1e3 * self._detect_every * synchroniser.interval_s / clock.speed
        self._pace = PaceWatch(due_ms, pool.detection.parallel)
        self._pace_events: list[PaceEvent] = []  # since the last tick
        self._tracker = Tracker()
        self._detected_s: float | None = None  # time of the frame of the tracker's last detections
        self._last_time_s = -np.inf  # time of the last frame
        self._number = 0  # number of the next frame
        self._frames: deque[_FrameInWork] = deque()
        self._unread: list[SensorMessage] = []  # not read for faults yet
        self._late_results: list[FrameDetections] = []  # since the last frame given out

    def run(self, source: MessageSource) -> Iterator[CentreFrame]:
        """Yield the frames of a source's messages as they are done.

        Raises the errors of the detector and the writers."""
        while (messages := source.take(self._find_pause())) is not None:
            self._hear(messages)
            yield from self._give_out()
            self._read_messages()
        self._begin_frames(self._synchroniser.flush())
        while self._frames or self._pool.is_expected(np.inf):
            source.rest(self._find_pause())
            yield from self._give_out()

    def _hear(self, messages: Iterable[SensorMessage]) -> None:
        """Take messages, report what happened since, and begin the frames that are complete."""
        for message in messages:
            self._watch.hear(message)
            self._synchroniser.add(message)
        now_s = self._clock.now()
        # faults that began or ended since the last call, and changes of the detector's pace
        fault_events = self._watch.look(now_s)
        self._tick(now_s, [*fault_events, *self._pace_events])
        self._pace_events.clear()
        # a frame does not wait for sensors that are silent or late
        expected_sensors = self._watch.in_time
        self._begin_frames(self._synchroniser.take(now_s, expected_sensors))

    def _begin_frames(self, groups: Iterable[MessageGroup]) -> None:
        """Fuse groups of messages to frames, and let the pool detect in them if it is due."""
        for group in groups:
            if group.time_s <= self._last_time_s:
                self.dropped_frames += 1
                continue
            self._last_time_s = group.time_s
            stages = _Stages(self._clock, group.time_s)
            is_due = self._number % self._detect_every == 0
            frame = self._fuse(group)
            stages.end("fuse")
            self._frames.append(_FrameInWork(frame, stages))
            self._unread += group.messages.values()
            if is_due:
                self._pool.add(frame)

    def _find_pause(self) -> float:
        """Return the longest wait before something is due (s)."""
        if not self._frames:
            return MAX_PAUSE_S
        remaining_s = self._find_remaining(self._frames[0].frame.time) / self._clock.speed
        return min(max(0.0, remaining_s), MAX_PAUSE_S)

    def _find_remaining(self, time_s: float) -> float:
        """Return the seconds of the sensors to the deadline of a frame; time_s: its time (s)."""
        return time_s + self._deadline_s - self._clock.now()

    def _give_out(self) -> Iterator[CentreFrame]:
        """Take the detections that are done, and yield the frames that are, in their order."""
        while self._frames:
            entry = self._frames[0]  # the oldest
            # detections in later frames must not update the tracks before this frame is given out
            self._take_detections(entry.frame.time)
            if not self._is_ready(entry.frame.time):
                return
            self._frames.popleft()
            yield self._finish(entry)
        self._take_detections(np.inf)  # no frame waits, so all that are done

    def _is_ready(self, time_s: float) -> bool:
        """Return True if a frame is to wait no longer; time_s: its time (s)."""
        is_settled = not self._pool.is_expected(time_s)
        return is_settled or self._find_remaining(time_s) <= _TOLERANCE_S

    def _take_detections(self, time_s: float) -> None:
        """Update the tracks with the detections that are done, in frames up to a time (s).

        Those in the oldest frame at work are kept with it; those in a frame that is out already
        are late results, which the next frame given out reports."""
        for result in self._pool.take(time_s):
            first = self._frames[0] if self._frames else None
            if first is not None and result.frame is first.frame:
                first.detections = result.detections
                first.stages.end_detection(result)
            else:
                self.late_detections += 1
                self._late_results.append(result)
            self._track(result)

    def _track(self, result: FrameDetections) -> None:
        """Update the tracks with the detections in a frame."""
        if self._detected_s is None:
            self._tracker = Tracker(result.stand.corners.tolist())
        self._detected_s = result.frame.time
        self._tracker.advance(result.detections, result.frame.time)
        event = self._pace.add_work(sum(result.stage_ms.values()), self._clock.now())
        if event is not None:
            self._pace_events.append(event)

    def _finish(self, entry: "_FrameInWork") -> CentreFrame:
        """Return the oldest frame, with its tracks written."""
        frame = entry.frame
        stages = entry.stages
        if entry.detections is None:
            self.predicted_frames += 1
            stages.end("hold")
        tracks = self._tracker.at(frame.time)
        stages.end("track")
        clouds = frame.clouds if self._with_clouds else ()
        self._write(Instant.from_tracks(frame.time, tracks, clouds))
        stages.end("write")
        late_results = tuple(self._late_results)
        self._late_results.clear()
        return CentreFrame(
            frame,
            detections=entry.detections,
            tracks=tracks,
            faults=dict(self._watch.faults),
            stage_ms=stages.times_ms,
            latency_ms=stages.latency_ms(frame.time),
            detection_age_s=None if self._detected_s is None else frame.time - self._detected_s,
            late_detections=late_results,
        )

    def _read_messages(self) -> None:
        """Read the messages of the frames begun since the last call for faults."""
        for message in self._unread:
            self._watch.read(message)
        self._unread.clear()

    def count_left_out(self, source: MessageSource) -> LeftOut:
        """Return the numbers of what was left out; source: source of the messages."""
        return LeftOut(
            frames=self.dropped_frames,
            messages=source.drops,
            late=self._synchroniser.late,
            predicted=self.predicted_frames,
            late_detections=self.late_detections,
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


@dataclass(eq=False)
class _FrameInWork:
    """Frame that has been fused and is not given out yet.

    Attributes:
        frame: Frame.
        stages: Times of its stages so far.
        detections: Its detections, None as long as they are not there.
    """

    frame: Frame
    stages: "_Stages"
    detections: Detections | None = None


class _Stages:
    """Times of the stages of a frame, from the moment when work on it begins.

    clock: time of the sensors; time_s: time of the frame's last point.

    Attributes:
        times_ms: Milliseconds by stage.
    """

    def __init__(self, clock: Clock, time_s: float) -> None:
        self._clock = clock
        self._last_s = perf_counter()
        self.times_ms = {"wait": self.latency_ms(time_s)}

    def end(self, stage: str) -> None:
        """End a stage, which began when the last one ended."""
        now_s = perf_counter()
        self.times_ms[stage] = 1e3 * (now_s - self._last_s)
        self._last_s = now_s

    def end_detection(self, result: FrameDetections) -> None:
        """End detection, with the times of its parts; the frame was on hold before it."""
        self.end("hold")
        self.times_ms["hold"] -= sum(result.stage_ms.values())
        self.times_ms["fuse"] += result.fuse_ms
        self.times_ms["level"] = result.stand.ms
        self.times_ms["detect"] = result.detect_ms

    def latency_ms(self, time_s: float) -> float:
        """Milliseconds since a time of the sensors."""
        return 1e3 * (self._clock.now() - time_s) / self._clock.speed
