"""A recording as one page of HTML.

It works from disk, without server or network, and has frames, switches and the scene.

viser's serialised scenes hold every frame as nodes of their own; the page shows one at a time and plays them. Points
are stored once, whatever they are coloured by, and thinned to what a page can hold.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from toolkit.plots.palette import OUTCOME, sensor_colour
from toolkit.runtime.files import write_text
from toolkit.viewing.drawn import BOX_KINDS, MARKED, Colouring, DrawnSample, Scales, list_colourings
from toolkit.viewing.recording_scene import (
    BOXES,
    GRID_NODE,
    OUTCOME_NODES,
    SceneStyle,
    add_grid,
    add_groups,
    add_sample,
    find_view_area,
    list_sensors,
    nodes_of_kind,
)
from toolkit.viewing.scene import overview, render_page, scene_html, set_view, viser_server

PAGE_FRAMES = 20  # of a recording, unless another number is asked for
PAGE_POINTS = 600_000  # of all clouds of all frames together


@dataclass(frozen=True)
class Switch:
    """A part that a reader can hide. It has a name, its nodes separated by spaces, and a colour if it has one."""

    name: str
    nodes: str
    colour: str | None = None
    checked: bool = True


@dataclass(frozen=True)
class PageContent:
    """Contents of a page. It has a switch for each part, one of `colourings` at a time, and frames by their nodes with
    a line of text each. points: number of all points; drawn: number of those on the page."""

    title: str
    html: str
    switches: tuple[Switch, ...]
    colourings: tuple[Switch, ...]
    frames: tuple[tuple[str, ...], ...]
    names: tuple[str, ...]
    points: int
    drawn: int


def page_content(samples: Sequence[DrawnSample], title: str, *, most: int = PAGE_POINTS) -> PageContent:
    """Contents of a page of some frames. most: limit on its points. Raises ValueError without a frame, ImportError
    without viser."""
    if not samples:
        raise ValueError("there is no sample to view: check the path and the layout")
    clouds = sum(len(sample.clouds) for sample in samples)
    scales = Scales.of(samples[0])
    style = SceneStyle(
        list_sensors(samples), list_colourings(samples), scales, max(most // max(clouds, 1), 1), "float16"
    )
    area = find_view_area(samples[0])
    nodes: list[tuple[str, ...]] = []
    with viser_server() as server:
        add_grid(server.scene, area)
        add_groups(server.scene, style)
        for frame, sample in enumerate(samples):
            made = add_sample(server.scene, sample, style, frame=frame, visible=frame == 0)
            nodes.append(tuple(handle.name for handle in made))
        set_view(server, *overview(area))
        html = scene_html(server)
    sizes = [len(cloud.points) for sample in samples for cloud in sample.clouds]
    return PageContent(
        title,
        html,
        _switches(samples, style.sensors),
        tuple(_colouring(each, style) for each in style.colourings),
        tuple(nodes),
        tuple(sample.describe() for sample in samples),
        sum(sizes),
        sum(min(size, style.most) for size in sizes),
    )


def _switches(samples: Sequence[DrawnSample], sensors: Sequence[str]) -> tuple[Switch, ...]:
    """Switches for sensors, truth, detections, outcomes and object kinds. Outcomes have one if they are known, and each
    kind that occurs has one."""
    found = [Switch(name, f"/sensors/{k}", sensor_colour(k)) for k, name in enumerate(sensors)]
    found += [Switch(name, f"/{name}", colour) for name, colour in BOXES.items()]
    known = any(sample.outcomes for sample in samples)
    colours = {name: OUTCOME[outcome].colour for name, outcome in MARKED.items() if known}
    found += [Switch(name, f"/{OUTCOME_NODES[name]}", colour) for name, colour in colours.items()]
    there = {kind for sample in samples for kind in (*sample.truth, *sample.detections)}
    found += [Switch(kind, " ".join(nodes_of_kind(kind, outcomes=known))) for kind in BOX_KINDS if kind in there]
    return (*found, Switch("grid of 10 m", GRID_NODE))


def _colouring(colouring: Colouring, style: SceneStyle) -> Switch:
    nodes = " ".join(f"/sensors/{number}/{colouring}" for number in range(len(style.sensors)))
    return Switch(style.scales.describe(colouring), nodes, checked=colouring == style.colourings[0])


def page_html(content: PageContent) -> str:
    """The page. Raises ImportError without jinja2."""
    data = {"html": content.html, "frames": content.frames, "names": content.names}
    return render_page(Path(__file__).parent / "page.html.j2", data, content=content)


def write_page(samples: Sequence[DrawnSample], title: str, out: str | Path) -> PageContent:
    """Write frames as a page; return its contents. It is written whole or not at all. The same frames give the same
    bytes."""
    content = page_content(samples, title)
    write_text(out, page_html(content))
    return content
