"""AP, recall and HOTA of each class in a street, next to the AP that its plan promises.

Objects count as in the plan: those with their centre in the site's area, by protocol `exact` of
`toolkit.detection.metrics`. Intervals are a bootstrap over blocks of `BLOCK_S`, in which road users
come and go twice."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace

import numpy as np

from placement_env.acceptance.street_detections import FrameBoxes
from placement_env.analysis.intervals import (
    BLOCK_FRAMES,
    RESAMPLES,
    Interval,
    Tally,
    draws_of_blocks,
    figure_interval,
)
from placement_env.report.content import Judgement
from placement_env.report.planning.plan_folder import StatedClass
from toolkit.arrays import Float64, Int64
from toolkit.detection.metrics import matches
from toolkit.points import has_centre_inside
from toolkit.sites.site import Site
from toolkit.tracking.scores import score_tracks
from toolkit.tracking.tracks import Tracks

BLOCK_S = 40.0  # two stays of a road user


@dataclass(frozen=True)
class ClassCheck:
    """One class of road users in a street.

    Attributes:
        label: name of the class.
        is_promised: True if the class counts in the plan; others are shown only.
        iou: IoU from which a detection counts; several for their mean.
        promised: result by the plan.
        measured: result by the recording, None without an object of the class.
        hota: HOTA of its tracks (`toolkit.tracking.scores`), None if nothing was tracked."""

    label: str
    is_promised: bool
    iou: float | tuple[float, ...]
    promised: Judgement
    measured: Judgement | None
    hota: float | None

    @property
    def is_compared(self) -> bool:
        """True if both figures have intervals."""
        return self.measured is not None and self.measured.known and self.promised.known

    @property
    def falls_short(self) -> bool:
        """True if the measured AP of a class that counts is certainly below the promised one."""
        if self.measured is None or not (self.is_promised and self.is_compared):
            return False
        return self.measured.high < self.promised.low

    def as_dict(self) -> dict[str, object]:
        """Return all figures as plain values for JSON."""
        return {**asdict(self), "compared": self.is_compared, "falls_short": self.falls_short}


def compare_classes(
    frames: Sequence[FrameBoxes],
    stated: Sequence[StatedClass],
    site: Site,
    tracks: Sequence[Tracks] | None,
    seed: int = 0,
) -> tuple[ClassCheck, ...]:
    """Score each class that the plan states a result of.

    Args:
        frames: Detections and labels of each frame.
        stated: Results by the plan.
        site: Planned site.
        tracks: Tracks in each frame, None if frames are too far apart to follow anyone.
        seed: Seed of the intervals."""
    blocks = find_blocks([frame.time for frame in frames])
    checks = []
    for promise in stated:
        tallies = [
            tally_class(frames, promise.label, iou, site) for iou in np.atleast_1d(promise.iou)
        ]
        measured = None
        if tallies[0].truths.any():
            measured = replace(judge_class(tallies, blocks, seed), kind=promise.judged.kind)
        hota = None
        if tracks is not None and measured is not None:
            hota = _score_hota(frames, tracks, promise.label, site)
        check = ClassCheck(
            label=promise.label,
            is_promised=promise.weight > 0,
            iou=promise.iou,
            promised=promise.judged,
            measured=measured,
            hota=hota,
        )
        checks.append(check)
    return tuple(checks)


def find_blocks(times: Sequence[float]) -> Int64[np.ndarray, " frames"]:
    """Return the number of each frame's block for the bootstrap.

    times: time of each frame (s); if they do not rise, blocks have `BLOCK_FRAMES` frames."""
    seconds = np.asarray(times, np.float64)
    if len(seconds) > 1 and (np.diff(seconds) > 0).all():
        # half a millisecond, since times that are sums of steps may lie just below a block
        return np.floor((seconds - seconds[0] + 0.0005) / BLOCK_S).astype(np.int64)
    return np.arange(len(seconds)) // BLOCK_FRAMES


def tally_class(frames: Sequence[FrameBoxes], label: str, iou: float, site: Site) -> Tally:
    """Tally the detections of one class that count, at one IoU threshold.

    An object counts if its centre is in the site's area; a detection that hits another object is
    neither a hit nor a false alarm. label: name of the class."""
    scores = []
    hits = []
    truths = []
    for frame in frames:
        counted = has_centre_inside(frame.objects.boxes, site.area)
        (match,) = matches(frame.detections, frame.objects, [iou], label=label, counted=counted)
        is_counted = ~match.ignored
        scores.append(frame.detections.scores[is_counted])
        hits.append(match.truth[is_counted] >= 0)
        truths.append(int(match.scored.sum()))
    return Tally.of_frames(scores, hits, truths)


def judge_class(
    tallies: Sequence[Tally], blocks: Int64[np.ndarray, " frames"], seed: int
) -> Judgement:
    """Return the mean result over the IoU thresholds, with its interval over blocks of frames.

    tallies: one for each threshold; blocks: number of each frame's block."""
    draws = draws_of_blocks(blocks, resamples=RESAMPLES, seed=seed)
    figures: Float64[np.ndarray, "ious resamples"] = np.stack(
        [tally.resamples(draws=draws) for tally in tallies]
    )
    objects = int(tallies[0].truths.sum())
    ap = float(np.mean([tally.ap for tally in tallies]))
    interval: Interval = figure_interval(
        ap, figures.mean(axis=0), blocks=len(np.unique(blocks)), objects=objects
    )
    return Judgement(
        ap=ap,
        low=interval.low,
        high=interval.high,
        recall=float(np.mean([tally.recall for tally in tallies])),
        precision=float(np.mean([tally.precision for tally in tallies])),
        vehicles=objects,
        frames=len(blocks),
    )


def _score_hota(
    frames: Sequence[FrameBoxes], tracks: Sequence[Tracks], label: str, site: Site
) -> float:
    """HOTA of the tracks and objects of a class whose centres are in the site's area.

    tracks: tracks in each frame; label: name of the class."""
    inside_tracks = [
        frame_tracks[has_centre_inside(frame_tracks.boxes, site.area)] for frame_tracks in tracks
    ]
    inside_objects = [
        frame.objects[has_centre_inside(frame.objects.boxes, site.area)] for frame in frames
    ]
    return score_tracks(inside_tracks, inside_objects, label).hota
