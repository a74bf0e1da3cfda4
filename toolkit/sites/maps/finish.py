"""Kerbs, mounts, drawn surroundings and warnings of an imported site."""

import warnings
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import shapely

from toolkit.sites import furniture, network as nets
from toolkit.sites.georeference import doubt_place, doubt_scale
from toolkit.sites.maps.furnishing import furnish_site
from toolkit.sites.maps.map_bays import MAP_BAY_SIZE_M
from toolkit.sites.maps.piece import MapPiece
from toolkit.sites.maps.road_surface import kerbstones
from toolkit.sites.maps.tracks import find_turns
from toolkit.sites.site import Mount, Site, Solid
from toolkit.sites.surroundings.mount_places import POLE_HEIGHT_M, place_mounts
from toolkit.sites.surroundings.parking_bays import bay_outline
from toolkit.sites.surroundings.plot import Road
from toolkit.sites.surroundings.things import mark_drawn

BRACKET_M = 0.45  # from a lamp post's axis to the sensor it carries
LAMP_REACH_M = 10.0  # distance around the area within which lamp posts become mounts
MIN_WALL_HEIGHT_M = 2.0  # height from which solids keep mounts out of their ground
MIN_LAMP_MOUNTS = 6  # with fewer, mounts are made along the kerbs too


def finish_site(
    site: Site, piece: MapPiece, solids: Sequence[Solid], *, lamps: np.ndarray, notes: Sequence[str]
) -> Site:
    """Add kerbs and mounts to a site, and drawn surroundings if the piece has a seed; return it.

    site: without solids and mounts; solids: things of the map, on level ground (z = 0); lamps:
    (n, 2) places x, y (m) of street lamps in the site's frame; notes: texts of warnings, to which
    others may be added. Raises ValueError if no lane is in the area."""
    if not nets.unite(site.lanes).intersects(shapely.box(*site.area)):
        raise piece.no_road()
    mounts = _make_mounts(site, solids, lamps)
    turns = find_turns(site.network)
    stones = kerbstones(site.lanes, site.footways, lowered=turns)
    if piece.seed is None:
        feet = [mount.position[:2].tolist() for mount in mounts if mount.origin == "drawn"]
        poles = mark_drawn([furniture.post(x, y, height=POLE_HEIGHT_M) for x, y in feet])
        finished_site = replace(
            site,
            solids=furniture.raise_onto_ground([*solids, *poles, *stones], site.relief),
            mounts=furniture.on_ground(mounts, site),
        )
    else:
        all_solids = [*solids, *stones]
        finished_site, furnishing_note = furnish_site(
            site, mounts, all_solids, seed=piece.seed, density=piece.density
        )
        notes = [*notes, furnishing_note]
    for note in [*notes, *_note_uncertain_place(site)]:
        warnings.warn(f"{piece.path.name}: {note}", stacklevel=3)
    return finished_site


def _make_mounts(site: Site, solids: Sequence[Solid], lamps: np.ndarray) -> list[Mount]:
    """Make mounts on lamp posts and, if these are few, along the kerbs too.

    Their feet are at z = 0. lamps: (n, 2) places x, y of street lamps."""
    road = Road(paths=(), half_widths=(), lanes=site.lanes, footways=site.footways)
    tall_solids = [solid for solid in solids if solid.top > MIN_WALL_HEIGHT_M]
    # both widened by the room that a mount needs (m)
    walls = nets.unite(solid.footprint for solid in tall_solids).buffer(0.3)
    bays = [bay_outline(bay, MAP_BAY_SIZE_M) for bay in site.parking]
    obstacles = walls.union(shapely.union_all(bays).buffer(0.3))
    # without that room: the bracket of a lamp may be next to a wall
    mounts = _mount_on_lamps(site, road, lamps, obstacles.buffer(-0.3))
    if len(mounts) >= MIN_LAMP_MOUNTS:
        return mounts
    rng = np.random.default_rng(0)  # fixed, so that a map always gives the same mounts
    drawn_mounts = place_mounts(road, site.area, rng, spacing=12.0, avoid=obstacles)
    near_lamps = shapely.MultiPoint(lamps).buffer(2.0)
    for mount in drawn_mounts:
        if not near_lamps.intersects(shapely.Point(mount.position[:2])):
            mounts.append(replace(mount, price=1.0, origin="drawn"))
    return mounts


def _mount_on_lamps(
    site: Site, road: Road, lamps: np.ndarray, obstacles: shapely.Geometry
) -> list[Mount]:
    """Make mounts on brackets of lamp posts, `BRACKET_M` from the post towards the road.

    lamps: (n, 2) places x, y; lamps far from the area, or whose bracket ends within `obstacles`,
    get none."""
    mounts: list[Mount] = []
    surroundings = shapely.box(*site.area).buffer(LAMP_REACH_M)
    for lamp in lamps:
        spot = shapely.Point(lamp)
        link = shapely.shortest_line(spot, road.carriageway)
        _, road_point = shapely.get_coordinates(link)
        to_road = road_point - lamp
        # + 1e-9: a lamp may be on the carriageway
        bracket_end = lamp + BRACKET_M * to_road / (np.hypot(*to_road) + 1e-9)
        if surroundings.contains(spot) and not obstacles.intersects(shapely.Point(bracket_end)):
            position = np.array([*bracket_end.round(3), 0.0])
            name = f"lamp{len(mounts):02}"
            mounts.append(Mount(name, position, min_height=3.0, max_height=8.0))
    return mounts


def _note_uncertain_place(site: Site) -> list[str]:
    """Return notes of what is uncertain about a site's place on earth and its scale."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)  # it repeats a note of the import
            doubts = [doubt_place(site.geo_reference), doubt_scale(site)]
    except ValueError as error:
        return [f"its place on earth cannot be used: {error}"]
    return [doubt for doubt in doubts if doubt is not None]
