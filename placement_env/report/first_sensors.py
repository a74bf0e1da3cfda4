"""First sensors for a site without any. Greedy coverage finds them, to try a site; they are not a plan."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from placement_env.candidates.pool import pool
from placement_env.checks import check_whole
from placement_env.fidelity.coverage import LEAST
from placement_env.fidelity.seeing import see
from placement_env.fidelity.traffic import simulate_traffic
from placement_env.fidelity.visibility import Visibility
from placement_env.handover.mounted import mounted_site
from placement_env.objective import Objective
from placement_env.protocol import Estimate
from placement_env.search import greedy
from placement_env.setting import Setting
from placement_env.subsets import MemberSums
from toolkit.arrays import Bool
from toolkit.sites.site import Site

HEIGHT = 6.0  # m above the foot of the mount
TILT = float(np.deg2rad(15.0))  # rad below the horizon
HEADINGS = 8
FIRST_FRAMES = 40


@dataclass(frozen=True, eq=False)
class FirstSensors:
    """A site with first sensors. covered: share of the vehicles on which a sensor has `LEAST` points or more."""

    site: Site
    poses: int
    covered: float

    def __str__(self) -> str:
        count, mounts = len(self.site.sensors), len(self.site.mounts)
        return (
            f"{count} sensors placed by coverage: from {self.poses} poses of the paper's camera on {mounts} mounts "
            f"({HEIGHT:g} m up, {np.rad2deg(TILT):.0f} degrees down, {HEADINGS} headings), each in turn the pose that "
            f"sees most vehicles with {LEAST:g} points in {FIRST_FRAMES} frames of traffic; together they see "
            f"{self.covered:.0%}. This is a start to try the site: coview plan or coview search says what to build"
        )


class HalvedViews:
    """Mean over objects of 1 - 2^-n where n sensors of a set have `LEAST` points on the object. Submodular.

    Each further view is worth half of the one before, so sensors that add no object still spread their views.
    """

    name = "halved views"

    def __init__(self, visibility: Visibility) -> None:
        self._sums = MemberSums((visibility.points >= LEAST).astype(np.uint16))

    def __call__(self, subsets: Bool[np.ndarray, "n C"], /) -> Estimate:
        """Return the mean of each set as AP and recall. kbit are 0."""
        worth = np.zeros(len(subsets))
        for block, views in self._sums.blocks(subsets):
            worth[block] = (1 - 0.5 ** views.astype(np.float64)).mean(axis=1)
        return Estimate(worth, worth.copy(), np.zeros(len(subsets)))


def with_first_sensors(site: Site, count: int, *, seed: int = 0) -> FirstSensors:
    """Replace a site's sensors by `count` cameras on its mounts, fewer if no more fit or see a vehicle.

    Raises ValueError for a count below 1, and for a site without mounts, poses or vehicles.
    """
    check_whole("number of sensors", count, least=1)
    candidates = pool(site, heights=[HEIGHT], headings=HEADINGS, tilts=[TILT])
    visibility = see(simulate_traffic(site, FIRST_FRAMES, seed), candidates)
    if not visibility.points.shape[1]:
        raise ValueError(
            f"no vehicle enters the area of site {site.name!r} in {FIRST_FRAMES} frames: place sensors yourself"
        )
    setting = Setting(site, candidates=candidates, fidelity=HalvedViews(visibility))
    chosen = greedy.search(Objective(setting, visibility=visibility), count).best.subset
    covered = (visibility.points[list(chosen)] >= LEAST).any(axis=0).mean() if chosen else 0.0
    return FirstSensors(mounted_site(site, candidates, chosen), len(candidates), float(covered))
