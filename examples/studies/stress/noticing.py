"""Time until the fusion centre notices a failing sensor, and false alarms.

In every stretch of traffic each sensor fails in turn, `ONSET_S` after the stretch began: it becomes
silent, repeats its last measurement, or sees nothing any more. Its `SensorMonitor` watches what
arrives, once with whole images and once with foreground. A sensor must see the objects that the
centre detects in all messages and that have points from other sensors. False alarms are counted
over the same traffic with no fault but the link's."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from examples.studies.stress.channel import PERFECT, delay_frames
from examples.studies.stress.conditions import make_conditions
from toolkit.arrays import ImageMask
from toolkit.boxes import count_points
from toolkit.calibration.recording_scenes import Scenes
from toolkit.centre.sensor_monitor import Fault, SensorMonitor, Shown, standing_before
from toolkit.datasets.recording_views import ReadRecording, Reads, read_frame
from toolkit.detection.link.foreground import Foreground
from toolkit.detection.link.foreground_pixels import draw_scene, standing_out
from toolkit.detection.link.range_images import STEPS_M
from toolkit.detection.view import frame_view
from toolkit.frame import Frame, SiteRecording, unproject
from toolkit.objects import Detector
from toolkit.runtime.run import Run

ONSET_S = 2.0  # from the start of traffic to the fault
MAX_NOTICE_S = 2.0  # a fault must be noticed within this time
MIN_SUPPORT_POINTS = 10  # points of other sensors from which a sensor must see an object
FAULTS = (Fault.SILENT, Fault.FROZEN, Fault.BLINDED)
SENT_AS = ("whole images", "foreground")


@dataclass(frozen=True)
class Noticed:
    """Time until a fault was noticed.

    Attributes:
        fault: Name of the fault.
        sent_as: What sensors send, of `SENT_AS`.
        cases: Number of cases: sensors times stretches of traffic.
        noticed: Number of cases in which it was noticed within `MAX_NOTICE_S`.
        median: Median time (s), infinite if it was never noticed.
        worst: Longest time (s), infinite if it was not noticed in a case."""

    fault: str
    sent_as: str
    cases: int
    noticed: int
    median: float
    worst: float


@dataclass(frozen=True)
class FalseAlarms:
    """Alarms about working sensors over one link.

    Attributes:
        link: Link in words, such as "delay 0.1 s".
        sent_as: What sensors send, of `SENT_AS`.
        alarms: Number of alarms.
        minutes: Time that sensors were watched, added up over sensors (min).
    """

    link: str
    sent_as: str
    alarms: int
    minutes: float


def check_stretches(recording: SiteRecording, run: Run = Run()) -> None:
    """Raise ValueError if no stretch of traffic is `ONSET_S` long."""
    count = min(len(recording), run.frames_or(len(recording)))
    stretches = _stretches(recording, count, run.seed)
    if not any(stretch[-1].time - stretch[0].time >= ONSET_S for stretch in stretches):
        raise ValueError(
            f"no stretch of traffic is {ONSET_S:g} s long here: record more frames with coview "
            "simulate --every 0.1"
        )


def time_faults(
    recording: SiteRecording, detector: Detector, run: Run = Run()
) -> tuple[tuple[Noticed, ...], tuple[FalseAlarms, ...]]:
    """Time every fault of every sensor, and count false alarms over every link.

    recording: frames close together in time; run: its seed is for noise and links, its frames are
    the number of first frames. Returns a row for each fault and way of sending, and one for each
    link and way of sending. Raises ValueError if no stretch of traffic is long enough."""
    check_stretches(recording, run)
    count = min(len(recording), run.frames_or(len(recording)))
    seed = run.seed
    scenes = Scenes(ReadRecording(recording, Reads(noise_seed=seed)))
    links = {"nothing wrong": PERFECT}
    for condition in (*make_conditions("delay", ()), *make_conditions("loss", ())):
        if not condition.tracks:
            links[f"{condition.kind} {condition.level}"] = condition.channel
    times_to_notice: dict[tuple[Fault, str], list[float]] = {
        (fault, sent_as): [] for fault in FAULTS for sent_as in SENT_AS
    }
    alarms = {(link, sent_as): 0 for link in links for sent_as in SENT_AS}
    minutes = dict.fromkeys(links, 0.0)
    for stretch in _stretches(recording, count, seed):
        seconds = stretch[-1].time - stretch[0].time
        sensors = range(len(stretch[0].sensors))
        if seconds < ONSET_S:
            continue
        centre = _Centre(recording, detector, scenes)
        for fault, sent_as in times_to_notice:
            times_to_notice[fault, sent_as] += [
                _time_to_notice(centre, stretch, sensor, fault, sent_as) for sensor in sensors
            ]
        for link, channel in links.items():
            arrivals = [
                (lagged.frame, lagged.ages)
                for lagged in delay_frames(stretch, channel, seed=seed, noise_seed=None)
            ]
            minutes[link] += seconds * len(sensors) / 60
            for sent_as in SENT_AS:
                alarms[link, sent_as] += sum(
                    _count_alarms(centre, arrivals, sensor, sent_as) for sensor in sensors
                )
    noticed = [_summarise_times(*key, times) for key, times in times_to_notice.items()]
    false_alarms = [
        FalseAlarms(*key, alarm_count, minutes[key[0]]) for key, alarm_count in alarms.items()
    ]
    return tuple(noticed), tuple(false_alarms)


def _summarise_times(fault: Fault, sent_as: str, times: Sequence[float]) -> Noticed:
    """Summarise the times (s) until a fault was noticed, infinite if it was not.

    The median is the later of the middle two times if their number is even."""
    noticed = int(np.isfinite(times).sum())
    median = sorted(times)[len(times) // 2]
    return Noticed(fault.value, sent_as, len(times), noticed, median, max(times))


def _stretches(recording: SiteRecording, count: int, seed: int) -> Iterator[list[Frame]]:
    """Yield runs of frames with continuous traffic, among the first `count` frames.

    Traffic restarts if a frame shares no road user with the frame before. seed: seed of the
    noise."""
    stretch: list[Frame] = []
    for k in range(count):
        frame = read_frame(recording, k, noise_seed=seed)
        if stretch and not np.isin(frame.objects.ids, stretch[-1].objects.ids).any():
            yield stretch
            stretch = []
        stretch.append(frame)
    if stretch:
        yield stretch


class _Centre:
    """Fusion centre: messages it receives and detections it makes.

    Attributes:
        scenes: Empty scenes of the sensors.
    """

    def __init__(self, recording: SiteRecording, detector: Detector, scenes: Scenes) -> None:
        self._site = recording.site
        self._detector = detector
        self.scenes = scenes

    def shown(self, frame: Frame, sensor: int, sent_as: str, time: float) -> Shown:
        """Return a sensor's message: the whole image, or the foreground in the finest step.

        sensor: index; sent_as: one of `SENT_AS`; time: time of measurement (s)."""
        if sent_as == SENT_AS[0]:
            return Shown(time, np.asarray(frame.images[sensor], np.float32))
        captured = frame_view(frame, self._detector, self._site).captured(sensor)
        foreground = standing_out(captured, self.scenes(sensor))
        image = captured.sending(foreground.pixels).measurement
        # distances in whole steps, as they are sent
        rounded = np.rint(image / STEPS_M[0]).astype(np.float32) * np.float32(STEPS_M[0])
        return Shown(time, rounded, image > 0, foreground.missing)

    def monitor(self, frame: Frame, sensor: int, start: float) -> SensorMonitor:
        """Return the monitor of a sensor (index) that starts sending at a time (s).

        frame: any frame with that sensor."""
        captured = frame_view(frame, self._detector, self._site).captured(sensor)
        scene = self.scenes(sensor)
        view = np.zeros(scene.first.size, bool)
        view[draw_scene(captured, scene).pixels] = True
        return SensorMonitor(scene, start=start, view=view.reshape(scene.first.shape))

    def covered(self, frame: Frame, sensor: int) -> ImageMask:
        """Return the mask of the pixels in which a sensor must see objects that others see.

        The objects are detected in the foreground of all sensors and have points of others."""
        view = frame_view(frame, self._detector, self._site, scene=self.scenes)
        boxes = Foreground().fuse(view, range(len(frame.sensors))).detections.boxes
        clouds = [np.zeros((0, 3))]
        for k in range(len(frame.sensors)):
            if k != sensor:
                image = self.shown(frame, k, SENT_AS[1], frame.time).image
                xyz, valid = unproject(frame.sensors[k], image)
                clouds.append(xyz[:, valid].T)
        points = count_points(np.concatenate(clouds), boxes)
        supported_boxes = boxes[points >= MIN_SUPPORT_POINTS]
        return standing_before(self.scenes(sensor), frame.sensors[sensor], supported_boxes)


def _time_to_notice(
    centre: _Centre, stretch: Sequence[Frame], sensor: int, fault: Fault, sent_as: str
) -> float:
    """Return the time (s) from a fault until the monitor notices it, infinite if it does not.

    stretch: frames of continuous traffic; sensor: index of the failing sensor; sent_as: one of
    `SENT_AS`."""
    start = stretch[0].time
    onset = next(k for k, frame in enumerate(stretch) if frame.time - start >= ONSET_S - 1e-9)
    monitor = centre.monitor(stretch[0], sensor, start)
    message: Shown | None = None
    for k in range(max(0, onset - 2), len(stretch)):  # two frames before the fault are enough
        frame = stretch[k]
        since_onset = stretch[k].time - stretch[onset].time
        if since_onset > MAX_NOTICE_S + 1e-9:
            break
        if k >= onset and fault is not Fault.SILENT:
            images = list(frame.images)
            images[sensor] = stretch[onset].images[sensor]
            if fault is Fault.BLINDED:  # else it is frozen
                images[sensor] = np.zeros_like(frame.images[sensor])
            frame = replace(frame, measurements=tuple(images))
        if k < onset or fault is not Fault.SILENT:
            message = centre.shown(frame, sensor, sent_as, frame.time)
        alarm = monitor.look(frame.time, message, partial(centre.covered, frame, sensor))
        if alarm is not None and k >= onset:
            return round(since_onset, 6)
    return float("inf")


def _count_alarms(
    centre: _Centre, arrivals: Sequence[tuple[Frame, np.ndarray]], sensor: int, sent_as: str
) -> int:
    """Count how often the monitor of a working sensor begins an alarm.

    arrivals: frames as they have arrived, and the age of each sensor's measurement in them (s), NaN
    without one; sensor: index; sent_as: one of `SENT_AS`."""
    first_frame = arrivals[0][0]
    monitor = centre.monitor(first_frame, sensor, first_frame.time)
    count = 0
    was_alarmed = False
    message: Shown | None = None
    for frame, ages in arrivals:
        if not np.isnan(ages[sensor]):
            measured = frame.time - float(ages[sensor])
            if message is None or measured > message.time:
                message = centre.shown(frame, sensor, sent_as, measured)
        alarm = monitor.look(frame.time, message, partial(centre.covered, frame, sensor))
        count += alarm is not None and not was_alarmed
        was_alarmed = alarm is not None
    return count
