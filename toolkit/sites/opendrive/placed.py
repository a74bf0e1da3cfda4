"""What an OpenDRIVE map says stands there, put into a site: in its frame, near it, off its lanes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import shapely

from toolkit.arrays import Float64
from toolkit.sites.opendrive.extract import MapRoad
from toolkit.sites.opendrive.standing import Standing, standing_beside
from toolkit.sites.site import Solid


def understood(path: Path, roads: Sequence[MapRoad]) -> Standing:
    """What the map says stands there; ValueError that names the file where it is damaged."""
    try:
        return standing_beside(roads)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from None


def in_frame(there: Standing, map_SE3_site: Float64[np.ndarray, "4 4"]) -> Standing:
    """What stands there, in the site's frame."""
    turn, origin = map_SE3_site[:2, :2], map_SE3_site[:2, 3]
    yaw = float(np.arctan2(map_SE3_site[1, 0], map_SE3_site[0, 0]))
    groups = [[replace(s, footprint=((s.footprint - origin) @ turn).round(3)) for s in g] for g in there.groups]
    bays = [(*(np.array(bay[:2]) - origin) @ turn, bay[2] - yaw) for bay in there.bays]
    lamps = [tuple((np.array(lamp) - origin) @ turn) for lamp in there.lamps]
    return replace(there, groups=groups, bays=[(float(x), float(y), float(a)) for x, y, a in bays], lamps=lamps)


def off_the_road(
    there: Standing, window: shapely.Geometry, lanes: Sequence[np.ndarray], tracks: shapely.Geometry
) -> tuple[list[Solid], list[str]]:
    """The solids within `window` that stand on no lane, and what is to be said of the map's objects."""
    road = shapely.union_all([shapely.Polygon(p) for p in lanes]).union(tracks).buffer(-1e-3)
    shapely.prepare(road)
    shapes = [shapely.union_all([shapely.Polygon(s.footprint) for s in g]) for g in there.groups]
    near = [(g, shape) for g, shape in zip(there.groups, shapes, strict=True) if g and shape.intersects(window)]
    kept = [solid for g, shape in near if not road.intersects(shape) for solid in g]
    stopped = sum(bool(road.intersects(shape)) for _, shape in near)
    notes = [f"{stopped} objects or signals stand on the carriageway and were left out"] if stopped else []
    if there.unknown:
        listed = ", ".join(f"{count} {kind[:30]!r}" for kind, count in sorted(there.unknown.items())[:12])
        notes.append(f"objects of types that are not known were left out: {listed}")
    return kept, notes
