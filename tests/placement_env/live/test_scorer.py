"""Figures of variants in the live planner's memory."""

from collections.abc import Iterator
from dataclasses import replace
from itertools import islice, product

import pytest

from placement_env import LivePlanner
from placement_env.live.scorer import MAX_ANSWERS
from placement_env.live.variant import Variant


@pytest.fixture(scope="module")
def planner():
    return LivePlanner("tjunction", frames=4, seed=3)


def locked_variants(variant: Variant) -> Iterator[Variant]:
    """Variants that differ in which sensors are locked or have failed, the given one first."""
    flags = product((False, True), repeat=2 * len(variant.sensors))
    for row in flags:
        sensors = tuple(
            replace(sensor, locked=row[2 * k], failed=row[2 * k + 1])
            for k, sensor in enumerate(variant.sensors)
        )
        yield replace(variant, sensors=sensors)


def test_as_many_answers_are_in_memory_as_allowed_and_no_more(planner):
    variants = list(islice(locked_variants(planner.variant), MAX_ANSWERS + 1))
    answers = [planner.estimate(variant) for variant in variants[:-1]]
    assert all(
        planner.scorer.recall(variant) is answer
        for variant, answer in zip(variants, answers, strict=False)
    )
    last = planner.estimate(variants[-1])
    assert planner.scorer.recall(variants[-1]) is last
    assert planner.scorer.recall(variants[0]) is None
