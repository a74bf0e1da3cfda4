"""`CaseFigures`: figures of sensor sets from tallies, and their reduction over cases.

Searches, races and plans reduce the figures of all cases here, in this order:

    IoU thresholds   mean
    levels           worst or mean
    failures         worst or mean
    drawings         mean over samples of what no map knows of the site
    error profiles   worst or mean

The worst case of a set is the one with the lowest AP. It gives all figures of the set, except that
every resample has its worst case. Undefined figures (NaN) are left out: a level without an
object has no AP. `placement_env.cases` reduces single figures of fast fidelities by the same rules.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import inf

import numpy as np

from placement_env.analysis.intervals import BLOCK_FRAMES, Draws, Interval, Tally, figure_interval
from placement_env.cases import TIE_SHARE, Cases
from placement_env.classes import Classes, Combine
from toolkit.arrays import Float64, Int64

AP_COLUMN, RECALL_COLUMN, PRECISION_COLUMN, OBJECTS_COLUMN, FRAMES_COLUMN, KBIT_COLUMN = range(6)
COUNT_COLUMNS = slice(OBJECTS_COLUMN, FRAMES_COLUMN + 1)
RESAMPLE_COLUMNS = slice(KBIT_COLUMN + 1, None)


@dataclass(frozen=True, eq=False)
class CaseFigures:
    """Figures of sensor sets on some frames.

    Attributes:
        values: The last axis has AP, recall, precision, number of objects, number of frames, kbit
            per frame and the AP of each resample of blocks of frames; the axis before has the sets,
            and the first axes have cases. NaN if undefined or unknown.
        used: Number of requested frames that were used, from the first, if time ran out; None for
            all."""

    values: Float64[np.ndarray, "*cases figures"]
    used: int | None = None

    @classmethod
    def from_ap(
        cls,
        ap: Float64[np.ndarray, "*cases"],
        kbit: Float64[np.ndarray, "*cases"] | float,
        resamples: Float64[np.ndarray, "*cases resamples"],
        *,
        objects: int = 0,
        frames: int = 0,
    ) -> "CaseFigures":
        """Return figures without recall and precision.

        ap: AP of each set; kbit: data of all its sensors per frame; resamples: resampled APs of
        each set; objects, frames: numbers behind each AP."""
        values = np.full((*ap.shape, RESAMPLE_COLUMNS.start + resamples.shape[-1]), np.nan)
        values[..., AP_COLUMN] = ap
        values[..., COUNT_COLUMNS] = objects, frames
        values[..., KBIT_COLUMN] = kbit
        values[..., RESAMPLE_COLUMNS] = resamples
        return cls(values)

    def __getitem__(self, index: int) -> "CaseFigures":
        """Return the figures at one index of the first axis, a case or a set."""
        return CaseFigures(self.values[index], self.used)

    @property
    def ap(self) -> Float64[np.ndarray, "*cases"]:
        """AP of each set."""
        return self.values[..., AP_COLUMN]

    @property
    def recall(self) -> Float64[np.ndarray, "*cases"]:
        """Share of the objects that are found."""
        return self.values[..., RECALL_COLUMN]

    @property
    def precision(self) -> Float64[np.ndarray, "*cases"]:
        """Share of the detections that hit."""
        return self.values[..., PRECISION_COLUMN]

    @property
    def objects(self) -> Float64[np.ndarray, "*cases"]:
        """Number of objects in the frames of the AP's case."""
        return self.values[..., OBJECTS_COLUMN]

    @property
    def frames(self) -> Float64[np.ndarray, "*cases"]:
        """Number of frames of the AP's case."""
        return self.values[..., FRAMES_COLUMN]

    @property
    def kbit(self) -> Float64[np.ndarray, "*cases"]:
        """Data that each intact set sends per frame (kbit)."""
        return self.values[..., KBIT_COLUMN]

    @property
    def resamples(self) -> Float64[np.ndarray, "*cases resamples"]:
        """AP of each set in each resample; a resample draws the same blocks for all sets."""
        return self.values[..., RESAMPLE_COLUMNS]

    def interval(
        self, frames: Int64[np.ndarray, " k"], *, max_blocks: float = inf, confidence: float = 0.95
    ) -> Interval:
        """Return the interval of the AP of one set, NaN on too few frames.

        It counts the frames and objects of the case that the AP comes from.

        Args:
            frames: Numbers of all frames that were evaluated, also in other cases.
            max_blocks: Largest number of blocks that the resamples draw from.
            confidence: Level of the interval."""
        # `self.frames`: number of frames of the case
        block_count = _count_blocks(int(self.frames), frames)
        return figure_interval(
            float(self.ap),
            self.resamples,
            blocks=min(block_count, max_blocks),
            objects=int(self.objects),
            confidence=confidence,
        )


def _count_blocks(frame_count: int, frames: Int64[np.ndarray, " k"]) -> int:
    """Return the number of blocks that some of the frames amount to, rounded up.

    frame_count: how many frames; frames: numbers of all frames."""
    _, frames_in_block = np.unique(frames // BLOCK_FRAMES, return_counts=True)
    if frame_count == len(frames):
        return len(frames_in_block)
    return -(-frame_count // int(frames_in_block.max()))  # rounded up


def measure_tallies(
    tallies: Sequence[Sequence[Tally]], classes: Classes, draws: Draws, *, kbit: float = np.nan
) -> Float64[np.ndarray, " figures"]:
    """Return the figures of one set, the columns of `CaseFigures.values`: resampled APs come last.

    They are means over the IoU thresholds. AP and recall are combined over the classes; precision
    is for the detections of all classes together, NaN without detections or objects.

    Args:
        tallies: A list for each IoU threshold, with a tally for each class.
        classes: The same classes.
        draws: How often each frame (column) is in each resample (row).
        kbit: Data of the set per frame."""
    threshold_figures = []  # a row of figures for each IoU threshold
    for class_tallies in tallies:
        class_aps = [tally.ap for tally in class_tallies]
        class_recalls = [tally.recall for tally in class_tallies]
        ap, recall = classes.combined(np.array([class_aps, class_recalls]))
        detection_count = sum(len(tally.hit) for tally in class_tallies)
        hit_count = sum(int(tally.hit.sum()) for tally in class_tallies)
        object_count = sum(int(tally.truths.sum()) for tally in class_tallies)
        precision = np.nan
        if detection_count and object_count:
            precision = hit_count / detection_count
        first_tally, *_ = class_tallies
        frame_count = len(first_tally.truths)  # the same for all classes
        resamples = [tally.resamples(draws=draws) for tally in class_tallies]
        resampled_aps = classes.combined(np.stack(resamples, axis=1))  # from (resample, class)
        columns = [ap, recall, precision, object_count, frame_count, kbit]
        threshold_figures.append(np.concatenate([columns, resampled_aps]))
    figures = reduce_cases(np.array(threshold_figures), "mean")
    figures[KBIT_COLUMN] = kbit
    return figures


def reduce_cases(
    values: Float64[np.ndarray, "cases *rest figures"], by: Combine
) -> Float64[np.ndarray, "*rest figures"]:
    """Return the figures over cases, which are the first axis; NaN is left out.

    by: "worst" for the figures of the case with the lowest AP, except that each resample has the
    lowest AP of all cases in that resample; "mean" for means, with the numbers of objects and
    frames of the first case."""
    if by == "worst":
        ap = values[..., :1]  # column `AP_COLUMN`, with the axis of figures
        # `None` keeps the axis of cases, for `take_along_axis`
        worst_case = np.where(np.isnan(ap), np.inf, ap).argmin(axis=0)[None]
        reduced = np.take_along_axis(values, worst_case, axis=0)[0]
        resampled_aps = values[..., RESAMPLE_COLUMNS]
        reduced[..., RESAMPLE_COLUMNS] = np.fmin.reduce(resampled_aps, axis=0)
        return reduced
    is_defined = ~np.isnan(values)
    sums = np.where(is_defined, values, 0.0).sum(axis=0)
    counts = is_defined.sum(axis=0)
    means = np.divide(sums, counts, out=np.full(sums.shape, np.nan), where=counts > 0)
    means[..., COUNT_COLUMNS] = values[0, ..., COUNT_COLUMNS]
    return means


def reduce_levels(
    values: Float64[np.ndarray, "levels m figures"], by: Combine
) -> Float64[np.ndarray, "m figures"]:
    """Return the figures of m sets over the levels of traffic (first axis), by "mean" or "worst".

    Means have the sums of objects and frames over the levels with objects. kbit are means over the
    frames of all levels, whichever way the levels are combined."""
    reduced = reduce_cases(values, by)
    # weights of the levels are their shares of the frames
    frame_counts = values[:, 0, FRAMES_COLUMN]  # one for each level, the same for all sets
    reduced[:, KBIT_COLUMN] = frame_counts / frame_counts.sum() @ values[..., KBIT_COLUMN]
    if by == "mean":
        is_defined = ~np.isnan(values[..., :1])  # AP is NaN without objects
        counts = np.where(is_defined, values[..., COUNT_COLUMNS], 0)
        reduced[:, COUNT_COLUMNS] = counts.sum(axis=0)
    return reduced


def reduce_failures(
    values: Float64[np.ndarray, "m figures"],
    owners: Int64[np.ndarray, " m"],
    cases: Cases,
    *,
    tie: float = TIE_SHARE,
) -> Float64[np.ndarray, "n figures"]:
    """Return the figures of n sets over their failures; kbit are for intact sets.

    Args:
        values: Figures of m rows: the n intact sets, then what each failure leaves of each set.
        owners: Index of the set of each row.
        cases: Give the failures and how they are combined.
        tie: Share of the intact sets' AP to add, so that a race can distinguish sets that fail
            completely; 0 for AP to state."""
    if not cases.failing:
        return values
    set_count = int(owners.max()) + 1
    intact = values[:set_count]  # rows after the intact sets are failures
    failures = values[set_count:]
    reduced = np.stack(
        [reduce_cases(failures[owners[set_count:] == n], cases.failures) for n in range(set_count)]
    )
    reduced[:, KBIT_COLUMN] = intact[:, KBIT_COLUMN]
    for columns in (slice(AP_COLUMN, AP_COLUMN + 1), RESAMPLE_COLUMNS):
        reduced[:, columns] += tie * intact[:, columns]
    return reduced


def scale_figures(figures: CaseFigures, sampled: CaseFigures, whole: CaseFigures) -> CaseFigures:
    """Return figures in all frames, estimated from a sample by the ratio to a reference set's.

    AP, recall and the resamples of AP become the reference set's in all frames, times the ratio in
    the sample, at most 1. Figures stay if the reference set finds nothing in the sample. Precision,
    kbit, objects and frames come from the sample.

    Args:
        figures: Figures of n sets in the sample.
        sampled: Figures of the reference set in the sample.
        whole: Figures of the reference set in all frames; its resamples draw the same blocks."""
    values = figures.values.copy()
    for columns in (slice(AP_COLUMN, RECALL_COLUMN + 1), RESAMPLE_COLUMNS):
        reference = sampled.values[columns]
        scale = np.ones_like(reference)
        np.divide(whole.values[columns], reference, out=scale, where=reference > 0)
        values[..., columns] = np.minimum(values[..., columns] * scale, 1.0)
    return CaseFigures(values)
