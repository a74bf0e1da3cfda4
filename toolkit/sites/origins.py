"""Things of a site by their origin: taken from a map, surveyed, or drawn by coview where the map is silent."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace

import shapely

from toolkit.sites.network import unite
from toolkit.sites.site import ORIGINS, Site, Solid

_PART_OF = {"trunk": "tree"}
_TOUCHING = 0.15  # m between parts of one thing


def count_things(site: Site) -> dict[str, dict[str, int]]:
    """Count the things of a site by origin, then by kind.

    Solids of a kind that touch are one thing: a fence has many. A tree counts once, by its trunk. A pole is a mount,
    and its own post no thing beside it. A drawn road is one thing.
    """
    found: dict[str, Counter[str]] = {origin: Counter() for origin in ORIGINS}
    trunks = unite(s.footprint for s in site.solids if s.kind == "trunk").buffer(6.0)
    feet = shapely.MultiPoint([mount.position[:2] for mount in site.mounts]).buffer(0.3)
    grouped: dict[tuple[str, str], list[shapely.Polygon]] = {}
    for solid in site.solids:
        grouped.setdefault((solid.origin, solid.kind), []).append(shapely.Polygon(solid.footprint))
    for (origin, kind), shapes in grouped.items():
        joined = shapely.union_all(shapes) if kind == "trunk" else shapely.union_all(shapes).buffer(_TOUCHING / 2)
        parts = shapely.get_parts(joined)
        beside = {"tree": trunks, "post": feet}.get(kind)
        number = len(parts) if beside is None else int((~shapely.intersects(parts, beside)).sum())
        found[origin][_PART_OF.get(kind, kind)] += number
    found[site.road_origin]["road"] += bool(site.lanes)
    for origin in site.bay_origins:
        found[origin]["bay"] += 1
    for mount in site.mounts:
        found[mount.origin]["pole"] += 1
    return {origin: {kind: n for kind, n in sorted(kinds.items()) if n} for origin, kinds in found.items()}


def describe_things(counts: Mapping[str, int]) -> str:
    """List counted things in words.

    >>> describe_things({"bay": 1, "bench": 2, "tree": 30})
    '1 bay, 2 benches, 30 trees'
    """
    ends = {kind: "es" if kind.endswith(("sh", "ch")) else "s" for kind in counts}
    return ", ".join(f"{n} {kind}{'' if n == 1 else ends[kind]}" for kind, n in counts.items())


def mark_drawn(solids: Sequence[Solid]) -> list[Solid]:
    """Mark solids as drawn."""
    return [replace(solid, origin="drawn") for solid in solids]


def draw_everything(site: Site) -> Site:
    """Mark everything of a site as drawn."""
    solids, bays = tuple(mark_drawn(site.solids)), ("drawn",) * len(site.parking)
    mounts = tuple(replace(mount, origin="drawn") for mount in site.mounts)
    return replace(site, solids=solids, mounts=mounts, parking_origins=bays, road_origin="drawn")
