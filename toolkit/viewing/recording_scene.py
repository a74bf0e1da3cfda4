"""Scene of recorded frames in 3D: nodes that can each be hidden.

    /sensors/K                      a sensor, by its number among all names
    /sensors/K/COLOURING/FRAME      its points in one frame, in the colours of one colouring
    /sensors/K/place/FRAME          its place
    /truth/KIND/FRAME               labelled boxes of one kind
    /detections/KIND/FRAME          detected boxes of one kind
    /hits/KIND/FRAME                true ones; /missed, /false_alarms and /ignored likewise
    /trails/KIND/FRAME              where tracks were, if there are tracks
    /tags/KIND/FRAME-K              class, number of the track and score of a box

A node is seen if it and all nodes above it are visible."""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np

from toolkit.plots.palette import FAINT, OUTCOME, sensor_colour
from toolkit.viewing import drawn, scene, scene_parts
from toolkit.viewing.box_lines import headings, roof_crosses, spikes
from toolkit.viewing.box_styles import BoxStyle, DashPattern, add_boxes
from toolkit.viewing.colouring import Colouring, Scales, colour_points
from toolkit.viewing.drawn import BOX_KINDS, DrawnSample
from toolkit.viewing.outcomes import MARKED, Marked
from toolkit.viewing.sensor_parts import add_housing

if TYPE_CHECKING:
    from viser import SceneApi

# name of the node above the boxes of an outcome
OUTCOME_NODES: dict[Marked, str] = {name: name.replace(" ", "_") for name in MARKED}
TAGS = "tags"
TRAILS = "trails"
TRAIL_WIDTH_PX = 2.0
SHOWN_POINT_SIZE = 0.07  # m
_HOUSING_SIZE_M = (0.4, 0.4, 0.4)  # along x, y and z
_LABEL_RISE_M = 0.6  # height of a name above its sensor
GRID_NODE = "/grid"
_MIN_AREA_M = 20.0  # extent of a scene
_VIEW_PERCENTILES = (10.0, 90.0)  # percentiles of the points that the first view shows
_GRID_COLOUR = "#9aa0a6"
_DASHED = DashPattern(dash=0.4, gap=0.2)
_DOTTED = DashPattern(dash=0.15, gap=0.25)
# style of boxes by the node above them
_STYLES = {
    "truth": BoxStyle(FAINT, width=1.5, mark=headings),
    "detections": BoxStyle(OUTCOME["detection"].colour, 2.5, dashes=_DASHED, mark=headings),
    "hits": BoxStyle(OUTCOME["hit"].colour, width=3.0),
    "missed": BoxStyle(OUTCOME["missed"].colour, width=3.0, mark=roof_crosses),
    "false_alarms": BoxStyle(OUTCOME["false alarm"].colour, width=3.0, mark=spikes),
    "ignored": BoxStyle(OUTCOME["not scored"].colour, width=2.0, dashes=_DOTTED),
}
BOXES = {node: _STYLES[node].colour for node in ("truth", "detections")}  # colour by node


@dataclass(frozen=True)
class SceneStyle:
    """Selection and style of what is drawn in each frame.

    Attributes:
        sensors: names of all sensors; a sensor's number, which gives its node and colour, is its
            index here.
        colourings: colourings in which points are added; only the first is visible.
        scales: ranges of values that the colours span.
        max_points: maximum number of points of a cloud.
        precision: type of coordinates; float16 is half as large, in steps of 3 cm beyond 32 m.
        has_trails: whether there are tracks with trails.
    """

    sensors: tuple[str, ...]
    colourings: tuple[Colouring, ...]
    scales: Scales
    max_points: int
    precision: Literal["float16", "float32"] = "float32"
    has_trails: bool = False


def list_sensors(samples: Iterable[DrawnSample]) -> tuple[str, ...]:
    """Names of the sensors of some frames, each once, in the order in which they appear."""
    return tuple(dict.fromkeys(cloud.name for sample in samples for cloud in sample.clouds))


def add_groups(api: "SceneApi", style: SceneStyle) -> list[scene.Handle]:
    """Add the empty nodes above all others (sensors, groups and kinds of boxes).

    Returns a handle for each, with which its part of the scene is shown or hidden."""
    groups = [*_STYLES, TAGS]  # names of nodes such as "truth", "hits" and "tags"
    if style.has_trails:
        groups.append(TRAILS)
    nodes = ["/sensors", *(f"/{group}" for group in groups)]
    nodes += [f"/{group}/{kind}" for group in groups for kind in BOX_KINDS]
    handles: list[scene.Handle] = [scene_parts.add_group(api, node) for node in nodes]
    for sensor_index in range(len(style.sensors)):
        handles += add_sensor(api, style, sensor_index)
    return handles


def add_sensor(api: "SceneApi", style: SceneStyle, sensor_index: int) -> list[scene.Handle]:
    """Add the empty nodes above all nodes of one sensor, and return their handles.

    sensor_index: index of the sensor in the style. Only the first colouring is visible."""
    node = f"/sensors/{sensor_index}"
    handles: list[scene.Handle] = [
        scene_parts.add_group(api, path) for path in (node, f"{node}/place")
    ]
    for colouring in style.colourings:
        is_first = colouring == style.colourings[0]
        handles.append(scene_parts.add_group(api, f"{node}/{colouring}", visible=is_first))
    return handles


def add_sample(
    api: "SceneApi", sample: DrawnSample, style: SceneStyle, *, frame: int = 0, visible: bool = True
) -> list[scene.Handle]:
    """Add one frame to a scene that has the nodes of `add_groups`.

    frame: number of the frame, the last part of its nodes' names; visible: whether the nodes are
    seen at first. Returns the handles of all its nodes."""
    newest_time = drawn.find_newest(sample)
    handles: list[scene.Handle] = []
    for sample_cloud in sample.clouds:
        sensor_index = style.sensors.index(sample_cloud.name)
        place_node = f"/sensors/{sensor_index}/place/{frame}"
        handles.append(
            _add_place(api, sample_cloud, place_node, sensor_index=sensor_index, visible=visible)
        )
        cloud = drawn.limit_points(sample_cloud, style.max_points)
        if not len(cloud.points):
            continue
        for colouring in style.colourings:
            colours = colour_points(
                cloud, colouring, style.scales, sensor_index=sensor_index, newest_time=newest_time
            )
            handle = scene_parts.add_points(
                api,
                name=f"/sensors/{sensor_index}/{colouring}/{frame}",
                points=cloud.points,
                colour=colours,
                size=SHOWN_POINT_SIZE,
                visible=visible,
                precision=style.precision,
            )
            handles.append(handle)
    for tag_index, tag in enumerate(sample.tags):
        node = f"/{TAGS}/{tag.kind}/{frame}-{tag_index}"
        handles.append(scene_parts.add_label(api, node, tag.text, tag.place, visible=visible))
    for kind, segments in sample.trails.items():
        node = f"/{TRAILS}/{kind}/{frame}"
        trail = scene_parts.add_lines(
            api, node, segments, BOXES["detections"], width=TRAIL_WIDTH_PX, visible=visible
        )
        if trail is not None:  # None without segments
            handles.append(trail)
    return handles + _add_boxes(api, sample, frame=frame, visible=visible)


def _add_place(
    api: "SceneApi", cloud: drawn.DrawnCloud, node: str, *, sensor_index: int, visible: bool
) -> scene.Handle:
    """Add the housing and the name of a sensor, and return the handle of the node above both.

    node: path of this node; sensor_index: gives the sensor's colour; visible: whether the node is
    seen at first."""
    x, y, z = cloud.place.tolist()
    handle = scene_parts.add_group(api, node, visible=visible)
    add_housing(
        api,
        f"{node}/housing",
        position=(x, y, z),
        size=_HOUSING_SIZE_M,
        colour=sensor_colour(sensor_index),
    )
    scene_parts.add_label(api, f"{node}/name", cloud.name, (x, y, z + _LABEL_RISE_M))
    return handle


def _add_boxes(
    api: "SceneApi", sample: DrawnSample, *, frame: int, visible: bool
) -> list[scene.Handle]:
    """Add labelled boxes, and outcomes or, if unknown, detections; return the handles.

    frame: number of the frame, the last part of the nodes' names; visible: whether the nodes are
    seen at first."""
    # name of the node above, and boxes by the name of their class
    groups = [("truth", sample.truth)]
    if not sample.outcomes:
        groups.append(("detections", sample.detections))
    for name, boxes_by_kind in sample.outcomes.items():
        groups.append((OUTCOME_NODES[name], boxes_by_kind))
    handles = []
    for group, boxes_by_kind in groups:
        for kind, boxes in boxes_by_kind.items():
            node = f"/{group}/{kind}/{frame}"
            handle = add_boxes(api, name=node, boxes=boxes, style=_STYLES[group], visible=visible)
            if handle is not None:  # None without boxes
                handles.append(handle)
    return handles


def nodes_of_kind(kind: str, *, with_outcomes: bool, with_trails: bool = False) -> list[str]:
    """Paths of the nodes of one kind, such as "/truth/KIND"; hiding them hides all that is below.

    Below them are the boxes and tags of that kind in all frames, and its trails if wanted.

    kind: one of `BOX_KINDS`; with_outcomes: whether to include the nodes of outcomes, besides
    labels and detections; with_trails: whether to include the node of trails."""
    # `BOXES`: groups of labels and detections; `_STYLES` has a key for these and each outcome
    groups = [*(_STYLES if with_outcomes else BOXES), TAGS]
    if with_trails:
        groups.append(TRAILS)
    return [f"/{group}/{kind}" for group in groups]


def add_grid(api: "SceneApi", area: tuple[float, float, float, float]) -> scene.Handle:
    """Add a grid of 10 m squares on the ground, for scale; area: xmin, ymin, xmax, ymax (m)."""
    xmin, ymin, xmax, ymax = area
    colours = scene.Look(cell_color=scene.rgb(_GRID_COLOUR), section_color=scene.rgb(_GRID_COLOUR))
    sizes = scene.Look(width=xmax - xmin, height=ymax - ymin, cell_size=10.0, section_size=10.0)
    middle = ((xmin + xmax) / 2, (ymin + ymax) / 2, -0.02)  # 2 cm below points on the ground
    fade_distance = 10.0 * max(xmax - xmin, ymax - ymin)
    return api.add_grid(
        GRID_NODE, plane="xy", position=middle, fade_distance=fade_distance, **sizes, **colours
    )


def find_view_area(sample: DrawnSample) -> tuple[float, float, float, float]:
    """Area of most points of a frame and its sensors, or of its boxes without points.

    Returns xmin, ymin, xmax, ymax (m), extended to multiples of 10 m; each side is at least 20
    m."""
    # arrays of places that the area must hold; rows are x, y (m)
    places = [np.zeros((0, 2))]
    for cloud in sample.clouds:
        if len(cloud.points):
            xy = cloud.points[:, :2].astype(np.float64)
            # two corners that hold most points
            places.append(np.percentile(xy, _VIEW_PERCENTILES, axis=0))
    has_points = len(places) > 1
    if has_points:
        places += [cloud.place[None, :2] for cloud in sample.clouds]
    else:
        box_arrays = (*sample.truth.values(), *sample.detections.values())
        places += [boxes[:, :2] for boxes in box_arrays]
    all_places = np.concatenate(places)
    lower_corner = all_places.min(axis=0) if len(all_places) else np.zeros(2)
    upper_corner = all_places.max(axis=0) if len(all_places) else np.zeros(2)
    # added on each side, so that the extent along x and y is large enough
    margins = np.maximum(_MIN_AREA_M - (upper_corner - lower_corner), 0.0) / 2
    xmin, ymin = (10 * np.floor((lower_corner - margins) / 10)).tolist()
    xmax, ymax = (10 * np.ceil((upper_corner + margins) / 10)).tolist()
    return xmin, ymin, xmax, ymax
