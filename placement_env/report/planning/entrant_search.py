"""Search of a plan: traffic and objectives at each drawing of the site, and the sets found."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from placement_env.fidelity.preparation import Preparation
from placement_env.objective import Objective
from placement_env.report.planning.buildable import BuildableView, find_max_sensors, keep_buildable
from placement_env.report.planning.question import Question
from placement_env.report.planning.refusals import Refusal, refuse_traffic
from placement_env.search.exclusions import describe_exclusions, explain_kept
from placement_env.search.portfolio.entrants import (
    Effort,
    Entrants,
    at_other_ious,
    join_entrants,
    keep_entrants,
)
from placement_env.setting import Weights
from toolkit.objects import LABELS
from toolkit.runtime.run import Run


@dataclass(frozen=True, eq=False)
class PreparedSearch:
    """Inputs of the searches.

    A drawing of the site fills in at random what no map knows. The sequences have one entry for
    each drawing, in the order of `Question.at_drawings`; the first drawing is the site itself.

    Attributes:
        run: Run of the search traffic.
        preparations: Search traffic.
        views: Buildable candidates and what they see.
        objectives: Objectives over the buildable candidates, by AP without weights on kbit and
            price.
        excluded: Sentences on what excludes the other candidates, at the first drawing."""

    run: Run
    preparations: Sequence[Preparation]
    views: Sequence[BuildableView]
    objectives: Sequence[Objective]
    excluded: tuple[str, ...]


def prepare_search(question: Question, run: Run) -> PreparedSearch:
    """Simulate the search traffic, and find the candidates that may be built.

    Raises `Refusal` if the traffic lacks a counted class at some drawing, if no candidate may be
    built, or if a pole that the question keeps cannot get its sensor.

    run: number of frames and seed of the search traffic."""
    pool = question.setting.pool
    preparations = [Preparation(drawing.search_setting, run) for drawing in question.at_drawings]
    for preparation in preparations:
        missing = _list_missing(question, preparation)
        if missing:
            reasons = refuse_traffic(question, missing, preparation.frames, "simulated")
            raise Refusal(reasons, pool)
    pool_objectives = [
        Objective.from_view(
            preparation, preparation.setting.pool, preparation.visibility, Weights()
        )
        for preparation in preparations
    ]
    first_objective = pool_objectives[0]
    # sentences on what excludes candidates
    excluded = describe_exclusions(first_objective, question.max_kbit, question.currency)
    views = keep_buildable(preparations, pool_objectives, question.max_kbit)
    buildable_names = [sensor.name for sensor in views[0].candidates.sensors]
    is_buildable = np.isin(first_objective.names, buildable_names)
    max_kbit = math.inf if question.max_kbit is None else question.max_kbit
    # sentences on what keeps sensors from the poles that must carry one
    obstacles = explain_kept(first_objective, is_buildable, max_kbit, question.currency)
    if obstacles or not buildable_names:
        raise Refusal(obstacles or excluded, pool)
    objectives = [
        Objective.from_view(preparation, view.candidates, view.visibility, Weights())
        for preparation, view in zip(preparations, views, strict=True)
    ]
    return PreparedSearch(run, preparations, views, objectives, excluded)


def _list_missing(question: Question, preparation: Preparation) -> list[str]:
    """List the names of the counted classes without an object in a preparation's traffic."""
    seen_labels = preparation.visibility.labels
    counted_labels = question.setting.counted.labels
    return [LABELS[label] for label in counted_labels if not (seen_labels == label).any()]


def search_entrants(question: Question, prepared: PreparedSearch) -> Entrants:
    """Search for entrants at each drawing of the site, and join them.

    Entrants are the sensor sets that the detector later compares. Unless the cases are plain, with
    one IoU threshold and without failures and levels of traffic, searches run a second time for
    intact sets in undivided traffic, because their best may be best in the worst case.

    prepared: buildable candidates and their objectives (`prepare_search`)."""
    max_count = find_max_sensors(question, prepared.objectives[0].candidates)
    effort = Effort(tuple(range(1, max_count + 1)), min_ap=question.min_ap)
    run = prepared.run
    entrant_lists = [
        keep_entrants(
            objective,
            effort,
            run.memo,
            depends_on=preparation.traffic.digest(),
            others=at_other_ious(objective, preparation),
            seed=run.seed,
        )
        for objective, preparation in zip(prepared.objectives, prepared.preparations, strict=True)
    ]
    if not question.cases.is_one_case:
        entrant_lists += [
            keep_entrants(
                Objective.from_view(
                    preparation.intact_preparation, view.candidates, view.visibility, Weights()
                ),
                effort,
                run.memo,
                depends_on=preparation.traffic.digest(),
                others={},
                seed=run.seed,
            )
            for preparation, view in zip(prepared.preparations, prepared.views, strict=True)
        ]
    return join_entrants(prepared.objectives, entrant_lists)
