"""Drawn surroundings of an imported site, for all that its map leaves open."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import shapely

from toolkit.arrays import Rng
from toolkit.sites import furniture
from toolkit.sites.maps.legs import find_legs
from toolkit.sites.maps.map_bays import MAP_BAY_SIZE_M
from toolkit.sites.site import Furnishing, Mount, Site, Solid
from toolkit.sites.surroundings.furnish import furnish
from toolkit.sites.surroundings.parking_bays import bay_outline
from toolkit.sites.surroundings.plot import Road
from toolkit.sites.surroundings.things import count_things, describe_things, mark_drawn

MAX_ROUGHNESS_M = 0.12  # for drawn ground, as in random sites


def furnish_site(
    site: Site,
    mounts: Sequence[Mount],
    solids: Sequence[Solid],
    seed: int,
    density: Furnishing = "dense",
) -> tuple[Site, str]:
    """Furnish a site around the map's `solids`; return it and a note of the drawn things.

    Draws surroundings and the unevenness of the ground; mounts and solids, made for level ground,
    are set on it. Mounts get posts, except for those on the map's lamp posts.

    site: with roads, bays, slope and network, but without mounts and solids; mounts: all of the
    site; solids: things of the map; seed: for all draws; density: "light" for few kinds of things.
    Raises ValueError for a negative seed."""
    if seed < 0:
        raise ValueError(f"seed must be a whole number from 0 up, got {seed}")
    rng = np.random.default_rng(seed)
    amplitude = round(float(rng.uniform(0.0, MAX_ROUGHNESS_M)), 3)
    relief = replace(site.relief, amplitude=amplitude, seed=int(rng.integers(2**31)))
    site = replace(site, relief=relief, furnished=density)
    mapped_site = replace(
        site,
        solids=furniture.raise_onto_ground(solids, relief),
        mounts=furniture.on_ground(mounts, site),
    )
    furnished_site = _furnish(mapped_site, rng)
    counts = dict(count_things(furnished_site)["drawn"])  # by kind
    counts.pop("pole", None)  # mounts are made for bare sites too, so they are not of the seed
    note = f"drawn from seed {seed}, in no map: {describe_things(counts)}"
    return furnished_site, f"{note}, ground within {relief.amplitude} m"


def redraw(site: Site, seed: int) -> Site:
    """Draw again, from another seed, the things that an import drew; return the new site.

    Solids and bays of origin `drawn` are replaced; the map's things, the ground and all mounts
    stay. Raises ValueError for a site that no import furnished."""
    if site.furnished == "none":
        raise ValueError(
            f"site {site.name!r} has no furnishing to draw again: coview site import draws one"
        )
    map_solids = tuple(solid for solid in site.solids if solid.origin != "drawn")
    is_mapped = np.array([origin != "drawn" for origin in site.bay_origins], bool)
    map_origins = tuple(origin for origin in site.bay_origins if origin != "drawn")
    map_bays = site.parking[is_mapped]
    bare_site = replace(site, solids=map_solids, parking=map_bays, parking_origins=map_origins)
    return _furnish(bare_site, np.random.default_rng(seed))


def _furnish(site: Site, rng: Rng) -> Site:
    """Return a site with drawn solids and bays added, as many as `site.furnished` asks for.

    site: with its mounts and the map's solids, on its ground. Drawn kerbs are left out, as the
    import has made kerbs, and so is all that touches things of the map."""
    legs = find_legs(site.network)
    road = Road(
        paths=legs.paths, half_widths=legs.half_widths, lanes=site.lanes, footways=site.footways
    )
    is_light = site.furnished == "light"
    drawn_solids, drawn_bays = furnish(road, site.area, site.mounts, rng, light=is_light)
    map_shapes = _list_map_shapes(site)
    drawn_solids = [solid for solid in drawn_solids if solid.kind != "kerb"]
    new_solids = _select_free_solids(drawn_solids, shapely.union_all(map_shapes).buffer(0.2))
    raised_solids = furniture.raise_onto_ground(mark_drawn(new_solids), site.relief)
    kerbs = [shapely.Polygon(solid.footprint) for solid in site.solids if solid.kind == "kerb"]
    occupied = shapely.union_all(map_shapes + kerbs)
    new_bays = [
        bay for bay in drawn_bays if not occupied.intersects(bay_outline(bay, MAP_BAY_SIZE_M))
    ]
    return replace(
        site,
        solids=site.solids + raised_solids,
        parking=np.concatenate([site.parking, np.reshape(new_bays, (-1, 3))]),
        parking_origins=site.bay_origins + ("drawn",) * len(new_bays),
    )


def _list_map_shapes(site: Site) -> list[shapely.Geometry]:
    """List the ground of the map's things on which nothing is drawn: poles, solids and bays."""
    feet = [mount.position[:2] for mount in site.mounts if mount.origin != "drawn"]
    solids = [solid for solid in site.solids if solid.kind not in ("kerb", "island")]
    return [
        *(shapely.Point(foot).buffer(0.5) for foot in feet),
        *(shapely.Polygon(solid.footprint) for solid in solids),
        *(bay_outline(bay, MAP_BAY_SIZE_M) for bay in site.parking),
    ]


def _select_free_solids(solids: Sequence[Solid], occupied: shapely.Geometry) -> list[Solid]:
    """Return the solids that do not touch occupied ground, even through others.

    Solids that touch each other are kept or left out together. All islands stay, and do not connect
    the solids on them."""
    shapes = [shapely.Polygon(solid.footprint) for solid in solids]
    pairs = list(zip(solids, shapes, strict=True))
    joined_ground = shapely.union_all([shape for solid, shape in pairs if solid.kind != "island"])
    groups = shapely.get_parts(joined_ground)  # ground of solids that touch each other
    left_out = shapely.union_all([group for group in groups if group.intersects(occupied)])
    return [
        solid for solid, shape in pairs if solid.kind == "island" or not left_out.intersects(shape)
    ]
