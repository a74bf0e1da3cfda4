"""The junction in 3D: a page of viser that plays in an iframe without server or network.

`toolkit.viewing.scene` has viser write it. viser's own player cannot leave out one sensor and its points in words
that a reader knows, so every sensor, every frame and every kind of box is a node of its own, and the page around it
switches them by messages (`layers` are their nodes).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import shapely

from placement_env.report.content import Ground, Moment, Plan, PlannedSensor
from placement_env.report.pages import scene_shapes as shapes
from toolkit.arrays import Float64
from toolkit.mesh import Mesh, box, extrude, merge, tube
from toolkit.plots.palette import FAINT, GROUND, OTHER_SOLID, OUTCOME, POLE_INK, SOLID, sensor_colour
from toolkit.rendering.renderer import Renderer
from toolkit.sensors.sensor import Sensor
from toolkit.sites.site import Site
from toolkit.viewing import scene as lines
from toolkit.viewing.scene import add_lines, add_mesh, overview, rgb, scene_html, start_at, viser_server

if TYPE_CHECKING:
    from viser import SceneApi

MOST_DRAWN = 240_000  # of all clouds of all frames together
# Darker than on maps: the light of the scene whitens them.
_SHADES = {**SOLID, "pond": "#a0c8dc", "tree": "#9fbf8c", "hedge": "#93b57f", "trunk": "#7a6554"}
_FREE_POLE, _LANE, _BARE_GROUND = "#8c8c8c", "#b4b6ba", "#dfe2d8"
_TRUTH = FAINT
_HIT, _MISSED, _FALSE_ALARM = OUTCOME["hit"].colour, OUTCOME["missed"].colour, OUTCOME["false alarm"].colour


@dataclass(frozen=True)
class Layer:
    """What a reader may hide: its name, the node of the scene, and how it looks (colour; a mark in words)."""

    name: str
    node: str
    colour: str
    mark: str


@dataclass(frozen=True)
class Scene:
    """A page of HTML that shows the scene; what of it can be hidden; the nodes of each frame, of which one is shown."""

    html: str
    layers: tuple[Layer, ...]
    frames: tuple[tuple[str, ...], ...]


def build_scene(plan: Plan, site: Site, ground: Ground | None, moments: Sequence[Moment]) -> Scene:
    """The scene of a plan: site, chosen sensors and what they see, and the frames of `moments`, one after the other."""
    with viser_server() as server:
        api = server.scene
        _add_site(api, site, {sensor.pole for sensor in plan.sensors})
        layers = [
            _add_sensor(api, site, sensor, index, seen=None if ground is None else shapes_of(site, ground, index))
            for index, sensor in enumerate(plan.sensors)
        ]
        _add_views(api, site, plan.sensors)
        _add_clouds(api, moments, len(plan.sensors))
        layers += _add_boxes(api, moments)
        xmin, ymin, xmax, ymax = site.area.tolist()
        start_at(server, *overview((xmin, ymin, xmax, ymax)))
        html = scene_html(server)
    frames = tuple(_frame_nodes(f, len(plan.sensors)) for f in range(len(moments)))
    return Scene(html, tuple(layers), frames)


def shapes_of(site: Site, ground: Ground, index: int) -> Mesh:
    """The ground that the sensor of this row of `ground.seen` sees; each lies a little above the one before."""
    return shapes.seen_cells(site, ground, ground.seen[index], lift=0.08 + 0.03 * index)


def _add_site(api: SceneApi, site: Site, used: set[str]) -> None:
    add_mesh(api, "/site/ground", shapes.ground_mesh(site), _BARE_GROUND)
    for layer, lift, colour in (("lanes", 0.03, _LANE), ("footways", 0.04, GROUND["footways"])):
        polygons = [shapely.Polygon(polygon) for polygon in getattr(site, layer)]
        add_mesh(api, f"/site/{layer}", shapes.draped(site, polygons, lift=lift), colour)
    solids: dict[str, list[Mesh]] = {}
    for solid in site.solids:
        solids.setdefault(solid.kind, []).append(extrude(solid.footprint, solid.base, solid.top))
    for kind, meshes in sorted(solids.items()):
        add_mesh(api, f"/site/{kind}", merge(meshes), _SHADES.get(kind, OTHER_SOLID))
    for name, radius, colour, mounts in (
        ("free poles", 0.06, _FREE_POLE, [m for m in site.mounts if m.name not in used]),
        ("poles in use", 0.12, POLE_INK, [m for m in site.mounts if m.name in used]),
    ):
        tubes = [tube(np.stack([m.position, m.position + np.array([0.0, 0, m.max_height])]), radius) for m in mounts]
        add_mesh(api, f"/site/{name}", merge(tubes), colour)


def _add_sensor(api: SceneApi, site: Site, sensor: PlannedSensor, index: int, *, seen: Mesh | None) -> Layer:
    colour, node = sensor_colour(index), f"/sensors/{index}"
    api.add_frame(node, show_axes=False)
    foot = float(site.ground(np.array([sensor.x, sensor.y])))
    pole = tube(np.array([[sensor.x, sensor.y, foot], [sensor.x, sensor.y, sensor.z + 0.3]]), 0.1)
    add_mesh(api, f"{node}/pole", pole, POLE_INK)
    add_mesh(api, f"{node}/housing", box((0.7, 0.7, 0.5), (sensor.x, sensor.y, sensor.z)), colour)
    where = (sensor.x, sensor.y, sensor.z + 1.2)
    api.add_label(f"{node}/label", sensor.name, position=where, font_screen_scale=1.3, anchor="bottom-center")
    if seen is not None:
        add_mesh(api, f"{node}/ground", seen, colour, opacity=0.28)
    return Layer(sensor.name, node, colour, "points, field of view and visible ground")


def _add_views(api: SceneApi, site: Site, planned: Sequence[PlannedSensor]) -> None:
    """Edges of the fields of view of those planned sensors that the site has."""
    hanging: dict[str, Sensor] = {sensor.name: sensor for sensor in site.sensors}
    found = [(index, hanging[each.name]) for index, each in enumerate(planned) if each.name in hanging]
    if not found:
        return
    renderer = Renderer(site, (), [sensor for _, sensor in found])
    for (index, sensor), background in zip(found, renderer.background, strict=True):
        edges = shapes.view_edges(sensor, background)
        add_lines(api, f"/sensors/{index}/view", edges, sensor_colour(index), width=1.5, visible=True)


def _add_clouds(api: SceneApi, moments: Sequence[Moment], sensors: int) -> None:
    most = MOST_DRAWN // max(sum(len(moment.clouds) for moment in moments), 1)
    for frame, moment in enumerate(moments):
        for index, points in enumerate(moment.clouds[:sensors]):
            api.add_point_cloud(
                f"/sensors/{index}/points {frame}",
                lines.sampled(points, most),
                rgb(sensor_colour(index)),
                point_size=0.09,
                point_shape="square",
                point_shading="flat",
                visible=frame == 0,
            )


def _add_boxes(api: SceneApi, moments: Sequence[Moment]) -> list[Layer]:
    """Truth and detections, told apart by colour, line and mark."""
    layers = {
        "truth": Layer("Vehicles that were there", "/truth", _TRUTH, "thin solid boxes"),
        "hit": Layer("Detections that hit", "/hit", _HIT, "thick solid boxes"),
        "missed": Layer("Vehicles that were missed", "/missed", _MISSED, "dashed boxes, a cross on the roof"),
        "false": Layer("False alarms", "/false", _FALSE_ALARM, "dotted boxes under a mast"),
    }
    for layer in layers.values():
        api.add_frame(layer.node, show_axes=False)
    for frame, moment in enumerate(moments):
        truth, detections = moment.truth.boxes, moment.detections.boxes
        missed = truth[~moment.truth_hit & ~moment.truth_ignored]
        hit = detections[moment.detection_hit]
        wrong = detections[~moment.detection_hit & ~moment.detection_ignored]
        drawn = (
            ("truth", lines.box_edges(truth), _TRUTH, 1.5),
            ("hit", lines.box_edges(hit), _HIT, 3.0),
            ("missed", _both(lines.dashed(lines.box_edges(missed), dash=0.6, gap=0.4), missed), _MISSED, 3.0),
            ("false", _marked(wrong), _FALSE_ALARM, 3.0),
        )
        for key, segments, colour, width in drawn:
            add_lines(api, f"{layers[key].node}/{frame}", segments, colour, width=width, visible=frame == 0)
    return list(layers.values())


def _both(edges: Float64[np.ndarray, "n 2 3"], missed: Float64[np.ndarray, "m 7"]) -> Float64[np.ndarray, "k 2 3"]:
    return np.concatenate([edges, lines.roof_crosses(missed)])


def _marked(wrong: Float64[np.ndarray, "m 7"]) -> Float64[np.ndarray, "k 2 3"]:
    return np.concatenate([lines.dashed(lines.box_edges(wrong), dash=0.15, gap=0.3), lines.spikes(wrong)])


def _frame_nodes(frame: int, sensors: int) -> tuple[str, ...]:
    """The nodes of one frame that may be in the scene; hiding one that is not does nothing."""
    clouds = [f"/sensors/{index}/points {frame}" for index in range(sensors)]
    return (*clouds, *(f"{kind}/{frame}" for kind in ("/truth", "/hit", "/missed", "/false")))
