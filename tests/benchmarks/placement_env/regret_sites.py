"""The 12 junctions of `bench_regret.py`: six drawn, six built or imported, each with a pool of some
100 candidates.

Neither `general`, the network that judges here, nor its surrogate was fitted to any of them. Drawn
are the first six seeds from 41801 on whose detection area is below 7,000 m², since judging takes
time in proportion. The maps of CARLA are no part of this repository; their sites are left out where
COVIEW_SHARED has none.
"""

import os
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from placement_env.candidates.candidates import pool
from toolkit.sensors.models import find_model
from toolkit.sites.files import load_site
from toolkit.sites.maps.opendrive_site import import_opendrive
from toolkit.sites.maps.osm_site import import_osm
from toolkit.sites.maps.piece import MapPiece
from toolkit.sites.random import random_site

if TYPE_CHECKING:
    from placement_env.candidates.candidates import Candidates
    from toolkit.sites.site import Site

ROOT = Path(__file__).parents[3]
SHARED = Path(os.environ.get("COVIEW_SHARED", ROOT.parent / "shared"))
POSES = 100


@dataclass(frozen=True)
class Place:
    """make: the site; seed: of the poses that are taken of its pool, and of its traffic (three
    seeds from here on); models: names of the sensor models, none for the paper's camera."""

    make: "Callable[[], Site]"
    seed: int
    models: tuple[str, ...] = ()

    def candidates(self, site: "Site") -> "Candidates":
        """Some poses of the pool, drawn evenly over it."""
        named = {"models": tuple(map(find_model, self.models))} if self.models else {}
        every = pool(site, **named)
        drawn = np.random.default_rng(self.seed).choice(
            len(every), min(POSES, len(every)), replace=False
        )
        return every.select(np.sort(drawn))


def _random(seed: int) -> "Site":
    return random_site(seed)


def _built(name: str) -> "Site":
    return load_site(name)


def _town(name: str, centre: tuple[float, float], size: tuple[float, float]) -> "Site":
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return import_opendrive(
            MapPiece(SHARED / "carla" / f"{name}.xodr", centre=centre, size=size, seed=0)
        )


def _drawn_by_hand() -> "Site":
    return import_osm(
        MapPiece(ROOT / "docs" / "own-junction.osm", centre=(8.0, 49.5), size=(70.0, 50.0), seed=0)
    )


PLACES: dict[str, Place] = {
    "random-41801": Place(partial(_random, 41801), 41801),
    "town01-east": Place(partial(_town, "Town01", (335.0, -196.0), (60.0, 60.0)), 42801),
    "random-41802": Place(partial(_random, 41802), 41802),
    "osm": Place(_drawn_by_hand, 42802),
    "random-41803": Place(partial(_random, 41803), 41803, ("spinning-lidar",)),
    "tjunction": Place(partial(_built, "tjunction"), 42803),
    "random-41806": Place(partial(_random, 41806), 41806),
    "town03-east": Place(partial(_town, "Town03", (152.0, 130.0), (60.0, 60.0)), 42804),
    "random-41810": Place(partial(_random, 41810), 41810, ("depth-camera", "solid-state-lidar")),
    "roundabout": Place(partial(_built, "roundabout"), 42805, ("solid-state-lidar",)),
    "random-41812": Place(partial(_random, 41812), 41812),
    "town03-south": Place(partial(_town, "Town03", (0.0, -195.0), (70.0, 60.0)), 42806),
}


def places(names: list[str]) -> dict[str, Place]:
    """Those of the names, all where none is given, as far as their maps are here."""
    here = (SHARED / "carla").is_dir()
    return {name: PLACES[name] for name in names or PLACES if here or not name.startswith("town")}
