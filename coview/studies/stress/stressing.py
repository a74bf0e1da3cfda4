"""`run_stress`: AP of fusion schemes under every condition, with intervals, and the bits that they
send.

Objects centred in the site's area are to be found, by protocol `exact`. Where frames lie close
together, the first second after traffic restarts is not scored under any condition, because late
messages cannot have arrived yet. Intervals are a bootstrap over blocks of frames
(`placement_env.analysis.intervals`) with one seed, so conditions are compared on the same draws.
They are too narrow over frames close together, which resemble each other."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from hashlib import sha256

import numpy as np

from coview.studies.stress.conditions import (
    IN_SEQUENCE,
    KINDS,
    Condition,
    StressQuestion,
    System,
    make_conditions,
    make_systems,
)
from placement_env.analysis.intervals import Tally
from placement_env.report.content import Judgement
from toolkit.arrays import Float32
from toolkit.calibration.empty_scene import Scenes
from toolkit.datasets.recordings import ReadRecording, Reads, block_seed, read_frame
from toolkit.detection.link.channel import STALE, Lagged, Tracks, delay_frames
from toolkit.detection.metrics import matches
from toolkit.detection.scheme import Chained
from toolkit.detection.schemes import find_scheme
from toolkit.detection.view import LinkMemory, frame_view
from toolkit.frame import Frame, RecordingView, SiteRecording
from toolkit.objects import Detections, Detector, check_known, known_labels
from toolkit.points import has_centre_inside
from toolkit.runtime.cache import Cache, code_digest, make_key
from toolkit.runtime.run import Run
from toolkit.sensors.error_profiles import PAPER_ERRORS, ErrorProfile
from toolkit.sensors.error_terms import MOST_APART
from toolkit.sites.site import Site
from toolkit.traffic.spawner import LIFE

Needed = Callable[[int], Sequence[int]]  # messages that must have arrived before one can be read


@dataclass(frozen=True)
class StressRow:
    """One scheme under one condition.

    judged: AP with its interval; kbit_per_sensor: per frame, over the sensors that send; age: mean
    over sensors and frames of what the centre shows (s); label, iou: of what is to be found;
    amount: how much goes wrong, None if that is no number; tally: the detections behind
    `judged`."""

    kind: str
    level: str
    scheme: str
    codec: str
    judged: Judgement
    kbit_per_sensor: float
    age: float
    label: str
    iou: float
    amount: float | None = None
    tally: Tally | None = field(default=None, repr=False, compare=False)


def is_sequence(recording: SiteRecording) -> bool:
    """Return whether frames lie close enough together in time."""
    return 0 < _frame_spacing(recording) <= MOST_APART


def check_kinds(kinds: Sequence[str]) -> None:
    """Raise ValueError for an unknown kind of stress."""
    for kind in kinds:
        make_conditions(kind, ())


def choose_kinds(recording: SiteRecording, kinds: Sequence[str] | None = None) -> tuple[str, ...]:
    """Return the given kinds of stress, by default all that a recording can show. Raises ValueError
    for an unknown kind, and for one that needs frames closer together."""
    close = is_sequence(recording)
    check_kinds(kinds or ())
    for kind in kinds or ():
        if kind in IN_SEQUENCE and not close:
            raise ValueError(
                f"stress {kind!r} needs frames at most {MOST_APART} s apart, these are "
                f"{_frame_spacing(recording):g} s apart: record with coview simulate --every 0.1"
            )
    return tuple(kinds or ()) or tuple(kind for kind in KINDS if close or kind not in IN_SEQUENCE)


def _frame_spacing(recording: SiteRecording) -> float:
    return recording[1].time - recording[0].time if len(recording) > 1 else np.inf


class KeptDetections:
    """Detector that is asked once for each cloud, as most clouds come again under other conditions.

    cache: where detections are kept, None for memory alone; on disk, an interrupted stress test
    resumes, and one with other schemes, levels or IoU thresholds detects only what is new. Raises
    ValueError for a cache with a path and a detector without the attribute `digest`."""

    def __init__(self, detector: Detector, cache: Cache | None = None) -> None:
        digest = getattr(detector, "digest", None)
        self._cache = Cache() if cache is None else cache
        self.asked = 0
        if digest is None and self._cache.path is not None:
            said = "a detector whose detections are kept needs an attribute digest"
            raise ValueError(
                f"{said}, a text that changes with all that it depends on: add one, or keep nothing"
            )
        self.labels = known_labels(detector)
        self._detector = detector
        self._depends_on = [digest, code_digest(type(detector).__module__)]

    @staticmethod
    def of(detector: Detector, cache: Cache | None = None) -> "KeptDetections":
        """Return a detector that keeps its detections."""
        return detector if isinstance(detector, KeptDetections) else KeptDetections(detector, cache)

    def __call__(self, points: Float32[np.ndarray, "n 3"], /) -> Detections:
        """Return the detections for these points, in this order."""
        content = sha256(np.ascontiguousarray(points).tobytes()).hexdigest()
        key = make_key("detections", *self._depends_on, len(points), content)
        kept = self._cache.get([key])[0]
        if kept is None:
            self.asked += 1
            detections = self._detector(points)
            kept = detections.boxes, detections.scores, detections.labels
            self._cache.put({key: kept})
        return Detections(*kept)


def run_stress(
    recording: SiteRecording,
    detector: Detector,
    question: StressQuestion,
    run: Run = Run(),
    *,
    finished: Callable[[Sequence[StressRow]], None] | None = None,
) -> tuple[StressRow, ...]:
    """Put every scheme under every condition.

    run: its seed is that of noise, errors, channels and bootstrap, its frames are the first ones of
    the recording; with its cache an interrupted run resumes; finished: called with the rows of each
    condition. Raises ValueError as `choose_kinds` and `KeptDetections`, and for a label that the
    detector does not know."""
    check_known(detector, [question.label])
    kept = KeptDetections.of(detector, run.memo)
    names = [sensor.name for sensor in recording.sensors]
    conditions = [
        each
        for kind in choose_kinds(recording, question.kinds)
        for each in make_conditions(kind, names)
    ]
    count = min(len(recording), run.frames_or(len(recording)))
    report = run.stage("frames under stress", count * len(conditions))
    scenes = Scenes(ReadRecording(recording, Reads(noise_seed=run.seed)))
    each_frame = report if run.alone else None
    job = _ConditionJob(recording, kept, question, count, run.seed, scenes, each_frame)
    rows: list[StressRow] = []
    for number, more in enumerate(run.map(job, enumerate(conditions)), 1):
        rows += more
        if report is not None:
            report(number * count)
        if finished is not None:
            finished(more)
    return tuple(rows)


@dataclass(frozen=True, eq=False)
class _ConditionJob:
    """Work on all systems under one of several conditions."""

    recording: SiteRecording
    detector: KeptDetections
    question: StressQuestion
    frames: int
    seed: int
    scenes: Scenes
    report: Callable[[int], None] | None

    def __call__(self, task: tuple[int, Condition]) -> list[StressRow]:
        number, condition = task
        settled = STALE if _frame_spacing(self.recording) <= MOST_APART else 0.0
        systems = make_systems(
            [find_scheme(each) for each in self.question.schemes], condition.kind
        )
        trials = [Trial(system, self.question.label, self.question.iou) for system in systems]
        alone = [trial for trial in trials if not isinstance(trial.system.scheme, Chained)]
        groups: list[tuple[list[Trial], Needed | None]] = [(alone, None)] if alone else []
        groups += [
            ([t], t.system.scheme.dependencies)
            for t in trials
            if isinstance(t.system.scheme, Chained)
        ]
        for part, (some, needed) in enumerate(groups):
            memory: LinkMemory = {}
            redrawn = condition.redrawn
            errors = condition.errors
            arrivals = delay_frames(
                _RedrawnErrors(self.recording, errors, self.seed) if redrawn else self.recording,
                condition.channel,
                frames=self.frames,
                seed=self.seed,
                errors=PAPER_ERRORS if redrawn else errors,
                noise_seed=None if redrawn else self.seed,
                frozen=condition.frozen,
                needed=needed,
            )
            for k, lagged in enumerate(arrivals, 1):
                self._look(
                    some,
                    _blind(lagged, condition.blinded),
                    condition,
                    memory,
                    scored=lagged.since >= settled,
                )
                if self.report is not None:
                    self.report(number * self.frames + (part * self.frames + k) // len(groups))
        return [row for trial in trials for row in trial.rows(condition, self.seed)]

    def _look(
        self,
        trials: "Sequence[Trial]",
        lagged: Lagged,
        condition: Condition,
        memory: LinkMemory,
        *,
        scored: bool,
    ) -> None:
        """Fuse one frame by every system; those that send alike share views. Chained messages
        follow from frames as they were measured, whichever arrive, and restore whole images."""
        frame = lagged.frame
        site = self.recording.site
        views = {}
        sending = [
            k for k, age in enumerate(lagged.ages) if age == age and k not in condition.silent
        ]
        for trial in trials:
            codec = trial.system.codec
            if codec.digest not in views:
                views[codec.digest] = frame_view(
                    frame, self.detector, site, codec=codec, scene=self.scenes
                )
            scheme = trial.system.scheme
            fused = scheme.fuse(views[codec.digest], sending)
            if isinstance(scheme, Chained):
                sent = frame_view(
                    lagged.sent, self.detector, site, scene=self.scenes, memory=memory
                )
                fused = replace(fused, bits=np.array(scheme.sent_bits(sent, sending), np.int64))
            ages = lagged.ages[sending] if sending else np.array([np.nan])
            detections = fused.detections
            if condition.tracks:  # median age: one sensor may have been silent for long
                detections = trial.track(
                    detections, frame.time, float(np.median(ages)), begins=not lagged.since
                )
            if scored:
                trial.add(frame, site, detections, fused.kbit_per_sensor, float(ages.mean()))


class Trial:
    """Detections of one system under one condition, by frame."""

    def __init__(self, system: System, label: str, ious: Sequence[float]) -> None:
        self.system = system
        self._label = label
        self._ious = tuple(ious)
        # scores and hits of each frame
        self._found: list[list[tuple[np.ndarray, np.ndarray]]] = [[] for _ in ious]
        self._truths: list[int] = []
        self._kbit: list[float] = []
        self._ages: list[float] = []
        self._tracks = Tracks()
        self._last = -np.inf

    def track(self, detections: Detections, now: float, age: float, *, begins: bool) -> Detections:
        """Move detections of old measurements to their present places."""
        if begins:
            self._tracks = Tracks()
            self._last = -np.inf
        if age != age:
            return detections
        self._last = max(self._last, now - age)
        self._tracks.update(detections, self._last)
        return self._tracks.at(now)

    def add(
        self, frame: Frame, site: Site, detections: Detections, kbit: float, age: float
    ) -> None:
        """Score one more frame."""
        counted = has_centre_inside(frame.objects.boxes, site.area)
        at_ious = matches(detections, frame.objects, self._ious, label=self._label, counted=counted)
        for found, matched in zip(self._found, at_ious, strict=True):
            found.append(
                (detections.scores[~matched.ignored], matched.truth[~matched.ignored] >= 0)
            )
        self._truths.append(int(matched.scored.sum()))
        self._kbit.append(kbit)
        self._ages.append(age)

    def rows(self, condition: Condition, seed: int) -> list[StressRow]:
        """Figures over all frames, at each IoU."""
        ages = np.array(self._ages)
        label = self._label
        system = self.system
        age = float(ages[~np.isnan(ages)].mean()) if (~np.isnan(ages)).any() else np.nan
        names = (condition.kind, condition.level, system.scheme.name, system.name)
        rows = []
        for iou, found in zip(self._ious, self._found, strict=True):
            scores, hits = zip(*found, strict=True)
            tally = Tally.of_frames(scores, hits, self._truths)
            figures = (
                tally.ap,
                *tally.interval(seed=seed),
                tally.recall,
                tally.precision if len(tally.hit) else None,
            )
            judged = Judgement(*figures, sum(self._truths), len(self._truths), label)
            kbit = float(np.mean(self._kbit))
            rows.append(StressRow(*names, judged, kbit, age, label, iou, condition.amount, tally))
        return rows


@dataclass(frozen=True, eq=False)
class _RedrawnErrors(RecordingView):
    errors: ErrorProfile
    seed: int

    def __getitem__(self, index: int) -> Frame:
        return read_frame(
            self.recording,
            index,
            errors=self.errors,
            noise_seed=block_seed(self.seed, index // LIFE),
        )


def _blind(lagged: Lagged, sensors: Sequence[int]) -> Lagged:
    """Frames without what these sensors measure."""
    frame, sent = (
        replace(
            each,
            measurements=tuple(
                np.zeros_like(x) if k in sensors else x for k, x in enumerate(each.images)
            ),
        )
        for each in (lagged.frame, lagged.sent)
    )
    return lagged._replace(frame=frame, sent=sent)
