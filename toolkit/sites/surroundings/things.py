"""Things of a site by origin: taken from a map, surveyed, or drawn by coview.

coview draws things that the map leaves open."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace

import shapely

from toolkit.sites.network import unite
from toolkit.sites.site import ORIGINS, Site, Solid

_PART_OF = {"trunk": "tree"}  # kind of a solid: kind of the thing that it counts as
_TOUCHING_M = 0.15  # between parts of one thing


def count_things(site: Site) -> dict[str, dict[str, int]]:
    """Count the things of a site: a number for each kind, by origin and then by kind.

    Solids of a kind that touch are one thing: a fence has many. A tree counts once, by its trunk. A
    pole is a mount, whose post is not counted again. A road is one thing. All origins are there,
    each with the kinds it has, in order of name."""
    counts: dict[str, Counter[str]] = {origin: Counter() for origin in ORIGINS}
    # ground to which the crowns of counted trees reach, and ground of the mounts' posts
    trees = unite(s.footprint for s in site.solids if s.kind == "trunk").buffer(6.0)
    posts = shapely.MultiPoint([mount.position[:2] for mount in site.mounts]).buffer(0.3)
    shapes_by_kind: dict[tuple[str, str], list[shapely.Polygon]] = {}  # by origin and kind
    for solid in site.solids:
        shape = shapely.Polygon(solid.footprint)
        shapes_by_kind.setdefault((solid.origin, solid.kind), []).append(shape)
    for (origin, kind), shapes in shapes_by_kind.items():
        joined_shape = shapely.union_all(shapes)
        if kind != "trunk":  # trunks that only nearly touch are several trees
            joined_shape = joined_shape.buffer(_TOUCHING_M / 2)
        parts = shapely.get_parts(joined_shape)
        if kind == "tree":
            parts = parts[~shapely.intersects(parts, trees)]
        if kind == "post":
            parts = parts[~shapely.intersects(parts, posts)]
        counts[origin][_PART_OF.get(kind, kind)] += len(parts)
    counts[site.road_origin]["road"] += 1 if site.lanes else 0
    for origin in site.bay_origins:
        counts[origin]["bay"] += 1
    for mount in site.mounts:
        counts[mount.origin]["pole"] += 1
    # + of a Counter drops counts of 0
    return {origin: dict(sorted((+kinds).items())) for origin, kinds in counts.items()}


def describe_things(counts: Mapping[str, int]) -> str:
    """List counted things in words, such as "2 benches, 1 tree". counts: by kind."""
    return ", ".join(f"{count} {_pluralize(kind, count)}" for kind, count in counts.items())


def _pluralize(kind: str, count: int) -> str:
    """Name of a kind of thing, in the plural unless `count` is 1."""
    if count == 1:
        return kind
    return kind + ("es" if kind.endswith(("sh", "ch")) else "s")


def mark_drawn(solids: Sequence[Solid]) -> list[Solid]:
    """Return copies of solids with the origin `drawn`, made up by coview."""
    return [replace(solid, origin="drawn") for solid in solids]


def draw_everything(site: Site) -> Site:
    """Return a site with the origin `drawn` for all its solids, mounts and bays and its road."""
    solids = tuple(mark_drawn(site.solids))
    bays = ("drawn",) * len(site.parking)
    mounts = tuple(replace(mount, origin="drawn") for mount in site.mounts)
    return replace(site, solids=solids, mounts=mounts, parking_origins=bays, road_origin="drawn")
