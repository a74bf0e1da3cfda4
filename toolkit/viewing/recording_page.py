"""Page of recorded frames: one file of HTML that works from disk, without server or network.

It holds frames, switches and the scene. The scene has separate nodes for every frame; the page
shows one frame at a time and plays them. Points are stored once, whatever they are coloured by, and
thinned to what a page can hold."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from toolkit.plots.canvas import OUTCOME, sensor_colour
from toolkit.runtime.writing import write_text
from toolkit.viewing import pages, scene
from toolkit.viewing.colouring import Colouring, Scales, list_colourings
from toolkit.viewing.drawn import BOX_KINDS, DrawnSample
from toolkit.viewing.outcomes import MARKED
from toolkit.viewing.recording_scene import (
    BOXES,
    GRID_NODE,
    OUTCOME_NODES,
    TAGS,
    SceneStyle,
    add_grid,
    add_groups,
    add_sample,
    find_view_area,
    list_sensors,
    nodes_of_kind,
)

TAGS_NAME = "class and score"
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
    """Contents of a page: a switch for each part, one of `colourings` at a time, and frames by
    their nodes with a line of text each. points: number of all points; drawn: number of those on
    the page."""

    title: str
    html: str
    switches: tuple[Switch, ...]
    colourings: tuple[Switch, ...]
    frames: tuple[tuple[str, ...], ...]
    names: tuple[str, ...]
    points: int
    drawn: int


def page_content(
    samples: Sequence[DrawnSample], title: str, *, max_points: int = PAGE_POINTS
) -> PageContent:
    """Contents of a page of some frames. max_points: limit on its points. Raises ValueError without
    a frame, ImportError without viser."""
    if not samples:
        raise ValueError("there is no sample to view: check the path and the layout")
    sizes = [len(cloud.points) for sample in samples for cloud in sample.clouds]
    sensors = list_sensors(samples)
    colourings = list_colourings(samples)
    scales = Scales.of(samples[0])
    style = SceneStyle(
        sensors, colourings, scales, max(max_points // max(len(sizes), 1), 1), "float16"
    )
    area = find_view_area(samples[0])
    nodes: list[tuple[str, ...]] = []
    with scene.viser_server() as server:
        add_grid(server.scene, area)
        add_groups(server.scene, style)
        for frame, sample in enumerate(samples):
            handles = add_sample(server.scene, sample, style, frame=frame, visible=frame == 0)
            nodes.append(tuple(handle.name for handle in handles))
        scene.set_view(server, *scene.overview(area))
        html = scene.scene_html(server)
    switches = [Switch(name, f"/sensors/{k}", sensor_colour(k)) for k, name in enumerate(sensors)]
    has_outcomes = any(sample.outcomes for sample in samples)
    all_scored = all(sample.outcomes for sample in samples)
    boxes = [name for name in BOXES if name != "detections" or not all_scored]
    switches += [Switch(name, f"/{name}", BOXES[name]) for name in boxes]
    colours = {name: OUTCOME[outcome].colour for name, outcome in MARKED.items() if has_outcomes}
    switches += [
        Switch(name, f"/{OUTCOME_NODES[name]}", colour) for name, colour in colours.items()
    ]
    if any(sample.tags for sample in samples):
        switches.append(Switch(TAGS_NAME, f"/{TAGS}"))
    present_kinds = {kind for sample in samples for kind in (*sample.truth, *sample.detections)}
    kinds = {
        kind: nodes_of_kind(kind, outcomes=has_outcomes)
        for kind in BOX_KINDS
        if kind in present_kinds
    }
    switches += [Switch(kind, " ".join(nodes)) for kind, nodes in kinds.items()]
    points: dict[Colouring, str] = {}
    for colouring in colourings:
        nodes_of_points = (f"/sensors/{number}/{colouring}" for number in range(len(sensors)))
        points[colouring] = " ".join(nodes_of_points)
    return PageContent(
        *(title, html, (*switches, Switch("grid of 10 m", GRID_NODE))),
        tuple(
            Switch(
                scales.describe(colouring), points[colouring], checked=colouring == colourings[0]
            )
            for colouring in colourings
        ),
        *(tuple(nodes), tuple(sample.describe() for sample in samples)),
        *(sum(sizes), sum(min(size, style.most) for size in sizes)),
    )


def page_html(content: PageContent) -> str:
    """The page. Raises ImportError without jinja2."""
    data = {"html": content.html, "frames": content.frames, "names": content.names}
    return pages.render_page(Path(__file__).parent / "page.html.j2", data, content=content)


def write_page(samples: Sequence[DrawnSample], title: str, out: str | Path) -> PageContent:
    """Write frames as a page, whole or not at all; return its contents. The same frames give the
    same bytes."""
    content = page_content(samples, title)
    write_text(out, page_html(content))
    return content
