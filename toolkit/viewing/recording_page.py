"""Page of recorded frames: one file of HTML that works from disk, without server or network.

It holds frames, switches and the scene. The scene has separate nodes for every frame; the page
shows one frame at a time and plays them. Points are stored once, whatever they are coloured by, and
thinned to what a page can hold."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from toolkit.plots.palette import OUTCOME, sensor_colour
from toolkit.runtime.writing import write_text
from toolkit.viewing import pages, scene
from toolkit.viewing.colouring import Scales, list_colourings
from toolkit.viewing.drawn import BOX_KINDS, DrawnSample
from toolkit.viewing.outcomes import MARKED
from toolkit.viewing.recording_scene import (
    BOXES,
    GRID_NODE,
    OUTCOME_NODES,
    TAGS,
    TRAILS,
    SceneStyle,
    add_grid,
    add_groups,
    add_sample,
    find_view_area,
    list_sensors,
    nodes_of_kind,
)

TAGS_NAME = "class and score"
PAGE_FRAMES = 20  # frames of a recording by default
PAGE_POINTS = 600_000  # in all clouds of all frames together


@dataclass(frozen=True)
class Switch:
    """Checkbox with which a reader hides a part of the scene.

    Attributes:
        name: label of the checkbox.
        nodes: paths of the nodes that it shows or hides, separated by spaces.
        colour: #rrggbb next to the label, None without one.
        checked: whether the part is visible at first.
    """

    name: str
    nodes: str
    colour: str | None = None
    checked: bool = True


@dataclass(frozen=True)
class PageContent:
    """Contents of a page.

    Attributes:
        title: title of the page.
        html: the scene, itself a page of HTML for an iframe.
        switches: a switch for each part that can be hidden.
        colourings: switches of the colourings of points; one is on at a time.
        frame_nodes: paths of the nodes of each frame, shown one frame at a time.
        frame_lines: a line of text for each frame.
        point_count: number of points in all clouds of all frames.
        drawn_count: number of points that are on the page after thinning.
    """

    title: str
    html: str
    switches: tuple[Switch, ...]
    colourings: tuple[Switch, ...]
    frame_nodes: tuple[tuple[str, ...], ...]
    frame_lines: tuple[str, ...]
    point_count: int
    drawn_count: int


def page_content(
    samples: Sequence[DrawnSample], title: str, *, max_points: int = PAGE_POINTS
) -> PageContent:
    """Contents of a page that shows some frames, the first one at first.

    max_points: limit on the points of all clouds of all frames, shared evenly by the clouds. Raises
    ValueError without a frame, and ImportError without viser."""
    if not samples:
        raise ValueError("there is no sample to view: check the path and the layout")
    # number of points of each cloud of each frame
    cloud_sizes = [len(cloud.points) for sample in samples for cloud in sample.clouds]
    max_cloud_points = max(max_points // max(len(cloud_sizes), 1), 1)
    style = SceneStyle(
        sensors=list_sensors(samples),
        colourings=list_colourings(samples),
        scales=Scales.from_sample(samples[0]),
        max_points=max_cloud_points,
        precision="float16",
        has_trails=any(sample.trails for sample in samples),
    )
    area = find_view_area(samples[0])
    frame_nodes: list[tuple[str, ...]] = []
    with scene.viser_server() as server:
        add_grid(server.scene, area)
        add_groups(server.scene, style)
        for frame, sample in enumerate(samples):
            handles = add_sample(server.scene, sample, style, frame=frame, visible=frame == 0)
            frame_nodes.append(tuple(handle.name for handle in handles))
        scene.show_area(server, area)
        html = scene.scene_html(server)
    return PageContent(
        title=title,
        html=html,
        switches=tuple(_list_switches(samples, style)),
        colourings=tuple(_list_colour_switches(style)),
        frame_nodes=tuple(frame_nodes),
        frame_lines=tuple(sample.describe() for sample in samples),
        point_count=sum(cloud_sizes),
        drawn_count=sum(min(size, max_cloud_points) for size in cloud_sizes),
    )


def _list_switches(samples: Sequence[DrawnSample], style: SceneStyle) -> list[Switch]:
    """Switches of sensors, boxes, outcomes, tags, trails, kinds of boxes and the grid, in order.

    Outcomes, tags, trails and kinds that no frame has are left out; so are detections if every
    frame shows outcomes, which replace them."""
    switches = []
    for index, name in enumerate(style.sensors):
        switches.append(Switch(name, nodes=f"/sensors/{index}", colour=sensor_colour(index)))
    has_outcomes = any(sample.outcomes for sample in samples)
    all_have_outcomes = all(sample.outcomes for sample in samples)
    for group, colour in BOXES.items():
        if group != "detections" or not all_have_outcomes:
            switches.append(Switch(group, nodes=f"/{group}", colour=colour))
    if has_outcomes:
        # `MARKED` gives the style of each part of the scene that holds one outcome
        for part, outcome in MARKED.items():
            node = f"/{OUTCOME_NODES[part]}"
            switches.append(Switch(part, nodes=node, colour=OUTCOME[outcome].colour))
    if any(sample.tags for sample in samples):
        switches.append(Switch(TAGS_NAME, nodes=f"/{TAGS}"))
    if style.has_trails:
        switches.append(Switch(TRAILS, nodes=f"/{TRAILS}", colour=BOXES["detections"]))
    present_kinds = {kind for sample in samples for kind in (*sample.truth, *sample.detections)}
    for kind in BOX_KINDS:
        if kind in present_kinds:
            nodes = nodes_of_kind(kind, with_outcomes=has_outcomes, with_trails=style.has_trails)
            switches.append(Switch(kind, nodes=" ".join(nodes)))
    return [*switches, Switch("grid of 10 m", nodes=GRID_NODE)]


def _list_colour_switches(style: SceneStyle) -> list[Switch]:
    """Switches of the colourings of points, each for all sensors; only the first is on."""
    switches = []
    for colouring in style.colourings:
        nodes = [f"/sensors/{index}/{colouring}" for index in range(len(style.sensors))]
        is_first = colouring == style.colourings[0]
        name = style.scales.describe(colouring)
        switches.append(Switch(name, nodes=" ".join(nodes), checked=is_first))
    return switches


def page_html(content: PageContent) -> str:
    """Render contents as a page of HTML. Raises ImportError without jinja2."""
    # keys that scene.js reads
    data = {"html": content.html, "frames": content.frame_nodes, "names": content.frame_lines}
    return pages.render_page(Path(__file__).parent / "page.html.j2", data, content=content)


def write_page(samples: Sequence[DrawnSample], title: str, out: str | Path) -> PageContent:
    """Write frames as a page, and return its contents.

    out: file to write, whole or not at all. The same frames give the same bytes."""
    content = page_content(samples, title)
    write_text(out, page_html(content))
    return content
