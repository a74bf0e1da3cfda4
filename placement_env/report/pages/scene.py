"""The junction in 3D, as a page of viser that plays in an iframe without server or network.

viser's own player cannot hide one sensor with its points under a name that a reader knows. So every
sensor, frame and kind of box is a node of its own, and the page around the scene switches nodes by
messages (`Layer.node`)."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from placement_env.handover.ground import GroundGrid
from placement_env.handover.mounted import PlannedSensor
from placement_env.report.content import Plan, SceneMoment
from placement_env.report.pages.scene_layer import Layer
from toolkit.arrays import Float64
from toolkit.mesh import Mesh, tube
from toolkit.plots.palette import FAINT, OUTCOME, POLE_INK, sensor_colour
from toolkit.rendering.renderer import Renderer
from toolkit.sites.site import Site
from toolkit.viewing import scene, scene_parts
from toolkit.viewing.box_lines import roof_crosses, spikes
from toolkit.viewing.box_styles import BoxStyle, DashPattern, add_boxes
from toolkit.viewing.sensor_parts import add_housing, view_edges
from toolkit.viewing.site_scene import add_site, lift_to_ground

if TYPE_CHECKING:
    from viser import SceneApi


MAX_DRAWN_POINTS = 240_000  # points of all clouds in all frames together
_HOUSING_SIZE_M = (0.7, 0.7, 0.5)  # along x, y and z
_LABEL_RISE_M = 1.2  # height of a label above its sensor
MAX_RUN_CELLS = 8  # cells of visible ground in one rectangle
_DASHED = DashPattern(dash=0.6, gap=0.4)
_DOTTED = DashPattern(dash=0.15, gap=0.3)
# style of boxes by the node above them
BOX_STYLES = {
    "/truth": BoxStyle(FAINT, width=1.5),
    "/hit": BoxStyle(OUTCOME["hit"].colour, width=3.0),
    "/missed": BoxStyle(OUTCOME["missed"].colour, 3.0, dashes=_DASHED, mark=roof_crosses),
    "/false": BoxStyle(OUTCOME["false alarm"].colour, 3.0, dashes=_DOTTED, mark=spikes),
}
BOX_LAYERS = tuple(
    Layer(name, node, BOX_STYLES[node].colour, mark)
    for name, node, mark in (
        ("Vehicles that were there", "/truth", "thin solid boxes"),
        ("Detections that hit", "/hit", "thick solid boxes"),
        ("Vehicles that were missed", "/missed", "dashed boxes, a cross on the roof"),
        ("False alarms", "/false", "dotted boxes under a mast"),
    )
)


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
    """Build the scene of a plan: site, sensors and their views, visible ground, and frames.

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
        scene.show_area(server, (xmin, ymin, xmax, ymax))
        html = scene.scene_html(server)
    # the page shows the nodes of one frame and hides the others; to hide a missing one does nothing
    frame_nodes = []
    for frame in range(len(moments)):
        nodes = [f"/sensors/{index}/points {frame}" for index in range(len(plan.sensors))]
        nodes += [f"{layer.node}/{frame}" for layer in BOX_LAYERS]
        frame_nodes.append(tuple(nodes))
    return PlanScene(html, layers=(*sensor_layers, *BOX_LAYERS), frames=tuple(frame_nodes))


def _add_sensor(
    api: "SceneApi", site: Site, sensor: PlannedSensor, index: int, *, seen_ground: Mesh | None
) -> Layer:
    """Add pole, housing, label and visible ground of a sensor, and return their layer.

    index: number of the sensor in the plan, for node and colour; seen_ground: None to draw none."""
    colour = sensor_colour(index)
    node = f"/sensors/{index}"
    scene_parts.add_group(api, node)
    foot_z = float(site.ground(np.array([sensor.x, sensor.y])))
    # the pole reaches a little above the sensor; all lengths in m
    pole_ends = np.array([[sensor.x, sensor.y, foot_z], [sensor.x, sensor.y, sensor.z + 0.3]])
    pole = tube(pole_ends, radii=0.1)
    scene_parts.add_mesh(api, f"{node}/pole", pole, POLE_INK)
    position = (sensor.x, sensor.y, sensor.z)
    add_housing(api, name=f"{node}/housing", position=position, size=_HOUSING_SIZE_M, colour=colour)
    label_position = (sensor.x, sensor.y, sensor.z + _LABEL_RISE_M)
    scene_parts.add_label(api, f"{node}/label", sensor.name, label_position, scale=1.3)
    if seen_ground is not None:
        scene_parts.add_mesh(api, f"{node}/ground", seen_ground, colour, opacity=0.28)
    return Layer(sensor.name, node, colour, mark="points, field of view and visible ground")


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
        scene_parts.add_group(api, layer.node)
    for frame, moment in enumerate(moments):
        truth_boxes = moment.truth.boxes
        detections = moment.detections.boxes
        layer_boxes = (  # in the order of `BOX_LAYERS`
            truth_boxes,
            detections[moment.detection_hit],
            truth_boxes[~moment.truth_hit & ~moment.truth_ignored],
            detections[~moment.detection_hit & ~moment.detection_ignored],
        )
        for layer, boxes in zip(BOX_LAYERS, layer_boxes, strict=True):
            style = BOX_STYLES[layer.node]
            add_boxes(api, f"{layer.node}/{frame}", boxes, style, visible=frame == 0)


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
    return lift_to_ground(site, flat_mesh, 0.08 + 0.03 * index)


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
