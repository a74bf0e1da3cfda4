"""A recording as one page of HTML that works from disk, without server or network: frames, switches and the scene. The
scene holds every frame as nodes of their own; the page shows one at a time and plays them. Points are stored once,
whatever they are coloured by, and thinned to what a page can hold."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from toolkit.plots.canvas import OUTCOME, sensor_colour
from toolkit.runtime.files import write_text
from toolkit.viewing import recording_scene
from toolkit.viewing.drawn import BOX_KINDS, MARKED, DrawnSample, Scales, list_colourings
from toolkit.viewing.scene import overview, render_page, scene_html, set_view, viser_server

PAGE_FRAMES = 20  # of a recording, unless another number is asked for
PAGE_POINTS = 600_000  # of all clouds of all frames together


@dataclass(frozen=True)
class Switch:
    """A part that a reader can hide."""

    name: str
    nodes: str
    colour: str | None = None
    checked: bool = True


@dataclass(frozen=True)
class PageContent:
    """Contents of a page: a switch for each part, one of `colourings` at a time, and frames by their nodes with a line
    of text each. points: number of all points; drawn: number of those on the page."""

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
    sizes = [len(cloud.points) for sample in samples for cloud in sample.clouds]
    sensors, colourings, scales = recording_scene.list_sensors(samples), list_colourings(samples), Scales.of(samples[0])
    style = recording_scene.SceneStyle(sensors, colourings, scales, max(most // max(len(sizes), 1), 1), "float16")
    area = recording_scene.find_view_area(samples[0])
    nodes: list[tuple[str, ...]] = []
    with viser_server() as server:
        recording_scene.add_grid(server.scene, area)
        recording_scene.add_groups(server.scene, style)
        for frame, sample in enumerate(samples):
            made = recording_scene.add_sample(server.scene, sample, style, frame=frame, visible=frame == 0)
            nodes.append(tuple(handle.name for handle in made))
        set_view(server, *overview(area))
        html = scene_html(server)
    switches = [Switch(name, f"/sensors/{k}", sensor_colour(k)) for k, name in enumerate(sensors)]
    known = any(sample.outcomes for sample in samples)
    boxes = [name for name in recording_scene.BOXES if name != "detections" or not all(s.outcomes for s in samples)]
    switches += [Switch(name, f"/{name}", recording_scene.BOXES[name]) for name in boxes]
    colours = {name: OUTCOME[outcome].colour for name, outcome in MARKED.items() if known}
    switches += [Switch(name, f"/{recording_scene.OUTCOME_NODES[name]}", colour) for name, colour in colours.items()]
    if any(sample.tags for sample in samples):
        switches.append(Switch(recording_scene.TAGS_NAME, f"/{recording_scene.TAGS}"))
    there = {kind for sample in samples for kind in (*sample.truth, *sample.detections)}
    kinds = {kind: recording_scene.nodes_of_kind(kind, outcomes=known) for kind in BOX_KINDS if kind in there}
    switches += [Switch(kind, " ".join(nodes)) for kind, nodes in kinds.items()]
    points = {each: " ".join(f"/sensors/{number}/{each}" for number in range(len(sensors))) for each in colourings}
    return PageContent(
        *(title, html, (*switches, Switch("grid of 10 m", recording_scene.GRID_NODE))),
        tuple(Switch(scales.describe(each), points[each], checked=each == colourings[0]) for each in colourings),
        *(tuple(nodes), tuple(sample.describe() for sample in samples)),
        *(sum(sizes), sum(min(size, style.most) for size in sizes)),
    )


def page_html(content: PageContent) -> str:
    """The page. Raises ImportError without jinja2."""
    data = {"html": content.html, "frames": content.frames, "names": content.names}
    return render_page(Path(__file__).parent / "page.html.j2", data, content=content)


def write_page(samples: Sequence[DrawnSample], title: str, out: str | Path) -> PageContent:
    """Write frames as a page, whole or not at all; return its contents. The same frames give the same bytes."""
    content = page_content(samples, title)
    write_text(out, page_html(content))
    return content
