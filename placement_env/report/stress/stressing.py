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

from placement_env.analysis.intervals import ap_interval
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
from toolkit.detection.metrics import average_precision, match, precision_recall
from toolkit.detection.scheme import Scheme
from toolkit.detection.schemes import SCHEMES, scheme_of
from toolkit.detection.sharing.adaptive import Adaptive
from toolkit.detection.sharing.foreground_differences import ForegroundDifferences
from toolkit.detection.view import LinkMemory, frame_view
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
    scenes, rows = RecordingScenes(recording, noise_seed=seed), []
    for number, condition in enumerate(conditions):
        done = 0
        tallies = [_Tally(system, label, iou) for system in _systems(chosen, condition)]
        for some, needed in _arriving_alike(tallies):
            memory: LinkMemory = {}
            for lagged in lagged_frames(
                recording, condition.channel, frames=count, seed=seed, errors=condition.errors, noise_seed=seed,
                frozen=condition.frozen, needed=needed,
            ):  # fmt: skip
                seen, scored = _seen(lagged, condition), lagged.since >= settled
                _look(some, seen, condition, recording, detector, scenes, memory, scored=scored)
                done += len(some)
                if progress is not None:
                    progress(number * count + done // len(tallies), count * len(conditions))
        rows += [tally.row(condition, seed) for tally in tallies]
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
            stepped = replace(scheme, step=step) if isinstance(scheme, Foreground | ForegroundDifferences) else scheme
            systems.append(_System(stepped, RangeImages(step), _step_words(step)))
    return systems


def _arriving_alike(
    tallies: Sequence[_Tally],
) -> list[tuple[list[_Tally], Callable[[int], Sequence[int]] | None]]:
    """The systems whose messages can be read when they arrive, and each of those that need others before."""
    alone = [tally for tally in tallies if not isinstance(tally.system.scheme, ForegroundDifferences)]
    after = [(tally, tally.system.scheme) for tally in tallies]
    chained: list[tuple[list[_Tally], Callable[[int], Sequence[int]] | None]] = [
        ([tally], scheme.needed) for tally, scheme in after if isinstance(scheme, ForegroundDifferences)
    ]
    return ([(alone, None)] if alone else []) + chained


def _step_words(step: float) -> str:
    return f"{100 * step:g} cm"


def _seen(lagged: Lagged, condition: Condition) -> Lagged:
    """Without what blinded sensors measure."""
    return lagged._replace(
        frame=_without(lagged.frame, condition.blinded), sent=_without(lagged.sent, condition.blinded)
    )


def _without(frame: Frame, blinded: Sequence[int]) -> Frame:
    measured = tuple(np.zeros_like(image) if k in blinded else image for k, image in enumerate(frame.measurements))
    return replace(frame, measurements=measured)


def _look(
    tallies: Sequence[_Tally],
    lagged: Lagged,
    condition: Condition,
    recording: Recording,
    detector: Detector,
    scenes: RecordingScenes,
    memory: LinkMemory,
    *,
    scored: bool,
) -> None:
    """One frame, fused by every system; views are shared by those that send alike. What differences send follows from
    frames as they were measured, whichever arrive, and what they restore is what whole images would."""
    frame, views = lagged.frame, {}
    sent = frame_view(lagged.sent, detector, recording.site, scene=scenes, memory=memory)
    sending = [k for k, age in enumerate(lagged.ages) if age == age and k not in condition.silent]
    for tally in tallies:
        codec = tally.system.codec
        if codec.digest not in views:
            views[codec.digest] = frame_view(frame, detector, recording.site, codec=codec, scene=scenes)
        scheme = tally.system.scheme
        fused = scheme.fuse(views[codec.digest], sending)
        if isinstance(scheme, ForegroundDifferences):
            fused = replace(fused, bits=np.array(scheme.sent_bits(sent, sending), np.int64))
        ages, detections = lagged.ages[sending] if sending else np.array([np.nan]), fused.detections
        if condition.tracks:  # what one sensor has long not renewed, others have: the middle of them
            detections = tally.tracked(detections, frame.time, float(np.median(ages)), begins=not lagged.since)
        if scored:
            tally.add(frame, recording, detections, fused.kbit_per_sensor, float(ages.mean()))


class _Tally:
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
        self._truths.append(int((counted & (frame.objects.labels == label_index(self._label))).sum()))
        self._kbit.append(kbit)
        self._ages.append(age)

    def row(self, condition: Condition, seed: int) -> StressRow:
        """The figures of all frames."""
        scores, hits, truths = np.concatenate(self._scores), np.concatenate(self._hits), sum(self._truths)
        ap = average_precision(precision_recall(scores, hits, truths)) if truths else np.nan
        low, high = ap_interval(self._scores, self._hits, self._truths, seed=seed)
        recall = float(hits.sum() / truths) if truths else np.nan
        precision = float(hits.mean()) if len(hits) else None
        judged = Judgement(ap, low, high, recall, precision, truths, len(self._truths), self._label)
        ages = np.array(self._ages)
        age = float(ages[~np.isnan(ages)].mean()) if (~np.isnan(ages)).any() else np.nan
        kbit, system = float(np.mean(self._kbit)), self.system
        said = (condition.kind, condition.level, system.scheme.name, system.name)
        return StressRow(*said, judged, kbit, age, self._label, self._iou)
