"""Nodes of a scene that shows a recording.

Any part of it can be hidden.

    /sensors/K                      a sensor, by its number among all names
    /sensors/K/COLOURING/FRAME      its points in one frame, in the colours of one colouring
    /sensors/K/place/FRAME          its place
    /truth/KIND/FRAME               labelled boxes of one kind
    /detections/KIND/FRAME          detected boxes of one kind
    /hits/KIND/FRAME                true ones; /missed and /false_alarms likewise

A node is seen if it and all nodes above it are visible.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from toolkit.arrays import Float64
from toolkit.mesh import box
from toolkit.plots.palette import FAINT, OUTCOME, sensor_colour
from toolkit.viewing.drawn import (
    BOX_KINDS,
    MARKED,
    Colouring,
    DrawnCloud,
    DrawnSample,
    Marked,
    Scales,
    find_newest,
    shades,
    thinned,
)
from toolkit.viewing.scene import (
    add_lines,
    add_mesh,
    add_points,
    box_edges,
    dashes,
    headings,
    rgb,
    roof_crosses,
    spikes,
)

if TYPE_CHECKING:
    from viser import SceneApi

TRUTH, DETECTION = FAINT, OUTCOME["detection"].colour
BOXES = {"truth": TRUTH, "detections": DETECTION}  # by node
OUTCOME_NODES: dict[Marked, str] = {name: name.replace(" ", "_") for name in MARKED}
SHOWN_AS: dict[Marked, str] = {"hits": "green", "missed": "red with a cross", "false alarms": "violet with a mark"}
SHOWN_POINT_SIZE = 0.07  # m
GRID_NODE = "/grid"
_LEAST_AREA = 20.0  # m: least extent of a scene
_MOST = (10.0, 90.0)  # percentiles of the points that the first view shows
_GRID_COLOUR = "#9aa0a6"
_MARK_WIDTH = 3.0  # of the lines of outcomes, pixels
_WIDTH = {"truth": 1.5, "detections": 2.5}  # of lines, pixels


@dataclass(frozen=True)
class SceneStyle:
    """Selection and style of what is drawn in each frame. sensors: names, in the order of their numbers; most: points
    of a cloud; precision: of their coordinates; float16 is half as large, in steps of 3 cm beyond 32 m."""

    sensors: tuple[str, ...]
    colourings: tuple[Colouring, ...]
    scales: Scales
    most: int
    precision: Literal["float16", "float32"] = "float32"


def list_sensors(samples: Iterable[DrawnSample]) -> tuple[str, ...]:
    """Names of all sensors of some frames. They are in order of appearance."""
    return tuple(dict.fromkeys(cloud.name for sample in samples for cloud in sample.clouds))


def add_groups(api: SceneApi, style: SceneStyle) -> list[Any]:
    """Add the nodes above all others; return their handles. The first colouring is visible."""
    boxes = (*BOXES, *OUTCOME_NODES.values())
    names = [*(f"/{group}" for group in ("sensors", *boxes))]
    names += [f"/{group}/{kind}" for group in boxes for kind in BOX_KINDS]
    made = [api.add_frame(name, show_axes=False) for name in names]
    return made + [handle for number in range(len(style.sensors)) for handle in add_sensor(api, style, number)]


def add_sensor(api: SceneApi, style: SceneStyle, number: int) -> list[Any]:
    """Add the nodes above all nodes of one sensor."""
    made: list[Any] = [api.add_frame(f"/sensors/{number}", show_axes=False)]
    made.append(api.add_frame(f"/sensors/{number}/place", show_axes=False))
    for colouring in style.colourings:
        visible = colouring == style.colourings[0]
        made.append(api.add_frame(f"/sensors/{number}/{colouring}", show_axes=False, visible=visible))
    return made


def add_sample(
    api: SceneApi, sample: DrawnSample, style: SceneStyle, *, frame: int = 0, visible: bool = True
) -> list[Any]:
    """Add one frame below `add_groups`; return the handles."""
    newest = find_newest(sample)
    made: list[Any] = []
    for each in sample.clouds:
        cloud, number = thinned(each, style.most), style.sensors.index(each.name)
        made.append(_add_place(api, cloud, number, frame, visible))
        made += [
            add_points(
                api,
                f"/sensors/{number}/{colouring}/{frame}",
                cloud.points,
                shades(cloud, colouring, style.scales, index=number, newest=newest),
                size=SHOWN_POINT_SIZE,
                visible=visible,
                precision=style.precision,
            )
            for colouring in (style.colourings if len(cloud.points) else ())
        ]
    for group, rows, lines in (("truth", sample.truth, _outline), ("detections", sample.detections, _dashes)):
        for kind, boxes in rows.items():
            node = f"/{group}/{kind}/{frame}"
            handle = add_lines(api, node, lines(boxes), BOXES[group], width=_WIDTH[group], visible=visible)
            made += [] if handle is None else [handle]
    for name, by_kind in sample.outcomes.items():
        for kind, boxes in by_kind.items():
            node, colour = f"/{OUTCOME_NODES[name]}/{kind}/{frame}", OUTCOME[MARKED[name]].colour
            handle = add_lines(api, node, _MARKS[name](boxes), colour, width=_MARK_WIDTH, visible=visible)
            made += [] if handle is None else [handle]
    return made


def nodes_of_kind(kind: str, *, outcomes: bool) -> list[str]:
    """Nodes above all boxes of one kind."""
    return [f"/{group}/{kind}" for group in (*BOXES, *(OUTCOME_NODES.values() if outcomes else ()))]


def _add_place(api: SceneApi, cloud: DrawnCloud, number: int, frame: int, visible: bool) -> Any:
    """Add a housing where the sensor was, and its name."""
    node = f"/sensors/{number}/place/{frame}"
    x, y, z = cloud.place.tolist()
    made = api.add_frame(node, show_axes=False, visible=visible)
    add_mesh(api, f"{node}/housing", box((0.4, 0.4, 0.4), (x, y, z)), sensor_colour(number))
    api.add_label(f"{node}/name", cloud.name, position=(x, y, z + 0.6), anchor="bottom-center")
    return made


def add_grid(api: SceneApi, area: tuple[float, float, float, float]) -> Any:
    """Add a grid of 10 m squares on the ground. It gives the scale."""
    xmin, ymin, xmax, ymax = area
    middle = ((xmin + xmax) / 2, (ymin + ymax) / 2, -0.02)
    width, height = xmax - xmin, ymax - ymin
    return api.add_grid(
        GRID_NODE,
        width=width,
        height=height,
        plane="xy",
        cell_size=10.0,
        section_size=10.0,
        position=middle,
        fade_distance=10.0 * max(width, height),
        cell_color=rgb(_GRID_COLOUR),
        section_color=rgb(_GRID_COLOUR),
    )


def find_view_area(sample: DrawnSample) -> tuple[float, float, float, float]:
    """Area that the first view shows. It is xmin, ymin, xmax, ymax in m, rounded to 10 m. It holds most points of a
    frame and its sensors, or else its boxes."""
    clouds = [cloud.points[:, :2].astype(np.float64) for cloud in sample.clouds if len(cloud.points)]
    near = [np.percentile(xy, percent, axis=0)[None] for xy in clouds for percent in _MOST]
    places = [cloud.place[None, :2] for cloud in sample.clouds] if clouds else []
    boxes = [] if clouds else [rows[:, :2] for rows in (*sample.truth.values(), *sample.detections.values())]
    every = np.concatenate([np.zeros((0, 2)), *near, *places, *boxes])
    low, high = (every.min(axis=0), every.max(axis=0)) if len(every) else (np.zeros(2), np.zeros(2))
    more = np.maximum(_LEAST_AREA - (high - low), 0.0) / 2
    xmin, ymin = (10 * np.floor((low - more) / 10)).tolist()
    xmax, ymax = (10 * np.ceil((high + more) / 10)).tolist()
    return xmin, ymin, xmax, ymax


def _outline(boxes: Float64[np.ndarray, "_ 7"]) -> Float64[np.ndarray, "_ 2 3"]:
    return np.concatenate([box_edges(boxes), headings(boxes)])


def _dashes(boxes: Float64[np.ndarray, "_ 7"]) -> Float64[np.ndarray, "_ 2 3"]:
    return np.concatenate([dashes(box_edges(boxes), dash=0.4, gap=0.2), headings(boxes)])


_MARKS: dict[Marked, Callable[[Float64[np.ndarray, "_ 7"]], Float64[np.ndarray, "_ 2 3"]]] = {
    "hits": box_edges,
    "missed": lambda boxes: np.concatenate([box_edges(boxes), roof_crosses(boxes)]),
    "false alarms": lambda boxes: np.concatenate([box_edges(boxes), spikes(boxes)]),
}
