"""How soon the fusion centre notices that a sensor fails, and how often it says so of one that works.

In every stretch of traffic each sensor fails in turn, from `ONSET` after it began: it falls silent, repeats what it
measured then, or sees nothing any more. Its monitor (`toolkit.detection.failing.monitor`) looks at what arrives, once
where sensors send whole images and once where they send foreground; what it must see are the objects that the centre
detects in what all of them sent, and that have points of others. False alarms are counted over the same traffic with
nothing wrong but the link.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from placement_env.report.stress.conditions import conditions_of
from toolkit.arrays import Bool
from toolkit.boxes import count_points
from toolkit.calibration.recording_scenes import RecordingScenes
from toolkit.datasets.readings import read_frame
from toolkit.detection.evaluation import Recording
from toolkit.detection.failing.monitor import Fault, SensorMonitor, Shown, standing_before
from toolkit.detection.link.channel import PERFECT, LinkChannel
from toolkit.detection.link.foreground import Foreground
from toolkit.detection.link.lagged import lagged_frames
from toolkit.detection.link.range_images import STEPS
from toolkit.detection.link.standing_out import drawn_scene, standing_out
from toolkit.detection.view import frame_view
from toolkit.frame import Frame
from toolkit.objects import Detector
from toolkit.points import unproject
from toolkit.runtime.files import finite

ONSET = 2.0  # s after traffic began
LOOKED = 2.0  # s after it, for which the centre is given time
SUPPORT = 10  # points of other sensors that make an object one that a sensor must see
FAULTS = (Fault.SILENT, Fault.FROZEN, Fault.BLINDED)
SENT_AS = ("whole images", "foreground")


@dataclass(frozen=True)
class Noticed:
    """Seconds until a fault was noticed, of so many cases: median and greatest, infinite where it was not within
    `LOOKED`."""

    fault: str
    sent_as: str
    cases: int
    noticed: int
    median: float
    worst: float

    def as_dict(self) -> dict[str, Any]:
        """For JSON: None for infinity."""
        return {name: finite(value) for name, value in asdict(self).items()}


@dataclass(frozen=True)
class FalseAlarms:
    """How often a sensor that works was said to fail, in how many minutes of a sensor, over a link with this wrong."""

    link: str
    sent_as: str
    alarms: int
    minutes: float

    def as_dict(self) -> dict[str, Any]:
        """For JSON."""
        return asdict(self)


def noticing(
    recording: Recording, detector: Detector, *, frames: int | None = None, seed: int = 0
) -> tuple[tuple[Noticed, ...], tuple[FalseAlarms, ...]]:
    """Every fault of every sensor in every stretch of traffic, and false alarms over every link.

    recording: frames close together; frames: only the first so many; seed: of noise and links. Raises ValueError where
    no traffic goes on for as long as `ONSET`.
    """
    count = min(len(recording), len(recording) if frames is None else frames)
    scenes, links = RecordingScenes(recording, noise_seed=seed), _links()
    after: dict[tuple[Fault, str], list[float]] = {(fault, way): [] for fault in FAULTS for way in SENT_AS}
    alarms = {(link, way): 0 for link in links for way in SENT_AS}
    minutes = dict.fromkeys(links, 0.0)
    for stretch in _stretches(recording, count, seed):
        if stretch[-1].time - stretch[0].time < ONSET:
            continue
        centre = _Centre(recording, detector, scenes)
        for fault, way in after:
            sensors = range(len(stretch[0].sensors))
            after[fault, way] += [_noticed_after(centre, stretch, sensor, fault, way) for sensor in sensors]
        for link, channel in links.items():
            lagged = list(lagged_frames(stretch, channel, seed=seed, noise_seed=None))
            minutes[link] += (stretch[-1].time - stretch[0].time) * len(stretch[0].sensors) / 60
            for way in SENT_AS:
                shown = [(each.frame, each.ages) for each in lagged]
                alarms[link, way] += sum(
                    _alarms(centre, shown, sensor, way) for sensor in range(len(stretch[0].sensors))
                )
    if not any(after.values()):
        raise ValueError(f"no traffic goes on for {ONSET:g} s here: record some with coview simulate --every 0.1")
    noticed = [
        Noticed(fault.value, way, len(each), int(np.isfinite(each).sum()), _median(each), max(each))
        for (fault, way), each in after.items()
    ]
    return tuple(noticed), tuple(FalseAlarms(*which, made, minutes[which[0]]) for which, made in alarms.items())


def _links() -> dict[str, LinkChannel]:
    wrong = [each for kind in ("delay", "loss") for each in conditions_of(kind, ()) if not each.tracks]
    return {"nothing wrong": PERFECT} | {f"{each.kind} {each.level}": each.channel for each in wrong}


def _stretches(recording: Recording, count: int, seed: int) -> Iterator[list[Frame]]:
    """Frames between which traffic goes on."""
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
    """What the centre has of each frame, and detects in it."""

    def __init__(self, recording: Recording, detector: Detector, scenes: RecordingScenes) -> None:
        self._site, self._detector, self.scenes = recording.site, detector, scenes

    def shown(self, frame: Frame, sensor: int, way: str, time: float) -> Shown:
        """What a sensor has sent: the whole image, or the foreground of its crop in the finest step."""
        if way == SENT_AS[0]:
            return Shown(time, np.asarray(frame.measurements[sensor], np.float32))
        captured = frame_view(frame, self._detector, self._site).captured(sensor)
        out = standing_out(captured, self.scenes(sensor))
        image = captured.sending(out.pixels).measurement
        steps = np.rint(image / STEPS[0]).astype(np.float32) * np.float32(STEPS[0])
        return Shown(time, steps, image > 0, out.missing)

    def monitor(self, frame: Frame, sensor: int, start: float) -> SensorMonitor:
        """Of a sensor that should send from a time on; frame: in which it stands."""
        captured, scene = frame_view(frame, self._detector, self._site).captured(sensor), self.scenes(sensor)
        view = np.zeros(scene.first.size, bool)
        view[drawn_scene(captured, scene).pixels] = True
        return SensorMonitor(scene, start=start, view=view.reshape(scene.first.shape))

    def covered(self, frame: Frame, sensor: int) -> Bool[np.ndarray, "rows columns"]:
        """In which pixels a sensor must see what others see."""
        others = [k for k in range(len(frame.sensors)) if k != sensor]
        view = frame_view(frame, self._detector, self._site, scene=self.scenes)
        boxes = Foreground().fuse(view, range(len(frame.sensors))).detections.boxes
        clouds = []
        for k in others:
            shown = self.shown(frame, k, SENT_AS[1], frame.time)
            xyz, valid = unproject(frame.sensors[k], shown.image)
            clouds.append(xyz[:, valid].T)
        supported = count_points(np.concatenate([np.zeros((0, 3)), *clouds]), boxes) >= SUPPORT
        return standing_before(self.scenes(sensor), frame.sensors[sensor], boxes[supported])


def _noticed_after(centre: _Centre, stretch: Sequence[Frame], sensor: int, fault: Fault, way: str) -> float:
    """Seconds from the onset of a fault until its monitor says that something is wrong."""
    begin = stretch[0].time
    onset = next(k for k, frame in enumerate(stretch) if frame.time - begin >= ONSET - 1e-9)
    monitor = centre.monitor(stretch[0], sensor, begin)
    last: Shown | None = None
    for k in range(max(0, onset - 2), len(stretch)):
        frame, since = stretch[k], stretch[k].time - stretch[onset].time
        if since > LOOKED + 1e-9:
            break
        if k >= onset:
            frame = _failing(frame, stretch[onset], sensor, fault)
        if k < onset or fault is not Fault.SILENT:
            last = centre.shown(frame, sensor, way, frame.time)
        if monitor.look(frame.time, last, partial(centre.covered, frame, sensor)) is not None and k >= onset:
            return round(since, 6)
    return float("inf")


def _failing(frame: Frame, first: Frame, sensor: int, fault: Fault) -> Frame:
    """A frame of which one sensor measures nothing, or what it measured first."""
    instead = {
        Fault.BLINDED: np.zeros_like(frame.measurements[sensor]),
        Fault.FROZEN: first.measurements[sensor],
    }.get(fault, frame.measurements[sensor])
    return replace(
        frame, measurements=tuple(instead if k == sensor else each for k, each in enumerate(frame.measurements))
    )


def _alarms(centre: _Centre, shown: Sequence[tuple[Frame, np.ndarray]], sensor: int, way: str) -> int:
    """How often the monitor of a sensor that works begins to say that it fails."""
    monitor, before, count = centre.monitor(shown[0][0], sensor, shown[0][0].time), None, 0
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


def _median(seconds: Sequence[float]) -> float:
    """Of an odd or even number, the later of the middle two."""
    return sorted(seconds)[len(seconds) // 2]
