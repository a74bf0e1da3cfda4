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
from placement_env.report.pages.scene_layer import Layer
from toolkit.arrays import Float64, ImageRanges
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
MAX_OUTLINE_PIXELS = 240  # pixels of the outline of a sensor's view
MAX_EDGE_SHARE = 0.25  # length of an outline's edge as a share of its ray; longer ones are left out
MIN_TILE_AREA_M2 = 1e-6  # smaller pieces are slivers of rounding
BOX_LAYERS = (
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
BOX_WIDTHS_PX = (1.5, 3.0, 3.0, 3.0)  # width of lines in each of `BOX_LAYERS`


@dataclass(frozen=True)
class PlanScene:
    """A page of HTML with the scene.

    Attributes:
        html: The whole page.
        layers: Parts that readers may hide.
        frames: Nodes of each frame; one frame is shown at a time."""

    html: str
    layers: tuple[Layer, ...]
    frames: tuple[tuple[str, ...], ...]


def build_plan_scene(
    plan: Plan, site: Site, ground: GroundGrid | None, moments: Sequence[SceneMoment]
) -> PlanScene:
    """Build the scene of a plan: site, sensors, visible ground, and the frames of `moments`.

    site: site with the chosen sensors; ground: ground that they see, None to draw none; moments:
    frames of traffic; the scene opens with the first."""
    with scene.viser_server() as server:
        api = server.scene
        add_site(api, site, used_poles={sensor.pole for sensor in plan.sensors})
        sensor_layers = []
        for index, sensor in enumerate(plan.sensors):
            seen_ground = None if ground is None else seen_cells(site, ground, index)
            sensor_layers.append(_add_sensor(api, site, sensor, index, seen_ground=seen_ground))
        _add_views(api, site, plan.sensors)
        _add_clouds(api, moments, len(plan.sensors))
        _add_boxes(api, moments)
        xmin, ymin, xmax, ymax = site.area.tolist()
        position, look_at = scene.overview((xmin, ymin, xmax, ymax))
        scene.set_view(server, position, look_at)
        html = scene.scene_html(server)
    # some nodes may be missing; hiding them does nothing
    frame_nodes = []
    for frame in range(len(moments)):
        nodes = [f"/sensors/{index}/points {frame}" for index in range(len(plan.sensors))]
        nodes += [f"{layer.node}/{frame}" for layer in BOX_LAYERS]
        frame_nodes.append(tuple(nodes))
    return PlanScene(html, layers=(*sensor_layers, *BOX_LAYERS), frames=tuple(frame_nodes))


def add_site(api: "SceneApi", site: Site, used_poles: set[str]) -> None:
    """Add ground, streets, solids and poles to a scene.

    api: scene of viser; used_poles: names of the poles that carry a sensor, which are thicker and
    darker."""
    scene_parts.add_mesh(api, "/site/ground", ground_mesh(site), _BARE_GROUND)
    # attribute of the site, height over the ground (m) so that nothing flickers, colour
    for attribute, lift, colour in (("lanes", 0.03, _LANE), ("footways", 0.04, GROUND["footways"])):
        polygons = [shapely.Polygon(polygon) for polygon in getattr(site, attribute)]
        scene_parts.add_mesh(api, f"/site/{attribute}", drape(site, polygons, lift=lift), colour)
    meshes_by_kind: dict[str, list[Mesh]] = {}
    for solid in site.solids:
        mesh = extrude(solid.footprint, solid.base, solid.top)
        meshes_by_kind.setdefault(solid.kind, []).append(mesh)
    for kind, meshes in sorted(meshes_by_kind.items()):
        scene_parts.add_mesh(api, f"/site/{kind}", merge(meshes), _SHADES.get(kind, OTHER_SOLID))
    free_mounts = [mount for mount in site.mounts if mount.name not in used_poles]
    used_mounts = [mount for mount in site.mounts if mount.name in used_poles]
    free_poles = _pole_tubes(free_mounts, radius=0.06)
    used_tubes = _pole_tubes(used_mounts, radius=0.12)
    scene_parts.add_mesh(api, "/site/free poles", free_poles, _FREE_POLE)
    scene_parts.add_mesh(api, "/site/poles in use", used_tubes, POLE_INK)


def _pole_tubes(mounts: Sequence[Mount], radius: float) -> Mesh:
    """Return tubes from the foot of each mount to its highest place for sensors. radius: m."""
    tubes = []
    for mount in mounts:
        top = mount.position + np.array([0.0, 0, mount.max_height])
        tubes.append(tube(np.stack([mount.position, top]), radius))
    return merge(tubes)


def _add_sensor(
    api: "SceneApi", site: Site, sensor: PlannedSensor, index: int, *, seen_ground: Mesh | None
) -> Layer:
    """Add pole, housing, label and visible ground of a sensor, and return their layer.

    index: number of the sensor in the plan, for node and colour; seen_ground: None to draw none."""
    colour = sensor_colour(index)
    node = f"/sensors/{index}"
    api.add_frame(node, show_axes=False)
    foot_z = float(site.ground(np.array([sensor.x, sensor.y])))
    # the pole reaches a little above the sensor; all lengths in m
    pole_ends = np.array([[sensor.x, sensor.y, foot_z], [sensor.x, sensor.y, sensor.z + 0.3]])
    pole = tube(pole_ends, radii=0.1)
    scene_parts.add_mesh(api, f"{node}/pole", pole, POLE_INK)
    housing = box(size=(0.7, 0.7, 0.5), centre=(sensor.x, sensor.y, sensor.z))
    scene_parts.add_mesh(api, f"{node}/housing", housing, colour)
    api.add_label(
        f"{node}/label",
        sensor.name,
        position=(sensor.x, sensor.y, sensor.z + 1.2),
        font_screen_scale=1.3,
        anchor="bottom-center",
    )
    if seen_ground is not None:
        scene_parts.add_mesh(api, f"{node}/ground", seen_ground, colour, opacity=0.28)
    return Layer(sensor.name, node, colour, "points, field of view and visible ground")


def _add_views(api: "SceneApi", site: Site, planned: Sequence[PlannedSensor]) -> None:
    """Add the outline of the view of each planned sensor that the site has.

    Nodes and colours are numbered as the sensors are in `planned`."""
    mounted_sensors = {sensor.name: sensor for sensor in site.sensors}
    indexed_sensors = [
        (index, mounted_sensors[planned_sensor.name])
        for index, planned_sensor in enumerate(planned)
        if planned_sensor.name in mounted_sensors
    ]
    if not indexed_sensors:
        return
    # distances that each sensor measures at the site without objects
    renderer = Renderer(site, (), [sensor for _, sensor in indexed_sensors])
    for (index, sensor), background in zip(indexed_sensors, renderer.background, strict=True):
        edges = view_edges(sensor, background)
        scene_parts.add_lines(
            api, f"/sensors/{index}/view", edges, sensor_colour(index), width=1.5, visible=True
        )


def _add_clouds(api: "SceneApi", moments: Sequence[SceneMoment], sensor_count: int) -> None:
    """Add the points of each sensor in each frame, thinned evenly; frame 0 is visible at first.

    sensor_count: number of first clouds of each frame to add."""
    cloud_count = sum(len(moment.clouds) for moment in moments)
    max_points = MAX_DRAWN_POINTS // max(cloud_count, 1)  # in one cloud
    for frame, moment in enumerate(moments):
        for index, points in enumerate(moment.clouds[:sensor_count]):
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
    for layer in BOX_LAYERS:
        api.add_frame(layer.node, show_axes=False)
    for frame, moment in enumerate(moments):
        truth_boxes = moment.truth.boxes
        detections = moment.detections.boxes
        missed_boxes = truth_boxes[~moment.truth_hit & ~moment.truth_ignored]
        missed_dashes = box_lines.dashes(box_lines.box_edges(missed_boxes), dash=0.6, gap=0.4)
        false_alarms = detections[~moment.detection_hit & ~moment.detection_ignored]
        false_dots = box_lines.dashes(box_lines.box_edges(false_alarms), dash=0.15, gap=0.3)
        layer_lines = (  # in the order of `BOX_LAYERS`: truth, hits, misses, false alarms
            box_lines.box_edges(truth_boxes),
            box_lines.box_edges(detections[moment.detection_hit]),
            np.concatenate([missed_dashes, box_lines.roof_crosses(missed_boxes)]),
            np.concatenate([false_dots, box_lines.spikes(false_alarms)]),
        )
        for layer, lines, width in zip(BOX_LAYERS, layer_lines, BOX_WIDTHS_PX, strict=True):
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

    Polygons are cut into square tiles, and only their part in or near the area is kept.

    shapes, without: polygons to draw, and polygons to cut out, in the site's frame (m)."""
    xmin, ymin, xmax, ymax = _extent(site)
    grid = np.meshgrid(np.arange(xmin, xmax, TILE_M), np.arange(ymin, ymax, TILE_M))
    x, y = (coordinates.ravel() for coordinates in grid)  # lower left corner of each tile
    covered = shapely.union_all(list(shapes)).difference(shapely.union_all(list(without)))
    tiles = shapely.intersection(covered, shapely.box(x, y, x + TILE_M, y + TILE_M))
    is_drawn = ~shapely.is_empty(tiles) & (shapely.area(tiles) > MIN_TILE_AREA_M2)
    return _lift(site, triangulate(tiles[is_drawn]), lift)


def seen_cells(site: Site, ground: GroundGrid, index: int) -> Mesh:
    """Return the cells that a sensor sees as a mesh of rectangles over the ground.

    A rectangle is a run of up to `MAX_RUN_CELLS` cells of one row. Each sensor's rectangles are a
    little above the previous sensor's.

    index: number of the sensor in `ground`."""
    half_cell = ground.cell / 2
    rectangles = []  # xmin, ymin, xmax, ymax (m)
    for is_seen, y in zip(ground.seen[index], ground.y, strict=True):
        # first column of each run of seen cells and the column after its last, in turn
        padded = np.concatenate([[False], is_seen, [False]])
        steps = np.flatnonzero(np.diff(padded.astype(np.int8)))
        for first, end in steps.reshape(-1, 2):
            for start in range(first, end, MAX_RUN_CELLS):
                last = min(start + MAX_RUN_CELLS, end) - 1
                xmin = ground.x[start] - half_cell
                xmax = ground.x[last] + half_cell
                rectangles.append((xmin, y - half_cell, xmax, y + half_cell))
    flat_mesh = _triangulate_rectangles(np.array(rectangles, np.float64).reshape(-1, 4))
    return _lift(site, flat_mesh, 0.08 + 0.03 * index)


def _triangulate_rectangles(rectangles: Float64[np.ndarray, "n 4"]) -> Mesh:
    """Return rectangles as a mesh at height 0, two triangles each.

    rectangles: columns xmin, ymin, xmax, ymax (m)."""
    xmin, ymin, xmax, ymax = rectangles.T
    # corners counter-clockwise from the lower left, rectangle after rectangle
    corner_x = np.stack([xmin, xmax, xmax, xmin], axis=1).ravel()
    corner_y = np.stack([ymin, ymin, ymax, ymax], axis=1).ravel()
    vertices = np.column_stack([corner_x, corner_y, np.zeros(len(corner_x))])
    first_corners = 4 * np.arange(len(rectangles))[:, None]
    # both halves of a rectangle begin at its first corner
    halves = (np.array([0, 1, 2]), np.array([0, 2, 3]))
    triangles = np.concatenate([first_corners + half for half in halves])
    return Mesh(vertices, triangles.astype(np.int64))


def view_edges(sensor: Sensor, background: ImageRanges) -> box_lines.Segments:
    """Return the outline of a sensor's view of the empty site, and four rays that lead to it.

    The outline follows the border of the image, at up to `MAX_OUTLINE_PIXELS` of its pixels; rays
    that meet nothing have a length of at most `NO_RETURN_M`. Segments are pairs of points in the
    site's frame (m).

    background: distances (m) at the empty site, 0 without a return."""
    rows, columns = background.shape
    pixel = np.arange(rows * columns).reshape(rows, columns)  # number of each pixel, row by row
    # pixels of the border: top row, right column, bottom row backwards, left column upwards
    border = np.concatenate([pixel[0], pixel[1:, -1], pixel[-1, -2::-1], pixel[-2:0:-1, 0]])
    count = min(len(border), MAX_OUTLINE_PIXELS)
    outline_pixels = border[np.linspace(0, len(border), count, endpoint=False).astype(np.int64)]
    measured = background.ravel()[outline_pixels].astype(np.float64)
    lengths = np.where(measured > 0, measured, min(sensor.model.max_range, NO_RETURN_M))
    # `world_rays` has a column for each pixel: its direction, in units of the measured distance
    ends = sensor.position + sensor.world_rays.T[outline_pixels] * lengths[:, None]
    next_ends = np.roll(ends, -1, axis=0)
    # a long edge jumps to an object behind, and is left out
    is_jump = np.linalg.norm(next_ends - ends, axis=1) > MAX_EDGE_SHARE * lengths
    outline = np.stack([ends, next_ends], axis=1)[~is_jump]
    ray_ends = ends[np.linspace(0, len(ends), 4, endpoint=False).astype(np.int64)]
    ray_starts = np.broadcast_to(sensor.position, ray_ends.shape)
    return np.concatenate([outline, np.stack([ray_starts, ray_ends], axis=1)])


def _extent(site: Site) -> tuple[float, float, float, float]:
    """Return xmin, ymin, xmax and ymax (m) of the drawn ground: the area with a margin."""
    xmin, ymin, xmax, ymax = site.area.tolist()
    return (
        xmin - GROUND_MARGIN_M,
        ymin - GROUND_MARGIN_M,
        xmax + GROUND_MARGIN_M,
        ymax + GROUND_MARGIN_M,
    )


def _lift(site: Site, flat_mesh: Mesh, lift: float) -> Mesh:
    """Return the mesh with every vertex `lift` metres over the ground below it."""
    xy = flat_mesh.vertices[:, :2]
    return Mesh(np.column_stack([xy, site.ground(xy) + lift]), flat_mesh.triangles)
