"""Evaluators of sensor sets on fresh traffic, with resamples of blocks of frames that are the same
for all sets.

`DetectorEvaluator` detects; `FastEvaluator` lets another fidelity, such as the surrogate, score
batches of the frames. Both know one error profile and give figures at every IoU threshold;
`CasesEvaluator` combines them into one figure. Frames of one block of `BLOCK_FRAMES` show the same
objects, so blocks are drawn whole. `Schedule` divides the time of a portfolio: what a stage does
not use goes to the next."""

import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from placement_env.analysis.intervals import (
    BLOCK_FRAMES,
    Interval,
    Tally,
    draws_of_blocks,
    figure_interval,
)
from placement_env.cases import USUAL_CASES, Cases
from placement_env.fidelity.detector import IOUS, Detected
from placement_env.fidelity.preparation import Preparation
from placement_env.fidelity.seeing import see
from placement_env.fidelity.visibility import Visibility, of_frames
from placement_env.protocol import Estimate, FidelityName
from placement_env.subsets import Sets
from toolkit.arrays import Float64, Int64
from toolkit.runtime.run import Processes

# share of a portfolio's time that its searches may take; races and judgement share the rest
SEARCHING = 0.3
LONG_ENOUGH = 120.0  # s above which all frames are simulated; with less, a proportional part
FEWEST = BLOCK_FRAMES  # frames of a part of traffic
BATCHES = 12  # largest number of batches that a fast fidelity scores separately
Frames = Int64[np.ndarray, " k"]
Report = Callable[[int], None]


class Evaluated(NamedTuple):
    """Figures of n sets on some frames, at each of several IoU thresholds or over them. frames:
    number of requested frames used, from the first, where time ran out; None for all."""

    ap: Float64[np.ndarray, "*ious n"]
    kbit: Float64[np.ndarray, " n"]
    resamples: Float64[np.ndarray, "*ious n resamples"]
    frames: int | None = None


def build_evaluator(
    preparation: Preparation, fidelity: FidelityName, *, seed: int = 0
) -> "CasesEvaluator":
    """Evaluator of a preparation's traffic by a fidelity, over the cases of its setting. seed: of
    the resamples."""
    cases = preparation.setting.cases
    if fidelity != "detector":
        profiles = (FastEvaluator(preparation, fidelity, seed),) * len(cases.profiles)
        return CasesEvaluator(profiles, cases, preparation.levels)
    detectors = tuple(
        DetectorEvaluator(preparation.detected(each), cases.ious, seed) for each in cases.profiles
    )
    return CasesEvaluator(detectors, cases, preparation.levels)


def race_order(frames: int, *, seed: int = 0) -> Int64[np.ndarray, " frames"]:
    """Frames of a race, varied from the start: one of every block in random order, then a second of
    every block, …"""
    rng = np.random.default_rng(seed)
    blocks = rng.permutation(-(-frames // BLOCK_FRAMES))
    order = (blocks * BLOCK_FRAMES + rng.permutation(BLOCK_FRAMES)[:, None]).ravel()
    return order[order < frames]


@dataclass(frozen=True, eq=False)
class CasesEvaluator:
    """Evaluate over cases. kbit are those of intact sets in all frames.

    levels: frames of each level of traffic, empty where it is undivided. A resample draws each
    level from its own blocks, and the worst case is found within the resample. drawings: evaluators
    of the same candidates at other drawings of the site, over which figures are means."""

    profiles: "tuple[DetectorEvaluator | FastEvaluator, ...]"
    cases: Cases = USUAL_CASES
    levels: tuple[Int64[np.ndarray, " _"], ...] = ()
    drawings: "tuple[CasesEvaluator, ...]" = ()

    @property
    def name(self) -> str:
        """Name of the fidelity."""
        return self.profiles[0].name

    @property
    def frames(self) -> int:
        """Number of frames."""
        return self.profiles[0].frames

    def count_objects(self, frames: Frames) -> int:
        """Number of objects to be found in these frames."""
        return self.profiles[0].count_objects(frames)

    def interval(
        self, ap: float, resamples: Float64[np.ndarray, " resamples"], frames: Frames
    ) -> Interval:
        """Interval of an AP on these frames, NaN on too few of them."""
        blocks = len(np.unique(frames // BLOCK_FRAMES)) // max(1, len(self.levels))
        if isinstance(self.profiles[0], FastEvaluator):
            blocks = min(blocks, BATCHES)
        return figure_interval(ap, resamples, blocks=blocks, objects=self.count_objects(frames))

    def mean_ap(self, sets: Sets, frames: Frames) -> Float64[np.ndarray, " n"]:
        """Mean AP of intact sets over IoU thresholds at the first error profile; 0 without a
        detector."""
        profile = self.profiles[0]
        if not isinstance(profile, DetectorEvaluator):
            return np.zeros(len(sets))
        estimates = profile.detected.estimates(sets, frames.tolist())
        own = np.asarray(np.mean([estimates[iou].ap for iou in IOUS], axis=0))
        return np.asarray(
            np.mean([own, *(each.mean_ap(sets, frames) for each in self.drawings)], axis=0)
        )

    def evaluate(self, sets: Sets, frames: Frames, progress: Report | None = None) -> Evaluated:
        """Figures of the sets on these frames. progress: called with the number of frames done."""
        ap, kbit, resamples = self.at_profiles(sets, frames, progress)
        shares = self.cases.shares(ap)
        return Evaluated(
            (shares * ap).sum(axis=0),
            (shares * kbit).sum(axis=0),
            self.cases.over_errors(resamples),
        )

    def at_profiles(
        self, sets: Sets, frames: Frames, progress: Report | None = None
    ) -> tuple[
        Float64[np.ndarray, "P n"], Float64[np.ndarray, "P n"], Float64[np.ndarray, "P n resamples"]
    ]:
        """AP, kbit and resampled AP of the sets at each error profile."""
        rows, owners = self.cases.expand(sets)
        parts = [
            own for own in (frames[np.isin(frames, level)] for level in self.levels) if len(own)
        ] or [frames]
        found: list[list[Evaluated]] = []
        begun = 0

        def report(done: int) -> None:
            if progress is not None:
                progress((begun + done) // len(self.profiles))

        for profile in self.profiles:
            found.append([])
            for part in parts:
                found[-1].append(profile.at_thresholds(rows, part, report))
                begun += len(part)
        ap, kbits, resamples = (
            np.array([[level[i] for level in each] for each in found]) for i in range(3)
        )
        share = np.array([len(part) for part in parts]) / len(frames)
        kbit = np.array([share @ each for each in kbits[..., : len(sets)]])
        own = (self.cases.at_profiles(ap, owners), kbit, self.cases.at_profiles(resamples, owners))
        if not self.drawings:
            return own
        ap, kbit, resamples = zip(
            own, *(one.at_profiles(sets, frames, progress) for one in self.drawings), strict=True
        )
        return np.mean(ap, axis=0), np.mean(kbit, axis=0), np.mean(resamples, axis=0)


@dataclass(frozen=True, eq=False)
class DetectorEvaluator:
    """Evaluate by detection. Detections are kept where `detected` keeps them. seed: of the
    resamples."""

    detected: Detected
    ious: tuple[float, ...] = (0.7,)
    seed: int = 0
    name: str = "detector"

    @property
    def frames(self) -> int:
        """Number of frames."""
        return self.detected.frames

    def count_objects(self, frames: Frames) -> int:
        """Number of objects to be found in these frames."""
        return int(sum(self.detected.scored(k).sum() for k in frames.tolist()))

    def at_thresholds(
        self, sets: Sets, frames: Frames, progress: Report | None = None
    ) -> Evaluated:
        """Figures of the sets on these frames."""
        detected = self.detected.at(self.ious[0], self.ious)
        classes = detected.classes
        numbers = frames.tolist()
        rows = [tuple(np.flatnonzero(row).tolist()) for row in sets]
        outcomes = detected.outcomes(dict.fromkeys(rows), numbers, progress)
        draws = draws_of_blocks(frames // BLOCK_FRAMES, seed=self.seed)
        truths = [
            np.array([detected.to_find(k, label).sum() for k in numbers], np.int64)
            for label in classes.labels
        ]
        shape = (len(self.ious), len(sets))
        ap = np.empty(shape)
        resamples = np.empty((*shape, len(draws)))
        kbit = np.empty(len(sets))
        for n, row in enumerate(rows):
            kbit[n] = np.mean([outcome.bits.sum() for outcome in outcomes[row]]) / 1000
            of_class = [
                [outcome.of_class(label) for outcome in outcomes[row]] for label in classes.labels
            ]
            for i, at in enumerate(map(detected.ious.index, self.ious)):
                tallies = [
                    Tally.of(each, there, at) for each, there in zip(of_class, truths, strict=True)
                ]
                ap[i, n] = classes.combined(np.array([[tally.ap for tally in tallies]]))[0]
                drawn = np.stack([tally.resamples(draws=draws) for tally in tallies], axis=1)
                resamples[i, n] = classes.combined(drawn)
        return Evaluated(ap, kbit, resamples)


class FastEvaluator:
    """Evaluate by a fidelity that scores visibility. Only requested sets are rendered. seed: of the
    resamples.

    The AP is that of all frames together; its resamples are means over batches of blocks drawn with
    replacement, shifted so that their mean is that AP."""

    def __init__(self, preparation: Preparation, fidelity: FidelityName, seed: int) -> None:
        self.name: FidelityName = fidelity
        self._preparation = preparation
        self._seed = seed
        self.frames = len(preparation.traffic)
        self._seen: dict[bytes, Visibility] = {}

    def count_objects(self, frames: Frames) -> int:
        """Number of objects to be found in these frames."""
        return int(np.isin(self._look(np.array([0])).frame, frames).sum())

    def at_thresholds(
        self, sets: Sets, frames: Frames, progress: Report | None = None
    ) -> Evaluated:
        """Figures of the sets on these frames."""
        used = np.flatnonzero(sets.any(axis=0)) if sets.any() else np.array([0])
        whole = self._score(sets, used, frames)
        blocks = frames // BLOCK_FRAMES
        different = np.unique(blocks)
        batch = np.searchsorted(different, blocks) * min(BATCHES, len(different)) // len(different)
        batches = [self._score(sets, used, frames[batch == b]) for b in np.unique(batch)]
        draws = draws_of_blocks(np.arange(len(batches)), seed=self._seed) / len(batches)
        ap = np.stack([each.ap for each in whole])
        parts = np.stack([[at.ap for at in each] for each in batches], axis=2)  # iou, set, batch
        resamples = parts @ draws.T
        if progress is not None:
            progress(len(frames))
        return Evaluated(ap, whole[0].kbit, resamples - (parts.mean(axis=2) - ap)[:, :, None])

    def _score(self, sets: Sets, used: Int64[np.ndarray, " u"], frames: Frames) -> list[Estimate]:
        made = self._preparation
        there = made.at(
            made.setting.pool.select(used), of_frames(self._look(used), np.sort(frames))
        )
        fidelities = there.at_thresholds(self.name, made.setting.cases.profiles[0])
        return [fidelity(sets[:, used]) for fidelity in fidelities]

    def _look(self, used: Int64[np.ndarray, " u"]) -> Visibility:
        key = used.tobytes()
        made = self._preparation
        if key not in self._seen:
            run = replace(made.run, progress=None)
            labels = made.setting.counted.labels
            self._seen[key] = see(
                made.traffic, made.setting.pool.select(used), labels=labels, run=run
            )
        return self._seen[key]


@dataclass(eq=False)
class TimedEvaluator:
    """Evaluate frame by frame until time is up, by the monotonic clock (s), and report the number
    of frames done.

    It is called with the same frames in the same order every time, for fewer and fewer sets.
    at_once: frames between two looks at the clock; least: frames done regardless of time."""

    evaluator: CasesEvaluator
    until: float
    at_once: int = 1
    least: int = 1
    done: int = 0

    @property
    def frames(self) -> int:
        """Number of frames."""
        return self.evaluator.frames

    def mean_ap(self, sets: Sets, frames: Frames) -> Float64[np.ndarray, " n"]:
        """Mean AP over the detector's IoU thresholds, whatever time is left."""
        return self.evaluator.mean_ap(sets, frames)

    def evaluate(self, sets: Sets, frames: Frames, progress: Report | None = None) -> Evaluated:
        """Evaluate the sets on as many frames as time allows."""
        while self.done < len(frames) and (self.done < self.least or time.monotonic() < self.until):
            part = frames[self.done : self.done + self.at_once]
            self.evaluator.evaluate(sets, part)
            self.done += len(part)
            if progress is not None:
                progress(self.done)
        counted = min(self.done, len(frames))
        found = self.evaluator.evaluate(sets, frames[:counted])
        return found._replace(frames=None if counted == len(frames) else counted)


Timed = CasesEvaluator | TimedEvaluator


@dataclass(frozen=True)
class Schedule:
    """Seconds for everything from now on, None for no limit. at_once: frames between two looks at
    the clock."""

    seconds: float | None = None
    at_once: int = 1
    began: float = field(default_factory=time.monotonic)

    @staticmethod
    def of(seconds: float | None, processes: Processes) -> "Schedule":
        """Schedule with batches that keep the processes busy."""
        return Schedule(
            seconds, 16 if processes.ray else 1 if processes.alone else 2 * processes.count
        )

    @property
    def left(self) -> float:
        """Seconds that are left, infinite without a limit."""
        return np.inf if self.seconds is None else self.began + self.seconds - time.monotonic()

    def searching(self, searches: int) -> float | None:
        """Seconds of each search, for a number of searches."""
        return None if self.seconds is None else self.seconds * SEARCHING / searches

    def frames(self, frames: int) -> int:
        """Number of frames of one part of traffic that fit, in whole blocks."""
        if self.seconds is None or self.seconds >= LONG_ENOUGH:
            return frames
        blocks = int(frames * self.seconds / LONG_ENOUGH) // BLOCK_FRAMES
        return min(frames, max(FEWEST, blocks * BLOCK_FRAMES))

    def limit(self, evaluator: CasesEvaluator, share: float = 1.0, least: int = FEWEST) -> Timed:
        """Evaluator within a share of the time that is left, but on at least some frames: fewer say
        nothing."""
        if self.seconds is None:
            return evaluator
        return TimedEvaluator(evaluator, time.monotonic() + share * self.left, self.at_once, least)
