"""Evaluation of tracks: AP of their boxes, and the scores and errors of the tracks.

AP, as in `toolkit.detection.metrics`, takes every track in every frame. HOTA, MOTA and IDF1 are
defined in `toolkit.tracking.scores`, AMOTA and sAMOTA in `toolkit.tracking.recall_sweep`, errors of
speed and heading and times to the first detection in `toolkit.tracking.object_errors`, and what
does not count in `toolkit.tracking.frame_overlap`."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from typing import Any, NamedTuple

import numpy as np

from toolkit.arrays import Mask
from toolkit.boxes import Overlap
from toolkit.detection.comparison import class_thresholds
from toolkit.detection.metrics import evaluate
from toolkit.display import describe_count, format_share
from toolkit.objects import LABELS, label_index
from toolkit.runtime.text_tables import align_columns
from toolkit.runtime.text_values import replace_infinite
from toolkit.tracking.frame_overlap import measure_overlap
from toolkit.tracking.object_errors import ObjectErrors, TruthMotion, measure_errors
from toolkit.tracking.recall_sweep import SweepScores, sweep_recalls
from toolkit.tracking.scores import CLEAR_THRESHOLD, TrackScores, match_clear, score_pairs
from toolkit.tracking.tracks import Tracks


class ScoredFrame(NamedTuple):
    """Tracks and truth of one frame.

    Attributes:
        tracks: m tracks; velocities are NaN if they are unknown.
        truth: n true objects, with time and velocities.
        counted: (n,), mask of the objects that are to be found.
        outside: (m,), mask of the tracks that are no false alarm without a match."""

    tracks: Tracks
    truth: TruthMotion
    counted: Mask
    outside: Mask


@dataclass(frozen=True)
class TrackApRow:
    """AP of the boxes of tracks.

    Attributes:
        label: Name of the class.
        iou: IoU from which a box is true.
        ap: Average precision, NaN without objects.
        truths: Objects to find in all frames."""

    label: str
    iou: float
    ap: float
    truths: int


@dataclass(frozen=True)
class ClassTracks:
    """Scores of the tracks of a class.

    Attributes:
        label: Name of the class.
        threshold: Similarity from which an object and a track match, except for HOTA.
        scores: HOTA, MOTA and IDF1.
        sweep: AMOTA and sAMOTA.
        errors: Errors of motion, and times to the first detection."""

    label: str
    threshold: float
    scores: TrackScores
    sweep: SweepScores
    errors: ObjectErrors

    def as_dict(self) -> dict[str, Any]:
        """Return all figures by name for JSON; NaN and infinity become None."""
        figures = {"label": self.label, "threshold": self.threshold, **asdict(self.scores)}
        return replace_infinite(figures | self.sweep._asdict() | self.errors._asdict())


@dataclass(frozen=True)
class TrackEvaluation:
    """Scores of the tracks of a recording.

    Attributes:
        rows: AP of each class and IoU threshold.
        tracks: Scores of each class and threshold.
        frames: Number of frames.
        problems: Number of rows of the files left out, by kind."""

    rows: tuple[TrackApRow, ...]
    tracks: tuple[ClassTracks, ...]
    frames: int
    problems: dict[str, int] = field(default_factory=dict)

    def as_dict(self) -> dict[str, Any]:
        """Return all figures for JSON; NaN and infinity become None."""
        rows = replace_infinite([asdict(row) for row in self.rows])
        tracks = [scores.as_dict() for scores in self.tracks]
        return {
            "rows": rows,
            "tracks": tracks,
            "frames": self.frames,
            "problems": dict(self.problems),
        }

    def text(self) -> str:
        """Return all figures as tables of text."""
        parts = [_format_ap(self.rows), _format_scores(self.tracks), _format_errors(self.tracks)]
        if self.problems:
            counts = ", ".join(f"{number} {kind}" for kind, number in self.problems.items())
            parts.append(f"left out: {counts}")
        return "\n\n".join(parts)


def evaluate_tracks(
    frames: Sequence[ScoredFrame],
    labels: Sequence[str] | None = None,
    *,
    ious: Sequence[float] | None = None,
    metric: Overlap = "3d",
    thresholds: Sequence[float] = (CLEAR_THRESHOLD,),
) -> TrackEvaluation:
    """Score tracks against the truth, as defined in the modules named above.

    Args:
        frames: Tracks and truth of each frame.
        labels: Names of the classes, None for those with an object to find.
        ious: IoU thresholds of AP, None for each class's usual ones.
        metric: IoU of volumes or of footprints, for AP.
        thresholds: Similarities from which an object and a track match, except for HOTA.

    Raises ValueError if no object is to be found."""
    label_parts = [np.zeros(0, np.int64)]
    label_parts += [frame.truth.objects.labels[frame.counted] for frame in frames]
    class_numbers = np.unique(np.concatenate(label_parts)).tolist()  # objects to find
    classes = [LABELS[number] for number in class_numbers] if labels is None else list(labels)
    if not {label_index(label) for label in classes} & set(class_numbers):
        raise ValueError(
            f"no {' and no '.join(classes) or 'road user'} is to be found in "
            f"{describe_count(len(frames), 'frame')}: give more frames, other --classes or another "
            "area"
        )
    rows: list[TrackApRow] = []
    tracks: list[ClassTracks] = []
    for label in classes:
        rows += _score_boxes(frames, label, ious=class_thresholds(ious, label), metric=metric)
        tracks += _score_class(frames, label, thresholds)
    return TrackEvaluation(rows=tuple(rows), tracks=tuple(tracks), frames=len(frames))


def _score_boxes(
    frames: Sequence[ScoredFrame], label: str, ious: Sequence[float], metric: Overlap
) -> list[TrackApRow]:
    """AP of a class's tracks at each IoU threshold, each frame's boxes taken as detections.

    metric: overlap of two boxes that the thresholds are about."""
    scores = evaluate(
        [frame.tracks for frame in frames],
        [frame.truth.objects for frame in frames],
        iou_thresholds=ious,
        metric=metric,
        label=label,
        counted=[frame.counted for frame in frames],
        outside=[frame.outside for frame in frames],
    )
    return [
        TrackApRow(label, iou=iou, ap=score.ap, truths=score.truths)
        for iou, score in scores.items()
    ]


def _score_class(
    frames: Sequence[ScoredFrame], label: str, thresholds: Sequence[float]
) -> list[ClassTracks]:
    """Score the tracks of a class at each threshold; return a row for each.

    frames: tracks and truth of each frame in order; label: name of the class; thresholds:
    similarities from which a track and an object can be matched."""
    class_number = label_index(label)
    overlaps = []  # similarities of objects and tracks, by frame
    for frame in frames:
        overlap = measure_overlap(
            frame.tracks,
            frame.truth.objects,
            class_number,
            counted=frame.counted,
            outside=frame.outside,
        )
        overlaps.append(overlap)
    rows = []
    for threshold in thresholds:
        # only what counts at this threshold
        scored_frames = [overlap.scored(threshold) for overlap in overlaps]
        pairs = [scored_frame.pairs for scored_frame in scored_frames]
        errors = measure_errors(
            scored_frames,
            match_clear(pairs, threshold).matches,
            tracks=[frame.tracks for frame in frames],
            truths=[frame.truth for frame in frames],
        )
        rows.append(
            ClassTracks(
                label,
                threshold=threshold,
                scores=score_pairs(pairs, threshold),
                sweep=sweep_recalls(overlaps, threshold),
                errors=errors,
            )
        )
    return rows


def _format_ap(rows: Sequence[TrackApRow]) -> str:
    """Format AP as a table of text."""
    table = [["class", "to find", "IoU", "AP"]]
    for row in rows:
        ap = format_share(row.ap, row.truths)
        table.append([row.label, str(row.truths), f"{row.iou:g}", ap])
    return align_columns(table, texts=1)


def _format_scores(rows: Sequence[ClassTracks]) -> str:
    """Format HOTA, MOTA, IDF1 and sAMOTA as a table of text, a line for each class and match."""
    headings = ["class", "match", "objects", "HOTA", "DetA", "AssA", "MOTA", "IDF1", "switches"]
    table = [[*headings, "mostly tracked", "AMOTA", "sAMOTA"]]
    for row in rows:
        scores = row.scores
        shares = (scores.hota, scores.deta, scores.assa, scores.mota, scores.idf1)
        cells = [row.label, f"{row.threshold:g}", str(scores.objects)]
        cells += [_format_number(value, 3) for value in shares]
        cells += [str(scores.switches), _format_number(scores.mostly_tracked, 3)]
        cells += [_format_number(row.sweep.amota, 3), _format_number(row.sweep.samota, 3)]
        table.append(cells)
    return align_columns(table, texts=1)


def _format_errors(rows: Sequence[ClassTracks]) -> str:
    """Format errors of motion and times to the first detection as a table of text.

    A line is for a class and a match, the threshold at which a track matches an object."""
    headings = ["class", "match", "speed m/s", "heading °", "come in", "first detection s"]
    table = [[*headings, "95 % s", "never found"]]
    for row in rows:
        errors = row.errors
        cells = [row.label, f"{row.threshold:g}", _format_number(errors.speed_error_mps, 2)]
        cells += [_format_number(errors.heading_error_deg, 1), str(errors.entering)]
        cells += [_format_number(errors.first_detection_s, 1)]
        cells += [_format_number(errors.first_detection_95_s, 1)]
        cells += [_format_number(errors.never_found, 3)]
        table.append(cells)
    return align_columns(table, texts=1)


def _format_number(value: float, digits: int) -> str:
    """Format a number, "-" if it is unknown and "never" if it is infinite."""
    if np.isnan(value):
        return "-"
    return "never" if np.isinf(value) else f"{value:.{digits}f}"
