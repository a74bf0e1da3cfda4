"""A recording in 3D, live in the browser or as a page: nodes of its scene, of which any part can be
hidden.

    /sensors/K                      a sensor, by its number among all names
    /sensors/K/COLOURING/FRAME      its points in one frame, in the colours of one colouring
    /sensors/K/place/FRAME          its place
    /truth/KIND/FRAME               labelled boxes of one kind
    /detections/KIND/FRAME          detected boxes of one kind
    /hits/KIND/FRAME                true ones; /missed, /false_alarms and /ignored likewise
    /tags/KIND/FRAME-K              class and score of a box

A node is seen if it and all nodes above it are visible.

The page is one file of HTML that works from disk, without server or network: frames, switches and
the scene. The scene holds every frame as nodes of their own; the page shows one at a time and plays
them. Points are stored once, whatever they are coloured by, and thinned to what a page can hold.

The live view reads the recording while it is shown, with a slider for frames and switches."""

import secrets
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from threading import Lock
from typing import TYPE_CHECKING, Literal

import numpy as np

from toolkit.arrays import BoxRows
from toolkit.datasets.recordings import Part
from toolkit.mesh import box
from toolkit.plots.canvas import FAINT, OUTCOME, sensor_colour
from toolkit.runtime.files import write_text
from toolkit.viewing import drawn as drawings, scene
from toolkit.viewing.drawn import (
    BOX_KINDS,
    COLOURINGS,
    MARKED,
    Colouring,
    Drawing,
    DrawnSample,
    Marked,
    Scales,
    list_colourings,
)

if TYPE_CHECKING:
    from viser import SceneApi, ViserServer

BOXES = {"truth": FAINT, "detections": OUTCOME["detection"].colour}  # colour by node
OUTCOME_NODES: dict[Marked, str] = {name: name.replace(" ", "_") for name in MARKED}
_LOOKS = "green", "red with a cross", "violet with a mark", "grey, dotted"
SHOWN_AS: dict[Marked, str] = dict(zip(MARKED, _LOOKS, strict=True))
TAGS = "tags"
TAGS_NAME = "class and score"
SHOWN_POINT_SIZE = 0.07  # m
GRID_NODE = "/grid"
_LEAST_AREA = 20.0  # m: least extent of a scene
_MOST = (10.0, 90.0)  # percentiles of the points that the first view shows
_GRID_COLOUR = "#9aa0a6"
_LINES: dict[
    str, tuple[float, Callable[[BoxRows], list[scene.Segments]]]
] = {  # width (pixels), by node
    "truth": (1.5, lambda boxes: [scene.box_edges(boxes), scene.headings(boxes)]),
    "detections": (
        2.5,
        lambda boxes: [
            scene.dashes(scene.box_edges(boxes), dash=0.4, gap=0.2),
            scene.headings(boxes),
        ],
    ),
    "hits": (3.0, lambda boxes: [scene.box_edges(boxes)]),
    "missed": (3.0, lambda boxes: [scene.box_edges(boxes), scene.roof_crosses(boxes)]),
    "false_alarms": (3.0, lambda boxes: [scene.box_edges(boxes), scene.spikes(boxes)]),
    "ignored": (2.0, lambda boxes: [scene.dashes(scene.box_edges(boxes), dash=0.15, gap=0.25)]),
}


@dataclass(frozen=True)
class SceneStyle:
    """Selection and style of what is drawn in each frame. sensors: names, in the order of their
    numbers; most: points of a cloud; precision: of their coordinates; float16 is half as large, in
    steps of 3 cm beyond 32 m."""

    sensors: tuple[str, ...]
    colourings: tuple[Colouring, ...]
    scales: Scales
    most: int
    precision: Literal["float16", "float32"] = "float32"


def list_sensors(samples: Iterable[DrawnSample]) -> tuple[str, ...]:
    """Names of all sensors of some frames."""
    return tuple(dict.fromkeys(cloud.name for sample in samples for cloud in sample.clouds))


def add_groups(api: "SceneApi", style: SceneStyle) -> list[scene.Handle]:
    """Add the nodes above all others; return their handles."""
    groups = (*_LINES, TAGS)
    names = ["/sensors", *(f"/{group}" for group in groups)]
    names += [f"/{group}/{kind}" for group in groups for kind in BOX_KINDS]
    handles = [api.add_frame(name, show_axes=False) for name in names]
    return handles + [
        handle for number in range(len(style.sensors)) for handle in add_sensor(api, style, number)
    ]


def add_sensor(api: "SceneApi", style: SceneStyle, number: int) -> list[scene.Handle]:
    """Add the nodes above all nodes of one sensor."""
    nodes = {f"/sensors/{number}": True, f"/sensors/{number}/place": True}
    nodes |= {
        f"/sensors/{number}/{colouring}": colouring == style.colourings[0]
        for colouring in style.colourings
    }
    return [
        api.add_frame(node, show_axes=False, visible=visible) for node, visible in nodes.items()
    ]


def add_sample(
    api: "SceneApi", sample: DrawnSample, style: SceneStyle, *, frame: int = 0, visible: bool = True
) -> list[scene.Handle]:
    """Add one frame below `add_groups`; return the handles."""
    newest = drawings.find_newest(sample)
    handles: list[scene.Handle] = []
    for drawn_cloud in sample.clouds:
        cloud = drawings.thinned(drawn_cloud, style.most)
        number = style.sensors.index(drawn_cloud.name)
        node_of_place, (x, y, z) = f"/sensors/{number}/place/{frame}", cloud.place.tolist()
        handles.append(api.add_frame(node_of_place, show_axes=False, visible=visible))
        scene.add_mesh(
            api, f"{node_of_place}/housing", box((0.4, 0.4, 0.4), (x, y, z)), sensor_colour(number)
        )
        api.add_label(
            f"{node_of_place}/name", cloud.name, position=(x, y, z + 0.6), anchor="bottom-center"
        )
        for colouring in style.colourings if len(cloud.points) else ():
            colours = drawings.shades(cloud, colouring, style.scales, index=number, newest=newest)
            node = f"/sensors/{number}/{colouring}/{frame}"
            look = scene.Look(size=SHOWN_POINT_SIZE, visible=visible)
            handles.append(
                scene.add_points(
                    api, node, cloud.points, colours, precision=style.precision, **look
                )
            )
    for number, tag in enumerate(sample.tags):
        node = f"/{TAGS}/{tag.kind}/{frame}-{number}"
        handles.append(
            api.add_label(
                node, tag.text, position=tag.place, anchor="bottom-center", visible=visible
            )
        )
    groups = [("truth", BOXES["truth"], sample.truth)]
    groups += [] if sample.outcomes else [("detections", BOXES["detections"], sample.detections)]
    groups += [
        (OUTCOME_NODES[name], OUTCOME[MARKED[name]].colour, boxes)
        for name, boxes in sample.outcomes.items()
    ]
    for group, colour, by_kind in groups:
        width, lines = _LINES[group]
        for kind, boxes in by_kind.items():
            segments = np.concatenate(lines(boxes))
            node = f"/{group}/{kind}/{frame}"
            handle = scene.add_lines(api, node, segments, colour, width=width, visible=visible)
            handles += [] if handle is None else [handle]
    return handles


def nodes_of_kind(kind: str, *, outcomes: bool) -> list[str]:
    """Nodes above all boxes of one kind."""
    return [f"/{group}/{kind}" for group in ((*_LINES, TAGS) if outcomes else (*BOXES, TAGS))]


def add_grid(api: "SceneApi", area: tuple[float, float, float, float]) -> scene.Handle:
    """Add a grid of 10 m squares on the ground, for scale."""
    xmin, ymin, xmax, ymax = area
    colours = scene.Look(cell_color=scene.rgb(_GRID_COLOUR), section_color=scene.rgb(_GRID_COLOUR))
    sizes = scene.Look(width=xmax - xmin, height=ymax - ymin, cell_size=10.0, section_size=10.0)
    middle = ((xmin + xmax) / 2, (ymin + ymax) / 2, -0.02)
    far = 10.0 * max(xmax - xmin, ymax - ymin)
    return api.add_grid(
        GRID_NODE, plane="xy", position=middle, fade_distance=far, **sizes, **colours
    )


def find_view_area(sample: DrawnSample) -> tuple[float, float, float, float]:
    """Area (xmin, ymin, xmax, ymax, rounded to 10 m) of most points of a frame and its sensors, or
    else its boxes."""
    clouds = [
        cloud.points[:, :2].astype(np.float64) for cloud in sample.clouds if len(cloud.points)
    ]
    near = [np.percentile(xy, percent, axis=0)[None] for xy in clouds for percent in _MOST]
    places = [cloud.place[None, :2] for cloud in sample.clouds] if clouds else []
    boxes = (
        []
        if clouds
        else [rows[:, :2] for rows in (*sample.truth.values(), *sample.detections.values())]
    )
    points = np.concatenate([np.zeros((0, 2)), *near, *places, *boxes])
    low, high = (
        (points.min(axis=0), points.max(axis=0)) if len(points) else (np.zeros(2), np.zeros(2))
    )
    margin = np.maximum(_LEAST_AREA - (high - low), 0.0) / 2
    xmin, ymin = (10 * np.floor((low - margin) / 10)).tolist()
    xmax, ymax = (10 * np.ceil((high + margin) / 10)).tolist()
    return xmin, ymin, xmax, ymax


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
    return scene.render_page(Path(__file__).parent / "page.html.j2", data, content=content)


def write_page(samples: Sequence[DrawnSample], title: str, out: str | Path) -> PageContent:
    """Write frames as a page, whole or not at all; return its contents. The same frames give the
    same bytes."""
    content = page_content(samples, title)
    write_text(out, page_html(content))
    return content


LIVE_POINTS = 400_000  # of one cloud
PORT = 8080  # unless it is taken


class LiveView:
    """Scene of one frame at a time, served by viser. It has controls. said: the line below the
    slider, with the frame's contents or the reason why it cannot be shown. Raises the errors of
    reading the first frame."""

    def __init__(self, server: "ViserServer", samples: Part, drawing: Drawing) -> None:
        self.server = server
        self.samples = samples
        self.drawing = drawing
        self.said = ""
        self._lock = Lock()
        self.colouring: Colouring = COLOURINGS[0]
        self._drawn: DrawnSample | None = None
        first = samples[0]
        self.origin = drawing.origin(first)
        drawn = drawing.draw(first, self.origin)
        sensors = list_sensors([drawn])
        self.style = SceneStyle(sensors, COLOURINGS, Scales.of(drawn), LIVE_POINTS)
        area = find_view_area(drawn)
        groups = [add_grid(server.scene, area), *add_groups(server.scene, self.style)]
        self.groups: dict[str, scene.Handle] = {handle.name: handle for handle in groups}
        self.shown: list[scene.Handle] = []
        self.switches: dict[str, scene.Handle] = {}  # of the page, by the part they show
        self._wanted = 0
        scene.set_view(server, *scene.overview(area))
        server.gui.configure_theme(show_share_button=False, show_logo=False)
        self._line = server.gui.add_markdown("")
        if len(samples) > 1:
            self._add_slider()
        names = {
            self.style.scales.describe(colouring): colouring for colouring in self.style.colourings
        }
        choice = server.gui.add_dropdown("Points coloured by", tuple(names))
        choice.on_update(lambda _: self.colour_by(names[choice.value]))
        self.sensor_switches = server.gui.add_folder("Sensors")
        for number, name in enumerate(self.style.sensors):
            self._add_switch(self.sensor_switches, name, [f"/sensors/{number}"])
        boxes = server.gui.add_folder("Boxes")
        for group, how in zip(BOXES, ("truth, solid", "detections, dashed"), strict=True):
            self._add_switch(boxes, how, [f"/{group}"])
        for name, node in OUTCOME_NODES.items() if drawing.detector is not None else ():
            self._add_switch(boxes, f"{name}, {SHOWN_AS[name]}", [f"/{node}"])
        if drawing.detector is not None:
            self._add_switch(boxes, TAGS_NAME, [f"/{TAGS}"])
        for kind in BOX_KINDS:
            self._add_switch(boxes, kind, nodes_of_kind(kind, outcomes=True))
        self._add_switch(boxes, "grid of 10 m", [GRID_NODE])
        self.show(0)

    def show(self, number: int) -> None:
        """Show the frame of this number, or say why not."""
        self._wanted = number
        with self._lock:
            if number != self._wanted:  # the slider has gone on meanwhile
                return
            try:
                drawn = self.drawing.draw(self.samples[number], self.origin)
                parts = [drawn.describe()]
                if any(len(cloud.points) > LIVE_POINTS for cloud in drawn.clouds):
                    parts.append(f"of larger clouds {LIVE_POINTS} points are drawn")
                self._drawn = drawn
                self.said = ". ".join([*parts, *([drawn.warning] if drawn.warning else [])])
            except (ValueError, OSError) as error:
                self._drawn = None
                self.said = f"sample {number} cannot be shown: {error}"
            self._redraw()
            letters = (
                f"\\{letter}" if letter in r"\`*_{}[]()#+-.!|<>~&" else letter
                for letter in self.said
            )
            # Markdown that shows names of any characters literally
            self._line.content = "".join(letters)

    def colour_by(self, colouring: Colouring) -> None:
        """Show points in these colours."""
        with self._lock:
            self.colouring = colouring
            self._redraw()

    def _redraw(self) -> None:
        for handle in self.shown:
            handle.remove()
        self.shown = []
        if self._drawn is not None:
            for name in list_sensors([self._drawn]):
                if name not in self.style.sensors:
                    self._add_sensor(name)
            style = replace(self.style, colourings=(self.colouring,))
            self.shown = add_sample(self.server.scene, self._drawn, style)
        for number in range(len(self.style.sensors)):
            for colouring in self.style.colourings:
                self.groups[f"/sensors/{number}/{colouring}"].visible = colouring == self.colouring

    def _add_sensor(self, name: str) -> None:
        """Add a sensor that earlier frames did not have."""
        number = len(self.style.sensors)
        self.style = replace(self.style, sensors=(*self.style.sensors, name))
        handles = add_sensor(self.server.scene, self.style, number)
        self.groups |= {handle.name: handle for handle in handles}
        self._add_switch(self.sensor_switches, name, [f"/sensors/{number}"])

    def _add_slider(self) -> None:
        slider: scene.Handle = self.server.gui.add_slider("Frame", 0, len(self.samples) - 1, 1, 0)
        self.switches["frame"] = slider
        slider.on_update(lambda _: self.show(int(slider.value)))

        def go_on(_: scene.Handle) -> None:
            slider.value = (int(slider.value) + 1) % len(self.samples)

        self.server.gui.add_button("Next frame").on_click(go_on)

    def _add_switch(self, folder: scene.Handle, name: str, nodes: list[str]) -> None:
        with folder:
            switch = self.server.gui.add_checkbox(name, True)
        self.switches[name] = switch

        def apply(_: scene.Handle) -> None:
            for node in nodes:
                self.groups[node].visible = bool(switch.value)

        switch.on_update(apply)


def view_live(
    samples: Part, drawing: Drawing, *, port: int = PORT, ready: Callable[[str], None] = print
) -> None:
    """Serve a recording to browsers of this machine. It runs until the process is interrupted.
    ready: called with the address. Raises ImportError without viser, ValueError for an invalid
    port, and the errors of reading the first frame."""
    if not 1 <= port < 2**16:
        raise ValueError(f"port must lie in 1..65535, got {port}: leave it out for {PORT}")
    token = secrets.token_urlsafe(16)
    with scene.viser_server(port, token) as server:
        LiveView(server, samples, drawing)
        ready(f"http://127.0.0.1:{server.get_port()}/{token}/")
        with suppress(KeyboardInterrupt):
            server.sleep_forever()
