"""`coview evaluate --tracks`: score tracks of a file against a recording's truth."""

import json
import warnings
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from coview.arguments import check_least, check_positive, check_share
from coview.commands.detection.evaluation_options import Rules, Subject
from coview.outputs import OK, Writing, check_folder, print_result
from coview.progress_bar import progress_bar
from coview.recordings import Opening
from coview.tracks import TEXT, find_sequence, number_frames, read_tracks
from toolkit.calibration.place import Place

if TYPE_CHECKING:
    from toolkit.detection.track_evaluation import ScoredFrame
    from toolkit.runtime.run import Run

SCORES_FILE = "table.json"
SCORING = ("classes", "iou", "metric", "protocol", "similarity", "link")  # rules for tracks


def evaluate_track_file(
    dataset: Path,
    *,
    out: Path,
    subject: Subject,
    rules: Rules,
    opening: Opening,
    place: Place,
    run: "Run",
    writing: Writing,
) -> int:
    """Score a file of tracks against the truth of a recording or a text of labels.

    Arguments as in `coview.commands.detection.evaluate.evaluate_command`, whose `subject` names the
    tracks. Returns the exit code; raises ValueError and OSError, by name, for options and files
    that do not fit."""
    from toolkit.detection.track_evaluation import evaluate_tracks
    from toolkit.runtime.writing import write_text
    from toolkit.tracking.scores import CLEAR_THRESHOLD

    path = subject.tracks
    if path is None:
        raise ValueError("give --tracks")
    _check_track_options(subject, rules)
    check_least("--frames", run.frames, 1, "leave it out for all")
    if not path.exists():
        raise FileNotFoundError(f"no such file of tracks: {path}")
    inputs = [dataset, path, *opening.files]
    check_folder(out, holds=SCORES_FILE, inputs=inputs, overwrite=writing.overwrite)
    if _holds_labels(dataset, path):
        paired = _pair_labels(dataset, path, rules.link.rate, run.frames)
    else:
        if rules.link.rate is not None:
            raise ValueError("--rate is for texts of labels: a recording has times, leave it out")
        reading = _Reading(opening, place, rules.protocol, run.frames)
        paired = reading.pair(dataset, path, hidden=writing.json)
    evaluation = evaluate_tracks(
        paired.frames,
        rules.classes,
        ious=rules.iou,
        metric=rules.metric,
        thresholds=rules.similarity or (CLEAR_THRESHOLD,),
    )
    evaluation = replace(evaluation, problems=paired.problems)
    figures = evaluation.as_dict()
    write_text(out / SCORES_FILE, f"{json.dumps(figures, indent=1)}\n")
    text = f"{evaluation.text()}\nwritten to {out}/{SCORES_FILE}"
    print_result(figures, text, as_json=writing.json)
    return OK


def _check_track_options(subject: Subject, rules: "Rules") -> None:
    """Raise ValueError for options that do not go with --tracks."""
    # names of the options of each group that go with --tracks; all others must have their defaults
    for group, allowed_names in ((subject, ("tracks",)), (rules, SCORING)):
        default_options = type(group)()
        for option in fields(group):
            name = option.name
            is_default = getattr(group, name) == getattr(default_options, name)
            if name not in allowed_names and not is_default:
                raise ValueError(f"--{name} does not go with --tracks: leave it out")
    # only the rate of the link may be set
    if replace(rules.link, rate=None) != type(rules.link)():
        raise ValueError("--codec and --step do not go with --tracks: leave them out")
    if rules.protocol == "published":
        raise ValueError("--protocol published does not go with --tracks: give exact or measured")
    for similarity in rules.similarity or ():
        check_share("--similarity", similarity)


def _holds_labels(dataset: Path, tracks: Path) -> bool:
    """Return True if a path is a text of labels, or a folder of texts next to one of tracks."""
    return dataset.suffix.lower() == TEXT or (dataset.is_dir() and tracks.is_dir())


class _Paired(NamedTuple):
    """Tracks and truth of each frame, and the number of rows left out, by kind."""

    frames: "list[ScoredFrame]"
    problems: dict[str, int]


@dataclass(frozen=True)
class _Reading:
    """Options for reading the truth of a recording.

    Attributes:
        opening: Options for opening it.
        place: Detection area.
        protocol: Objects that are to be found, None for the usual ones.
        frames: Number of first frames, None for all."""

    opening: Opening
    place: Place
    protocol: str | None
    frames: int | None

    def pair(self, dataset: Path, path: Path, *, hidden: bool) -> _Paired:
        """Return tracks and truth of each frame of a recording.

        dataset: the recording; path: file of tracks; hidden: True to show no progress."""
        from toolkit.datasets.listing import check_labels
        from toolkit.datasets.recording_views import Reads
        from toolkit.detection.track_truth import pair_with_truth, read_truth

        with self.opening.open(dataset) as recording:
            count = Reads(frames=self.frames).count(recording)
            check_labels(recording, count)
            sequence = find_sequence(dataset, self.opening)
            file = read_tracks(path, sequence)
            default_protocol = "exact" if self.place.uses_site(recording.site) else "measured"
            with progress_bar("frame", count, hidden=hidden) as bar:
                truth = read_truth(
                    number_frames(recording, sequence),
                    count,
                    self.place,
                    needs_points=(self.protocol or default_protocol) == "measured",
                    progress=bar.to,
                )
            is_part = count < len(recording)
        return _Paired(pair_with_truth(file, truth, is_part=is_part), file.problems)


def _pair_labels(labels: Path, tracks: Path, rate_hz: float | None, count: int | None) -> _Paired:
    """Return tracks and labels of each frame of KITTI's tracking text.

    rate_hz: frames in a second, None if unknown; count: number of first frames, None for all."""
    from toolkit.detection.track_labels import describe_unscored, pair_with_labels

    check_positive("--rate", rate_hz)
    paired = pair_with_labels(labels, tracks, rate_hz, count)
    if paired.unscored:
        warnings.warn(describe_unscored(paired.unscored), stacklevel=2)
    if paired.late:
        warnings.warn(
            f"{paired.late} frames have tracks after the last labelled one, which count as false "
            "alarms",
            stacklevel=2,
        )
    return _Paired(paired.frames, paired.problems)
