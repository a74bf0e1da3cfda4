"""Sets on some frames: the AP that the fidelity says of them, and resamples drawn alike for all
sets."""

from dataclasses import replace

import numpy as np
import pytest

from placement_env.analysis.case_figures import CaseFigures
from placement_env.analysis.intervals import draws_of_blocks, figure_interval
from placement_env.candidates.candidates import paper_candidates
from placement_env.cases import Cases
from placement_env.classes import Classes
from placement_env.fidelity.coverage import Coverage
from placement_env.fidelity.detector import Detected
from placement_env.fidelity.preparation import Preparation
from placement_env.fidelity.seeing import see
from placement_env.fidelity.visibility import of_frames
from placement_env.search.portfolio import evaluators
from placement_env.search.portfolio.evaluators import (
    CasesEvaluator,
    DetectorEvaluator,
    FastEvaluator,
    build_evaluator,
    race_order,
)
from placement_env.setting import Setting
from toolkit.objects import Detections
from toolkit.runtime.run import Run
from toolkit.sensors.error_profiles import PAPER_ERRORS, POOR

SETS = np.array([[1, 0, 0, 0], [1, 1, 0, 0], [1, 1, 1, 0]], bool)
EVERY = np.arange(8)


@pytest.fixture
def prepared(small_traffic):
    def prepare(**fields):
        setting = Setting(
            small_traffic.site, candidates=paper_candidates(small_traffic.site), **fields
        )
        made = Preparation(setting, Run(frames=len(small_traffic)))
        vars(made).update(traffic=small_traffic, network="general")
        return made

    return prepare


def test_detection_of_some_frames(street):
    evaluator = CasesEvaluator((DetectorEvaluator(street.detected, seed=3),))
    frames = np.array([5, 1, 2])
    found = evaluator.evaluate(SETS, frames)
    expected = street.detected.partial(SETS, frames.tolist())
    assert found.ap == pytest.approx(expected.ap)
    assert found.kbit == pytest.approx(expected.kbit)
    assert found.resamples.shape == (3, 1000)
    assert found.resamples == pytest.approx(
        np.repeat(found.ap[:, None], 1000, axis=1)
    )  # all frames are alike
    assert (evaluator.frames, evaluator.name) == (8, "detector")
    assert evaluator.count_objects(EVERY) == 32
    assert evaluator.count_objects(np.array([6, 1])) == 8


def test_resamples_are_of_blocks_of_frames(street):
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
    found = CasesEvaluator((DetectorEvaluator(blind, seed=1),)).evaluate(SETS[:2], EVERY)
    assert found.ap == pytest.approx([0.25, 0.375])
    assert set(found.resamples[0].round(6)) == {0.0, 0.25, 0.5}
    assert found.resamples[1] == pytest.approx(1.5 * found.resamples[0])


def test_a_fast_fidelity_scores_the_frames_together_and_in_batches(
    prepared, small_traffic, blocks_of_four
):
    evaluator = build_evaluator(prepared(), "coverage", seed=2)
    assert isinstance(evaluator.by_profile[0], FastEvaluator)
    sets = np.eye(4, dtype=bool)[[0, 2]] | np.eye(4, dtype=bool)[[3, 3]]
    found = evaluator.evaluate(sets, np.arange(5))
    seen = see(small_traffic, paper_candidates(small_traffic.site))
    assert found.ap == pytest.approx(Coverage(seen)(sets).ap)
    assert found.kbit == pytest.approx(Coverage(seen)(sets).kbit)
    assert found.resamples.mean(axis=1) == pytest.approx(found.ap, abs=0.03)
    assert found.resamples[0].std() > 0
    some = evaluator.evaluate(sets, np.array([4, 0]))
    assert some.ap == pytest.approx(Coverage(of_frames(seen, np.array([0, 4])))(sets).ap)
    assert evaluator.count_objects(np.arange(evaluator.frames)) == seen.points.shape[1]
    assert evaluator.count_objects(np.array([1])) == (seen.frame == 1).sum()


def test_what_is_seen_of_some_frames(small_traffic):
    seen = see(small_traffic, paper_candidates(small_traffic.site))
    part = of_frames(seen, np.array([1, 4]))
    assert part.frames == 2
    assert set(part.frame.tolist()) == {0, 1}
    assert np.array_equal(part.boxes[part.frame == 1], seen.boxes[seen.frame == 4])
    assert np.array_equal(part.points[:, part.frame == 0], seen.points[:, seen.frame == 1])
    assert np.array_equal(part.sent, seen.sent[:, [1, 4]])


def test_classes_thresholds_and_failures_are_combined(street):
    both = Classes(("vehicle", "pedestrian"), combine="worst")

    class Knowing:
        labels = ("vehicle", "pedestrian")
        digest = "knowing"

        def __call__(self, points, /):
            return street.detected.detector(points)

    detected = Detected(street.detected.renders, Knowing(), "early", classes=both)
    found = CasesEvaluator((DetectorEvaluator(detected),)).evaluate(SETS, EVERY)
    assert found.ap.tolist() == [0.0, 0.0, 0.0]  # nobody detects the walker
    matched = street.detected.at(0.7, (0.7, 1.0))
    evaluators = (DetectorEvaluator(matched, (0.7, 1.0)),)
    found = CasesEvaluator(evaluators, Cases(iou=(0.7, 1.0))).evaluate(SETS, EVERY)
    each = [
        CasesEvaluator((DetectorEvaluator(matched, (iou,)),)).evaluate(SETS, EVERY)
        for iou in (0.7, 1.0)
    ]
    assert found.ap == pytest.approx((each[0].ap + each[1].ap) / 2)
    assert found.resamples == pytest.approx((each[0].resamples + each[1].resamples) / 2)
    whole = CasesEvaluator((DetectorEvaluator(street.detected),))
    left = replace(whole, cases=Cases(failing=1)).evaluate(SETS, EVERY)
    assert left.ap == pytest.approx([0.0, 0.5, 0.55], abs=0.06)
    intact = whole.evaluate(np.array([[1, 0, 1, 0], [0, 1, 1, 0], [1, 1, 0, 0]], bool), EVERY)
    assert left.ap[2] == pytest.approx(intact.ap.min(), abs=1e-5)
    assert left.resamples[2] == pytest.approx(intact.resamples.min(axis=0), abs=1e-5)
    assert left.kbit == pytest.approx(whole.evaluate(SETS, EVERY).kbit)


@pytest.mark.parametrize("frames", [1, 7, 96])
def test_a_race_begins_with_a_frame_of_every_block(frames):
    order = race_order(frames, seed=5)
    assert sorted(order.tolist()) == list(range(frames))
    blocks = -(-frames // 4)
    if not frames % 4:
        assert sorted((order[:blocks] // 4).tolist()) == list(range(blocks))
        assert len({*(order[:blocks] % 4)}) == 1
    assert order.tolist() == race_order(frames, seed=5).tolist()


@pytest.mark.parametrize("combine", ["worst", "mean"])
def test_each_level_of_traffic_by_itself(street, combine):
    """Sets on the frames of each level alone, in whatever order they are asked for."""
    whole = CasesEvaluator((DetectorEvaluator(street.detected),))
    parts = (np.array([0, 1, 5]), np.array([2, 3, 4, 6, 7]))
    over = replace(whole, cases=Cases(levels=2, levels_by=combine), levels=parts)
    order = np.array([7, 0, 3, 1, 2, 5])
    found = over.evaluate(SETS, order)
    each = [whole.evaluate(SETS, np.array([0, 1, 5])), whole.evaluate(SETS, np.array([7, 3, 2]))]
    reduce = np.min if combine == "worst" else np.mean
    assert found.ap == pytest.approx(reduce([part.ap for part in each], axis=0))
    assert found.resamples == pytest.approx(reduce([part.resamples for part in each], axis=0))
    assert found.kbit == pytest.approx(whole.evaluate(SETS, order).kbit)
    done = []
    alone = over.evaluate(SETS, np.array([4, 6]), done.append)
    assert alone.ap == pytest.approx(whole.evaluate(SETS, np.array([4, 6])).ap)
    assert done[-1:] in ([], [2])


def test_levels_are_those_of_the_traffic_that_is_judged(prepared):
    evaluator = build_evaluator(prepared(cases=Cases(levels=2)), "coverage")
    assert [len(part) for part in evaluator.levels] == [3, 2]
    assert build_evaluator(prepared(), "coverage").levels == ()


@pytest.fixture
def hazy(street):
    """The street's evaluator, and one at which sensor 1 sees nothing in the first block and sensor
    0 nothing at all."""

    class Hazy(type(street.detected.renders)):  # type: ignore[misc]
        def clouds(self, k, c):
            return super().clouds(k, c)[: 0 if c == 0 or (c == 1 and k < 4) else None]

    renders = Hazy(street.site, street.detected.renders.sensors)
    renders.digest = "hazy"
    rough = DetectorEvaluator(Detected(renders, street.detected.detector, "early"))
    return DetectorEvaluator(street.detected), rough


@pytest.mark.parametrize("combine", ["worst", "mean"])
def test_each_error_profile_by_itself(hazy, combine):
    """Of four cars 0 and 1 find two each; in the haze 1 finds one on average, and 0 none."""
    over = CasesEvaluator(hazy, Cases(errors=("paper", "poor"), errors_by=combine))
    found = over.evaluate(SETS[:2], EVERY)
    exact, rough = (CasesEvaluator((each,)).evaluate(SETS[:2], EVERY) for each in hazy)
    assert exact.ap.tolist() == [0.5, 0.75]
    assert rough.ap.tolist() == [0.0, 0.25]
    assert found.ap.tolist() == ([0.0, 0.25] if combine == "worst" else [0.25, 0.5])
    reduce = np.min if combine == "worst" else np.mean
    assert found.resamples == pytest.approx(reduce([exact.resamples, rough.resamples], axis=0))
    assert len(np.unique(found.resamples[1])) > 1
    assert found.kbit == pytest.approx(
        rough.kbit if combine == "worst" else (exact.kbit + rough.kbit) / 2
    )
    profiles = over.at_profiles(SETS[:2], EVERY)
    assert profiles.ap.tolist() == [exact.ap.tolist(), rough.ap.tolist()]
    assert profiles[1].kbit.tolist() == rough.kbit.tolist()
    assert profiles[1].resamples == pytest.approx(rough.resamples)


def test_frames_are_counted_once_for_all_profiles(hazy):
    done = []
    CasesEvaluator(hazy, Cases(errors=("paper", "poor"))).evaluate(SETS[:1], EVERY, done.append)
    assert done == [0, 1, 1, 2, 2, 3, 3, 4, 4, 5, 5, 6, 6, 7, 7, 8]


def test_each_profile_is_rendered_with_its_errors(prepared, street):
    class Blind:
        digest = "blind"

        def __call__(self, points, /):
            return street.detected.detector(points)

    cases = Cases(errors=("paper", "poor"))
    over = build_evaluator(prepared(detector=Blind(), cases=cases), "detector", seed=7)
    assert over.cases == cases
    profiles = [each for each in over.by_profile if isinstance(each, DetectorEvaluator)]
    assert [each.seed for each in profiles] == [7, 7]
    assert [each.detected.renders.errors for each in profiles] == [PAPER_ERRORS, POOR]  # type: ignore[attr-defined]


def test_batches_are_drawn_by_the_seed_and_shifted_to_the_whole(
    prepared, small_traffic, blocks_of_four, limits
):
    """Five frames are two blocks: each resample is the mean of two drawn ones, moved by what the
    mean of both lacks."""
    evaluator = build_evaluator(prepared(), "coverage", seed=2)
    sets = np.eye(4, dtype=bool)[[0, 2]] | np.eye(4, dtype=bool)[[3, 3]]
    seen = see(small_traffic, paper_candidates(small_traffic.site))
    parts = np.stack(
        [Coverage(of_frames(seen, block))(sets).ap for block in (np.arange(4), np.array([4]))],
        axis=1,
    )
    drawn = draws_of_blocks(np.arange(2), seed=2) / 2
    whole = Coverage(seen)(sets).ap
    found = evaluator.evaluate(sets, np.arange(5)[::-1])
    assert found.resamples == pytest.approx(
        parts @ drawn.T + (whole - parts.mean(axis=1))[:, None], abs=1e-6
    )
    other = build_evaluator(prepared(), "coverage", seed=3).evaluate(sets, np.arange(5))
    assert not np.array_equal(found.resamples, other.resamples)
    usual = build_evaluator(prepared(), "coverage").evaluate(sets, np.arange(5))
    assert np.array_equal(
        usual.resamples,
        build_evaluator(prepared(), "coverage", seed=0).evaluate(sets, EVERY[:5]).resamples,
    )
    done = []
    nothing = evaluator.evaluate(np.zeros((1, 4), bool), np.arange(5), done.append)
    assert (nothing.ap.tolist(), nothing.kbit.tolist(), done) == ([0.0], [0.0], [5])
    limits(evaluators, MAX_BATCHES=1)
    one = evaluator.evaluate(sets, np.arange(5))
    assert one.resamples == pytest.approx(np.repeat(whole[:, None], 1000, axis=1), abs=1e-6)


def test_intervals_know_the_blocks_behind_their_draws(street, prepared, blocks_of_four):
    """A fast fidelity draws from twelve batches at most."""
    draws, frames = np.random.default_rng(0).normal(0.6, 0.1, 1000), np.arange(80)
    figures = CaseFigures.from_ap(np.array(0.6), 0.0, draws, objects=320, frames=80)
    whole = CasesEvaluator((DetectorEvaluator(street.detected),))
    assert whole.interval(figures, frames) == figure_interval(0.6, draws, blocks=20)
    fast = build_evaluator(prepared(), "coverage")
    assert fast.interval(figures, frames) == figure_interval(0.6, draws, blocks=12)
    assert fast.mean_ap(SETS[:, :4], frames).tolist() == [0.0, 0.0, 0.0]


def test_a_mean_ap_is_over_three_thresholds_and_all_drawings(street):
    class Rough(type(street.detected.detector)):  # type: ignore[misc]
        digest = "rough"

        def __call__(self, points, /):
            found = super().__call__(points)
            boxes = found.boxes.copy()
            boxes[:, 3] *= 1.2  # IoU 1 / 1.2 = 0.83
            return Detections(boxes, found.scores)

    exact = CasesEvaluator((DetectorEvaluator(street.detected),))
    rough = CasesEvaluator(
        (DetectorEvaluator(Detected(street.detected.renders, Rough(), "early")),)
    )
    assert exact.mean_ap(SETS[:2], EVERY) == pytest.approx([0.5, 0.75])
    assert rough.mean_ap(SETS[:2], EVERY) == pytest.approx([1 / 3, 0.5])  # not at 0.9
    both = replace(exact, drawings=(rough,))
    assert both.mean_ap(SETS[:2], EVERY) == pytest.approx([5 / 12, 0.625])


def test_orders_of_races_are_those_of_seed_0_unless_given():
    assert (
        race_order(96).tolist()
        == race_order(96, seed=0).tolist()
        != race_order(96, seed=1).tolist()
    )
    assert sorted(race_order(13).tolist()) == list(range(13))


def test_over_drawings_of_a_site_all_figures_are_means(hazy):
    exact, rough = (CasesEvaluator((each,)) for each in hazy)
    both = replace(exact, drawings=(rough,))
    found, each = both.evaluate(SETS, EVERY), [one.evaluate(SETS, EVERY) for one in (exact, rough)]
    for name in ("ap", "kbit", "resamples"):
        assert getattr(found, name) == pytest.approx(
            np.mean([getattr(one, name) for one in each], axis=0)
        )
    assert found.ap.shape == (3,)


@pytest.mark.parametrize("frames", [96, 93])
def test_frames_of_a_race_follow_a_permutation_of_the_blocks(frames, blocks_of_four):
    """The seed's first permutation is that of the blocks, so orders of equally many blocks go
    alike."""
    blocks = np.random.default_rng(6).permutation(24)
    order = race_order(frames, seed=6)
    whole = race_order(96, seed=6)
    assert (whole[:24] // 4).tolist() == blocks.tolist()
    assert order.tolist() == [k for k in whole.tolist() if k < frames]


def test_resamples_of_detections_are_drawn_by_the_seed(hazy):
    """In the haze sensor 1 finds two of four cars in the second block alone: an AP of one half, as
    often as drawn."""
    _, rough = hazy
    for made, seed in (
        (replace(rough, seed=5), 5),
        (rough, 0),
        (DetectorEvaluator(rough.detected), 0),
    ):
        resamples = CasesEvaluator((made,)).evaluate(SETS[1:2], EVERY).resamples[0]
        drawn = draws_of_blocks(np.arange(2), seed=seed)[:, 1]
        assert resamples == pytest.approx(0.5 * drawn / 2)


def test_a_fast_fidelity_knows_a_single_candidate_and_all_classes_and_looks_silently(
    small_traffic, spy
):
    """It looks with the processes and the cache of its run, but tells nobody how far it is."""
    stages, looks = [], spy(evaluators, "see")
    for only, classes in (([1], ("vehicle",)), ([0, 2], ("vehicle", "pedestrian"))):
        candidates = paper_candidates(small_traffic.site).select(np.array(only))
        setting = Setting(small_traffic.site, candidates=candidates, classes=classes)
        made = Preparation(
            setting, Run(frames=len(small_traffic), progress=lambda *stage: stages.append(stage))
        )
        vars(made).update(traffic=small_traffic, network="general")
        evaluator = build_evaluator(made, "coverage")
        seen = see(small_traffic, candidates, labels=made.setting.counted.labels)
        assert evaluator.count_objects(np.arange(5)) == seen.points.shape[1]
        sets = np.array([[False] * len(only), [True] * len(only)])
        expected = Coverage(seen, classes=made.setting.counted)(sets).ap
        assert evaluator.evaluate(sets, np.arange(5)).ap == pytest.approx(expected)
        assert evaluator.evaluate(sets[:1], np.arange(5)).ap.tolist() == [0.0]
        assert all(call.named["run"] == replace(made.run, progress=None) for call in looks)
    assert stages == []
