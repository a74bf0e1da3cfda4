"""Candidates as people name them: the site's pool, its own sensors, or the poles of a file, with any sensor models."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import shapely

from placement_env.candidates.candidates import Candidates
from placement_env.candidates.poles import load_keep_out, load_poles
from placement_env.candidates.pool import paper_candidates, pool
from toolkit.sensors.models import DepthCamera
from toolkit.sensors.sensor import SensorModel
from toolkit.sites.site import Site

PAPER = (DepthCamera(),)


def chosen_candidates(
    site: Site,
    which: str | Path,
    models: Sequence[SensorModel] = (),
    *,
    prices: Sequence[float] = (),
    keep_out: Sequence[shapely.Geometry] = (),
) -> Candidates:
    """ "pool": every pose on the site's mounts; "paper": the site's own sensors; else a GeoJSON file of poles.

    models: what may be mounted at each pose, none for the paper's camera; prices: of these, none where only mounts
    cost; keep_out: no mount within these is used, beside the areas of the file. Raises ValueError where models are
    given for sensors that hang already, and what `load_poles` and `pool` raise.
    """
    if which == "paper":
        if models:
            raise ValueError("the site's own sensors have their models: give models with 'pool' or a file of poles")
        return paper_candidates(site)
    if which == "pool":
        return pool(site, models=models or PAPER, prices=prices, keep_out=keep_out)
    areas = (*keep_out, *load_keep_out(which, site))
    return pool(site, mounts=load_poles(which, site), keep_out=areas, models=models or PAPER, prices=prices)
