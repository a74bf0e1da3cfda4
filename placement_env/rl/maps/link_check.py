"""What sensors send, found out by looking at the empty site from these sensors alone, once."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from placement_env.candidates.candidates import Candidates
from placement_env.fidelity.traffic import Traffic
from placement_env.fidelity.visibility import see
from toolkit.arrays import Float64
from toolkit.detection.codec import PAPER
from toolkit.objects import Objects
from toolkit.sites.site import Site
from toolkit.traffic.snapshots import Snapshot

TRAFFIC_SHARE = 1.05  # of what the empty site sends, that traffic adds to it at most


def sent_when_empty(site: Site, candidates: Candidates) -> Callable[[tuple[int, ...]], Float64[np.ndarray, " k"]]:
    """A function of some of the candidates that says how many kbit of a frame each sends of the empty site, and
    `TRAFFIC_SHARE` for traffic. It renders nothing but what these see."""

    def sent(members: tuple[int, ...]) -> Float64[np.ndarray, " k"]:
        if not members:
            return np.zeros(0)
        nobody = Snapshot(Objects(np.zeros((0, 7)), np.zeros(0, np.int64)), np.zeros(0, np.int64), 0.0)
        seen = see(Traffic(site, (), (nobody,)), candidates.select(list(members)), rendering="full")
        kbit = PAPER.bits(points=seen.sent[:, 0].astype(np.float64)) / 1000
        return np.asarray(TRAFFIC_SHARE * kbit, np.float64)

    return sent
