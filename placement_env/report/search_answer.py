"""The answer of one search as files: the site with the chosen sensors, schedule, map, picture and where it comes from.

Smaller than a plan: nothing is judged on traffic that the search did not see.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from placement_env.fidelity.coverage import LEAST
from placement_env.fidelity.visibility import see
from placement_env.handover.exchange import EXCHANGE_FILES, write_exchange
from placement_env.handover.ground import visible_ground
from placement_env.handover.mounted import mounted_site, planned_sensors, unused_mounts
from placement_env.objective import Objective
from placement_env.search.cmaes import as_candidates
from placement_env.search.result import Result
from toolkit.arrays import Float64
from toolkit.runtime.files import write_text, writing_together
from toolkit.sites.georeference import longitude_latitude
from toolkit.sites.site import Site

ORIGIN, PICTURE = "search.json", "site.png"
ANSWER_FILES = (*EXCHANGE_FILES, PICTURE, ORIGIN)


def check_georeference(site: Site) -> None:
    """Raise what `longitude_latitude` raises for the site, before hours of search."""
    longitude_latitude(site, np.zeros((1, 2)))


def write_answer(
    folder: str | Path,
    objective: Objective,
    result: Result,
    summary: Mapping[str, Any],
    *,
    chosen: tuple[int, ...] | None = None,
) -> None:
    """Write `ANSWER_FILES` into a folder: all of them, or none where anything fails.

    summary: of the search, for search.json; chosen: another set of its candidates to hand over, as after a check by a
    more accurate fidelity; None for the result's. Raises ValueError for an empty set or an objective without a site.
    """
    from toolkit.plots.plan_view import draw_site

    members = result.best.subset if chosen is None else chosen
    if not members or objective.preparation is None:
        raise ValueError("only a set of sensors at a site can be handed over, and this is an empty set or has no site")
    moved = result.sensors
    candidates, plain = objective.candidates, objective.preparation.site
    site = mounted_site(plain, candidates, members, moved)
    per_frame = kbit_per_frame(objective, members, result)
    sensors = planned_sensors(
        plain,
        candidates,
        members,
        moved,
        kbit=per_frame.mean(axis=1),
        peak_kbit=per_frame.max(axis=1),
        model_prices=candidates.model_prices[list(members)],
    )
    ground = visible_ground(site, site.sensors)
    with writing_together(folder) as unfinished:
        unused = unused_mounts(candidates, members, moved)
        write_exchange(unfinished, site, sensors, ground, unused=unused)
        draw_site(site, unfinished / PICTURE)
        write_text(unfinished / ORIGIN, json.dumps(summary, indent=1, allow_nan=False, ensure_ascii=False) + "\n")


def kbit_per_frame(
    objective: Objective, members: tuple[int, ...], result: Result
) -> Float64[np.ndarray, "sensors frames"]:
    """What each sensor of a set sends in each frame of the objective's traffic. Of boxes, where the scheme sends them,
    it is taken that a sensor sends one for each object that it sees with `LEAST` points."""
    made = objective.preparation
    if made is None:
        raise ValueError("what is sent in each frame is known of an objective made from a site: Objective(site, ...)")
    if result.sensors:
        visibility = see(
            made.traffic, as_candidates(result.sensors, objective.candidates.mounts), labels=made.classes.labels
        )
    else:
        known = made.visibility if objective.visibility is None else objective.visibility
        visibility = known.select(members)
    frames = visibility.frames
    boxes = np.array([np.bincount(visibility.frame[row >= LEAST], minlength=frames) for row in visibility.points])
    sent = boxes if objective.scheme.sends_boxes else np.zeros_like(boxes)
    points = objective.scheme.sent_points(visibility).astype(np.float64)
    return np.asarray(objective.codec.bits(points=points, boxes=sent) / 1000, np.float64)
