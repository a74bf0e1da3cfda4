"""Schemes, Shapley values, failures and order of building of the chosen set."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from placement_env.analysis.intervals import count_blocks, is_as_good
from placement_env.analysis.worth import estimate_worth, exact_worth
from placement_env.cases import Cases
from placement_env.fidelity.detector import IOUS, Detected
from placement_env.objective import Objective
from placement_env.report import content
from placement_env.report.planning import judging
from placement_env.report.planning.sampled_judge import SampledJudge
from placement_env.subsets import all_subsets
from toolkit.arrays import Bool, Float64
from toolkit.detection.schemes import PAPER_SCHEMES
from toolkit.runtime.run import Run

MAX_SUBSET_SENSORS = 6  # for larger sets, not every subset is judged by the detector


@dataclass(frozen=True, eq=False)
class ChosenSet:
    """Schemes, worth of each sensor, failures and order of building of the chosen set.

    Subsets are rows of booleans over the set's k members; sets are rows over all candidates.

    Attributes:
        members: Indices of its candidates, ascending.
        names: Names of its candidates.
        judge: Judge on the final traffic.
        objective: Objective of the searches, which scores subsets of large sets.
        run: Run of the plan."""

    members: tuple[int, ...]
    names: tuple[str, ...]
    judge: judging.Judge
    objective: Objective
    run: Run = Run()

    @property
    def is_small(self) -> bool:
        """True for at most `MAX_SUBSET_SENSORS` sensors: the detector judges every subset."""
        return len(self.members) <= MAX_SUBSET_SENSORS

    @property
    def whole_set(self) -> Bool[np.ndarray, "1 candidates"]:
        """The whole set as a row over all candidates."""
        return self.rows(np.ones((1, len(self.members)), np.bool_))

    @property
    def sampled(self) -> SampledJudge:
        """Judge of parts of the set, and of the set in other schemes, in a sample of the frames."""
        return SampledJudge(self.judge, self.whole_set)

    def stage(self, name: str, frames: int | None = None) -> Callable[[int], None] | None:
        """Return a callback that counts the frames of a stage, None if nobody listens.

        name: noun phrase for the progress line; frames: number of frames, None for all."""
        return self.run.stage(f"frames of the {name}", frames or self.judge.frames)

    def rows(self, subsets: Bool[np.ndarray, "n k"]) -> Bool[np.ndarray, "n candidates"]:
        """Expand subsets of the set to rows over all candidates."""
        rows = np.zeros((len(subsets), len(self.judge.detected.renders.sensors)), np.bool_)
        rows[:, list(self.members)] = subsets
        return rows

    def _judge(self, subsets: Bool[np.ndarray, "n k"], stage: str) -> list[content.Judgement]:
        """Return the detector's results of intact subsets: parts are judged in a sample of frames.

        stage: name in the progress line."""
        sampled_judge = self.sampled
        judge = self.judge
        report = self.stage(stage, len(sampled_judge.frames))
        judgements, _ = sampled_judge.judge_sets(judge, self.rows(subsets), judge.intact, report)
        for n in np.flatnonzero(subsets.all(axis=1)).tolist():
            judgements[n] = judge.judge(self.whole_set)[0]  # in all frames
        return judgements

    def _aps(self, subsets: Bool[np.ndarray, "n k"], stage: str) -> Float64[np.ndarray, " n"]:
        """Return the AP of subsets: judged for small sets, else predicted by the objective.

        stage: name in the progress line; not used for predictions."""
        if self.is_small:
            return np.array([judgement.ap for judgement in self._judge(subsets, stage)])
        return self.objective.scores(self.rows(subsets)).ap

    def schemes(self) -> tuple[content.SchemeFigures, ...]:
        """Judge the intact set under every scheme of the paper at every IoU.

        The thresholds are `IOUS` and the question's; if the question has several, their mean is one
        row. Figures are at the first drawing of the site and the first error profile. Other schemes
        than the plan's are judged in a sample of the frames. A scheme is marked as good if its AP
        is within the tolerance of the planned scheme's."""
        judge = replace(self.judge, drawings=())
        planned = judge.detected
        intact = judge.intact
        ious = intact.ious
        sampled_judge = SampledJudge(judge, self.whole_set)
        _, planned_draws = judge.judge_drawn(self.whole_set, intact)  # axes: the one set, resample
        blocks = count_blocks(self.judge.frames)
        # several thresholds together are one entry, for their mean
        thresholds = sorted({*IOUS, *ious}) if len(ious) == 1 else (*IOUS, ious)
        shared_names = ("codec", "memo", "processes", "classes")
        shared_values = {name: getattr(planned, name) for name in shared_names}
        figures = []
        for scheme in PAPER_SCHEMES:
            is_planned = scheme == planned.scheme.name
            frames = np.arange(judge.frames) if is_planned else sampled_judge.frames
            detected = Detected(planned.renders, planned.detector, scheme, **shared_values)
            scheme_judge = replace(judge, profiles=(detected.at(ious[0], ious),))
            report = self.stage("fusion schemes", len(frames))
            scheme_detected = scheme_judge.detected
            outcomes = scheme_detected.outcomes([self.members], frames.tolist(), report)
            # mean over frames and sensors
            bits = [outcome.bits.mean() for outcome in outcomes[self.members]]
            for iou in thresholds:
                cases = replace(intact, iou=iou)
                if is_planned:
                    judgements, draws = judge.judge_drawn(self.whole_set, cases)
                else:
                    judgements, draws = sampled_judge.judge_sets(
                        scheme_judge, self.whole_set, cases
                    )
                is_planned_iou = iou == intact.threshold
                as_good = is_planned_iou and is_as_good(draws[0], planned_draws[0], blocks)
                row = content.SchemeFigures(
                    scheme=scheme,
                    iou=iou,
                    judged=judgements[0],
                    kbit_per_sensor=float(np.mean(bits)) / 1000,
                    as_good=as_good,
                )
                figures.append(row)
        return tuple(figures)

    def worth(self) -> tuple[content.SensorWorth, ...]:
        """Return the Shapley value of each sensor, and its synergy with each other sensor (AP).

        Both are exact for small sets, from the judged AP of all subsets. For large sets they are
        estimated from a sample of subsets that the objective of the searches scores."""
        count = len(self.members)
        if self.is_small:
            aps = self._aps(all_subsets(count), "subsets")
            worth = exact_worth(lambda _: aps, count)  # asks for all subsets, in this order
        else:
            # twice as many rounds of random orders as usual
            worth = estimate_worth(lambda sets: self._aps(sets, stage=""), count, rounds=64)
        sensor_worths = []
        for k, name in enumerate(self.names):
            synergy = dict(zip(self.names, worth.synergy[k].tolist(), strict=True))
            del synergy[name]  # a sensor has no synergy with itself
            sensor_worths.append(content.SensorWorth(name, float(worth.shapley[k]), synergy))
        return tuple(sensor_worths)

    def failures(self) -> tuple[content.FailureCase, ...]:
        """Judge the remaining sensors after each failure of one sensor, then of each two.

        Within one number of failures the lowest AP comes first. At least one sensor remains, so
        sets of two have only single failures, and a single sensor none."""
        count = len(self.members)
        names = np.array(self.names)
        whole_set = np.ones((1, count), np.bool_)
        cases: list[content.FailureCase] = []
        for failing in range(1, min(3, count)):  # one or two failures
            subsets, _ = Cases(failing=failing).expand(whole_set)
            remaining = subsets[1:]  # the first is the whole set
            judgements = self._judge(remaining, "failures")
            failure_cases = [
                content.FailureCase(tuple(names[~is_left].tolist()), judgement)
                for is_left, judgement in zip(remaining, judgements, strict=True)
            ]
            cases += sorted(failure_cases, key=lambda case: case.judged.ap)
        return tuple(cases)

    def order(self) -> tuple[content.BuildStep, ...]:
        """Return the order of building, in which each sensor adds the most AP to those before.

        Each step has the sensor, and the price and result of the set so far. Next sensors are
        chosen by judged AP for small sets, else by predicted AP; the detector judges all steps."""
        built = np.zeros((1, len(self.members)), np.bool_)  # rows: nothing, then the set so far
        while not built[-1].all():
            # one row for each sensor that may come next: the set so far and this sensor
            next_sets = built[-1] | np.eye(len(self.members), dtype=np.bool_)[~built[-1]]
            best = int(np.argmax(self._aps(next_sets, "order of building")))
            built = np.concatenate([built, next_sets[best : best + 1]])
        # each step differs from the row before in one sensor; its index among the members
        added_members = np.diff(built, axis=0).argmax(axis=1)
        steps = built[1:]
        prices = self.objective.price(self.rows(steps)).tolist()
        judgements = self._judge(steps, "order of building")
        names = [self.names[i] for i in added_members]
        return tuple(map(content.BuildStep, names, prices, judgements))
