"""`stress`: the AP of fusion schemes under every condition, with intervals, and what they send.

Objects centred in the site's area are to be found, by protocol `exact`. Where frames lie close together the first
second after traffic began anew is not scored under any condition: messages that are late have not come yet. Intervals
are a bootstrap over blocks of frames (`placement_env.analysis.intervals`), of one seed, so that conditions are compared
on the same draws; over frames close together, which resemble each other, they are too narrow.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from placement_env.analysis.tally import Tally
from placement_env.report.content import Judgement
from placement_env.report.stress.conditions import IN_SEQUENCE, KINDS, Condition, conditions_of
from toolkit.calibration.recording_scenes import RecordingScenes
from toolkit.detection.codec import PAPER, Codec
from toolkit.detection.evaluation import Recording
from toolkit.detection.link.channel import STALE
from toolkit.detection.link.foreground import Foreground
from toolkit.detection.link.lagged import Lagged, lagged_frames
from toolkit.detection.link.range_images import STEPS, RangeImages
from toolkit.detection.link.tracks import Tracks
from toolkit.detection.metrics import match
from toolkit.detection.scheme import Scheme
from toolkit.detection.schemes import SCHEMES, scheme_of
from toolkit.detection.sharing.adaptive import Adaptive
from toolkit.detection.view import frame_view
from toolkit.frame import Frame
from toolkit.objects import LABELS, VEHICLE, Detections, Detector, check_known, label_index
from toolkit.points import centred_in
from toolkit.sensors.errors.clock import MOST_APART


@dataclass(frozen=True)
class StressRow:
    """One scheme under one condition. judged: AP with its interval; kbit_per_sensor: per frame, of the sensors that
    send; age: of what the centre shows, mean over sensors and frames (s); label, iou: of what is to be found."""

    kind: str
    level: str
    scheme: str
    codec: str
    judged: Judgement
    kbit_per_sensor: float
    age: float
    label: str
    iou: float

    def as_dict(self) -> dict[str, Any]:
        """For JSON."""
        return asdict(self)


@dataclass(frozen=True)
class _System:
    """A scheme and how it sends, by its name in tables."""

    scheme: Scheme
    codec: Codec
    name: str


def kinds_for(recording: Recording, kinds: Sequence[str] = ()) -> tuple[str, ...]:
    """The kinds asked for, or all that a recording can show. Raises ValueError for one that there is not, and one that
    needs frames closer together."""
    for kind in kinds:
        conditions_of(kind, ())
    apart = _apart(recording)
    close = 0 < apart <= MOST_APART
    for kind in kinds:
        if kind in IN_SEQUENCE and not close:
            raise ValueError(
                f"stress {kind!r} needs frames at most {MOST_APART} s apart, these are {apart:g} s: record some with "
                "coview simulate --every 0.1"
            )
    return tuple(kinds) or tuple(kind for kind in KINDS if close or kind not in IN_SEQUENCE)


def _apart(recording: Recording) -> float:
    """Seconds between its first two frames."""
    return recording[1].time - recording[0].time if len(recording) > 1 else np.inf


def stress(
    recording: Recording,
    detector: Detector,
    *,
    schemes: Sequence[Scheme | str] = tuple(SCHEMES),
    kinds: Sequence[str] = (),
    frames: int | None = None,
    label: str = LABELS[VEHICLE],
    iou: float = 0.7,
    seed: int = 0,
    progress: Callable[[int, int], None] | None = None,
) -> tuple[StressRow, ...]:
    """Every scheme under the conditions of every kind, all that the recording can show if none is named.

    frames: only the first so many; label, iou: of what is to be found; seed: of noise, errors, channels and bootstrap;
    progress: called with how many frames are done, of how many. Raises ValueError as `kinds_for`, and for a label that
    there is not or the detector does not know.
    """
    check_known(detector, [LABELS[label_index(label)]])
    chosen = [scheme_of(scheme) for scheme in schemes]
    if not chosen:
        raise ValueError(f"there must be a scheme to stress: choose among {', '.join(SCHEMES)}")
    names = [sensor.name for sensor in recording.sensors]
    conditions = [each for kind in kinds_for(recording, kinds) for each in conditions_of(kind, names)]
    count = min(len(recording), len(recording) if frames is None else frames)
    if count < 1:
        raise ValueError(f"there must be a frame to stress, got {frames} of {len(recording)}")
    settled = STALE if _apart(recording) <= MOST_APART else 0.0
    scenes, rows, done = RecordingScenes(recording, noise_seed=seed), [], 0
    for condition in conditions:
        runs = [_Run(system, label, iou) for system in _systems(chosen, condition)]
        for lagged in lagged_frames(
            recording, condition.channel, frames=count, seed=seed, errors=condition.errors, noise_seed=seed,
            frozen=condition.frozen,
        ):  # fmt: skip
            seen, scored = _seen(lagged, condition), lagged.since >= settled
            _look(runs, seen, condition, recording, detector, scenes, scored=scored)
            done += 1
            if progress is not None:
                progress(done, count * len(conditions))
        rows += [run.row(condition, seed) for run in runs]
    return tuple(rows)


def _systems(schemes: Sequence[Scheme], condition: Condition) -> list[_System]:
    """Every scheme as bytes; where bytes are looked at, by the paper's counting and in all steps as well."""
    if condition.kind != "bytes":
        return [_System(scheme, RangeImages(), _step_words(STEPS[0])) for scheme in schemes]
    systems = []
    for scheme in schemes:
        own = getattr(scheme, "codec", None)
        if isinstance(scheme, Adaptive):  # chooses its steps itself
            systems.append(_System(scheme, scheme.codec, "own"))
            continue
        if own is None:
            systems.append(_System(scheme, PAPER, "paper"))
        for step in STEPS:
            stepped = scheme if not isinstance(scheme, Foreground) else replace(scheme, step=step)
            systems.append(_System(stepped, RangeImages(step), _step_words(step)))
    return systems


def _step_words(step: float) -> str:
    return f"{100 * step:g} cm"


def _seen(lagged: Lagged, condition: Condition) -> Lagged:
    """Without what blinded sensors measure."""
    frame = lagged.frame
    measured = tuple(
        np.zeros_like(image) if k in condition.blinded else image for k, image in enumerate(frame.measurements)
    )
    return lagged._replace(frame=replace(frame, measurements=measured))


def _look(
    runs: Sequence[_Run],
    lagged: Lagged,
    condition: Condition,
    recording: Recording,
    detector: Detector,
    scenes: RecordingScenes,
    *,
    scored: bool,
) -> None:
    """One frame, fused by every system; views are shared by those that send alike."""
    frame, views = lagged.frame, {}
    sending = [k for k, age in enumerate(lagged.ages) if age == age and k not in condition.silent]
    for run in runs:
        codec = run.system.codec
        if codec.digest not in views:
            views[codec.digest] = frame_view(frame, detector, recording.site, codec=codec, scene=scenes)
        fused = run.system.scheme.fuse(views[codec.digest], sending)
        ages, detections = lagged.ages[sending] if sending else np.array([np.nan]), fused.detections
        if condition.tracks:  # what one sensor has long not renewed, others have: the middle of them
            detections = run.tracked(detections, frame.time, float(np.median(ages)), begins=not lagged.since)
        if scored:
            run.add(frame, recording, detections, fused.kbit_per_sensor, float(ages.mean()))


class _Run:
    """What became of one system's detections, frame after frame."""

    def __init__(self, system: _System, label: str, iou: float) -> None:
        self.system, self._label, self._iou = system, label, iou
        self._scores: list[np.ndarray] = []
        self._hits: list[np.ndarray] = []
        self._truths: list[int] = []
        self._kbit: list[float] = []
        self._ages: list[float] = []
        self._tracks, self._last = Tracks(), -np.inf

    def tracked(self, detections: Detections, now: float, age: float, *, begins: bool) -> Detections:
        """What was detected in measurements of an age, where it is now."""
        if begins:
            self._tracks, self._last = Tracks(), -np.inf
        if age != age:
            return detections
        self._last = max(self._last, now - age)
        self._tracks.update(detections, self._last)
        return self._tracks.at(now)

    def add(self, frame: Frame, recording: Recording, detections: Detections, kbit: float, age: float) -> None:
        """One frame more."""
        counted = centred_in(frame.objects.boxes, recording.site.area)
        matched = match(detections, frame.objects, self._iou, label=self._label, counted=counted)
        self._scores.append(detections.scores[~matched.ignored])
        self._hits.append(matched.truth[~matched.ignored] >= 0)
        self._truths.append(int(matched.scored.sum()))
        self._kbit.append(kbit)
        self._ages.append(age)

    def row(self, condition: Condition, seed: int) -> StressRow:
        """The figures of all frames."""
        tally = Tally.of_frames(self._scores, self._hits, self._truths)
        figures = (tally.ap, *tally.interval(seed=seed), tally.recall, tally.precision if len(tally.hit) else None)
        judged = Judgement(*figures, int(tally.truths.sum()), len(tally.truths), self._label)
        ages = np.array(self._ages)
        age = float(ages[~np.isnan(ages)].mean()) if (~np.isnan(ages)).any() else np.nan
        kbit, system = float(np.mean(self._kbit)), self.system
        said = (condition.kind, condition.level, system.scheme.name, system.name)
        return StressRow(*said, judged, kbit, age, self._label, self._iou)
