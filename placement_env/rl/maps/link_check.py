"""Whether links carry what sensors send, found out by looking at the empty site from these sensors alone, once."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from placement_env.candidates.candidates import Candidates
from placement_env.fidelity.traffic import Traffic
from placement_env.fidelity.visibility import see
from toolkit.arrays import Bool
from toolkit.detection.codec import PAPER
from toolkit.objects import Objects
from toolkit.sites.site import Site
from toolkit.traffic.snapshots import Snapshot

TRAFFIC_SHARE = 1.05  # of what the empty site sends, that traffic adds to it at most


def links_carry(site: Site, candidates: Candidates) -> Callable[[tuple[int, ...]], Bool[np.ndarray, " k"]]:
    """A function of some of the candidates that says which of their links carry the points that they send of the empty
    site, and `TRAFFIC_SHARE` for traffic. It renders nothing but what these see."""

    def carries(members: tuple[int, ...]) -> Bool[np.ndarray, " k"]:
        if not members:
            return np.zeros(0, np.bool_)
        nobody = Snapshot(Objects(np.zeros((0, 7)), np.zeros(0, np.int64)), np.zeros(0, np.int64), 0.0)
        seen = see(Traffic(site, (), (nobody,)), candidates.select(list(members)), rendering="full")
        kbit = PAPER.bits(points=seen.sent[:, 0].astype(np.float64)) / 1000
        return np.asarray(TRAFFIC_SHARE * kbit <= candidates.capacity[list(members)])

    return carries
