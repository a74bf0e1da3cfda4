"""`run_stress`: AP of fusion schemes under every condition, with intervals and sent bits.

Objects centred in the site's area are to be found, by protocol `exact`. If frames are close
together in time, the first second after traffic restarts is not scored under any condition, because
late messages cannot have arrived yet. Intervals are a bootstrap over blocks of frames
(`placement_env.analysis.intervals`) with one seed, so that conditions are compared on the same
draws. They are too narrow for frames close together, which resemble each other."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from hashlib import sha256

import numpy as np

from examples.studies.stress.channel import MAX_AGE_S, PERFECT, Lagged, delay_frames
from examples.studies.stress.conditions import (
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
from toolkit.arrays import Float32, Float64
from toolkit.calibration.recording_scenes import Scenes
from toolkit.datasets.recording_views import ReadRecording, Reads, block_seed, read_frame
from toolkit.detection.metrics import matches
from toolkit.detection.scheme import Chained
from toolkit.detection.schemes import find_scheme
from toolkit.detection.view import LinkMemory, frame_view
from toolkit.frame import Frame, RecordingView, SiteRecording
from toolkit.objects import Detections, Detector, check_known, known_labels
from toolkit.points import has_centre_inside
from toolkit.runtime.cache import Cache, code_digest, make_key
from toolkit.runtime.run import Run
from toolkit.sensors.error_profile import ErrorProfile
from toolkit.sensors.error_profiles import PAPER_ERRORS
from toolkit.sensors.track_velocities import MOST_APART
from toolkit.sites.site import Site
from toolkit.tracking.tracker import Tracker
from toolkit.traffic.spawner import LIFE

# called with the number of a message; returns the numbers of all messages needed to read it
Needed = Callable[[int], Sequence[int]]


@dataclass(frozen=True)
class StressRow:
    """One scheme under one condition.

    Attributes:
        kind: Kind of stress.
        level: Level in words.
        scheme: Name of the scheme.
        codec: Name of its codec.
        judged: AP with its interval.
        kbit_per_sensor: Mean kbit per frame of a sensor that sends.
        age: Mean age of the shown measurements, over sensors and frames (s), NaN without any.
        label: Class of the road users to find.
        iou: IoU threshold.
        amount: Level as a number, None if it is no number.
        tally: Detections behind `judged`."""

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
    """Return True if frames are close enough together in time to show late and lost messages."""
    return 0 < _frame_spacing(recording) <= MOST_APART


def check_stress_kinds(kinds: Sequence[str]) -> None:
    """Raise ValueError for an unknown kind of stress."""
    for kind in kinds:
        make_conditions(kind, ())


def choose_kinds(recording: SiteRecording, kinds: Sequence[str] | None = None) -> tuple[str, ...]:
    """Return the given kinds of stress, by default all that a recording can show.

    Raises ValueError for an unknown kind, and for a kind that needs frames closer together."""
    has_close_frames = is_sequence(recording)
    check_stress_kinds(kinds or ())
    for kind in kinds or ():
        if kind in IN_SEQUENCE and not has_close_frames:
            raise ValueError(
                f"stress {kind!r} needs frames at most {MOST_APART} s apart, these are "
                f"{_frame_spacing(recording):g} s apart: record with coview simulate --every 0.1"
            )
    if kinds:
        return tuple(kinds)
    return tuple(kind for kind in KINDS if has_close_frames or kind not in IN_SEQUENCE)


def _frame_spacing(recording: SiteRecording) -> float:
    # time between the first two frames (s), infinite with fewer
    return recording[1].time - recording[0].time if len(recording) > 1 else np.inf


class KeptDetections:
    """Detector that keeps its detections, because most clouds return under other conditions.

    cache: memory or file that keeps detections, None for memory only. With a cache on disk an
    interrupted stress test resumes, and a test of other schemes, levels or IoU thresholds detects
    only in new clouds. Raises ValueError for a cache with a path and a detector without `digest`.

    Attributes:
        asked: Number of clouds that the detector was run on.
        labels: Classes that the detector knows.
    """

    def __init__(self, detector: Detector, cache: Cache | None = None) -> None:
        digest = getattr(detector, "digest", None)
        self._cache = Cache() if cache is None else cache
        self.asked = 0
        if digest is None and self._cache.path is not None:
            raise ValueError(
                "a detector whose detections are kept needs an attribute digest, a text that "
                "changes with all that it depends on: add one, or keep nothing"
            )
        self.labels = known_labels(detector)
        self._detector = detector
        self._depends_on = [digest, code_digest(type(detector).__module__)]

    @staticmethod
    def from_detector(detector: Detector, cache: Cache | None = None) -> "KeptDetections":
        """Return a detector that keeps its detections, which may be `detector` itself."""
        if isinstance(detector, KeptDetections):
            return detector
        return KeptDetections(detector, cache)

    def __call__(self, points: Float32[np.ndarray, "n 3"], /) -> Detections:
        """Return the detections for these points; the same points in another order are new."""
        content = sha256(np.ascontiguousarray(points).tobytes()).hexdigest()
        key = make_key("detections, doubts", *self._depends_on, len(points), content)
        arrays = self._cache.get([key])[0]
        if arrays is None:
            self.asked += 1
            detections = self._detector(points)
            arrays = detections.boxes, detections.scores, detections.labels
            if detections.doubts is not None:
                arrays += (detections.doubts,)
            self._cache.put({key: arrays})
        return Detections(*arrays)


def run_stress(
    recording: SiteRecording,
    detector: Detector,
    question: StressQuestion,
    run: Run = Run(),
    *,
    finished: Callable[[Sequence[StressRow]], None] | None = None,
) -> tuple[StressRow, ...]:
    """Test every scheme under every condition.

    run: its seed is for noise, errors, channels and bootstrap, its frames are the number of first
    frames; with its cache an interrupted run resumes; finished: called with the rows of each
    condition. Raises ValueError like `choose_kinds` and `KeptDetections`, for a label that the
    detector does not know, and if no frame is scored."""
    check_known(detector, [question.label])
    kept_detections = KeptDetections.from_detector(detector, run.memo)
    names = [sensor.name for sensor in recording.sensors]
    conditions: list[Condition] = []
    for kind in choose_kinds(recording, question.kinds):
        conditions += make_conditions(kind, names, in_sequence=is_sequence(recording))
    count = min(len(recording), run.frames_or(len(recording)))
    _check_scored(recording, count)
    report = run.stage("frames under stress", count * len(conditions))
    scenes = Scenes(ReadRecording(recording, Reads(noise_seed=run.seed)))
    frame_report = report if run.has_one_process else None
    job = _ConditionJob(recording, kept_detections, question, count, run.seed, scenes, frame_report)
    rows: list[StressRow] = []
    for number, condition_rows in enumerate(run.map(job, enumerate(conditions)), 1):
        rows += condition_rows
        if report is not None:
            report(number * count)
        if finished is not None:
            finished(condition_rows)
    return tuple(rows)


def _settling_time(recording: SiteRecording) -> float:
    """Time after traffic restarts in which frames are not scored (s)."""
    return MAX_AGE_S if _frame_spacing(recording) <= MOST_APART else 0.0


def _check_scored(recording: SiteRecording, count: int) -> None:
    """Raise ValueError if the first frames leave no frame to score."""
    settled_s = _settling_time(recording)
    frames = delay_frames(recording, PERFECT, frames=count, noise_seed=None)
    if not any(lagged.since >= settled_s for lagged in frames):
        raise ValueError(
            f"{count} frames leave no frame to score, because the first {settled_s:g} s after "
            "traffic starts is never scored: use more frames"
        )


@dataclass(frozen=True, eq=False)
class _ConditionJob:
    """Work on all systems under one of several conditions.

    It is called with the number of a condition, from 0, and the condition, and returns its rows.

    Attributes:
        recording: Recording whose frames are tested.
        detector: Detector that keeps its detections.
        question: Schemes, class and IoU thresholds.
        frames: Number of first frames to test.
        seed: Seed of noise, errors, channels and bootstrap.
        scenes: Empty scenes of the sensors.
        report: Function that is called with the number of frames done over all conditions.
    """

    recording: SiteRecording
    detector: KeptDetections
    question: StressQuestion
    frames: int
    seed: int
    scenes: Scenes
    report: Callable[[int], None] | None

    def __call__(self, task: tuple[int, Condition]) -> list[StressRow]:
        number, condition = task
        settled_s = _settling_time(self.recording)
        schemes = [find_scheme(scheme) for scheme in self.question.schemes]
        systems = make_systems(schemes, condition.kind)
        area = self.recording.site.area
        trials = [Trial(system, self.question.label, self.question.iou, area) for system in systems]
        groups = _group_trials(trials)
        for group_index, (group_trials, needed) in enumerate(groups):
            memory: LinkMemory = {}
            for k, lagged in enumerate(self._delay_frames(condition, needed), 1):
                self._look(
                    group_trials,
                    _blind(lagged, condition.blinded),
                    condition,
                    memory,
                    scored=lagged.since >= settled_s,
                )
                if self.report is not None:
                    group_frames = (group_index * self.frames + k) // len(groups)
                    self.report(number * self.frames + group_frames)
        return [row for trial in trials for row in trial.rows(condition, self.seed)]

    def _delay_frames(self, condition: Condition, needed: Needed | None) -> Iterator[Lagged]:
        """Yield the frames as they arrive at the centre under a condition.

        needed: function that returns the messages needed to read one, None for only that one."""
        recording: SiteRecording | _RedrawnErrors = self.recording
        errors = condition.errors
        noise_seed: int | None = self.seed
        if condition.redrawn:  # errors and noise are in the frames already
            recording = _RedrawnErrors(self.recording, errors, self.seed)
            errors = PAPER_ERRORS
            noise_seed = None
        yield from delay_frames(
            recording,
            condition.channel,
            frames=self.frames,
            seed=self.seed,
            errors=errors,
            noise_seed=noise_seed,
            frozen=condition.frozen,
            needed=needed,
        )

    def _look(
        self,
        trials: "Sequence[Trial]",
        lagged: Lagged,
        condition: Condition,
        memory: LinkMemory,
        *,
        scored: bool,
    ) -> None:
        """Fuse one frame by every system, and add the detections to its trial.

        Systems with one codec share views. Chained messages depend on all measured frames, arrived
        or not, and restore whole images. lagged: frame as it has arrived; memory: state of the
        links of chained messages, changed in place; scored: False for a frame that only updates
        tracks and links."""
        frame = lagged.frame
        site = self.recording.site
        views = {}  # by digest of the codec
        has_arrived = ~np.isnan(lagged.ages)
        sending = [k for k in np.flatnonzero(has_arrived).tolist() if k not in condition.silent]
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
            if condition.tracks:
                median_age = float(np.median(ages))  # one sensor may have been silent for long
                begins = not lagged.since  # 0 s: traffic restarts with this frame
                detections = trial.track(detections, frame.time, median_age, begins=begins)
            if scored:
                trial.add(frame, site, detections, fused.kbit_per_sensor, float(ages.mean()))


def _group_trials(trials: Sequence["Trial"]) -> list[tuple[list["Trial"], Needed | None]]:
    """Group trials that can share frames.

    Each group comes with the function that returns the messages needed to read one, None if a
    message needs no other. All schemes without chained messages are one group."""
    groups: list[tuple[list[Trial], Needed | None]] = []
    unchained = [trial for trial in trials if not isinstance(trial.system.scheme, Chained)]
    if unchained:
        groups.append((unchained, None))
    for trial in trials:
        scheme = trial.system.scheme
        if isinstance(scheme, Chained):
            groups.append(([trial], scheme.dependencies))
    return groups


class Trial:
    """Detections of one system under one condition, by frame.

    Args:
        system: Scheme and codec.
        label: Class of the road users to find.
        ious: IoU thresholds.
        area: Detection area: xmin, ymin, xmax, ymax (m)."""

    def __init__(
        self, system: System, label: str, ious: Sequence[float], area: Float64[np.ndarray, "4"]
    ) -> None:
        self.system = system
        self._label = label
        self._ious = tuple(ious)
        self._area = area.tolist()
        # for each IoU: scores of the detections of each frame, and masks of the hits
        self._found: list[list[tuple[np.ndarray, np.ndarray]]] = [[] for _ in ious]
        self._truths: list[int] = []
        self._kbit: list[float] = []
        self._ages: list[float] = []
        self._tracker = Tracker(self._area)
        self._last = -np.inf  # time (s) of the newest measurement in the tracks

    def track(self, detections: Detections, now: float, age: float, *, begins: bool) -> Detections:
        """Return the tracks of all measurements so far, moved to the present.

        Args:
            detections: Detections in the newest measurements that have arrived.
            now: Time of the frame (s).
            age: Age of these measurements (s), NaN without any; if they are no newer than the
                last ones, nothing changes.
            begins: True to begin without tracks, as traffic restarts."""
        if begins:
            self._tracker = Tracker(self._area)
            self._last = -np.inf
        if now - age > self._last:
            self._last = now - age
            self._tracker.update(detections, self._last)
        return self._tracker.at(now)

    def add(
        self, frame: Frame, site: Site, detections: Detections, kbit: float, age: float
    ) -> None:
        """Score one more frame. kbit: mean data of a sensor; age: mean age of measurements (s)."""
        counted = has_centre_inside(frame.objects.boxes, site.area)
        at_ious = matches(detections, frame.objects, self._ious, label=self._label, counted=counted)
        for iou_frames, matched in zip(self._found, at_ious, strict=True):
            is_counted = ~matched.ignored
            iou_frames.append((detections.scores[is_counted], matched.truth[is_counted] >= 0))
        self._truths.append(int(matched.scored.sum()))
        self._kbit.append(kbit)
        self._ages.append(age)

    def rows(self, condition: Condition, seed: int) -> list[StressRow]:
        """Return the figures over all frames, a row for each IoU. seed: seed of the draws."""
        ages = np.array(self._ages)
        ages = ages[~np.isnan(ages)]
        rows = []
        for iou, iou_frames in zip(self._ious, self._found, strict=True):
            scores, hits = zip(*iou_frames, strict=True)
            tally = Tally.of_frames(scores, hits, self._truths)
            interval = tally.interval(seed=seed)
            judgement = Judgement(
                ap=tally.ap,
                low=interval.low,
                high=interval.high,
                recall=tally.recall,
                precision=tally.precision if len(tally.hit) else None,
                vehicles=sum(self._truths),
                frames=len(self._truths),
                kind=self._label,
            )
            row = StressRow(
                kind=condition.kind,
                level=condition.level,
                scheme=self.system.scheme.name,
                codec=self.system.name,
                judged=judgement,
                kbit_per_sensor=float(np.mean(self._kbit)),
                age=float(ages.mean()) if len(ages) else np.nan,
                label=self._label,
                iou=iou,
                amount=condition.amount,
                tally=tally,
            )
            rows.append(row)
        return rows


@dataclass(frozen=True, eq=False)
class _RedrawnErrors(RecordingView):
    """A recording whose errors and noise are drawn again for each block of `LIFE` frames."""

    errors: ErrorProfile
    seed: int

    def __getitem__(self, index: int) -> Frame:
        noise_seed = block_seed(self.seed, index // LIFE)
        return read_frame(self.recording, index, errors=self.errors, noise_seed=noise_seed)


def _blind(lagged: Lagged, sensors: Sequence[int]) -> Lagged:
    """Return both frames, the arrived and the sent one, with blank images of these sensors."""
    frame = _blank_images(lagged.frame, sensors)
    return lagged._replace(frame=frame, sent=_blank_images(lagged.sent, sensors))


def _blank_images(frame: Frame, sensors: Sequence[int]) -> Frame:
    # frame in which these sensors (indices) measure nothing in any pixel
    images = list(frame.images)
    for k in sensors:
        images[k] = np.zeros_like(images[k])
    return replace(frame, measurements=tuple(images))
