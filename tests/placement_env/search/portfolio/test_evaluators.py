"""Sets on some frames: the AP that the fidelity says of them, and resamples drawn alike for all sets."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from placement_env.candidates.pool import paper_candidates
from placement_env.classes import Classes
from placement_env.fidelity.combined.error_profiles import ErrorProfiles
from placement_env.fidelity.combined.prepared import Counting
from placement_env.fidelity.combined.robust import Failing
from placement_env.fidelity.combined.traffic_levels import TrafficLevels
from placement_env.fidelity.coverage import Coverage
from placement_env.fidelity.detector import Detected
from placement_env.fidelity.preparation import Preparation
from placement_env.fidelity.visibility import of_frames, see
from placement_env.search.portfolio.evaluators import (
    DetectorEvaluator,
    FastEvaluator,
    LevelEvaluator,
    MeanEvaluator,
    ProfileEvaluator,
    RobustEvaluator,
    evaluator_of,
    race_order,
)
from toolkit.detection.schemes import find_scheme
from toolkit.sensors.error_profiles import PAPER_ERRORS, POOR

SETS = np.array([[1, 0, 0, 0], [1, 1, 0, 0], [1, 1, 1, 0]], bool)


@pytest.fixture
def prepared(small_traffic):
    made = Preparation(
        site=small_traffic.site,
        candidates=paper_candidates(small_traffic.site),
        frames=len(small_traffic),
        scheme=find_scheme("early"),
    )
    vars(made).update(traffic=small_traffic, network="general")
    return made


def test_detection_of_some_frames(street):
    evaluator = DetectorEvaluator(street.detected, seed=3)
    frames = np.array([5, 1, 2])
    found = evaluator.evaluate(SETS, frames)
    expected = street.detected.partial(SETS, frames.tolist())
    assert found.ap == pytest.approx(expected.ap)
    assert found.kbit == pytest.approx(expected.kbit)
    assert found.resamples.shape == (3, 1000)
    assert found.resamples == pytest.approx(np.repeat(found.ap[:, None], 1000, axis=1))  # all frames are alike
    assert (evaluator.frames, evaluator.name) == (8, "detector")
    assert evaluator.objects_in(np.arange(8)) == 32
    assert evaluator.objects_in(np.array([6, 1])) == 8


def test_resamples_are_of_blocks_and_the_same_for_every_set(street):
    class Blind:
        """Sees nothing in the first block of four frames."""

        def __init__(self, street):
            self.__dict__.update(vars(street))
            self.street = street

        def clouds(self, k, c):
            return self.street.clouds(k, c)[: 0 if k < 4 else None]

        def objects(self, k):
            return self.street.objects(k)

    blind = Detected(Blind(street.detected.renders), street.detected.detector, "early")
    found = DetectorEvaluator(blind, seed=1).evaluate(SETS[:2], np.arange(8))
    assert found.ap == pytest.approx([0.25, 0.375])
    assert set(found.resamples[0].round(6)) == {0.0, 0.25, 0.5}
    assert found.resamples[1] == pytest.approx(1.5 * found.resamples[0])


def test_a_fast_fidelity_scores_the_frames_together_and_in_batches(prepared, small_traffic):
    evaluator = FastEvaluator(prepared, "coverage", seed=2)
    sets = np.eye(4, dtype=bool)[[0, 2]] | np.eye(4, dtype=bool)[[3, 3]]
    found = evaluator.evaluate(sets, np.arange(5))
    seen = see(small_traffic, prepared.candidates)
    assert found.ap == pytest.approx(Coverage(seen)(sets).ap)
    assert found.kbit == pytest.approx(Coverage(seen)(sets).kbit)
    assert found.resamples.mean(axis=1) == pytest.approx(found.ap, abs=0.03)
    assert found.resamples[0].std() > 0
    some = evaluator.evaluate(sets, np.array([4, 0]))
    assert some.ap == pytest.approx(Coverage(of_frames(seen, np.array([0, 4])))(sets).ap)
    assert evaluator.objects_in(np.arange(evaluator.frames)) == seen.points.shape[1]
    assert evaluator.objects_in(np.array([1])) == (seen.frame == 1).sum()


def test_what_is_seen_of_some_frames(prepared, small_traffic):
    seen = see(small_traffic, prepared.candidates)
    part = of_frames(seen, np.array([1, 4]))
    assert part.frames == 2
    assert set(part.frame.tolist()) == {0, 1}
    assert np.array_equal(part.boxes[part.frame == 1], seen.boxes[seen.frame == 4])
    assert np.array_equal(part.points[:, part.frame == 0], seen.points[:, seen.frame == 1])
    assert np.array_equal(part.sent, seen.sent[:, [1, 4]])


def test_the_evaluator_for_a_fidelity(prepared, street):
    assert isinstance(evaluator_of(prepared, "coverage"), FastEvaluator)
    knowing = replace(prepared, detector=street.detected.detector)
    vars(knowing).update(traffic=prepared.traffic, network="general")
    assert isinstance(evaluator_of(knowing, "detector"), DetectorEvaluator)


def test_several_classes_are_combined(street):
    both = Classes(("vehicle", "pedestrian"), combine="worst")

    class Knowing:
        labels = ("vehicle", "pedestrian")
        digest = "knowing"

        def __call__(self, points, /):
            return street.detected.detector(points)

    detected = Detected(street.detected.renders, Knowing(), "early", classes=both)
    found = DetectorEvaluator(detected).evaluate(SETS, np.arange(8))
    assert found.ap.tolist() == [0.0, 0.0, 0.0]  # nobody detects the walker


@pytest.mark.parametrize("frames", [1, 7, 96])
def test_a_race_begins_with_a_frame_of_every_block(frames):
    order = race_order(frames, seed=5)
    assert sorted(order.tolist()) == list(range(frames))
    blocks = -(-frames // 4)
    if not frames % 4:
        assert sorted((order[:blocks] // 4).tolist()) == list(range(blocks))
        assert len({*(order[:blocks] % 4)}) == 1
    assert order.tolist() == race_order(frames, seed=5).tolist()


def test_the_mean_over_thresholds_and_what_is_left_in_every_resample(street):
    detector, renders = street.detected.detector, street.detected.renders
    each = tuple(DetectorEvaluator(Detected(renders, detector, "early", iou=iou)) for iou in (0.7, 1.0))
    mean = MeanEvaluator(each)
    found, parts = mean.evaluate(SETS, np.arange(8)), [one.evaluate(SETS, np.arange(8)) for one in each]
    assert found.ap == pytest.approx((parts[0].ap + parts[1].ap) / 2)
    assert found.resamples == pytest.approx((parts[0].resamples + parts[1].resamples) / 2)
    assert (mean.frames, mean.objects_in(np.arange(8)), mean.name) == (8, 32, "detector")
    hardy = RobustEvaluator(each[0], Failing(1))
    left = hardy.evaluate(SETS, np.arange(8))
    assert left.ap == pytest.approx([0.0, 0.5, 0.55], abs=0.06)
    intact = each[0].evaluate(np.array([[1, 0, 1, 0], [0, 1, 1, 0], [1, 1, 0, 0]], bool), np.arange(8))
    assert left.ap[2] == pytest.approx(intact.ap.min(), abs=1e-5)
    assert left.resamples[2] == pytest.approx(intact.resamples.min(axis=0), abs=1e-5)
    assert left.kbit == pytest.approx(parts[0].kbit)


def test_an_evaluator_counts_as_the_objective_does(prepared):
    counted = evaluator_of(prepared, "coverage", counting=Counting.of((0.7, 0.9), 1))
    assert isinstance(counted, RobustEvaluator)
    assert isinstance(counted.evaluator, MeanEvaluator)
    assert isinstance(evaluator_of(prepared, "coverage", counting=Counting.of(0.7)), FastEvaluator)


@pytest.mark.parametrize("combine", ["worst", "mean"])
def test_each_level_of_traffic_by_itself(street, combine):
    """Sets on the frames of each level alone, in whatever order they are asked for."""
    whole, levels = DetectorEvaluator(street.detected), TrafficLevels(2, combine)
    parts = (np.array([0, 1, 5]), np.array([2, 3, 4, 6, 7]))
    order = np.array([7, 0, 3, 1, 2, 5])
    found = LevelEvaluator(whole, levels, parts).evaluate(SETS, order)
    each = [whole.evaluate(SETS, np.array([0, 1, 5])), whole.evaluate(SETS, np.array([7, 3, 2]))]
    reduce = np.min if combine == "worst" else np.mean
    assert found.ap.tolist() == reduce([part.ap for part in each], axis=0).tolist()
    assert found.resamples.tolist() == reduce([part.resamples for part in each], axis=0).tolist()
    assert found.kbit == pytest.approx(whole.evaluate(SETS, order).kbit)
    done = []
    alone = LevelEvaluator(whole, levels, parts).evaluate(SETS, np.array([4, 6]), done.append)
    assert (alone.ap.tolist(), done) == (whole.evaluate(SETS, np.array([4, 6])).ap.tolist(), [2])


def test_levels_are_those_of_the_traffic_that_is_judged(prepared):
    evaluator = evaluator_of(prepared, "coverage", counting=Counting.of(0.7, 0, 2))
    assert isinstance(evaluator, LevelEvaluator)
    assert [part.tolist() for part in evaluator.parts] == [[1, 2, 3], [0, 4]] or len(evaluator.parts) == 2
    both = evaluator_of(prepared, "coverage", counting=Counting.of(0.7, 1, 2))
    assert isinstance(both, RobustEvaluator)
    assert isinstance(both.evaluator, LevelEvaluator)


@pytest.fixture
def hazy(street):
    """The street's evaluator, and one at which sensor 1 sees nothing in the first block and sensor 0 nothing at all."""

    class Hazy(type(street.detected.renders)):  # type: ignore[misc]
        def clouds(self, k, c):
            return super().clouds(k, c)[: 0 if c == 0 or (c == 1 and k < 4) else None]

    renders = Hazy(street.site, street.detected.renders.sensors)
    renders.digest = "hazy"
    rough = DetectorEvaluator(Detected(renders, street.detected.detector, "early"))
    return DetectorEvaluator(street.detected), rough


@pytest.mark.parametrize("combine", ["worst", "mean"])
def test_each_error_profile_by_itself(hazy, combine):
    """Of four cars 0 and 1 find two each; in the haze 1 finds one in the mean, and 0 none."""
    over, order = ProfileEvaluator(hazy, ErrorProfiles((PAPER_ERRORS, POOR), combine)), np.arange(8)
    found = over.evaluate(SETS[:2], order)
    exact, rough = (each.evaluate(SETS[:2], order) for each in hazy)
    assert exact.ap.tolist() == [0.5, 0.75]
    assert rough.ap.tolist() == [0.0, 0.25]
    assert found.ap.tolist() == ([0.0, 0.25] if combine == "worst" else [0.25, 0.5])
    reduce = np.min if combine == "worst" else np.mean
    assert found.resamples.tolist() == reduce([exact.resamples, rough.resamples], axis=0).tolist()
    assert len(np.unique(found.resamples[1])) > 1
    assert found.kbit == pytest.approx(rough.kbit if combine == "worst" else (exact.kbit + rough.kbit) / 2)
    assert (over.name, over.frames, over.objects_in(order)) == ("detector", 8, 32)
    each = over.at_each(SETS[:2], order)
    assert list(each) == ["paper", "poor"]
    assert each["poor"].ap.tolist() == rough.ap.tolist()
    assert each["poor"].resamples.tolist() == rough.resamples.tolist()


def test_frames_are_counted_once_for_all_profiles(hazy):
    done = []
    over = ProfileEvaluator(hazy, ErrorProfiles((PAPER_ERRORS, POOR)))
    over.evaluate(SETS[:1], np.arange(8), done.append)
    assert done == [0, 1, 1, 2, 2, 3, 3, 4, 4, 5, 5, 6, 6, 7, 7, 8]


def test_the_evaluator_over_error_profiles_has_failures_and_levels_within(prepared, street):
    several = replace(prepared, detector=street.detected.detector, errors=ErrorProfiles((PAPER_ERRORS, POOR)))
    vars(several).update(traffic=prepared.traffic, network="general")
    over = evaluator_of(several, "detector", seed=7)
    assert isinstance(over, ProfileEvaluator)
    assert over.errors == several.errors
    made: tuple[Any, ...] = over.evaluators
    assert [each.seed for each in made] == [7, 7]
    assert [each.detected.renders.errors for each in made] == [PAPER_ERRORS, POOR]
    counted: Any = evaluator_of(several, "detector", counting=Counting.of(0.7, 1, 2))
    assert [type(each) for each in counted.evaluators] == [RobustEvaluator] * 2
    assert [type(each.evaluator) for each in counted.evaluators] == [LevelEvaluator] * 2
