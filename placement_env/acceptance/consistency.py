"""Consistency of a recording without labels: agreement of two halves of the sensors, and tracks
that end where no road user can leave.

Every other sensor is one half, the rest the other. A half confirms a detection of the other half if
it has one of any class nearby. If misses of both are independent, the share of a half's detections
that the other confirms is the other's recall, and both together find 1 - (1 - a)(1 - b)
(Lincoln-Petersen). Hidden places make misses alike, so this is an upper bound."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import NamedTuple

import numpy as np

from placement_env.acceptance.street_detections import FrameBoxes
from placement_env.analysis.intervals import RESAMPLES, Interval, draws_of_blocks, percentiles
from toolkit.arrays import Bool, Int64
from toolkit.objects import Detections
from toolkit.points import has_centre_inside
from toolkit.sites.site import Site
from toolkit.tracking.tracks import Tracks

MIN_PAIR_SCORE = 0.5  # least score of a detection that the other half must confirm
MAX_PAIR_DISTANCE_M = 2.0  # between the centres of two detections of one road user
BORDER_M = 8.0  # a track that ends closer to the area's border has left
MIN_AGE_S = 1.0  # least age at which a track counts
MIN_REST_S = 3.0  # between the ends of a track and of the recording


@dataclass(frozen=True)
class Consistency:
    """Figures of a recording without labels; NaN if there is nothing to compare.

    Attributes:
        first_share: share of the second half's detections that the first half confirms.
        second_share: share of the first half's detections that the second half confirms.
        recall: estimated share of the road users that both together find.
        recall_low: lower end of its interval, NaN for few blocks of frames.
        recall_high: upper end.
        detections: number of detections that were compared.
        vanished_share: share of the tracks that end inside the area.
        tracks: number of tracks that end."""

    first_share: float
    second_share: float
    recall: float
    recall_low: float
    recall_high: float
    detections: int
    vanished_share: float
    tracks: int

    def as_dict(self) -> dict[str, float]:
        """Return all figures as plain values for JSON."""
        return asdict(self)


def check_consistency(
    frames: Sequence[FrameBoxes],
    blocks: Int64[np.ndarray, " frames"],
    site: Site,
    tracks: Sequence[Tracks] | None,
    seed: int = 0,
) -> Consistency:
    """Compare the halves of the sensors, and look for tracks that end inside.

    Args:
        frames: Detections of each frame, with both halves.
        blocks: Number of each frame's block, for the interval.
        site: Planned site.
        tracks: Tracks in each frame, None if frames are too far apart to follow anyone.
        seed: Seed of the interval."""
    counts = np.array([_count_confirmed(frame, site) for frame in frames], np.float64)
    total = _Confirmed(*counts.sum(axis=0))
    draws = draws_of_blocks(blocks, resamples=RESAMPLES, seed=seed)
    resamples = np.array([_Confirmed(*row).recall for row in draws @ counts])
    interval: Interval = percentiles(resamples, len(np.unique(blocks)))
    ended = find_ends(frames, tracks, site) if tracks is not None else np.zeros(0, bool)
    return Consistency(
        first_share=total.first_recall,
        second_share=total.second_recall,
        recall=total.recall,
        recall_low=interval.low,
        recall_high=interval.high,
        detections=int(total.first + total.second),
        vanished_share=float(ended.mean()) if len(ended) else float("nan"),
        tracks=len(ended),
    )


class _Confirmed(NamedTuple):
    """Numbers of sure detections.

    first, second: by each half; first_confirmed, second_confirmed: detections that the
    other half confirms."""

    first: float
    first_confirmed: float
    second: float
    second_confirmed: float

    @property
    def first_recall(self) -> float:
        """Share of the second half's detections that the first half confirms."""
        return self.second_confirmed / self.second if self.second else float("nan")

    @property
    def second_recall(self) -> float:
        """Share of the first half's detections that the second half confirms."""
        return self.first_confirmed / self.first if self.first else float("nan")

    @property
    def recall(self) -> float:
        """Share that both halves together find, if their misses are independent."""
        return 1 - (1 - self.first_recall) * (1 - self.second_recall)


def _count_confirmed(frame: FrameBoxes, site: Site) -> _Confirmed:
    """Count the sure detections of both halves, and those that are confirmed; 0 without halves."""
    if not frame.halves:
        return _Confirmed(first=0, first_confirmed=0, second=0, second_confirmed=0)
    first, second = frame.halves
    first_confirmed = _confirm(first, second, site)
    second_confirmed = _confirm(second, first, site)
    return _Confirmed(
        first=len(first_confirmed),
        first_confirmed=int(first_confirmed.sum()),
        second=len(second_confirmed),
        second_confirmed=int(second_confirmed.sum()),
    )


def _confirm(detections: Detections, others: Detections, site: Site) -> Bool[np.ndarray, " n"]:
    """Mask of the sure detections in the area, True if the other half has one nearby.

    A sure detection has a score of `MIN_PAIR_SCORE` or more, so the mask has a row for each of
    these n, not for all. detections: by one half; others: by the other half, whatever their
    scores."""
    is_sure = (detections.scores >= MIN_PAIR_SCORE) & has_centre_inside(detections.boxes, site.area)
    offsets = detections.boxes[is_sure, None, :2] - others.boxes[None, :, :2]
    distances = np.hypot(offsets[..., 0], offsets[..., 1])
    return np.asarray((distances < MAX_PAIR_DISTANCE_M).any(axis=1))


def find_ends(
    frames: Sequence[FrameBoxes], tracks: Sequence[Tracks], site: Site
) -> Bool[np.ndarray, " tracks"]:
    """Return for each track that ends whether it ends inside the area, away from its border.

    Tracks of less than `MIN_AGE_S`, and those that end with the recording, are left out. tracks:
    tracks of each frame, in the site's frame."""
    # by number of the track: last box and time (s) with a detection, and age (s)
    last_boxes: dict[int, np.ndarray] = {}
    last_times: dict[int, float] = {}
    ages: dict[int, float] = {}
    for frame, frame_tracks in zip(frames, tracks, strict=True):
        # detected in this frame, not only predicted
        is_seen = frame_tracks.unseen == 0
        for track, box in zip(
            frame_tracks.ids[is_seen].tolist(), frame_tracks.boxes[is_seen], strict=True
        ):
            last_boxes[track] = box
            last_times[track] = frame.time
        ages |= dict(zip(frame_tracks.ids.tolist(), frame_tracks.ages.tolist(), strict=True))
    end = frames[-1].time - MIN_REST_S
    ended = [track for track, time in last_times.items() if time < end and ages[track] >= MIN_AGE_S]
    # xmin, ymin, xmax, ymax (m)
    inner_area = site.area + np.array([BORDER_M, BORDER_M, -BORDER_M, -BORDER_M])
    # (0, 7) without tracks
    boxes = np.array([last_boxes[track] for track in ended]).reshape(-1, 7)
    return has_centre_inside(boxes, inner_area)
