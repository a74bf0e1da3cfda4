"""The junction in 3D, as a page of viser that plays in an iframe without server or network.

viser's own player cannot hide one sensor with its points under a name that a reader knows. So every
sensor, frame and kind of box is a node of its own, and the page around the scene switches nodes by
messages (`Layer.node`)."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import shapely

from placement_env.handover.ground import GroundGrid
from placement_env.handover.mounted import PlannedSensor
from placement_env.report.content import Plan, SceneMoment
from toolkit.arrays import ImageRanges
from toolkit.mesh import Mesh, box, extrude, merge, triangulate, tube
from toolkit.plots.palette import (
    FAINT,
    GROUND,
    OTHER_SOLID,
    OUTCOME,
    POLE_INK,
    SOLID,
    sensor_colour,
)
from toolkit.rendering.renderer import Renderer
from toolkit.sensors.sensor import Sensor
from toolkit.sites.site import Mount, Site
from toolkit.viewing import box_lines, scene, scene_parts

if TYPE_CHECKING:
    from viser import SceneApi


MAX_DRAWN_POINTS = 240_000  # of all clouds in all frames together
# Darker than on maps, because the light of the scene whitens them.
_SHADES = {**SOLID, "pond": "#a0c8dc", "tree": "#9fbf8c", "hedge": "#93b57f", "trunk": "#7a6554"}
_FREE_POLE = "#8c8c8c"
_LANE = "#b4b6ba"
_BARE_GROUND = "#dfe2d8"
GROUND_MARGIN_M = 25.0  # of ground drawn around the area
TILE_M = 4.0  # side of the tiles into which ground and streets are cut to follow the relief
MAX_RUN_CELLS = 8  # cells of visible ground in one rectangle
NO_RETURN_M = 12.0  # length of rays that meet nothing


@dataclass(frozen=True)
class Layer:
    """A part of the scene that readers may hide.

    Attributes:
        name: Name for the switch.
        node: Path of its node in viser's tree; hiding it hides all nodes below.
        colour: Colour of the switch and the part.
        mark: Drawing style in words, such as "dashed boxes"."""

    name: str
    node: str
    colour: str
    mark: str


BOXES = (
    Layer("Vehicles that were there", "/truth", FAINT, "thin solid boxes"),
    Layer("Detections that hit", "/hit", OUTCOME["hit"].colour, "thick solid boxes"),
    Layer(
        "Vehicles that were missed",
        "/missed",
        OUTCOME["missed"].colour,
        "dashed boxes, a cross on the roof",
    ),
    Layer("False alarms", "/false", OUTCOME["false alarm"].colour, "dotted boxes under a mast"),
)


@dataclass(frozen=True)
class Scene:
    """A page of HTML with the scene.

    Attributes:
        html: The whole page.
        layers: Parts that readers may hide.
        frames: Nodes of each frame; one frame is shown at a time."""

    html: str
    layers: tuple[Layer, ...]
    frames: tuple[tuple[str, ...], ...]


def build_scene(
    plan: Plan, site: Site, ground: GroundGrid | None, moments: Sequence[SceneMoment]
) -> Scene:
    """Build the scene of a plan: site, sensors, visible ground, and the frames of `moments`.

    site: site with the chosen sensors; ground: ground that they see, None to draw none; moments:
    frames of traffic; the scene opens with the first."""
    with scene.viser_server() as server:
        api = server.scene
        add_site(api, site, {sensor.pole for sensor in plan.sensors})
        layers = []
        for index, sensor in enumerate(plan.sensors):
            seen = None if ground is None else seen_cells(site, ground, index)
            layers.append(_add_sensor(api, site, sensor, index, seen=seen))
        _add_views(api, site, plan.sensors)
        _add_clouds(api, moments, len(plan.sensors))
        _add_boxes(api, moments)
        xmin, ymin, xmax, ymax = site.area.tolist()
        scene.set_view(server, *scene.overview((xmin, ymin, xmax, ymax)))
        html = scene.scene_html(server)
    # some of these nodes may be missing; hiding them does nothing
    frames = []
    for frame in range(len(moments)):
        nodes = [f"/sensors/{index}/points {frame}" for index in range(len(plan.sensors))]
        nodes += [f"{layer.node}/{frame}" for layer in BOXES]
        frames.append(tuple(nodes))
    return Scene(html, (*layers, *BOXES), tuple(frames))


def add_site(api: "SceneApi", site: Site, used_poles: set[str]) -> None:
    """Add ground, streets, solids and poles to a scene.

    used_poles: names of the poles that carry a sensor, which are thicker and darker."""
    scene_parts.add_mesh(api, "/site/ground", ground_mesh(site), _BARE_GROUND)
    # attribute of the site, height over the ground (m) so that nothing flickers, colour
    for layer, lift, colour in (("lanes", 0.03, _LANE), ("footways", 0.04, GROUND["footways"])):
        polygons = [shapely.Polygon(polygon) for polygon in getattr(site, layer)]
        scene_parts.add_mesh(api, f"/site/{layer}", drape(site, polygons, lift=lift), colour)
    solids: dict[str, list[Mesh]] = {}
    for solid in site.solids:
        solids.setdefault(solid.kind, []).append(extrude(solid.footprint, solid.base, solid.top))
    for kind, meshes in sorted(solids.items()):
        scene_parts.add_mesh(api, f"/site/{kind}", merge(meshes), _SHADES.get(kind, OTHER_SOLID))
    free_mounts = [mount for mount in site.mounts if mount.name not in used_poles]
    used_mounts = [mount for mount in site.mounts if mount.name in used_poles]
    scene_parts.add_mesh(api, "/site/free poles", _pole_tubes(free_mounts, 0.06), _FREE_POLE)
    scene_parts.add_mesh(api, "/site/poles in use", _pole_tubes(used_mounts, 0.12), POLE_INK)


def _pole_tubes(mounts: Sequence[Mount], radius: float) -> Mesh:
    # tubes from the foot of each mount to its highest place; radius: m
    tubes = []
    for mount in mounts:
        top = mount.position + np.array([0.0, 0, mount.max_height])
        tubes.append(tube(np.stack([mount.position, top]), radius))
    return merge(tubes)


def _add_sensor(
    api: "SceneApi", site: Site, sensor: PlannedSensor, index: int, *, seen: Mesh | None
) -> Layer:
    # pole, housing, label and visible ground of a sensor; index: in the plan, for node and colour
    colour = sensor_colour(index)
    node = f"/sensors/{index}"
    api.add_frame(node, show_axes=False)
    foot = float(site.ground(np.array([sensor.x, sensor.y])))
    pole = tube(np.array([[sensor.x, sensor.y, foot], [sensor.x, sensor.y, sensor.z + 0.3]]), 0.1)
    scene_parts.add_mesh(api, f"{node}/pole", pole, POLE_INK)
    housing = box((0.7, 0.7, 0.5), (sensor.x, sensor.y, sensor.z))
    scene_parts.add_mesh(api, f"{node}/housing", housing, colour)
    api.add_label(
        f"{node}/label",
        sensor.name,
        position=(sensor.x, sensor.y, sensor.z + 1.2),
        font_screen_scale=1.3,
        anchor="bottom-center",
    )
    if seen is not None:
        scene_parts.add_mesh(api, f"{node}/ground", seen, colour, opacity=0.28)
    return Layer(sensor.name, node, colour, "points, field of view and visible ground")


def _add_views(api: "SceneApi", site: Site, planned: Sequence[PlannedSensor]) -> None:
    # outlines of the views of planned sensors that the site has
    mounted = {sensor.name: sensor for sensor in site.sensors}
    indexed_sensors = [
        (index, mounted[planned_sensor.name])
        for index, planned_sensor in enumerate(planned)
        if planned_sensor.name in mounted
    ]
    if not indexed_sensors:
        return
    renderer = Renderer(site, (), [sensor for _, sensor in indexed_sensors])
    for (index, sensor), background in zip(indexed_sensors, renderer.background, strict=True):
        edges = view_edges(sensor, background)
        scene_parts.add_lines(
            api, f"/sensors/{index}/view", edges, sensor_colour(index), width=1.5, visible=True
        )


def _add_clouds(api: "SceneApi", moments: Sequence[SceneMoment], sensors: int) -> None:
    # points of each sensor in each frame, thinned evenly; only frame 0 is visible at first
    max_points = MAX_DRAWN_POINTS // max(sum(len(moment.clouds) for moment in moments), 1)
    for frame, moment in enumerate(moments):
        for index, points in enumerate(moment.clouds[:sensors]):
            name = f"/sensors/{index}/points {frame}"
            colour = scene.rgb(sensor_colour(index))
            scene_parts.add_points(
                api,
                name,
                scene_parts.thin_evenly(points, max_points),
                colour,
                size=0.09,
                visible=frame == 0,
            )


def _add_boxes(api: "SceneApi", moments: Sequence[SceneMoment]) -> None:
    """Add truth and detections of each frame in distinct colours, lines and marks.

    Only frame 0 is visible at first. Detections and misses that do not count are not drawn."""
    for layer in BOXES:
        api.add_frame(layer.node, show_axes=False)
    for frame, moment in enumerate(moments):
        truth = moment.truth.boxes
        detections = moment.detections.boxes
        missed = truth[~moment.truth_hit & ~moment.truth_ignored]
        missed_dashes = box_lines.dashes(box_lines.box_edges(missed), dash=0.6, gap=0.4)
        false_alarms = detections[~moment.detection_hit & ~moment.detection_ignored]
        false_dots = box_lines.dashes(box_lines.box_edges(false_alarms), dash=0.15, gap=0.3)
        layer_lines = (  # in the order of `BOXES`
            box_lines.box_edges(truth),
            box_lines.box_edges(detections[moment.detection_hit]),
            np.concatenate([missed_dashes, box_lines.roof_crosses(missed)]),
            np.concatenate([false_dots, box_lines.spikes(false_alarms)]),
        )
        for layer, lines, width in zip(BOXES, layer_lines, (1.5, 3.0, 3.0, 3.0), strict=True):
            scene_parts.add_lines(
                api, f"{layer.node}/{frame}", lines, layer.colour, width=width, visible=frame == 0
            )


def ground_mesh(site: Site) -> Mesh:
    """Return the ground in the area and `GROUND_MARGIN_M` around it, with holes at ponds."""
    ponds = [shapely.Polygon(solid.footprint) for solid in site.solids if solid.kind == "pond"]
    return drape(site, [shapely.box(*_extent(site))], lift=0.0, without=ponds)


def drape(
    site: Site,
    shapes: Sequence[shapely.Polygon],
    *,
    lift: float,
    without: Sequence[shapely.Polygon] = (),
) -> Mesh:
    """Return polygons as a mesh that follows the relief, `lift` metres over the ground.

    Polygons are cut into tiles, and only their part in or near the area is kept. without: polygons
    to cut out."""
    xmin, ymin, xmax, ymax = _extent(site)
    x, y = np.meshgrid(np.arange(xmin, xmax, TILE_M), np.arange(ymin, ymax, TILE_M))
    x, y = x.ravel(), y.ravel()
    covered = shapely.union_all(list(shapes)).difference(shapely.union_all(list(without)))
    tiles = shapely.intersection(covered, shapely.box(x, y, x + TILE_M, y + TILE_M))
    is_drawn = ~shapely.is_empty(tiles) & (shapely.area(tiles) > 1e-6)  # m²; slivers are left out
    return _lift(site, triangulate(tiles[is_drawn]), lift)


def seen_cells(site: Site, ground: GroundGrid, index: int) -> Mesh:
    """Return the cells that a sensor sees as a mesh of rectangles over the ground.

    A rectangle is a run of up to `MAX_RUN_CELLS` cells of one row. Each sensor's rectangles are a
    little above those of the sensor before.

    index: number of the sensor in `ground`."""
    half = ground.cell / 2
    boxes = []
    for row, y in zip(ground.seen[index], ground.y, strict=True):
        # first column of each run of seen cells and the column after its last, in turn
        steps = np.flatnonzero(np.diff(np.concatenate([[False], row, [False]]).astype(np.int8)))
        for first, end in steps.reshape(-1, 2):
            for start in range(first, end, MAX_RUN_CELLS):
                last = min(start + MAX_RUN_CELLS, end) - 1
                boxes.append((ground.x[start] - half, y - half, ground.x[last] + half, y + half))
    x0, y0, x1, y1 = np.array(boxes, np.float64).reshape(-1, 4).T
    # four corners of each box counterclockwise, then two triangles from the first corner
    corners = np.stack(
        [np.stack([x, y], 1) for x, y in ((x0, y0), (x1, y0), (x1, y1), (x0, y1))], 1
    ).reshape(-1, 2)
    first_corner = 4 * np.arange(len(boxes))[:, None]
    triangles = np.concatenate(
        [first_corner + half_square for half_square in ([0, 1, 2], [0, 2, 3])]
    )
    flat = Mesh(np.column_stack([corners, np.zeros(len(corners))]), triangles.astype(np.int64))
    return _lift(site, flat, 0.08 + 0.03 * index)


def view_edges(sensor: Sensor, background: ImageRanges) -> box_lines.Segments:
    """Return the outline of a sensor's view of the empty site, and four rays that lead to it.

    The outline follows the border of the image, at up to 240 of its pixels; rays that meet nothing
    have a length of at most `NO_RETURN_M`. Segments are pairs of points in the site's frame (m).

    background: distances (m) at the empty site, 0 without a return."""
    rows, columns = background.shape
    index = np.arange(rows * columns).reshape(rows, columns)
    # pixels of the border: top row, right column, bottom row backwards, left column upwards
    ring = np.concatenate([index[0], index[1:, -1], index[-1, -2::-1], index[-2:0:-1, 0]])
    picked = ring[np.linspace(0, len(ring), min(len(ring), 240), endpoint=False).astype(np.int64)]
    lengths = background.ravel()[picked].astype(np.float64)
    lengths = np.where(lengths > 0, lengths, min(sensor.model.max_range, NO_RETURN_M))
    ends = sensor.position + sensor.world_rays.T[picked] * lengths[:, None]
    outline = np.stack([ends, np.roll(ends, -1, axis=0)], 1)
    # an edge that jumps to an object behind is left out
    is_jump = np.linalg.norm(outline[:, 1] - outline[:, 0], axis=1) > 0.25 * lengths
    corner_rays = np.linspace(0, len(ends), 4, endpoint=False).astype(np.int64)
    rays = np.stack([np.broadcast_to(sensor.position, (len(corner_rays), 3)), ends[corner_rays]], 1)
    return np.concatenate([outline[~is_jump], rays])


def _extent(site: Site) -> tuple[float, float, float, float]:
    # least x and y, greatest x and y (m) of the drawn ground
    xmin, ymin, xmax, ymax = site.area.tolist()
    return (
        xmin - GROUND_MARGIN_M,
        ymin - GROUND_MARGIN_M,
        xmax + GROUND_MARGIN_M,
        ymax + GROUND_MARGIN_M,
    )


def _lift(site: Site, flat: Mesh, lift: float) -> Mesh:
    # the mesh with every vertex `lift` metres over the ground below it
    return Mesh(
        np.column_stack([flat.vertices[:, :2], site.ground(flat.vertices[:, :2]) + lift]),
        flat.triangles,
    )
