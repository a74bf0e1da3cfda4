"""Evaluators: sensor sets scored on fresh traffic, with resamples of blocks of frames that are drawn alike for all.

`DetectorEvaluator` detects; `FastEvaluator` has another fidelity, such as the surrogate, score batches of the frames,
where there is no detector. Frames of one block of `BLOCK_FRAMES` show the same objects, so that blocks are drawn whole.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple, Protocol, runtime_checkable

import numpy as np

from placement_env.analysis.intervals import BLOCK_FRAMES, Tally, draws_of_blocks
from placement_env.fidelity.combined.error_profiles import ErrorProfiles, several
from placement_env.fidelity.combined.prepared import Counting
from placement_env.fidelity.combined.robust import Failing
from placement_env.fidelity.combined.traffic_levels import TrafficLevels
from placement_env.fidelity.detector import Detected
from placement_env.fidelity.preparation import Preparation
from placement_env.fidelity.visibility import Visibility, of_frames, see
from placement_env.protocol import Fidelity
from toolkit.arrays import Bool, Float64, Int64

BATCHES = 12  # of frames, at most, that a fast fidelity scores apart


class Evaluated(NamedTuple):
    """n sets on some frames: AP, kbit of the whole set, and the AP in each resample; the same draws for all sets.
    frames: how many of those asked for, the first ones, where time was up; None for all."""

    ap: Float64[np.ndarray, " n"]
    kbit: Float64[np.ndarray, " n"]
    resamples: Float64[np.ndarray, "n resamples"]
    frames: int | None = None


@runtime_checkable
class Evaluator(Protocol):
    """Scores sets of candidates on frames of traffic that no search saw."""

    @property
    def name(self) -> str:
        """Of the fidelity."""
        ...

    @property
    def frames(self) -> int:
        """How many there are."""
        ...

    def objects_in(self, frames: Int64[np.ndarray, " k"]) -> int:
        """How many are to be found in these frames."""
        ...

    def evaluate(
        self,
        sets: Bool[np.ndarray, "n C"],
        frames: Int64[np.ndarray, " k"],
        progress: Callable[[int], None] | None = None,
    ) -> Evaluated:
        """The sets on these frames. progress: called with how many frames are done."""
        ...


def evaluator_of(
    preparation: Preparation, fidelity: str, *, counting: Counting | None = None, seed: int = 0
) -> Evaluator:
    """The evaluator for a preparation's traffic by the fidelity of a name, over its error profiles where there are
    several. counting: at which IoU thresholds, and with which failures, None for the preparation's own; seed: of the
    resamples."""
    over = several(preparation.errors)
    if over is not None:
        made = [evaluator_of(at, fidelity, counting=counting, seed=seed) for at in preparation.at_profiles]
        return ProfileEvaluator(tuple(made), over)
    if counting is None:
        return _plain(preparation, fidelity, seed)
    each = [_plain(at, fidelity, seed) for at in counting.preparations(preparation)]
    return counted_evaluator(each, counting, counting.parts(preparation.traffic) if counting.levels.count > 1 else ())


def counted_evaluator(
    each: Sequence[Evaluator], counting: Counting | None, parts: Sequence[Int64[np.ndarray, " _"]] = ()
) -> Evaluator:
    """The mean of evaluators of one IoU threshold each, over levels of traffic, and what is left where sensors fail.
    parts: the frames of each level, none where all traffic is one."""
    mean = each[0] if len(each) == 1 else MeanEvaluator(tuple(each))
    if counting is not None and parts:
        mean = LevelEvaluator(mean, counting.levels, tuple(parts))
    return RobustEvaluator(mean, counting.failing) if counting is not None and counting.failing.sensors else mean


def _plain(preparation: Preparation, fidelity: str, seed: int) -> Evaluator:
    if fidelity == "detector":
        detected = preparation.fidelity(fidelity)
        if not isinstance(detected, Detected):
            raise TypeError("fidelity detector must be Detected")
        return DetectorEvaluator(detected, seed)
    return FastEvaluator(preparation, fidelity, seed)


def race_order(frames: int, *, seed: int = 0) -> Int64[np.ndarray, " frames"]:
    """The frames of a race: one of every block, in random order, then a second of every block, and so on, so that the
    first few show as different traffic as can be."""
    rng = np.random.default_rng(seed)
    blocks = rng.permutation(-(-frames // BLOCK_FRAMES))
    rounds = [blocks * BLOCK_FRAMES + place for place in rng.permutation(BLOCK_FRAMES)]
    order = np.concatenate(rounds).astype(np.int64)
    return order[order < frames]


@dataclass(frozen=True, eq=False)
class DetectorEvaluator:
    """By detection; what was detected is kept where `detected` keeps it. seed: of the resamples."""

    detected: Detected
    seed: int = 0
    name: str = "detector"

    @property
    def frames(self) -> int:
        """How many there are."""
        return self.detected.frames

    def objects_in(self, frames: Int64[np.ndarray, " k"]) -> int:
        """How many are to be found in these frames."""
        return int(sum(self.detected.scored(k).sum() for k in frames.tolist()))

    def evaluate(
        self,
        sets: Bool[np.ndarray, "n C"],
        frames: Int64[np.ndarray, " k"],
        progress: Callable[[int], None] | None = None,
    ) -> Evaluated:
        """The sets on these frames."""
        detected, classes = self.detected, self.detected.classes
        rows = [tuple(np.flatnonzero(row).tolist()) for row in sets]
        outcomes = detected.outcomes(dict.fromkeys(rows), frames.tolist(), progress)
        at = detected.ious.index(detected.iou)
        draws = draws_of_blocks(frames // BLOCK_FRAMES, seed=self.seed)
        truths = [
            np.array([detected.to_find(k, label).sum() for k in frames.tolist()], np.int64) for label in classes.labels
        ]
        ap, resamples, kbit = np.zeros(len(sets)), np.zeros((len(sets), len(draws))), np.zeros(len(sets))
        for n, row in enumerate(rows):
            tallies = [
                Tally.of([outcome.of_class(label) for outcome in outcomes[row]], there, at)
                for label, there in zip(classes.labels, truths, strict=True)
            ]
            ap[n] = classes.combined(np.array([[tally.ap for tally in tallies]]))[0]
            resamples[n] = classes.combined(np.stack([tally.resamples(draws=draws) for tally in tallies], axis=1))
            kbit[n] = np.mean([outcome.bits.sum() for outcome in outcomes[row]]) / 1000
        return Evaluated(ap, kbit, resamples)


class Like:
    """An evaluator that is made of others and has the name and the frames of the first of them."""

    @property
    def first(self) -> Evaluator:
        """Whose they are."""
        raise NotImplementedError

    @property
    def name(self) -> str:
        """Of the fidelity."""
        return self.first.name

    @property
    def frames(self) -> int:
        """How many there are."""
        return self.first.frames

    def objects_in(self, frames: Int64[np.ndarray, " k"]) -> int:
        """How many are to be found in these frames."""
        return self.first.objects_in(frames)


@dataclass(frozen=True, eq=False)
class MeanEvaluator(Like):
    """The mean of several, of one IoU threshold each; kbit are those of the first."""

    evaluators: tuple[Evaluator, ...]

    @property
    def first(self) -> Evaluator:
        """That of the first threshold."""
        return self.evaluators[0]

    def evaluate(
        self,
        sets: Bool[np.ndarray, "n C"],
        frames: Int64[np.ndarray, " k"],
        progress: Callable[[int], None] | None = None,
    ) -> Evaluated:
        """The sets on these frames."""
        found = [each.evaluate(sets, frames, progress) for each in self.evaluators]
        ap = np.mean([each.ap for each in found], axis=0)
        return Evaluated(ap, found[0].kbit, np.mean([each.resamples for each in found], axis=0))


@dataclass(frozen=True, eq=False)
class RobustEvaluator(Like):
    """What is left of sets when sensors fail, in every resample by itself; kbit are those of the intact set."""

    evaluator: Evaluator
    failing: Failing

    @property
    def first(self) -> Evaluator:
        """That of intact sets."""
        return self.evaluator

    def evaluate(
        self,
        sets: Bool[np.ndarray, "n C"],
        frames: Int64[np.ndarray, " k"],
        progress: Callable[[int], None] | None = None,
    ) -> Evaluated:
        """The sets on these frames."""
        rows, owners = self.failing.cases(sets)
        found = self.evaluator.evaluate(rows, frames, progress)
        ap, resamples = (self.failing.left(each, owners) for each in (found.ap, found.resamples))
        return Evaluated(ap, found.kbit[: len(sets)], resamples)


@dataclass(frozen=True, eq=False)
class LevelEvaluator(Like):
    """Each level of traffic by itself, then their mean or the worst. evaluator: of all traffic; parts: frames of each
    level. kbit are those of all frames."""

    evaluator: Evaluator
    levels: TrafficLevels
    parts: tuple[Int64[np.ndarray, " _"], ...]

    @property
    def first(self) -> Evaluator:
        """That of all traffic."""
        return self.evaluator

    def evaluate(
        self,
        sets: Bool[np.ndarray, "n C"],
        frames: Int64[np.ndarray, " k"],
        progress: Callable[[int], None] | None = None,
    ) -> Evaluated:
        """The sets on these frames. In a resample each level is drawn from its own blocks."""
        there = [own for own in (frames[np.isin(frames, part)] for part in self.parts) if len(own)]
        found, done = [], 0
        for own in there:
            found.append(self.evaluator.evaluate(sets, own))
            done += len(own)
            if progress is not None:
                progress(done)
        ap, resamples = (
            self.levels.combined(np.stack(each)) for each in ([f.ap for f in found], [f.resamples for f in found])
        )
        share = np.array([len(own) for own in there]) / len(frames)
        return Evaluated(ap, share @ np.stack([each.kbit for each in found]), resamples)


@dataclass(frozen=True, eq=False)
class ProfileEvaluator(Like):
    """Each error profile by itself, with an evaluator of its own, then their mean or for each set the one of least AP,
    in every resample by itself; kbit are those of the same profile."""

    evaluators: tuple[Evaluator, ...]
    errors: ErrorProfiles

    @property
    def first(self) -> Evaluator:
        """That of the first profile."""
        return self.evaluators[0]

    def evaluate(
        self,
        sets: Bool[np.ndarray, "n C"],
        frames: Int64[np.ndarray, " k"],
        progress: Callable[[int], None] | None = None,
    ) -> Evaluated:
        """The sets on these frames."""
        found = self.at_each(sets, frames, progress).values()
        ap, resamples, kbit = (np.stack([getattr(f, name) for f in found]) for name in ("ap", "resamples", "kbit"))
        shares = self.errors.shares(ap)
        return Evaluated((shares * ap).sum(axis=0), (shares * kbit).sum(axis=0), self.errors.combined(resamples))

    def at_each(
        self,
        sets: Bool[np.ndarray, "n C"],
        frames: Int64[np.ndarray, " k"],
        progress: Callable[[int], None] | None = None,
    ) -> dict[str, Evaluated]:
        """The same at each profile, by its name."""
        found: dict[str, Evaluated] = {}
        for name, each in zip(self.errors.names, self.evaluators, strict=True):
            report = None if progress is None else partial(_share_done, progress, len(found) * len(frames), self)
            found[name] = each.evaluate(sets, frames, report)
        return found


def _share_done(progress: Callable[[int], None], before: int, over: ProfileEvaluator, done: int) -> None:
    progress((before + done) // len(over.evaluators))


class FastEvaluator:
    """By a fidelity that scores what candidates see: nothing but the sets asked for is rendered.

    The AP is that of all frames together; its resamples are means over batches of blocks drawn with replacement, moved
    so that their mean is that AP. seed: of the resamples.
    """

    def __init__(self, preparation: Preparation, fidelity: str, seed: int = 0) -> None:
        self.name, self._preparation, self._seed = fidelity, preparation, seed
        self.frames = len(preparation.traffic)
        self._seen: dict[bytes, Visibility] = {}

    def objects_in(self, frames: Int64[np.ndarray, " k"]) -> int:
        """How many are to be found in these frames."""
        return int(np.isin(self._look(np.array([0])).frame, frames).sum())

    def evaluate(
        self,
        sets: Bool[np.ndarray, "n C"],
        frames: Int64[np.ndarray, " k"],
        progress: Callable[[int], None] | None = None,
    ) -> Evaluated:
        """The sets on these frames."""
        used = np.flatnonzero(sets.any(axis=0))
        used = used if len(used) else np.array([0])
        whole = self._scored_by(used, frames)(sets[:, used])
        blocks = frames // BLOCK_FRAMES
        different = np.unique(blocks)
        batch = np.searchsorted(different, blocks) * min(BATCHES, len(different)) // len(different)
        parts = np.stack(
            [self._scored_by(used, frames[batch == b])(sets[:, used]).ap for b in np.unique(batch)], axis=1
        )
        draws = draws_of_blocks(np.arange(parts.shape[1]), seed=self._seed) / parts.shape[1]
        resamples = parts @ draws.T
        if progress is not None:
            progress(len(frames))
        return Evaluated(whole.ap, whole.kbit, resamples - (parts.mean(axis=1) - whole.ap)[:, None])

    def _scored_by(self, used: Int64[np.ndarray, " u"], frames: Int64[np.ndarray, " k"]) -> Fidelity:
        made = self._preparation
        seen = of_frames(self._look(used), np.sort(frames))
        return made.at(made.candidates.select(used), seen).fidelity(self.name)

    def _look(self, used: Int64[np.ndarray, " u"]) -> Visibility:
        key = used.tobytes()
        if key not in self._seen:
            made = self._preparation
            self._seen[key] = see(
                made.traffic, made.candidates.select(used), labels=made.classes.labels, workers=made.workers,
                ray=made.ray, cache=made.disk_cache,
            )  # fmt: skip
        return self._seen[key]
