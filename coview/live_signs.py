"""Drawings in the live planner's scene: a map's signs, poles that may be used, pictures below."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import shapely

from coview.live_names import add_name
from placement_env.live.picture import GroundPicture
from toolkit.arrays import Float64, Int64
from toolkit.plots.map_sheet import scale_length
from toolkit.plots.north_arrow import north
from toolkit.plots.palette import INK
from toolkit.sites.site import Mount, Site
from toolkit.sites.streets import find_lane_arrows, find_street_names
from toolkit.viewing import scene, scene_parts
from toolkit.viewing.scene import Handle
from toolkit.viewing.site_scene import add_site, lift_points

if TYPE_CHECKING:
    from viser import SceneApi

LIFT_M = 0.15  # height of signs above the ground
PICTURE_LIFT_M = 0.06  # height of a picture above the ground, below the signs
PICTURE_ALPHA = 215  # opacity of a picture, 0 to 255
# lengths of the north arrow, head included, and of its head
ARROW_M = 8.0
HEAD_M = 2.0
LETTER_GAP_M = 1.5  # from the tip of the arrow to the N
SCALE_SHARE = 0.25  # largest part of the area's width that the scale takes
MARGIN_M = 4.0  # between the area and its signs
LANE_ARROW_M = 3.5
POLE_MARK_M = 1.0  # width of the cross on top of a pole
POLE_ROOM_M = 2.5  # around a pole, for its name
# detours (m): a sign goes so much farther from its corner to be clear of solids, names and lanes
SOLID_DETOUR_M = 100.0
NAME_DETOUR_M = 6.0
LANE_DETOUR_M = 4.0
# detours (m) for each solid, and for being covered by houses in full, if no place is clear
CROWD_DETOUR_M = 3.0
HOUSE_DETOUR_M = 200.0
LARGE_M2 = 60.0  # ground that a solid covers or hides, from which it counts as a house
STREET_SCALE = 0.8  # size of the names of streets
TRIED_PLACES = 24  # along each side of the area, for a sign without solids
MAX_NAMED_POLES = 60
LANE_INK = "#8a8a90"


def add_signs(api: "SceneApi", site: Site, poles: Sequence[Mount]) -> dict[str, Handle]:
    """Add the site with all poles that may carry a sensor, and the signs of a map.

    Signs are names and marks of poles, a north arrow, a scale, names of streets and arrows on
    lanes. Returns the labels of poles by name, none if there are more than `MAX_NAMED_POLES`."""
    site = replace(site, mounts=tuple(poles))
    add_site(api, site, set())
    labels = {}
    for k, pole in enumerate(poles if len(poles) <= MAX_NAMED_POLES else ()):
        top = pole.position + np.array([0.0, 0.0, pole.max_height])
        node = f"/signs/poles/{k}"
        labels[pole.name] = add_name(api, node, pole.name, position=top, scale=0.7)
    _add_pole_marks(api, poles)
    # the area's corners: xmin ymin, and xmax ymax (m)
    low_corner = site.area[:2]
    high_corner = site.area[2:]
    arrow_size = np.array([ARROW_M, ARROW_M + 2 * HEAD_M])
    arrow_middle = find_free_spot(site, arrow_size, high_corner)
    _add_north(api, site, arrow_middle)
    arrow_ground = shapely.box(*(arrow_middle - arrow_size / 2), *(arrow_middle + arrow_size / 2))
    length_m = scale_length(SCALE_SHARE * float(site.area[2] - site.area[0]))
    scale_size = np.array([length_m, HEAD_M])
    scale_middle = find_free_spot(site, size=scale_size, corner=low_corner, signs=[arrow_ground])
    _add_scale(api, site, length=length_m, middle=scale_middle)
    low, high = low_corner - MARGIN_M, high_corner + MARGIN_M
    for k, street in enumerate(find_street_names(site, low, high)):
        position = lift_points(site, np.array([[street.x, street.y]]), LIFT_M)[0]
        node = f"/signs/streets/{k}"
        scene_parts.add_label(
            api, node, street.name, position, scale=STREET_SCALE, anchor="center-center"
        )
    arrows = [
        _arrow(np.array([x, y]), angle, length=LANE_ARROW_M, head=1.0)
        for x, y, angle in find_lane_arrows(site, low, high)
    ]
    _add_lines(
        api,
        name="/signs/lanes",
        site=site,
        lines=np.concatenate([np.empty((0, 2, 2)), *arrows]),  # there may be no arrow
        colour=LANE_INK,
        width=1.5,
    )
    return labels


def _add_pole_marks(api: "SceneApi", poles: Sequence[Mount]) -> None:
    """Draw a cross on top of each pole, which from above is only a dot."""
    tops = [pole.position + np.array([0.0, 0.0, pole.max_height]) for pole in poles]
    # start and end (x, y, z) of both arms of a cross with corners at ±1, before it is scaled
    first_arm = [[-1.0, -1.0, 0.0], [1.0, 1.0, 0.0]]
    second_arm = [[-1.0, 1.0, 0.0], [1.0, -1.0, 0.0]]
    arms = POLE_MARK_M / 2 * np.array([first_arm, second_arm])
    # axes: pole, arm of the cross, end of the arm, xyz
    crosses = np.array(tops).reshape(-1, 1, 1, 3) + arms
    scene_parts.add_lines(
        api, "/signs/marks", crosses.reshape(-1, 2, 3), INK, width=2.0, visible=True
    )


def _add_north(api: "SceneApi", site: Site, middle: Float64[np.ndarray, "2"]) -> None:
    """Draw an arrow to the north around a point (x, y in m), and an N beyond its tip."""
    direction = north(site)  # unit vector (x, y)
    north_x, north_y = direction
    angle = float(np.arctan2(north_y, north_x))
    lines = _arrow(middle, angle, length=ARROW_M, head=HEAD_M)  # axes: line, end, xy
    _add_lines(api, name="/signs/north", site=site, lines=lines, colour=INK, width=3.0)
    letter_xy = middle + (ARROW_M / 2 + LETTER_GAP_M) * direction
    (position,) = lift_points(site, letter_xy[None], LIFT_M)
    scene_parts.add_label(
        api, "/signs/north/letter", "N", position, scale=1.2, anchor="center-center"
    )


def find_free_spot(
    site: Site,
    size: Float64[np.ndarray, "2"],
    corner: Float64[np.ndarray, "2"],
    signs: Sequence[shapely.Geometry] = (),
) -> Float64[np.ndarray, "2"]:
    """Middle (x, y in m) of a free place for a sign within the area, near one of its corners.

    As far as possible, solids do not cover it in the first view, nor do poles, their names and
    other signs, and no lane is below it. size: width and length of the place (m); corner: x and y
    (m); signs: outlines of signs to keep clear of."""
    # middles of places within the area (n, 2); an area smaller than the sign has one place only
    lowest, highest = site.area[:2] + size / 2, site.area[2:] - size / 2
    axes = [
        np.linspace(low, max(low, high), TRIED_PLACES)
        for low, high in zip(lowest, highest, strict=True)
    ]
    spots = np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 2)
    places = shapely.box(*(spots - size / 2).T, *(spots + size / 2).T)
    # ground that solids, and poles with room for their names, cover or hide
    solids = [_hidden_ground(solid.footprint, solid.top - solid.base) for solid in site.solids]
    circles = [
        shapely.Point(mount.position[:2]).buffer(POLE_ROOM_M, quad_segs=2) for mount in site.mounts
    ]
    rings = [shapely.get_coordinates(circle) for circle in circles]
    names = [
        _hidden_ground(ring, mount.max_height)
        for ring, mount in zip(rings, site.mounts, strict=True)
    ]
    lanes = [shapely.Polygon(lane) for lane in site.lanes]
    detours_m = np.linalg.norm(spots - corner, axis=1)  # distance of each place, plus detours
    for covers, detour_m in (
        (solids, SOLID_DETOUR_M),
        ([*names, *signs], NAME_DETOUR_M),
        (lanes, LANE_DETOUR_M),
    ):
        detours_m += detour_m * (_count_covers(places, covers) > 0)
    houses = [ground for ground in solids if ground.area > LARGE_M2]
    detours_m += CROWD_DETOUR_M * _count_covers(places, solids) + HOUSE_DETOUR_M * _share_covered(
        places, houses
    )
    return np.asarray(spots[detours_m.argmin()])


def _count_covers(
    places: np.ndarray, covers: Sequence[shapely.Geometry]
) -> Int64[np.ndarray, " n"]:
    """Number of geometries that touch each place. places: array of n polygons."""
    # indices of the place and the geometry of each pair that touches
    place, _ = shapely.STRtree(covers).query(places, predicate="intersects")
    return np.bincount(place, minlength=len(places))


def _share_covered(
    places: np.ndarray, covers: Sequence[shapely.Geometry]
) -> Float64[np.ndarray, " n"]:
    """Share of each place that geometries cover, up to 1. places: array of n polygons.

    Covers that overlap count twice."""
    tree = shapely.STRtree(covers)
    # indices of the place and the cover of each pair whose bounds touch
    place, cover = tree.query(places)
    pair_areas = shapely.area(shapely.intersection(places[place], tree.geometries[cover]))
    covered_areas = np.bincount(place, pair_areas, minlength=len(places))
    return np.minimum(covered_areas / shapely.area(places), 1.0)


def _hidden_ground(outline: Float64[np.ndarray, "n 2"], height: float) -> shapely.Geometry:
    """Ground that a prism covers, or hides behind it in the first view.

    outline: corners of the prism (x, y in m); height: height of the prism (m)."""
    # the direction of the first view is the same for any area, here a square around 0
    eye, target = (np.array(spot) for spot in scene.overview((-1.0, -1.0, 1.0, 1.0)))
    # from the foot of a top edge to the ground that it hides behind it (x, y): it points away from
    # the eye, as the eye is higher than the target
    shadow = height * (eye - target)[:2] / (target - eye)[2]
    return shapely.convex_hull(shapely.multipoints(np.concatenate([outline, outline + shadow])))


def _add_scale(
    api: "SceneApi", site: Site, length: float, middle: Float64[np.ndarray, "2"]
) -> None:
    """Draw a scale along the site's x axis, with its length as text.

    length: length of the scale (m); middle: its middle (x, y in m)."""
    half_length = np.array([length / 2, 0.0])
    half_tick = np.array([0.0, 0.8])  # m
    start = middle - half_length
    end = middle + half_length
    # the scale, and a tick across each end
    lines = np.array(
        [[start, end], [start - half_tick, start + half_tick], [end - half_tick, end + half_tick]]
    )
    _add_lines(api, name="/signs/scale", site=site, lines=lines, colour=INK, width=3.0)
    (position,) = lift_points(site, end[None], LIFT_M)
    text = f"{length:g} m"
    scene_parts.add_label(api, "/signs/scale/length", text, position, anchor="center-left")


def _arrow(
    middle: Float64[np.ndarray, "2"], angle: float, length: float, head: float
) -> Float64[np.ndarray, "3 2 2"]:
    """Start and end (x, y in m) of the lines of an arrow: its shaft and both sides of its head.

    middle: middle of the shaft (m); angle: direction, counter-clockwise from +x (rad); length,
    head: length of the arrow and of its head (m)."""
    forward = np.array([np.cos(angle), np.sin(angle)])
    to_left = np.array([-np.sin(angle), np.cos(angle)])
    start = middle - length / 2 * forward
    tip = middle + length / 2 * forward
    # ends of the head, which is as wide as it is long
    left = tip - head * forward + head / 2 * to_left
    right = tip - head * forward - head / 2 * to_left
    return np.array([[start, tip], [left, tip], [right, tip]])


def _add_lines(
    api: "SceneApi",
    name: str,
    site: Site,
    lines: Float64[np.ndarray, "n 2 2"],
    colour: str,
    *,
    width: float,
) -> None:
    """Draw lines just above the ground.

    name: path of their node in the scene; lines: axes line, start and end, x and y (m); width in
    px."""
    lifted_lines = lift_points(site, lines.reshape(-1, 2), LIFT_M).reshape(-1, 2, 3)
    scene_parts.add_lines(api, name, lifted_lines, colour, width=width, visible=True)


def lay_picture(api: "SceneApi", site: Site, picture: GroundPicture, folder: Path) -> None:
    """Draw a picture flat on the ground, at the height of the ground under its middle.

    folder: folder of its file."""
    # the picture's width and height are pixels, its scale is metres per pixel
    alpha = np.full((picture.height, picture.width), PICTURE_ALPHA, np.uint8)
    pixels = np.dstack([picture.read(folder)[::-1], alpha])  # RGBA, lowest row first
    width_m = picture.width * picture.scale
    length_m = picture.height * picture.scale
    image = api.add_image("/picture", pixels, width_m, length_m, cast_shadow=False)
    ground_z = float(site.ground(np.array([picture.x, picture.y])))
    image.position = picture.x, picture.y, ground_z + PICTURE_LIFT_M
    # quaternion w, x, y, z of a turn about z
    image.wxyz = np.cos(picture.turn / 2), 0.0, 0.0, np.sin(picture.turn / 2)
