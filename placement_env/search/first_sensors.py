"""`with_first_sensors`: first sensors for a site without any, placed by greedy coverage."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from placement_env.candidates.candidates import PAPER, Models, pool
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
from placement_env.subsets import MemberSums, Sets
from toolkit.sites.site import Site

FIRST_HEIGHT_M = 6.0  # above the foot of the mount
FIRST_TILT_RAD = float(np.deg2rad(15.0))  # below the horizon
FIRST_HEADINGS = 8  # directions of the first sensors' poses
FIRST_FRAMES = 40  # frames of traffic that choose the first sensors


@dataclass(frozen=True, eq=False)
class FirstSensors:
    """Site with first sensors.

    Attributes:
        site: The site with the sensors mounted.
        pose_count: Number of poses that were tried.
        covered_share: Share of vehicles with `LEAST` points or more from a sensor."""

    site: Site
    pose_count: int
    covered_share: float

    def __str__(self) -> str:
        """Sentences on how the sensors were placed, and what they see together."""
        return (
            f"{len(self.site.sensors)} sensors placed by coverage: from {self.pose_count} poses of "
            f"the paper's camera on {len(self.site.mounts)} mounts ({FIRST_HEIGHT_M:g} m up, "
            f"{np.rad2deg(FIRST_TILT_RAD):.0f} degrees down, {FIRST_HEADINGS} headings), each in "
            f"turn the pose that sees most vehicles with {LEAST:g} points in {FIRST_FRAMES} frames "
            f"of traffic; together they see {self.covered_share:.0%}. This is a start to try the "
            "site: coview plan or coview search says what to build"
        )


class HalvedViews:
    """Mean over objects of 1 - 2^-n, with n sensors of a set that have `LEAST` points on the
    object.

    Submodular. Each further view counts half of the one before, so sensors that add no object still
    spread their views. It is a fidelity for greedy: called with sets, it returns an estimate.
    """

    name = "halved views"

    def __init__(self, visibility: Visibility) -> None:
        sees_object = visibility.points >= LEAST  # candidates × objects
        self._view_sums = MemberSums(sees_object.astype(np.uint16))

    def __call__(self, subsets: Sets, /) -> Estimate:
        """Mean of each set as AP and recall; nothing is sent."""
        means = np.zeros(len(subsets))
        for block, views in self._view_sums.blocks(subsets):  # views: sets × objects
            means[block] = (1 - 0.5 ** views.astype(np.float64)).mean(axis=1)
        return Estimate(ap=means, recall=means.copy(), kbit=np.zeros(len(subsets)))


def with_first_sensors(
    site: Site, count: int, *, models: Models = PAPER, tilts: Sequence[float] = (FIRST_TILT_RAD,)
) -> FirstSensors:
    """Replace a site's sensors by `count` on its mounts, fewer if no more fit or see a vehicle.

    The sensors are chosen by greedy among poses at `FIRST_HEIGHT_M` on simulated traffic.

    models: sensor models to choose from, the paper's camera by default, with prices if it is a
    dictionary; tilts: rad below the horizon. Raises ValueError for a count below 1, and for a site
    without mounts, poses or vehicles.
    """
    check_whole("number of sensors", count, least=1)
    candidates = pool(
        site, heights=[FIRST_HEIGHT_M], headings=FIRST_HEADINGS, tilts=tilts, models=models
    )
    visibility = see(simulate_traffic(site, FIRST_FRAMES), candidates)
    _, vehicle_count = visibility.points.shape
    if not vehicle_count:
        problem = f"no vehicle enters the area of site {site.name!r} in {FIRST_FRAMES} frames"
        raise ValueError(f"{problem}: place sensors yourself")
    setting = Setting(site, candidates=candidates, fidelity=HalvedViews(visibility))
    members = greedy.search(Objective(setting, visibility=visibility), count).best.subset
    is_covered = (visibility.points[list(members)] >= LEAST).any(axis=0)
    return FirstSensors(
        site=mounted_site(site, candidates, members),
        pose_count=len(candidates),
        covered_share=float(is_covered.mean()) if members else 0.0,
    )
