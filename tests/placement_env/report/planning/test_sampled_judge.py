"""Parts of a set and other schemes, judged in a sample of the frames."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from placement_env.analysis.case_figures import CaseFigures, scale_figures
from placement_env.report.content import Judgement, Plan, PlanOption
from placement_env.report.planning import choosing, sampled_judge
from placement_env.report.planning.choosing import choose_set
from placement_env.report.planning.chosen_set import ChosenSet
from placement_env.report.planning.sampled_judge import sample_frames
from placement_env.search.portfolio.entrants import Entrants


@pytest.mark.parametrize("frames", [96, 120, 121, 129, 1000])
def test_every_block_of_eight_frames_has_its_first_and_a_third_of_the_others(frames):
    sampled = sample_frames(frames)
    assert set(range(0, frames, 8)) <= set(sampled.tolist())
    assert set(np.unique(sampled % 8)) == {0, 3, 6}
    assert frames / 3 <= len(sampled) <= 0.4 * frames


def test_few_frames_are_all_judged():
    assert sample_frames(95).tolist() == list(range(95))


def figures(rows):
    """AP, recall, precision, objects, frames, kbit and two resamples in each row."""
    return CaseFigures(np.array(rows, float))


def test_figures_are_the_whole_sets_times_the_ratio_in_the_sample():
    parts = figures([[0.4, 0.3, 0.9, 20, 3, 7, 0.2, 0.5], [0.9, 0.9, 1.0, 20, 3, 7, 1.0, 1.0]])
    sampled = figures([[0.8, 0.6, 0.9, 20, 3, 9, 0.4, 0.0]])[0]
    whole = figures([[0.6, 0.5, 0.8, 60, 9, 9, 0.5, 0.7]])[0]
    scaled = scale_figures(parts, sampled, whole)
    assert scaled.ap == pytest.approx([0.4 * 0.6 / 0.8, 0.9 * 0.6 / 0.8])
    assert scaled.recall == pytest.approx([0.3 * 0.5 / 0.6, 0.9 * 0.5 / 0.6])
    # a resample in which the whole set finds nothing stays; none exceeds 1
    assert scaled.resamples == pytest.approx(np.array([[0.25, 0.5], [1.0, 1.0]]))
    assert scaled.values[:, 2:6].tolist() == parts.values[:, 2:6].tolist()


def test_the_interval_holds_the_figure_of_all_frames():
    """Frames of a block are alike; one set finds a random half of what the whole set finds."""
    rng = np.random.default_rng(5)
    blocks, repetitions = 15, 300
    draws = rng.multinomial(blocks, np.full(blocks, 1 / blocks), size=400)
    frames = sample_frames(8 * blocks)
    held = 0
    for _ in range(repetitions):
        easy = rng.uniform(0.6, 1.0, blocks).repeat(8)
        whole_share = np.clip(easy + rng.normal(0, 0.1, 8 * blocks), 0, 1)
        part_share = whole_share * np.clip(rng.normal(0.5, 0.15, 8 * blocks), 0, 1)

        def judge(share, chosen):
            block_means = share[chosen].reshape(blocks, -1).mean(axis=1)
            resamples = draws @ block_means / blocks
            counts = [1.0, 100, len(chosen), 0.0]
            return np.r_[block_means.mean(), block_means.mean(), counts, resamples]

        everything = np.arange(8 * blocks)
        scaled = scale_figures(
            figures([judge(part_share, frames)]),
            figures([judge(whole_share, frames)])[0],
            figures([judge(whole_share, everything)])[0],
        )
        low, high = scaled[0].interval(frames)
        held += low <= 0.5 * 0.8 <= high
    assert 0.9 <= held / repetitions <= 0.99


def test_parts_and_other_schemes_are_detected_in_the_sample_alone(street, limits, spy):
    """All eight frames of the street are alike, so the figures stay."""
    in_full = ChosenSet((0, 1), ("a", "b"), street.judge, street.objective)
    stated = in_full.worth(), in_full.schemes(), in_full.failures(), in_full.order()
    limits(sampled_judge, MIN_SAMPLED_FRAMES=8)
    outcomes = spy(type(street.detected), "outcomes")
    chosen = ChosenSet((0, 1), ("a", "b"), street.judge, street.objective)
    assert chosen.worth() == stated[0]
    assert [row.judged.ap for row in chosen.schemes()] == [row.judged.ap for row in stated[1]]
    assert [row.judged.frames for row in chosen.schemes()] == [8, 8, 8, 3, 3, 3, 3, 3, 3]
    failures = chosen.failures()
    assert [case.judged.ap for case in failures] == [case.judged.ap for case in stated[2]]
    assert {case.judged.frames for case in failures} == {3}
    assert [step.judged.frames for step in chosen.order()] == [3, 8]
    partly = [call for call in outcomes if (0, 1) not in call.args[1]]
    assert partly
    assert all(list(call.args[2]) == [0, 3, 6] for call in partly)


def test_winners_of_sizes_behind_are_judged_in_the_sample(street, limits):
    """All frames are alike: three sensors find all cars, two find three of four, one finds two."""
    sets = np.array([[1, 1, 1, 0], [0, 1, 1, 1], [1, 1, 0, 0], [1, 0, 0, 0]], bool)
    entrants = Entrants(sets, street.objective.scores(sets).ap, ((),) * 4, 4)
    whole = choose_set(street.objective, entrants, street.judge)
    assert {option.judged.frames for option in whole.options} == {8}
    limits(sampled_judge, MIN_SAMPLED_FRAMES=8)
    choice = choose_set(street.objective, entrants, street.judge)
    assert [option.judged.frames for option in choice.options] == [8, 8, 3, 3]
    assert [option.judged.ap for option in choice.options] == [
        option.judged.ap for option in whole.options
    ]
    assert (choice.chosen, choice.alike) == (whole.chosen, whole.alike)
    assert (whole.list_judged_rows(), choice.list_judged_rows()) == ([0, 1, 2, 3], [0, 1])
    # sets that turn out near the best are judged on all frames
    lead = whole.options[0].judged.ap - whole.options[2].judged.ap
    limits(choosing, AP_TOLERANCE=lead + 0.01)
    near = choose_set(street.objective, entrants, street.judge)
    assert [option.judged.frames for option in near.options] == [8, 8, 8, 3]


def test_the_count_of_judged_sets_names_those_in_the_sample():
    judged = [Judgement(0.9, 0.8, 1.0, 0.9, 1.0, 100, frames) for frames in (120, 45, 120)]
    options = tuple(PlanOption((), 1.0, 1.0, 1.0, 0.9, judgement, ()) for judgement in judged)
    nothing: Any = None
    plan = Plan({}, "", "", (0.7,), "early", "", verdict=nothing, chosen=None)
    planned = replace(plan, considered=options)
    assert planned.describe_judged("of them on all") == "2 of them on all, 1 in 45 frames of it"
    planned = replace(planned, considered=options[::2])
    assert planned.describe_judged("of them on all") == "2 of them on all"
