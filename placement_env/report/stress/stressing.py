"""`stress`: the AP of fusion schemes under every condition, with intervals, and what they send.

Objects centred in the site's area are to be found, by protocol `exact`. Where frames lie close together the first
second after traffic began anew is not scored under any condition: messages that are late have not come yet. Intervals
are a bootstrap over blocks of frames (`placement_env.analysis.intervals`), of one seed, so that conditions are compared
on the same draws; over frames close together, which resemble each other, they are too narrow.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace

import numpy as np

from placement_env.analysis.intervals import BLOCK_FRAMES
from placement_env.report.stress.conditions import IN_SEQUENCE, KINDS, Condition, conditions_of
from placement_env.report.stress.kept_detections import KeptDetections
from placement_env.report.stress.outcomes import Run, StressRow
from placement_env.report.stress.systems import systems_of
from toolkit.calibration.recording_scenes import RecordingScenes
from toolkit.datasets.readings import read_frame
from toolkit.detection.evaluation import Recording
from toolkit.detection.link.channel import STALE
from toolkit.detection.link.lagged import Lagged, lagged_frames
from toolkit.detection.scheme import Chained, Scheme
from toolkit.detection.schemes import SCHEMES, scheme_of
from toolkit.detection.view import LinkMemory, frame_view
from toolkit.frame import Frame
from toolkit.objects import LABELS, VEHICLE, Detector, check_known, label_index
from toolkit.sensors.errors.clock import MOST_APART
from toolkit.sensors.errors.profile import ErrorProfile

Needed = Callable[[int], Sequence[int]]  # which messages must have arrived for one to be read


def in_sequence(recording: Recording) -> bool:
    """Whether its frames lie close enough together to show what is late or lost."""
    return 0 < _apart(recording) <= MOST_APART


def kinds_for(recording: Recording, kinds: Sequence[str] = ()) -> tuple[str, ...]:
    """The kinds asked for, or all that a recording can show. Raises ValueError for one that there is not, and one that
    needs frames closer together."""
    for kind in kinds:
        conditions_of(kind, ())
    close = in_sequence(recording)
    for kind in kinds:
        if kind in IN_SEQUENCE and not close:
            raise ValueError(
                f"stress {kind!r} needs frames at most {MOST_APART} s apart, these are {_apart(recording):g} s: record "
                "some with coview simulate --every 0.1"
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
    ious: Sequence[float] = (0.7,),
    seed: int = 0,
    progress: Callable[[int, int], None] | None = None,
    finished: Callable[[Sequence[StressRow]], None] | None = None,
) -> tuple[StressRow, ...]:
    """Every scheme under the conditions of every kind, all that the recording can show if none is named, at every IoU.

    frames: only the first so many; label, ious: of what is to be found; seed: of noise, errors, channels and bootstrap;
    progress: called with how many frames are done, of how many; finished: called with the rows of each condition. A
    detector that is a `KeptDetections` with a file goes on where a run was stopped. Raises ValueError as `kinds_for`,
    and for a label that there is not or the detector does not know.
    """
    check_known(detector, [LABELS[label_index(label)]])
    chosen = [scheme_of(scheme) for scheme in schemes]
    if not (chosen and len(ious)):
        raise ValueError(f"there must be a scheme to stress, and an IoU: choose among {', '.join(SCHEMES)}")
    names = [sensor.name for sensor in recording.sensors]
    conditions = [each for kind in kinds_for(recording, kinds) for each in conditions_of(kind, names)]
    count = min(len(recording), len(recording) if frames is None else frames)
    if count < 1:
        raise ValueError(f"there must be a frame to stress, got {frames} of {len(recording)}")
    settled = STALE if _apart(recording) <= MOST_APART else 0.0
    scenes, detect = RecordingScenes(recording, noise_seed=seed), KeptDetections.of(detector)
    rows: list[StressRow] = []
    for number, condition in enumerate(conditions):
        runs = [Run(system, label, ious) for system in systems_of(chosen, condition.kind)]
        done = 0
        for some, needed in _arriving_alike(runs):
            memory: LinkMemory = {}
            for lagged in _arriving(recording, condition, count, seed, needed):
                seen, scored = _seen(lagged, condition), lagged.since >= settled
                _look(some, seen, condition, recording, detect, scenes, memory, scored=scored)
                done += len(some)
                if progress is not None:
                    progress(number * count + done // len(runs), count * len(conditions))
        rows += [row for run in runs for row in run.rows(condition, seed)]
        if finished is not None:
            finished(rows[-len(runs) * len(ious) :])
    return tuple(rows)


def _arriving_alike(runs: Sequence[Run]) -> list[tuple[list[Run], Needed | None]]:
    """The systems whose messages can be read when they arrive, and each of those that need others before."""
    alone: list[Run] = []
    chained: list[tuple[list[Run], Needed | None]] = []
    for run in runs:
        if isinstance(run.system.scheme, Chained):
            chained.append(([run], run.system.scheme.needed))
        else:
            alone.append(run)
    return [*([(alone, None)] if alone else []), *chained]


def _arriving(
    recording: Recording, condition: Condition, count: int, seed: int, needed: Needed | None
) -> Iterator[Lagged]:
    """What the centre has in each frame under a condition."""
    if condition.redrawn:
        read = _Redrawn(recording, condition.errors, seed)
        return lagged_frames(read, condition.channel, frames=count, seed=seed, noise_seed=None, needed=needed)
    return lagged_frames(
        recording, condition.channel, frames=count, seed=seed, errors=condition.errors, noise_seed=seed,
        frozen=condition.frozen, needed=needed,
    )  # fmt: skip


class _Redrawn:
    """Frames as sensors say them whose errors are others in every block of frames."""

    def __init__(self, recording: Recording, errors: ErrorProfile, seed: int) -> None:
        self._recording, self._errors, self._seed = recording, errors, seed

    def __len__(self) -> int:
        return len(self._recording)

    def __getitem__(self, index: int, /) -> Frame:
        seed = int(np.random.default_rng([self._seed, index // BLOCK_FRAMES]).integers(2**31))
        return read_frame(self._recording, index, errors=self._errors, noise_seed=seed)


def _seen(lagged: Lagged, condition: Condition) -> Lagged:
    """Without what blinded sensors measure."""
    return lagged._replace(
        frame=_without(lagged.frame, condition.blinded), sent=_without(lagged.sent, condition.blinded)
    )


def _without(frame: Frame, blinded: Sequence[int]) -> Frame:
    measured = tuple(np.zeros_like(image) if k in blinded else image for k, image in enumerate(frame.measurements))
    return replace(frame, measurements=measured)


def _look(
    runs: Sequence[Run],
    lagged: Lagged,
    condition: Condition,
    recording: Recording,
    detector: Detector,
    scenes: RecordingScenes,
    memory: LinkMemory,
    *,
    scored: bool,
) -> None:
    """One frame, fused by every system; views are shared by those that send alike. What chained messages say follows
    from frames as they were measured, whichever arrive, and what they restore is what whole images would."""
    frame, views = lagged.frame, {}
    sending = [k for k, age in enumerate(lagged.ages) if age == age and k not in condition.silent]
    for run in runs:
        codec = run.system.codec
        if codec.digest not in views:
            views[codec.digest] = frame_view(frame, detector, recording.site, codec=codec, scene=scenes)
        scheme = run.system.scheme
        fused = scheme.fuse(views[codec.digest], sending)
        if isinstance(scheme, Chained):
            sent = frame_view(lagged.sent, detector, recording.site, scene=scenes, memory=memory)
            fused = replace(fused, bits=np.array(scheme.sent_bits(sent, sending), np.int64))
        ages, detections = lagged.ages[sending] if sending else np.array([np.nan]), fused.detections
        if condition.tracks:  # what one sensor has long not renewed, others have: the middle of them
            detections = run.tracked(detections, frame.time, float(np.median(ages)), begins=not lagged.since)
        if scored:
            run.add(frame, recording.site, detections, fused.kbit_per_sensor, float(ages.mean()))
