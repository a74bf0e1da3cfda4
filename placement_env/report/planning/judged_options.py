"""`JudgedOptions`: the entrants as options of a plan, judged on demand."""

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from placement_env.analysis import intervals
from placement_env.analysis.agreement import StageFigure, check_agreement
from placement_env.analysis.intervals import Resamples
from placement_env.analysis.shrinkage import shrink
from placement_env.candidates.candidates import name_sensor
from placement_env.objective import Objective
from placement_env.racing import Contest
from placement_env.report.content import PlanOption
from placement_env.report.planning.judging import Judge, one_stage, state_figure
from placement_env.report.planning.sampled_judge import SampledJudge
from placement_env.search.portfolio.entrants import Entrants
from toolkit.arrays import Int64
from toolkit.runtime.run import Run


class JudgedOptions:
    """Entrants as options of a plan; the detector judges them on demand.

    A row is the index of a set among the entrants.

    Attributes:
        objective: Objective of the searches, for prices, links and kbit.
        entrants: Sets that the searches found.
        judge: Judge on the traffic of the comparison.
        draws: AP in each resample of the sets judged so far, by row.
        sampled: Rows of the sets judged in a sample of the frames only.
        options: Option of each entrant; a judged one is replaced by one with figures."""

    def __init__(self, objective: Objective, entrants: Entrants, judge: Judge) -> None:
        """Make an option of each entrant, with figures of the objective only; none is judged."""
        self.objective = objective
        self.entrants = entrants
        self.judge = judge
        self.draws: dict[int, Resamples] = {}  # AP in each resample, by row of a judged set
        self.sampled: set[int] = set()
        self.options: list[PlanOption] = []
        mounts = objective.candidates.mounts
        for i, is_member in enumerate(entrants.sets):
            score = objective.score(np.flatnonzero(is_member))
            members = score.subset  # indices of the set's candidates
            mount_indices = objective.candidates.mount[list(members)]
            option = PlanOption(
                sensors=tuple(name_sensor(objective.names[c]) for c in members),
                price=score.price,
                kbit_per_sensor=score.kbit_per_sensor,
                kbit=score.kbit,
                # as by its search: scored together with other sets it may round differently
                predicted=round(float(entrants.predicted[i]), 6),
                judged=None,
                searches=entrants.searches[i],
                poles=tuple(mounts[m].name for m in mount_indices),
            )
            self.options.append(option)

    def judge_rows(
        self, rows: Sequence[int], run: Run = Run(), *, reference: int | None = None
    ) -> None:
        """Judge sets on all frames or in a sample, unless they are judged so already.

        Changes `options`, `draws` and `sampled` at these rows.

        Args:
            rows: Indices of the sets among the entrants.
            run: Reports the frames done.
            reference: Row of a set judged on all frames; the sets are then judged in a sample, as
                ratios to this set (`SampledJudge`). None for all frames."""
        judge = self.judge
        frames = np.arange(judge.frames)
        judge_drawn = judge.judge_drawn
        known_rows = self.draws.keys() - self.sampled
        if reference is not None:
            sampled_judge = SampledJudge(judge, self.entrants.sets[[reference]])
            frames = sampled_judge.frames
            judge_drawn = partial(sampled_judge.judge_sets, judge)
            known_rows = set(self.draws)
        new_rows = [i for i in rows if i not in known_rows]
        if not new_rows:
            return
        new_sets = self.entrants.sets[new_rows]
        stage = one_stage(run, "frames of the closest sets", len(frames))
        judged_sets, draws = judge.judge_cases(new_sets, stage, judge_drawn)
        mean_aps = judge.evaluator.mean_ap(new_sets, frames).tolist()
        for k, i in enumerate(new_rows):
            members = tuple(np.flatnonzero(self.entrants.sets[i]).tolist())
            self.options[i] = replace(
                self.options[i],
                mean_ap=mean_aps[k],
                fits_links=self.objective.fits_links(members, judge.kbit(members, frames)),
                **judged_sets[k]._asdict(),  # results by kind of case
            )
            self.draws[i] = draws[k]
        if len(frames) < judge.frames:
            self.sampled.update(new_rows)
        else:
            self.sampled.difference_update(new_rows)

    def check_race(self, row: int, ap: float, frames: Int64[np.ndarray, " k"]) -> None:
        """Raise ValueError if a judged set had quite another AP in its race.

        Nothing is compared for a set that is not judged, or over several cases, whose worst is
        lower on few frames.

        row: index of the set; ap: its AP in the race; frames: frames that it raced on."""
        option = self.options[row]
        judgement = option.judged
        has_one_case = self.judge.cases.is_one_case and len(self.judge.profiles) == 1
        if judgement is not None and has_one_case:
            objects = self.judge.evaluator.count_objects(frames)
            race_figure = StageFigure("in the race", ap=ap, objects=objects, frames=len(frames))
            comparison_figure = state_figure("in the comparison", judgement)
            check_agreement(option.sensors, race_figure, comparison_figure)

    def measure_sureness(
        self, row: int, size_rows: Int64[np.ndarray, " k"], race: Contest | None
    ) -> float | None:
        """Return the probability that no set of as many sensors is better than a judged one.

        Better means by more than `AP_TOLERANCE`. Judged sets count with all frames, the others with
        the frames on which they raced last. Returns None without a race, for a set that is not
        judged, and with too few frames or objects.

        Args:
            row: Index of the judged set among the entrants.
            size_rows: Indices of all sets of its size, ascending.
            race: Race of these sets, whose rows count within `size_rows`."""
        judgement = self.options[row].counted
        if race is None or judgement is None:
            return None
        if not intervals.is_comparable(judgement.frames, judgement.vehicles):
            return None
        judged_rows = [i for i in size_rows.tolist() if i in self.draws]
        results = [self.options[i].counted for i in judged_rows]
        aps = np.array([result.ap for result in results if result])
        draws = np.stack([self.draws[i] for i in judged_rows])
        predicted = self.entrants.predicted[judged_rows]
        blocks = intervals.count_blocks(judgement.frames)
        # noisy AP are moved towards their predictions; axes: judged set, resample
        likely_aps = shrink(aps, draws, predicted, blocks).resamples
        gains = likely_aps - likely_aps[judged_rows.index(row)]
        is_better = gains > intervals.AP_TOLERANCE
        judged_chance = float(is_better.any(axis=0).mean())
        # rows of the race: this set, then all judged ones, which are left out of the probability
        # that a set of the race is better
        race_rows = np.searchsorted(size_rows, [row, *judged_rows]).tolist()
        unjudged_chance = race.doubt(race_rows[0], judged=race_rows[1:])
        return max(0.0, 1 - judged_chance - unjudged_chance)
