"""`Junction`: a site with some candidates and what they see, prepared once and kept in two files.

A folder of them is what policies learn from: what takes long, simulating and rendering, is in the files. They are
written one after the other, so what was broken off goes on there. Most are random sites; own ones can be among them.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path

import numpy as np

from placement_env.candidates.candidates import Candidates
from placement_env.candidates.drawing import drawn_models, drawn_pool
from placement_env.checks import check_whole
from placement_env.fidelity.traffic import simulate_traffic
from placement_env.fidelity.visibility import Visibility, see
from toolkit.runtime.files import write_text
from toolkit.sites.files import load_site
from toolkit.sites.geojson import dumps
from toolkit.sites.random import random_site
from toolkit.sites.site import Site

JUNCTION_FRAMES = 16
JUNCTION_PLACES, POSES = 12, 24
OTHER_TRAFFIC = 500_000  # added to the seed of a junction's traffic, to have some that is in none of its files


@dataclass(frozen=True, eq=False)
class Junction:
    """Site, candidates, and what they see of simulated traffic."""

    site: Site
    candidates: Candidates
    visibility: Visibility


@dataclass(frozen=True)
class JunctionSource:
    """What a junction is made of. name: of its files; seed: of its candidates and its traffic; drawing: of an own site,
    "" for the random site of the seed."""

    name: str
    seed: int
    drawing: str = ""

    @staticmethod
    def of_seed(seed: int) -> JunctionSource:
        """The random site of a seed. Raises ValueError where that is negative."""
        check_whole("seed", seed, least=0)
        return JunctionSource(f"{seed:06d}", int(seed))

    @staticmethod
    def of_site(site: str | Path, draw: int = 0) -> JunctionSource:
        """A site of one's own, by file, or a built-in one by name; other draws have other candidates and traffic. One
        that was changed since has another name. Raises what `toolkit.sites.files.load_site` raises."""
        check_whole("draw", draw, least=0)
        drawing = dumps(load_site(site))
        return JunctionSource(f"site-{sha256(drawing.encode()).hexdigest()[:16]}-{draw}", int(draw), drawing)


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
    return prepare_from(JunctionSource.of_seed(seed), folder, frames=frames, places=places, poses=poses)


def prepare_from(
    source: JunctionSource,
    folder: str | Path,
    *,
    frames: int = JUNCTION_FRAMES,
    places: int = JUNCTION_PLACES,
    poses: int = POSES,
) -> Junction:
    """As `prepare`, of any source."""
    Path(folder).mkdir(parents=True, exist_ok=True)
    drawing = Path(folder) / f"{source.name}.geojson"
    if not drawing.exists():
        write_text(drawing, source.drawing or dumps(random_site(source.seed)))
    site = load_site(drawing)
    candidates = drawn_candidates(site, source.seed, places=places, poses=poses)
    seen = seen_at(site, candidates, Path(folder) / f"{source.name}.npz", frames=frames, seed=source.seed)
    return Junction(site, candidates, seen)


def other_traffic(source: JunctionSource, junction: Junction, folder: str | Path, *, frames: int) -> Visibility:
    """What its candidates see of other traffic than in its files; kept in the folder "searched" beside them."""
    path = Path(folder) / "searched" / f"{source.name}.npz"
    path.parent.mkdir(parents=True, exist_ok=True)
    return seen_at(junction.site, junction.candidates, path, frames=frames, seed=source.seed + OTHER_TRAFFIC)


def seen_at(site: Site, candidates: Candidates, path: Path, *, frames: int, seed: int) -> Visibility:
    """What candidates see of simulated traffic, read from a file, or made and written there. Raises ValueError where
    it is of other candidates or frames."""
    if not path.exists():
        see(simulate_traffic(site, frames, seed), candidates, rendering="panorama").save(path)
    visibility = Visibility.load(path)
    if (len(visibility), visibility.frames) != (len(candidates), frames):
        raise ValueError(
            f"{path} is of {len(visibility)} candidates and {visibility.frames} frames, not of {len(candidates)} and "
            f"{frames}: choose another folder or remove it"
        )
    return visibility


def drawn_candidates(site: Site, seed: int, *, places: int = JUNCTION_PLACES, poses: int = POSES) -> Candidates:
    """Some random poses of random sensor models, at random prices; the same seed draws the same."""
    rng = np.random.default_rng([seed, 7])
    models, prices = drawn_models(rng)
    return drawn_pool(site, rng, places=places, poses=poses, models=models, prices=prices)
