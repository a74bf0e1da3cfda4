"""Evaluators of sensor sets on fresh traffic, with resamples of blocks of frames that are the same
for all sets.

`DetectorEvaluator` detects; `FastEvaluator` lets another fidelity, such as the surrogate, score
batches of the frames. Both know one error profile and return means over the IoU thresholds;
`CasesEvaluator` reduces them over the other cases (`placement_env.analysis.case_figures`). A
block of `BLOCK_FRAMES` frames shows the same objects, so blocks are drawn whole.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from placement_env.analysis.case_figures import (
    KBIT_COLUMN,
    CaseFigures,
    measure_tallies,
    reduce_cases,
    reduce_failures,
    reduce_levels,
)
from placement_env.analysis.intervals import BLOCK_FRAMES, Interval, Tally, draws_of_blocks
from placement_env.cases import TIE_SHARE, Cases
from placement_env.defaults import USUAL_CASES
from placement_env.fidelity.detector import IOUS, Detected, Outcome
from placement_env.fidelity.preparation import Preparation
from placement_env.fidelity.seeing import see
from placement_env.fidelity.visibility import Visibility, of_frames
from placement_env.protocol import Estimate, FidelityName
from placement_env.subsets import Sets
from toolkit.arrays import Float64, Int64

MAX_BATCHES = 12  # that a fast fidelity scores separately
Frames = Int64[np.ndarray, " k"]
Report = Callable[[int], None]


def build_evaluator(
    preparation: Preparation, fidelity: FidelityName, *, seed: int = 0, tie: float = TIE_SHARE
) -> "CasesEvaluator":
    """Evaluator of a preparation's traffic by a fidelity, over the cases of its setting.

    Fidelities other than the detector have one evaluator for all error profiles.

    seed: for the resamples; tie: `CasesEvaluator.tie`."""
    cases = preparation.setting.cases
    by_profile: tuple[DetectorEvaluator | FastEvaluator, ...]
    if fidelity == "detector":
        # `at`: the IoU threshold of the scores, and all thresholds that detections are matched at
        by_profile = tuple(
            DetectorEvaluator(
                preparation.detected(profile).at(cases.ious[0], cases.ious),
                ious=cases.ious,
                seed=seed,
            )
            for profile in cases.profiles
        )
    else:
        by_profile = (FastEvaluator(preparation, fidelity, seed),) * len(cases.profiles)
    return CasesEvaluator(by_profile, cases=cases, levels=preparation.levels, tie=tie)


def race_order(frames: int, *, seed: int = 0) -> Int64[np.ndarray, " frames"]:
    """All frame numbers in the order of a race, which uses them from the start.

    Blocks of `BLOCK_FRAMES` frames show the same objects, so first comes one frame of every block,
    in random order, then a second of every block, and so on. frames: number of frames; seed: same
    seed, same order, so that two calls agree on the frames of a race.
    """
    rng = np.random.default_rng(seed)
    blocks = rng.permutation(-(-frames // BLOCK_FRAMES))  # rounded up; the last may be short
    offsets = rng.permutation(BLOCK_FRAMES)  # frames within every block
    order = (blocks * BLOCK_FRAMES + offsets[:, None]).ravel()  # a row of all blocks per offset
    return order[order < frames]


@dataclass(frozen=True, eq=False)
class CasesEvaluator:
    """Evaluation over cases.

    The kbit are for intact sets in all frames. A resample draws each level from its blocks, and the
    worst case is determined within the resample.

    Attributes:
        by_profile: Evaluator of each error profile.
        cases: Thresholds, failures, levels and error profiles.
        levels: Frames of each level of traffic, empty if it is undivided.
        drawings: Evaluators of the same candidates on other samples of the site; figures are means.
        tie: Share of the intact set's AP that is added after failures: `TIE_SHARE` for a race, 0
            for AP that are stated.
    """

    by_profile: "tuple[DetectorEvaluator | FastEvaluator, ...]"
    cases: Cases = USUAL_CASES
    levels: tuple[Int64[np.ndarray, " _"], ...] = ()
    drawings: "tuple[CasesEvaluator, ...]" = ()
    tie: float = TIE_SHARE

    @property
    def name(self) -> str:
        """Name of the fidelity."""
        return self.by_profile[0].name

    @property
    def frames(self) -> int:
        """Number of frames."""
        return self.by_profile[0].frames

    def count_objects(self, frames: Frames) -> int:
        """Number of objects to be found in these frames."""
        return self.by_profile[0].count_objects(frames)

    def interval(self, figures: CaseFigures, frames: Frames) -> Interval:
        """95 % interval of the AP of one set, NaN on too few frames.

        figures: figures of one set on these frames; frames: frame numbers."""
        return figures.interval(frames, max_blocks=self.by_profile[0].max_blocks)

    def mean_ap(self, sets: Sets, frames: Frames) -> Float64[np.ndarray, " n"]:
        """Mean AP of each intact set over the thresholds `IOUS`; 0 without a detector.

        It is at the first error profile and, with several random versions of the site (`drawings`),
        a mean over them. frames: frame numbers.
        """
        first = self.by_profile[0]
        if not isinstance(first, DetectorEvaluator):
            return np.zeros(len(sets))
        estimates = first.detected.estimates(sets, frames.tolist())  # by IoU threshold
        aps = [np.asarray(np.mean([estimates[iou].ap for iou in IOUS], axis=0))]
        aps += [drawing.mean_ap(sets, frames) for drawing in self.drawings]
        return np.asarray(np.mean(aps, axis=0))

    def evaluate(self, sets: Sets, frames: Frames, progress: Report | None = None) -> CaseFigures:
        """Figures of n sets on these frames, reduced over error profiles and all other cases.

        They come from the error profile with the lowest AP, or are means over profiles; every
        resample has its worst profile. progress: called with the number of frames done.
        """
        profiles = self.at_profiles(sets, frames, progress)
        return CaseFigures(reduce_cases(profiles.values, self.cases.errors_by))

    def at_profiles(
        self, sets: Sets, frames: Frames, progress: Report | None = None
    ) -> CaseFigures:
        """Figures of n sets at each error profile, with the axes profile and set.

        They are reduced over IoU thresholds, levels of traffic and failures, and are means over
        drawings of the site; kbit is for intact sets.

        frames: frame numbers; progress: called with the number of frames done, as a mean over the
        profiles.
        """
        rows, owners = self.cases.expand(sets)
        # levels without any of the frames are left out; undivided traffic is one part
        level_frames = [frames[np.isin(frames, level)] for level in self.levels]
        parts = [part for part in level_frames if len(part)] or [frames]
        profile_figures = []
        frames_begun = 0

        def report(done: int) -> None:
            """Report progress as a mean over profiles. done: frames of the present part."""
            if progress is not None:
                progress((frames_begun + done) // len(self.by_profile))

        for evaluator in self.by_profile:
            part_figures = []
            for part in parts:
                part_figures.append(evaluator.measure(rows, part, report))
                frames_begun += len(part)
            row_figures = reduce_levels(np.array(part_figures), self.cases.levels_by)
            profile_figures.append(reduce_failures(row_figures, owners, self.cases, tie=self.tie))
        drawing_figures = [np.array(profile_figures)]
        for drawing in self.drawings:
            drawing_figures.append(drawing.at_profiles(sets, frames, progress).values)
        return CaseFigures(reduce_cases(np.array(drawing_figures), "mean"))


@dataclass(frozen=True, eq=False)
class DetectorEvaluator:
    """Evaluation by detection at one error profile.

    Attributes:
        detected: Detector on the traffic, matched at these thresholds; it may keep detections from
            call to call.
        ious: IoU thresholds whose mean the figures are.
        seed: Seed of the resamples, the same for all sets.
        name: Name of the fidelity.
        max_blocks: Largest number of blocks that resamples draw from.
    """

    detected: Detected
    ious: tuple[float, ...] = (0.7,)
    seed: int = 0
    name: str = "detector"
    max_blocks: float = math.inf

    @property
    def frames(self) -> int:
        """Number of frames."""
        return self.detected.frames

    def count_objects(self, frames: Frames) -> int:
        """Number of objects to be found in these frames."""
        return int(sum(self.detected.scored(k).sum() for k in frames.tolist()))

    def measure(
        self, sets: Sets, frames: Frames, progress: Report | None = None
    ) -> Float64[np.ndarray, "n figures"]:
        """Figures of n intact sets on these frames, a row of `CaseFigures.values` for each.

        progress: called with the number of frames done.
        """
        detected = self.detected
        subsets = [tuple(np.flatnonzero(row).tolist()) for row in sets]
        # equal sets, such as what failures leave of several, are measured once
        outcomes = detected.outcomes(dict.fromkeys(subsets), frames.tolist(), progress)
        draws = draws_of_blocks(frames // BLOCK_FRAMES, seed=self.seed)
        truths = self.count_by_class(frames)
        figures = {}
        for subset, frame_outcomes in outcomes.items():
            tallies = self.tally(frame_outcomes, truths)
            kbit = np.mean([outcome.bits.sum() for outcome in frame_outcomes]) / 1000
            figures[subset] = measure_tallies(tallies, detected.classes, draws, kbit=kbit)
        return np.array([figures[subset] for subset in subsets])

    def count_by_class(self, frames: Frames) -> list[Int64[np.ndarray, " k"]]:
        """Number of objects to find in each frame, for each class that counts."""
        labels = self.detected.classes.labels
        return [self.detected.count_to_find(frames.tolist(), label) for label in labels]

    def tally(
        self, outcomes: Sequence[Outcome], truths: Sequence[Int64[np.ndarray, " k"]]
    ) -> list[list[Tally]]:
        """Tallies of one set in some frames; axes of the lists: IoU threshold, class.

        outcomes: the set's outcome in each frame; truths: objects of each class, by
        `count_by_class`."""
        class_outcomes = []
        for label in self.detected.classes.labels:
            class_outcomes.append([outcome.of_class(label) for outcome in outcomes])
        tallies = []
        for iou_index in map(self.detected.ious.index, self.ious):
            class_tallies = [
                Tally.from_outcomes(outcomes_of_class, class_truths, iou_index)
                for outcomes_of_class, class_truths in zip(class_outcomes, truths, strict=True)
            ]
            tallies.append(class_tallies)
        return tallies


class FastEvaluator:
    """Evaluation by a fidelity that scores visibility, rendering only requested candidates.

    The AP is the one on all frames together. Its resamples are means over batches of blocks drawn
    with replacement, shifted so that the mean over batches is that AP.

    preparation: traffic and candidates; fidelity: its name; seed: for the resamples.
    """

    max_blocks = MAX_BATCHES  # batches of whole blocks are drawn

    def __init__(self, preparation: Preparation, fidelity: FidelityName, seed: int) -> None:
        """Evaluate by a fidelity in a preparation's traffic. seed: draws the resamples."""
        self.name: FidelityName = fidelity
        self._preparation = preparation
        self._seed = seed
        self.frames = len(preparation.traffic)
        self._visibilities: dict[bytes, Visibility] = {}  # by the indices of candidates

    def count_objects(self, frames: Frames) -> int:
        """Number of objects to be found in these frames."""
        # any candidate will do: visibility has a column for every object
        any_visibility = self._find_visibility(np.array([0]))
        return int(np.isin(any_visibility.frame, frames).sum())

    def measure(
        self, sets: Sets, frames: Frames, progress: Report | None = None
    ) -> Float64[np.ndarray, "n figures"]:
        """Figures of n intact sets on these frames, a row of `CaseFigures.values` for each.

        There is no recall and precision. progress: called once, with the number of all frames.
        """
        # candidates of any set; the empty set needs one too, to have the objects
        members = np.flatnonzero(sets.any(axis=0)) if sets.any() else np.array([0])
        estimates = self._estimate(sets, members, frames)
        is_counted = np.isin(self._find_visibility(members).frame, frames)
        frame_blocks = frames // BLOCK_FRAMES  # number of each frame's block
        blocks = np.unique(frame_blocks)
        # batch of each frame: whole blocks in order, nearly as many in each batch
        batch_count = min(MAX_BATCHES, len(blocks))
        frame_batches = np.searchsorted(blocks, frame_blocks) * batch_count // len(blocks)
        batch_estimates = []
        for batch in np.unique(frame_batches):
            batch_estimates.append(self._estimate(sets, members, frames[frame_batches == batch]))
        # weight of each batch in each resample's mean: resamples × batches
        draws = draws_of_blocks(np.arange(len(batch_estimates)), seed=self._seed)
        weights = draws / len(batch_estimates)
        ap = _stack_ap(estimates)  # IoU thresholds × sets
        # axes: IoU, set, batch
        batch_ap = np.stack(
            [_stack_ap(estimates_of_one) for estimates_of_one in batch_estimates], axis=2
        )
        resamples = batch_ap @ weights.T
        if progress is not None:
            progress(len(frames))
        # the mean over batches differs from the AP on all frames together
        shift = (batch_ap.mean(axis=2) - ap)[:, :, None]
        figures = CaseFigures.from_ap(
            ap, np.nan, resamples - shift, objects=int(is_counted.sum()), frames=len(frames)
        )
        mean_figures = reduce_cases(figures.values, "mean")
        mean_figures[:, KBIT_COLUMN] = estimates[0].kbit  # kbit does not depend on the threshold
        return mean_figures

    def _estimate(
        self, sets: Sets, members: Int64[np.ndarray, " u"], frames: Frames
    ) -> list[Estimate]:
        """Estimate of n sets on these frames (AP and kbit of each) at each IoU threshold.

        sets: n sets × all candidates, rows of booleans; members: indices of all candidates that any
        set has, ascending. Only these are looked at."""
        preparation = self._preparation
        candidates = preparation.setting.pool.select(members)
        visibility = of_frames(self._find_visibility(members), np.sort(frames))
        selection = preparation.with_candidates(candidates, visibility)
        # only the detector, which this class does not serve, takes the error profile into account
        any_profile, *_ = preparation.setting.cases.profiles
        fidelities = selection.at_thresholds(self.name, any_profile)  # one for each threshold
        return [fidelity(sets[:, members]) for fidelity in fidelities]

    def _find_visibility(self, members: Int64[np.ndarray, " u"]) -> Visibility:
        """Points of some candidates (indices) on the objects in all frames.

        It is kept for the next call with the same candidates."""
        key = members.tobytes()
        preparation = self._preparation
        if key not in self._visibilities:
            self._visibilities[key] = see(
                preparation.traffic,
                preparation.setting.pool.select(members),
                labels=preparation.setting.counted.labels,
                run=replace(preparation.run, progress=None),
            )
        return self._visibilities[key]


def _stack_ap(estimates: list[Estimate]) -> Float64[np.ndarray, "ious n"]:
    """AP of n sets in a row for each estimate, one estimate an IoU threshold."""
    return np.stack([estimate.ap for estimate in estimates])
