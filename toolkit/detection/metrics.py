"""Average precision of detections over a dataset's frames.

One label is scored at a time, `vehicle` by default; detections and truths of other labels do not
take part.

Protocol `exact` (paper section "Evaluation Metrics"):

1. The detections of all frames are pooled and taken in order of descending score. Of equal scores
   the detection with the greater best IoU goes first, so the order of the input does not matter.
2. A detection is a **hit** if a truth of its frame that no earlier detection took has IoU >=
   threshold with it; it takes the one of greatest IoU. IoU is between volumes ("3d") or
   footprints ("bev"), exact for rotated boxes.
3. A detection that hit nothing is **ignored**, neither hit nor false alarm, if it is on an object
   that is present but not scored: IoU >= threshold with it, or more than half of the detection's
   footprint on its footprint (detectors see large vehicles in part). Not scored are heavy vehicles
   when vehicles are scored, and whatever `counted` excludes. A detection outside the scored area
   (`outside`) may hit a truth too, and is ignored if it does not: an object at the border counts as
   found wherever the detection's centre is.
4. Every other detection is a **false alarm**, in frames without truths too.
5. Over the detections that are not ignored, with hits and false alarms counted down to each score,
   precision = hits / (hits + false alarms), recall = hits / truths. Equal scores make one point of
   the curve, since no score threshold can separate them.
6. AP = Σ (r[n+1] - r[n]) · max over r' >= r[n+1] of p(r')
   (paper equations 4 and 5: all-point interpolation)

Without a single truth to find, recall and AP are undefined and given as NaN. Without detections AP
is 0.

Protocol `published` does what the code published with the paper does instead, in three places:
`evaluate` skips frames without truths together with their false alarms; `sample_iou` is the IoU of
footprints by 50 × 50 points of the truth and, for "3d", multiplied by (overlap of heights / greater
height); `claim_then_test` lets each detection claim its arg-max truth before its IoU is tested
(strictly greater than the threshold), so that a stray box, even one that overlaps nothing and so
claims truth 0, voids a good one with a lower score."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import partial
from itertools import repeat, zip_longest
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from toolkit.arrays import Bool, Float, Float64, Int64, Mask
from toolkit.boxes import FACE_TOLERANCE, Overlap, check_boxes, footprint_overlap, iou_3d, iou_bev
from toolkit.objects import CYCLIST, HEAVY, PEDESTRIAN, VEHICLE, Detections, Objects, label_index

Protocol = Literal["exact", "published"]

GRID_POINTS = 50  # points along each side of a truth's footprint, protocol `published`
USUAL_IOUS = {
    VEHICLE: (0.7, 0.8, 0.9),
    HEAVY: (0.7, 0.8, 0.9),
    CYCLIST: (0.25, 0.5, 0.7),
    PEDESTRIAN: (0.25, 0.5, 0.7),
}
TRUE_IOU = {VEHICLE: 0.5, HEAVY: 0.5, CYCLIST: 0.5, PEDESTRIAN: 0.25}  # 3D, of a true detection
# share of a footprint on an unscored object above which a detection is ignored
MAX_UNSCORED_SHARE = 0.5


@dataclass(frozen=True)
class Match:
    """Outcome of n detections of a frame against m truths, in the rows of the input.

    Attributes:
        truth: row of the truth that each detection hit, -1 without one.
        iou: IoU of each detection with the truth that it hit, 0 without one.
        ignored: mask of detections that do not count: they have another label, or hit nothing and
            are on an object that is not scored or outside the scored area.
        hit: mask of truths that were hit.
        scored: mask of truths that count.
    """

    truth: Int64[np.ndarray, " n"]
    iou: Float64[np.ndarray, " n"]
    ignored: Mask
    hit: Bool[np.ndarray, " m"]
    scored: Bool[np.ndarray, " m"]


@dataclass(frozen=True)
class Curve:
    """Precision and recall of all detections with at least a score, for k different scores.

    Scores descend. Recall is NaN if there is no truth to find."""

    precision: Float64[np.ndarray, " k"]
    recall: Float64[np.ndarray, " k"]
    score: Float64[np.ndarray, " k"]


@dataclass(frozen=True)
class DetectionScore:
    """Score of a detector at one IoU threshold.

    Attributes:
        ap: average precision.
        precision: precision over all detections.
        recall: recall over all detections.
        tp: number of hits.
        fp: number of false alarms.
        truths: number of truths to find.
        curve: precision and recall down to each score.
        scores: scores of the n detections that are not ignored, in no order.
        hits: mask of the hits among these n detections.
    """

    ap: float
    precision: float
    recall: float
    tp: int
    fp: int
    truths: int
    curve: Curve = field(repr=False)
    scores: Float64[np.ndarray, " n"] = field(repr=False, compare=False)
    hits: Mask = field(repr=False, compare=False)


@dataclass(frozen=True)
class Reliability:
    """Mean score, share of true detections and number of detections in b bins of scores.

    Mean score and share are NaN in bins without detections."""

    score: Float[np.ndarray, " b"]
    true: Float[np.ndarray, " b"]
    count: Int64[np.ndarray, " b"]

    @property
    def error(self) -> float:
        """Expected calibration error: mean gap between score and share of true detections.

        Bins are weighted by their numbers of detections; 0 without detections."""
        has_detections = self.count > 0
        count = self.count[has_detections]
        gap = np.abs(self.score[has_detections] - self.true[has_detections])
        return float((gap * count).sum() / max(self.count.sum(), 1))


def reliability(scores: Float[np.ndarray, " n"], hits: Mask, bins: int = 10) -> Reliability:
    """Return the reliability diagram of detections.

    scores: score of each detection, 0 to 1; hits: mask of true detections; bins: number of equal
    bins."""
    bin_index = np.clip((scores * bins).astype(np.int64), 0, bins - 1)
    count = np.bincount(bin_index, minlength=bins)
    with np.errstate(invalid="ignore"):  # 0 / 0 is NaN in bins without detections
        mean_score = np.bincount(bin_index, scores, minlength=bins) / count
        true_share = np.bincount(bin_index, hits, minlength=bins) / count
    return Reliability(score=mean_score, true=true_share, count=count)


def evaluate(
    detections: Iterable[Detections],
    truths: Iterable[Objects],
    *,
    iou_thresholds: Sequence[float],
    metric: Overlap = "3d",
    protocol: Protocol = "exact",
    label: str | int = "vehicle",
    counted: Iterable[ArrayLike] | None = None,
    outside: Iterable[ArrayLike] | None = None,
) -> dict[float, DetectionScore]:
    """Score detections at each IoU threshold, as defined at the top of this module.

    detections, truths: one of each per frame, read once. counted: per frame a mask (m,) of the
    truths that are scored, by default all; the others are neither to be found nor false alarms.
    outside: per frame a mask (n,) of detections outside the scored area, by default none; they can
    be hits but not false alarms. Raises ValueError for unequal numbers of frames, degenerate boxes,
    NaN scores, or thresholds outside (0, 1].

    >>> car = np.array([[0, 0, 1, 4, 2, 1.5, 0]])
    >>> evaluate([Detections(car, np.array([0.9]))], [Objects(car)], iou_thresholds=[0.7])[0.7].ap
    1.0
    """
    thresholds = list(dict.fromkeys(_check(iou_thresholds, metric, protocol)))
    label = label_index(label)
    scores: dict[float, list[np.ndarray]] = {threshold: [np.zeros(0)] for threshold in thresholds}
    hits = {threshold: [np.zeros(0, bool)] for threshold in thresholds}
    truth_count = 0
    frames = _pair_frames(detections, truths, counted, outside)
    for number, frame in enumerate(frames):
        overlaps = _measure_overlaps(
            frame.detected,
            frame.objects,
            label,
            metric=metric,
            protocol=protocol,
            counted=frame.counted,
            outside=frame.outside,
            location=f" of frame {number}",
        )
        if protocol == "published" and not len(overlaps.columns):
            continue  # its false alarms do not count
        truth_count += len(overlaps.columns)
        for threshold in thresholds:
            # column of a truth, -1 without one
            matched_column, is_ignored = overlaps.resolve(threshold)
            scores[threshold].append(overlaps.scores[~is_ignored])
            hits[threshold].append(matched_column[~is_ignored] >= 0)
    return {
        threshold: _score_pooled(
            np.concatenate(scores[threshold]), np.concatenate(hits[threshold]), truth_count
        )
        for threshold in thresholds
    }


class _FramePair(NamedTuple):
    """Detections and truths of one frame, with masks of counted truths and outside detections."""

    detected: Detections
    objects: Objects
    counted: ArrayLike | None
    outside: ArrayLike | None


def _pair_frames(
    detections: Iterable[Detections],
    truths: Iterable[Objects],
    counted: Iterable[ArrayLike] | None,
    outside: Iterable[ArrayLike] | None,
) -> Iterator[_FramePair]:
    """Yield detections, truths and masks of each frame, read once; masks not given are None.

    counted: mask of the scored truths of each frame; outside: mask of the detections of each frame
    that are outside the scored area. Raises ValueError for unequal numbers of frames."""
    masks = repeat(None) if counted is None else iter(counted)
    outsides = repeat(None) if outside is None else iter(outside)
    for number, (detected, objects) in enumerate(zip_longest(detections, truths)):
        # None at the end of any of the inputs: one has fewer frames
        mask = next(masks, None)
        is_outside = next(outsides, None)
        lacks_mask = counted is not None and mask is None
        lacks_outside = outside is not None and is_outside is None
        if detected is None or objects is None or lacks_mask or lacks_outside:
            raise ValueError(
                "detections, truths, counted and outside must have as many frames, but one ended "
                f"after {number}"
            )
        yield _FramePair(detected, objects, counted=mask, outside=is_outside)
    extra_masks = counted is not None and next(masks, None) is not None
    if extra_masks or (outside is not None and next(outsides, None) is not None):
        raise ValueError("counted and outside must have as many frames as the detections, got more")


def _score_pooled(
    scores: Float64[np.ndarray, " n"], hits: Bool[np.ndarray, " n"], truths: int
) -> DetectionScore:
    """Compute the score of the detections of all frames that are not ignored.

    scores: score of each detection, in any order; hits: mask of true detections; truths: number of
    objects to find. Without truths AP and recall are NaN, without detections precision is NaN."""
    curve = precision_recall(scores, hits, truths)
    tp = int(hits.sum())
    return DetectionScore(
        ap=average_precision(curve) if truths else np.nan,
        precision=tp / len(hits) if len(hits) else np.nan,
        recall=tp / truths if truths else np.nan,
        tp=tp,
        fp=len(hits) - tp,
        truths=truths,
        curve=curve,
        scores=scores,
        hits=hits,
    )


def matches(
    detections: Detections,
    truths: Objects,
    iou_thresholds: Iterable[float],
    *,
    metric: Overlap = "3d",
    protocol: Protocol = "exact",
    label: str | int = "vehicle",
    counted: ArrayLike | None = None,
    outside: ArrayLike | None = None,
) -> Iterator[Match]:
    """Match the detections of a class with the truths of one frame, at several IoU thresholds.

    counted: mask (m,) of the truths that are scored, None for all; outside: mask (n,) of detections
    outside the scored area, None for no such detections. Yields a match for each threshold, in the
    order given. Raises ValueError for degenerate boxes, NaN scores, or thresholds outside (0,
    1]."""
    thresholds = _check(iou_thresholds, metric, protocol)
    overlaps = _measure_overlaps(
        detections,
        truths,
        label_index(label),
        metric=metric,
        protocol=protocol,
        counted=counted,
        outside=outside,
    )
    # overlaps have sorted detections of the label and scored truths only: their rows in the input
    detection_rows = overlaps.rows
    truth_rows = overlaps.columns
    for threshold in thresholds:
        matched_column, is_ignored = overlaps.resolve(threshold)
        hits = np.flatnonzero(matched_column >= 0)
        hit_truths = matched_column[hits]
        result = Match(
            truth=np.full(len(detections), -1),
            iou=np.zeros(len(detections)),
            ignored=np.ones(len(detections), bool),
            hit=np.zeros(len(truths), bool),
            scored=np.isin(np.arange(len(truths)), truth_rows),
        )
        result.truth[detection_rows[hits]] = truth_rows[hit_truths]
        result.iou[detection_rows[hits]] = overlaps.iou[hits, hit_truths]
        result.ignored[detection_rows] = is_ignored
        result.hit[truth_rows[hit_truths]] = True
        yield result


def second_labels(
    detections: Detections,
    truths: Objects,
    *,
    metric: Overlap = "3d",
    counted: ArrayLike | None = None,
    outside: ArrayLike | None = None,
) -> Bool[np.ndarray, " n"]:
    """Mask of detected vehicles on a heavy vehicle that is found as heavy too.

    One object has two labels then. The matching of vehicles ignores the second (rule 3). A user
    counts it as a false alarm. counted: mask (m,) of the truths that are scored, None for all;
    outside: mask (n,) of detections outside the scored area, which are never marked."""
    no_second = np.zeros(len(detections), bool)
    if not (detections.labels == HEAVY).any() or not (detections.labels == VEHICLE).any():
        return no_second
    # one match each, for the single IoU threshold
    (heavy_match,) = matches(detections, truths, [TRUE_IOU[HEAVY]], metric=metric, label=HEAVY)
    if not heavy_match.hit.any():
        return no_second
    (vehicle_match,) = matches(
        detections,
        truths,
        [TRUE_IOU[VEHICLE]],
        metric=metric,
        label=VEHICLE,
        counted=counted,
        outside=outside,
    )
    is_ignored = (detections.labels == VEHICLE) & vehicle_match.ignored
    if outside is not None:
        is_ignored &= ~np.asarray(outside, bool)
    # share of each detection's footprint on each heavy vehicle that was found
    shares = footprint_overlap(detections.boxes, truths.boxes[heavy_match.hit])
    return is_ignored & (shares.max(axis=1) > MAX_UNSCORED_SHARE)


def precision_recall(scores: Float64[np.ndarray, " n"], hits: Mask, truths: int) -> Curve:
    """Return the curve of precision and recall of n pooled detections, in any order.

    scores: score of each detection; hits: mask of true detections; truths: number of objects to
    find. Equal scores make one point of the curve.

    >>> precision_recall(np.array([0.9, 0.8, 0.7]), np.array([True, False, True]), truths=4).recall
    array([0.25, 0.25, 0.5 ])
    """
    is_count = truths >= 0 and truths == int(truths)
    if not is_count or np.shape(scores) != np.shape(hits) or np.ndim(scores) != 1:
        needs = "one score and one hit for each detection, and 0 or more truths"
        got = f"{np.shape(scores)}, {np.shape(hits)} and {truths} truths"
        raise ValueError(f"precision_recall needs {needs}, got {got}")
    if np.sum(hits) > truths:
        raise ValueError(
            f"more detections hit ({np.sum(hits)}) than there are truths ({truths}): count all "
            "truths"
        )
    best_first = np.argsort(-scores, kind="stable")
    scores = scores[best_first]
    # index of the last detection of each score; the slice is for no detections at all
    last_of_equals = np.flatnonzero(np.append(scores[1:] != scores[:-1], True)[: len(scores)])
    tp = np.cumsum(hits[best_first])[last_of_equals]  # hits down to each score
    recall = tp / truths if truths else np.full(len(tp), np.nan)
    return Curve(precision=tp / (last_of_equals + 1), recall=recall, score=scores[last_of_equals])


def average_precision(curve: Curve) -> float:
    """Return the all-point interpolated AP (paper equations 4 and 5).

    curve: precision and recall, with ascending recall.

    >>> hits = np.array([True, False, True])
    >>> average_precision(precision_recall(np.array([0.9, 0.8, 0.7]), hits, truths=2))
    0.8333333333333333
    """
    # greatest precision at each recall or a higher one
    envelope = np.maximum.accumulate(curve.precision[::-1])[::-1]
    return float((np.diff(curve.recall, prepend=0.0) * envelope).sum())


def greedy(iou: Float64[np.ndarray, "n m"], threshold: float) -> Int64[np.ndarray, " n"]:
    """Column of the truth that each detection takes, or -1 for none.

    iou: IoU of n detections, best score first, with m truths. In this order, each detection takes
    the truth of greatest IoU that is still free, if the IoU is at least `threshold`."""
    matched_column = np.full(len(iou), -1)
    free_iou = iou.copy()
    for row in np.flatnonzero((iou >= threshold).any(axis=1)):
        truth = free_iou[row].argmax()
        if free_iou[row, truth] >= threshold:
            matched_column[row] = truth
            free_iou[:, truth] = 0  # below any threshold: the truth is taken
    return matched_column


def claim_then_test(iou: Float64[np.ndarray, "n m"], threshold: float) -> Int64[np.ndarray, " n"]:
    """Column of the truth that each detection takes, or -1 for none.

    iou: IoU of n detections, best score first, with m truths. Each claims its truth of greatest
    IoU, truth 0 if it overlaps nothing. Only the first to claim a truth may take it, if the IoU is
    above `threshold`."""
    matched_column = np.full(len(iou), -1)
    if iou.shape[1]:  # there are truths
        # claimed truths, and the first row that claims each
        truths, first_rows = np.unique(iou.argmax(axis=1), return_index=True)
        is_hit = iou[first_rows, truths] > threshold
        matched_column[first_rows[is_hit]] = truths[is_hit]
    return matched_column


def sample_iou(
    detected: ArrayLike, truths: ArrayLike, metric: Overlap = "3d"
) -> Float64[np.ndarray, "n m"]:
    """Estimate IoU of boxes (n, 7) and (m, 7) by 50 × 50 points in each truth's footprint.

    The points include the edges. For "3d" it is multiplied by (overlap of the heights / greater
    height), which is not the IoU of the volumes."""
    # columns of boxes: x, y, z, length, width, height, yaw; a: detections, b: truths
    a = check_boxes(detected, "detected")
    b = check_boxes(truths, "truths")
    half_sizes = a[:, 3:5] / 2 + FACE_TOLERANCE
    share = np.zeros((len(a), len(b)))  # share of the truth's points in the detection
    is_near = iou_bev(a, b) > 0
    for column, (x, y, _, length, width, _, yaw) in enumerate(b):
        # The 2500 points of this truth, in the frames of the detections near it: ahead and aside
        # are (rows, points along the length, points along the width).
        rows = np.flatnonzero(is_near[:, column])
        cos_a = np.cos(a[rows, 6])
        sin_a = np.sin(a[rows, 6])
        turn = (yaw - a[rows, 6])[:, None]
        dx = x - a[rows, 0]
        dy = y - a[rows, 1]
        u = np.linspace(-length / 2, length / 2, GRID_POINTS)
        v = np.linspace(-width / 2, width / 2, GRID_POINTS)
        cos = np.cos(turn)
        sin = np.sin(turn)
        ahead = (
            (dx * cos_a + dy * sin_a)[:, None, None] + (u * cos)[:, :, None] - (v * sin)[:, None, :]
        )
        aside = (
            (dy * cos_a - dx * sin_a)[:, None, None] + (u * sin)[:, :, None] + (v * cos)[:, None, :]
        )
        is_inside = np.abs(ahead) <= half_sizes[rows, 0, None, None]
        is_inside &= np.abs(aside) <= half_sizes[rows, 1, None, None]
        share[rows, column] = is_inside.mean(axis=(1, 2))
    overlap = share * (b[:, 3] * b[:, 4])  # m², as in the areas below
    iou = overlap / ((a[:, 3] * a[:, 4])[:, None] + b[:, 3] * b[:, 4] - overlap)
    if metric == "3d":
        top = np.minimum((a[:, 2] + a[:, 5] / 2)[:, None], b[:, 2] + b[:, 5] / 2)
        bottom = np.maximum((a[:, 2] - a[:, 5] / 2)[:, None], b[:, 2] - b[:, 5] / 2)
        iou *= np.maximum(top - bottom, 0) / np.maximum(a[:, 5:6], b[:, 5])
    return iou


class Overlaps(NamedTuple):
    """Overlaps of a frame's detections of one label, best score first, with objects."""

    rows: np.ndarray  # (n,) row of each detection in the input
    columns: np.ndarray  # (m,) row of each scored truth in the input
    scores: np.ndarray  # (n,) of the detections
    iou: np.ndarray  # (n, m) of detections and scored truths
    # (n, 2) greatest IoU with an object that is not scored, and share of the footprint on one
    elsewhere: np.ndarray
    outside: np.ndarray  # (n,) True for detections outside the scored area
    protocol: Protocol

    def resolve(self, threshold: float) -> tuple[np.ndarray, np.ndarray]:
        """Match detections and truths at one IoU threshold, by the rule of the protocol.

        Returns for each detection the column of the truth that it hit (an index in `columns`), or
        -1, and a mask of ignored detections: they hit nothing and are outside the scored area or on
        an object that is present but not scored."""
        match = claim_then_test if self.protocol == "published" else greedy
        matched_column = match(self.iou, threshold)
        # with objects that are present but not scored
        unscored_iou, unscored_share = self.elsewhere.T
        is_on_unscored = (unscored_iou >= threshold) | (unscored_share > MAX_UNSCORED_SHARE)
        return matched_column, (is_on_unscored | self.outside) & (matched_column < 0)


def _measure_overlaps(
    detected: Detections,
    objects: Objects,
    label: int,
    *,
    metric: Overlap,
    protocol: Protocol,
    counted: ArrayLike | None,
    outside: ArrayLike | None,
    location: str = "",
) -> Overlaps:
    """Overlaps of the detections and objects of one frame.

    Present but not scored are uncounted truths and, if vehicles are scored, heavy vehicles. label:
    class number; counted: mask of the objects to find, None for all; outside: mask of the
    detections outside the scored area, None for none; location: " of frame N" for errors, or ""."""
    if np.isnan(detected.scores).any():
        raise ValueError(
            f"scores must be numbers, but row {int(np.isnan(detected.scores).argmax())}{location} "
            "is NaN"
        )
    is_scored = objects.labels == label
    is_unscored = (objects.labels == HEAVY) & (label == VEHICLE)
    if counted is not None:
        mask = np.asarray(counted, bool)
        if mask.shape != is_scored.shape:
            raise ValueError(
                f"counted{location} must have one entry for each of {len(objects)} truths, got "
                f"{mask.shape}"
            )
        is_unscored = is_unscored | (is_scored & ~mask)
        is_scored = is_scored & mask
    is_outside = np.zeros(len(detected), bool) if outside is None else np.asarray(outside, bool)
    if is_outside.shape != (len(detected),):
        rule = f"outside{location} must have one entry for each of {len(detected)} detections"
        raise ValueError(f"{rule}, got {is_outside.shape}")
    rows = np.flatnonzero(detected.labels == label)
    columns = np.flatnonzero(is_scored)
    boxes = check_boxes(detected.boxes, "detections" + location)[rows]
    truths = check_boxes(objects.boxes, "truths" + location)
    exact_iou = iou_3d if metric == "3d" else iou_bev
    measure_iou = partial(sample_iou, metric=metric) if protocol == "published" else exact_iou
    all_iou = measure_iou(boxes, np.concatenate([truths[columns], truths[is_unscored]]))
    iou = all_iou[:, : len(columns)]
    unscored_iou = all_iou[:, len(columns) :]
    share = footprint_overlap(boxes, truths[is_unscored])
    elsewhere = np.stack(
        [unscored_iou.max(axis=1, initial=0), share.max(axis=1, initial=0)], axis=1
    )
    # by descending score, then by descending best IoU: the last key of lexsort counts first
    order = np.lexsort((-iou.max(axis=1, initial=0), -detected.scores[rows]))
    best_first = rows[order]
    return Overlaps(
        rows=best_first,
        columns=columns,
        scores=detected.scores[best_first],
        iou=iou[order],
        elsewhere=elsewhere[order],
        outside=is_outside[best_first],
        protocol=protocol,
    )


def _check(iou_thresholds: Iterable[float], metric: str, protocol: str) -> list[float]:
    """Return thresholds as floats.

    Raises ValueError for an unknown metric or protocol, or a threshold outside (0, 1]."""
    if metric not in ("3d", "bev") or protocol not in ("exact", "published"):
        raise ValueError(
            f'metric is "3d" or "bev", protocol "exact" or "published", got {metric!r}, '
            f"{protocol!r}"
        )
    thresholds = [float(threshold) for threshold in iou_thresholds]
    for threshold in thresholds:
        if not 0 < threshold <= 1:
            raise ValueError(f"an IoU threshold must lie in (0, 1], got {threshold}")
    return thresholds
