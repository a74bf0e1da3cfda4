"""Objects inside and outside the detection area of their site."""

import numpy as np

from toolkit.datasets import published_layout as published
from toolkit.doctor.findings import Finding, report_error
from toolkit.geometry import transform
from toolkit.sites.site import Site

UNKNOWN_SITE = "somewhere"  # name of a site whose detection area is unknown
MIRROR_Y = "negate columns 1 (y) and 5 (yaw) of objects"  # remedy in words
NEAR_SITE_M = 15.0  # distance from the detection area within which objects belong to the site
MIN_NEAR_SHARE = 0.5  # least share of such objects for coordinates to be right


def find_misplaced(rows: list[np.ndarray], site: Site) -> tuple[list[Finding], list[np.ndarray]]:
    """Find objects outside the site, perhaps because of a mirrored axis.

    rows: published rows of the objects of each frame, in CARLA's frame. Returns findings, and the
    rows without a mirrored axis, or as they are."""
    centres = np.concatenate([np.zeros((0, 3)), *(table[:, :3] for table in rows)])  # x, y, z
    # factors of the published columns: y (column 1) and yaw (column 5) change their signs
    mirror_factors = np.array([1.0, -1, 1, 1, 1, -1, 1, 1, 1, 1])
    near_share = _measure_near_share(centres, site)
    if near_share >= MIN_NEAR_SHARE or site.name == UNKNOWN_SITE:
        return [], rows
    mirrored_share = _measure_near_share(centres * mirror_factors[:3], site)
    evidence = f"{near_share:.0%} of {len(centres)} objects in or near the area of {site.name!r}"
    if mirrored_share < MIN_NEAR_SHARE:
        remedy = "pass the site where this was recorded, or check the coordinates"
        return [
            report_error(
                where="objects",
                suspected="objects elsewhere than the site",
                evidence=evidence,
                remedy=remedy,
            )
        ], rows
    evidence += f", {mirrored_share:.0%} with y negated"
    finding = report_error(
        where="objects", suspected="mirrored y axis", evidence=evidence, remedy=MIRROR_Y
    )
    return [finding], [table * mirror_factors for table in rows]


def _measure_near_share(centres: np.ndarray, site: Site) -> float:
    """Share of places within `NEAR_SITE_M` of the site's area, 0 to 1; 1 without any.

    centres: (n, 3) m, CARLA's frame."""
    if not len(centres):
        return 1.0
    site_from_carla = np.linalg.inv(published.MAP_FROM_CARLA @ site.map_SE3_site)
    places = transform(site_from_carla, centres)
    return float(in_area(places[:, :2], site, margin=NEAR_SITE_M).mean())


def in_area(xy: np.ndarray, site: Site, margin: float = 0.0) -> np.ndarray:
    """Mask of places in the detection area, or within a margin (m) around it.

    xy: (n, 2) m, site frame."""
    lower_corner, upper_corner = site.area[:2], site.area[2:]
    is_inside: np.ndarray = (xy >= lower_corner - margin) & (xy <= upper_corner + margin)
    return np.asarray(is_inside.all(axis=1))
