"""Random sets of sensors to measure a detector by: of a site's own sensors, and of random poses of its pool."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from placement_env.candidates.candidates import Candidates
from placement_env.candidates.pool import paper_candidates, pool
from toolkit.arrays import Bool
from toolkit.sensors.sensor import SensorModel
from toolkit.sites.site import Site

MOST_POSES = 8  # of the pool in one set


def own_and_random(
    site: Site, poses: int, rng: np.random.Generator, *, models: Sequence[SensorModel] = ()
) -> Candidates:
    """The site's own sensors, if any, each on a mount of its own, and after them some random poses of its pool, with
    any of the models, the paper's camera where there is none.

    Raises ValueError where the pool has fewer poses, or there would be no sensor.
    """
    more, least = (pool(site, models=tuple(models)) if models else pool(site)), 0 if site.sensors else 1
    if not least <= poses <= len(more):
        raise ValueError(f"poses must be {least} to the {len(more)} of the pool of {site.name!r}, got {poses}")
    more = more.select(np.sort(rng.choice(len(more), poses, replace=False)))
    if not site.sensors:
        return more
    own = paper_candidates(site)
    mount = np.concatenate([own.mount, len(own.mounts) + more.mount])
    return replace(
        own,
        sensors=(*own.sensors, *more.sensors),
        mounts=(*own.mounts, *more.mounts),
        mount=mount,
        factors=np.column_stack([mount, np.zeros((len(mount), 4), np.int64)]),
    )


def random_sets(candidates: Candidates, own: int, count: int, rng: np.random.Generator) -> Bool[np.ndarray, "n C"]:
    """Different random sets, up to `count`: half of them of the first `own` candidates, if there are any, half of 1 to
    `MOST_POSES` of the others, one to a mount."""
    sets, of_own = np.zeros((count, len(candidates)), bool), count // 2 if own else 0
    for row in sets[:of_own]:
        row[rng.choice(own, rng.integers(1, own + 1), replace=False)] = True
    for row in sets[of_own:]:
        members = own + rng.permutation(len(candidates) - own)
        _, first = np.unique(candidates.mount[members], return_index=True)
        row[members[np.sort(first)][: rng.integers(1, MOST_POSES + 1)]] = True
    return np.unique(sets, axis=0)
