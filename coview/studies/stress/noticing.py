"""Time until the fusion centre notices a failing sensor, and false alarms.

In every stretch of traffic each sensor fails in turn, `ONSET` after the stretch began: it falls
silent, repeats what it measured then, or sees nothing any more. Its monitor
(`toolkit.detection.sensor_monitor`) looks at what arrives, once with whole images and once with
foreground. A sensor must see the objects that the centre detects in all messages and that have
points from other sensors. False alarms are counted over the same traffic with nothing wrong but the
link."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from coview.studies.stress.conditions import make_conditions
from toolkit.arrays import ImageMask
from toolkit.boxes import count_points
from toolkit.calibration.empty_scene import Scenes
from toolkit.datasets.recordings import ReadRecording, Reads, read_frame
from toolkit.detection.link.channel import PERFECT, delay_frames
from toolkit.detection.link.foreground import Foreground, draw_scene, standing_out
from toolkit.detection.link.range_images import STEPS
from toolkit.detection.sensor_monitor import Fault, SensorMonitor, Shown, standing_before
from toolkit.detection.view import frame_view
from toolkit.frame import Frame, SiteRecording, unproject
from toolkit.objects import Detector
from toolkit.runtime.run import Run

ONSET = 2.0  # s after traffic began
TIME_ALLOWED = 2.0  # s after the onset, within which a fault must be noticed
SUPPORT = 10  # points of other sensors on an object that a sensor must see
FAULTS = (Fault.SILENT, Fault.FROZEN, Fault.BLINDED)
SENT_AS = ("whole images", "foreground")


@dataclass(frozen=True)
class Noticed:
    """Seconds until a fault was noticed; infinite if never."""

    fault: str
    sent_as: str
    cases: int
    noticed: int
    median: float
    worst: float


@dataclass(frozen=True)
class FalseAlarms:
    """Alarms about working sensors, and sensor-minutes watched."""

    link: str
    sent_as: str
    alarms: int
    minutes: float


def time_faults(
    recording: SiteRecording, detector: Detector, run: Run = Run()
) -> tuple[tuple[Noticed, ...], tuple[FalseAlarms, ...]]:
    """Time every fault of every sensor, and count false alarms over every link.

    recording: frames close together; run: with the seed of noise and links, and the number of first
    frames. Raises ValueError if no stretch of traffic is longer than `ONSET`."""
    count = min(len(recording), run.frames_or(len(recording)))
    seed = run.seed
    scenes = Scenes(ReadRecording(recording, Reads(noise_seed=seed)))
    wrong = [
        each for kind in ("delay", "loss") for each in make_conditions(kind, ()) if not each.tracks
    ]
    links = {"nothing wrong": PERFECT} | {
        f"{each.kind} {each.level}": each.channel for each in wrong
    }
    after: dict[tuple[Fault, str], list[float]] = {
        (fault, way): [] for fault in FAULTS for way in SENT_AS
    }
    alarms = {(link, way): 0 for link in links for way in SENT_AS}
    minutes = dict.fromkeys(links, 0.0)
    for stretch in _stretches(recording, count, seed):
        seconds = stretch[-1].time - stretch[0].time
        sensors = range(len(stretch[0].sensors))
        if seconds < ONSET:
            continue
        centre = _Centre(recording, detector, scenes)
        for fault, way in after:
            after[fault, way] += [
                _time_to_notice(centre, stretch, sensor, fault, way) for sensor in sensors
            ]
        for link, channel in links.items():
            shown = [
                (each.frame, each.ages)
                for each in delay_frames(stretch, channel, seed=seed, noise_seed=None)
            ]
            minutes[link] += seconds * len(sensors) / 60
            for way in SENT_AS:
                alarms[link, way] += sum(
                    _count_alarms(centre, shown, sensor, way) for sensor in sensors
                )
    if not any(after.values()):
        raise ValueError(
            f"no stretch of traffic is {ONSET:g} s long here: record with coview simulate --every "
            "0.1"
        )
    # of an even number of cases the median is the later of the middle two
    noticed = [
        Noticed(
            fault.value,
            way,
            len(each),
            int(np.isfinite(each).sum()),
            sorted(each)[len(each) // 2],
            max(each),
        )
        for (fault, way), each in after.items()
    ]
    return tuple(noticed), tuple(
        FalseAlarms(*which, made, minutes[which[0]]) for which, made in alarms.items()
    )


def _stretches(recording: SiteRecording, count: int, seed: int) -> Iterator[list[Frame]]:
    """Runs of frames in which traffic goes on."""
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
    """Fusion centre: messages it receives and detections it makes."""

    def __init__(self, recording: SiteRecording, detector: Detector, scenes: Scenes) -> None:
        self._site = recording.site
        self._detector = detector
        self.scenes = scenes

    def shown(self, frame: Frame, sensor: int, way: str, time: float) -> Shown:
        """Message of a sensor: the whole image, or the foreground of its crop in the finest
        step."""
        if way == SENT_AS[0]:
            return Shown(time, np.asarray(frame.images[sensor], np.float32))
        captured = frame_view(frame, self._detector, self._site).captured(sensor)
        out = standing_out(captured, self.scenes(sensor))
        image = captured.sending(out.pixels).measurement
        steps = np.rint(image / STEPS[0]).astype(np.float32) * np.float32(STEPS[0])
        return Shown(time, steps, image > 0, out.missing)

    def monitor(self, frame: Frame, sensor: int, start: float) -> SensorMonitor:
        """Monitor of a sensor that starts sending at `start`. frame: any one with that sensor."""
        captured = frame_view(frame, self._detector, self._site).captured(sensor)
        scene = self.scenes(sensor)
        view = np.zeros(scene.first.size, bool)
        view[draw_scene(captured, scene).pixels] = True
        return SensorMonitor(scene, start=start, view=view.reshape(scene.first.shape))

    def covered(self, frame: Frame, sensor: int) -> ImageMask:
        """Pixels in which a sensor must see what others see."""
        view = frame_view(frame, self._detector, self._site, scene=self.scenes)
        boxes = Foreground().fuse(view, range(len(frame.sensors))).detections.boxes
        clouds = []
        for k in range(len(frame.sensors)):
            if k != sensor:
                xyz, valid = unproject(
                    frame.sensors[k], self.shown(frame, k, SENT_AS[1], frame.time).image
                )
                clouds.append(xyz[:, valid].T)
        supported = count_points(np.concatenate([np.zeros((0, 3)), *clouds]), boxes) >= SUPPORT
        return standing_before(self.scenes(sensor), frame.sensors[sensor], boxes[supported])


def _time_to_notice(
    centre: _Centre, stretch: Sequence[Frame], sensor: int, fault: Fault, way: str
) -> float:
    begin = stretch[0].time
    onset = next(k for k, frame in enumerate(stretch) if frame.time - begin >= ONSET - 1e-9)
    monitor = centre.monitor(stretch[0], sensor, begin)
    last: Shown | None = None
    for k in range(max(0, onset - 2), len(stretch)):
        frame = stretch[k]
        since = stretch[k].time - stretch[onset].time
        if since > TIME_ALLOWED + 1e-9:
            break
        if k >= onset and fault is not Fault.SILENT:
            instead = (
                np.zeros_like(frame.images[sensor])
                if fault is Fault.BLINDED
                else stretch[onset].images[sensor]
            )
            images = tuple(
                instead if other == sensor else image for other, image in enumerate(frame.images)
            )
            frame = replace(frame, measurements=images)
        if k < onset or fault is not Fault.SILENT:
            last = centre.shown(frame, sensor, way, frame.time)
        if (
            monitor.look(frame.time, last, partial(centre.covered, frame, sensor)) is not None
            and k >= onset
        ):
            return round(since, 6)
    return float("inf")


def _count_alarms(
    centre: _Centre, shown: Sequence[tuple[Frame, np.ndarray]], sensor: int, way: str
) -> int:
    monitor = centre.monitor(shown[0][0], sensor, shown[0][0].time)
    before = None
    count = 0
    last: Shown | None = None
    for frame, ages in shown:
        if not np.isnan(ages[sensor]):
            measured = frame.time - float(ages[sensor])
            if last is None or measured > last.time:
                last = centre.shown(frame, sensor, way, measured)
        fault = monitor.look(frame.time, last, partial(centre.covered, frame, sensor))
        count += fault is not None and before is None
        before = fault
    return count
