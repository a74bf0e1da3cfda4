"""`Junction`: a random site with some candidates and what they see, prepared once and kept in two files.

A folder of them is what policies learn from: what takes long, simulating and rendering, is in the files. They are
written one after the other, so what was broken off goes on there.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from placement_env.candidates.candidates import Candidates
from placement_env.candidates.drawing import drawn_models, drawn_pool
from placement_env.checks import check_whole
from placement_env.fidelity.traffic import simulate_traffic
from placement_env.fidelity.visibility import Visibility, see
from toolkit.sites.files import load_site, save_site
from toolkit.sites.random import random_site
from toolkit.sites.site import Site

JUNCTION_FRAMES = 16
JUNCTION_PLACES, POSES = 12, 24


@dataclass(frozen=True, eq=False)
class Junction:
    """Site, candidates, and what they see of simulated traffic."""

    site: Site
    candidates: Candidates
    visibility: Visibility


def prepared(
    seeds: Iterable[int],
    folder: str | Path,
    *,
    frames: int = JUNCTION_FRAMES,
    places: int = JUNCTION_PLACES,
    poses: int = POSES,
) -> Iterator[Junction]:
    """The junctions of seeds one after the other, read from the folder, or made and written there.

    frames: of traffic; places, poses: of `placement_env.candidates.drawing.drawn_pool`. Raises ValueError where a seed
    is negative, and where a file there is damaged or of other candidates: remove it.
    """
    for seed in seeds:
        yield prepare(seed, folder, frames=frames, places=places, poses=poses)


def prepare(
    seed: int, folder: str | Path, *, frames: int = JUNCTION_FRAMES, places: int = JUNCTION_PLACES, poses: int = POSES
) -> Junction:
    """One of `prepared`."""
    check_whole("seed", seed, least=0)
    Path(folder).mkdir(parents=True, exist_ok=True)
    drawing, seen = (Path(folder) / f"{seed:06d}.{end}" for end in ("geojson", "npz"))
    if not drawing.exists():
        save_site(random_site(seed), drawing)
    site = load_site(drawing)
    candidates = drawn_candidates(site, seed, places=places, poses=poses)
    if not seen.exists():
        traffic = simulate_traffic(site, frames, seed)
        see(traffic, candidates, rendering="panorama").save(seen)
    visibility = Visibility.load(seen)
    if (len(visibility), visibility.frames) != (len(candidates), frames):
        raise ValueError(
            f"{seen} is of {len(visibility)} candidates and {visibility.frames} frames, not of {len(candidates)} and "
            f"{frames}: choose another folder or remove it"
        )
    return Junction(site, candidates, visibility)


def drawn_candidates(site: Site, seed: int, *, places: int = JUNCTION_PLACES, poses: int = POSES) -> Candidates:
    """Some random poses of random sensor models, at random prices; the same seed draws the same."""
    rng = np.random.default_rng([seed, 7])
    models, prices = drawn_models(rng)
    return drawn_pool(site, rng, places=places, poses=poses, models=models, prices=prices)
