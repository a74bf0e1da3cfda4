"""Live view of a recording, which is read while it is shown, with a slider and switches."""

import secrets
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from threading import Lock
from typing import TYPE_CHECKING

from toolkit.datasets.recording_views import Part
from toolkit.viewing import scene
from toolkit.viewing.colouring import COLOURINGS, Colouring, Scales
from toolkit.viewing.drawing import Drawing
from toolkit.viewing.drawn import BOX_KINDS, DrawnSample
from toolkit.viewing.outcomes import Marked
from toolkit.viewing.recording_page import TAGS_NAME
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
    add_sensor,
    find_view_area,
    list_sensors,
    nodes_of_kind,
)

if TYPE_CHECKING:
    from viser import ViserServer

# looks of outcomes in words
SHOWN_AS: dict[Marked, str] = {
    "hits": "green",
    "missed": "red with a cross",
    "false alarms": "violet with a mark",
    "ignored": "grey, dotted",
}
MARKDOWN_SIGNS = r"\`*_{}[]()#+-.!|<>~&"
LIVE_POINTS = 400_000  # in one cloud
PORT = 8080  # unless it is taken


class LiveView:
    """Scene of one frame at a time, served by viser, with a slider and switches.

    Raises the errors of reading the first frame.

    Attributes:
        server: viser's server.
        samples: frames, each read when it is shown.
        drawing: options for drawing frames.
        said: text above the controls: the frame's contents, or the reason why it cannot be shown.
        colouring: current colouring of points.
        origin: x, y, z (m, world) of the origin of all drawings, from the first frame.
        style: sensors so far, colourings and their ranges, the latter from the first frame.
        groups: handles of the nodes above all others, by path.
        shown: handles of the current frame's nodes, removed before another frame is added.
        switches: controls of the page, by the part that they show; the slider is "frame".
        sensor_switches: folder of the sensors' switches.
    """

    def __init__(self, server: "ViserServer", samples: Part, drawing: Drawing) -> None:
        self.server = server
        self.samples = samples
        self.drawing = drawing
        self.status_text = ""
        self._lock = Lock()
        self.colouring: Colouring = COLOURINGS[0]
        self._drawn: DrawnSample | None = None
        first = samples[0]
        self.origin = drawing.origin(first)
        drawn = drawing.draw(first, self.origin)
        sensors = list_sensors([drawn])
        self.style = SceneStyle(
            sensors,
            COLOURINGS,
            Scales.from_sample(drawn),
            LIVE_POINTS,
            has_trails=drawing.tracks is not None,
        )
        area = find_view_area(drawn)
        groups = [add_grid(server.scene, area), *add_groups(server.scene, self.style)]
        self.groups: dict[str, scene.Handle] = {handle.name: handle for handle in groups}
        self.shown: list[scene.Handle] = []
        self.switches: dict[str, scene.Handle] = {}  # of the page, by the part that they show
        self._wanted = 0
        scene.show_area(server, area)
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
        for name, node in OUTCOME_NODES.items() if drawing.has_detections else ():
            self._add_switch(boxes, f"{name}, {SHOWN_AS[name]}", [f"/{node}"])
        if drawing.has_detections:
            self._add_switch(boxes, TAGS_NAME, [f"/{TAGS}"])
        if self.style.has_trails:
            self._add_switch(boxes, TRAILS, [f"/{TRAILS}"])
        for kind in BOX_KINDS:
            nodes = nodes_of_kind(kind, outcomes=True, trails=self.style.has_trails)
            self._add_switch(boxes, kind, nodes)
        self._add_switch(boxes, "grid of 10 m", [GRID_NODE])
        self.show(0)

    def show(self, number: int) -> None:
        """Show a frame, or the reason why it cannot be shown.

        number: index of the frame. Calls from several threads wait for each other; a call that is
        outdated when its turn comes does nothing."""
        self._wanted = number
        with self._lock:
            if number != self._wanted:  # the slider has gone on meanwhile
                return
            try:
                drawn = self.drawing.draw(self.samples[number], self.origin)
                parts = [drawn.describe()]
                if any(len(cloud.points) > LIVE_POINTS for cloud in drawn.clouds):
                    parts.append(f"of larger clouds {LIVE_POINTS} points are drawn")
                if drawn.warning:
                    parts.append(drawn.warning)
                self._drawn = drawn
                self.status_text = ". ".join(parts)
            except (ValueError, OSError) as error:
                self._drawn = None
                self.status_text = f"sample {number} cannot be shown: {error}"
            self._redraw()
            self._line.content = escape_markdown(self.status_text)

    def colour_by(self, colouring: Colouring) -> None:
        """Colour the points of the shown frame, and of later ones, by another attribute."""
        with self._lock:
            self.colouring = colouring
            self._redraw()

    def _redraw(self) -> None:
        """Replace the nodes of the previous frame by nodes of `_drawn`, in the current colouring.

        Without a drawn frame none are added. New sensors get nodes and switches first."""
        for handle in self.shown:
            handle.remove()
        self.shown = []
        if self._drawn is not None:
            for name in list_sensors([self._drawn]):
                if name not in self.style.sensors:
                    self._add_sensor(name)
            style = replace(self.style, colourings=(self.colouring,))
            self.shown = add_sample(self.server.scene, self._drawn, style)
        # nodes above the points of one sensor in one colouring
        for number in range(len(self.style.sensors)):
            for colouring in self.style.colourings:
                group = self.groups[f"/sensors/{number}/{colouring}"]
                group.visible = colouring == self.colouring

    def _add_sensor(self, name: str) -> None:
        """Add nodes and a switch for a sensor that earlier frames did not have."""
        number = len(self.style.sensors)
        self.style = replace(self.style, sensors=(*self.style.sensors, name))
        handles = add_sensor(self.server.scene, self.style, number)
        self.groups |= {handle.name: handle for handle in handles}
        self._add_switch(self.sensor_switches, name, [f"/sensors/{number}"])

    def _add_slider(self) -> None:
        """Add a slider of frames, and a button for the next frame, after the last the first."""
        last = len(self.samples) - 1
        slider: scene.Handle = self.server.gui.add_slider(
            "Frame", min=0, max=last, step=1, initial_value=0
        )
        self.switches["frame"] = slider
        slider.on_update(lambda _: self.show(int(slider.value)))

        def go_on(_: scene.Handle) -> None:
            slider.value = (int(slider.value) + 1) % len(self.samples)

        self.server.gui.add_button("Next frame").on_click(go_on)

    def _add_switch(self, folder: scene.Handle, name: str, nodes: list[str]) -> None:
        """Add a checkbox that shows or hides nodes, and register it under its name.

        folder: part of the page for the checkbox; nodes: paths of nodes in the scene."""
        with folder:
            switch = self.server.gui.add_checkbox(name, initial_value=True)
        self.switches[name] = switch

        def apply(_: scene.Handle) -> None:
            for node in nodes:
                self.groups[node].visible = bool(switch.value)

        switch.on_update(apply)


def escape_markdown(text: str) -> str:
    """Return Markdown that shows any characters literally."""
    return "".join(f"\\{letter}" if letter in MARKDOWN_SIGNS else letter for letter in text)


def view_live(
    samples: Part, drawing: Drawing, *, port: int = PORT, ready: Callable[[str], None] = print
) -> None:
    """Serve a recording to browsers of this machine until the process is interrupted.

    port: port to listen on, a later one if it is taken; ready: called with the address, which ends
    in a secret token. Raises ImportError without viser, ValueError for an invalid port, and the
    errors of reading the first frame."""
    if not 1 <= port < 2**16:
        raise ValueError(f"port must lie in 1..65535, got {port}: leave it out for {PORT}")
    token = secrets.token_urlsafe(16)  # 16 random bytes as text
    with scene.viser_server(port, token) as server:
        LiveView(server, samples, drawing)
        ready(f"http://127.0.0.1:{server.get_port()}/{token}/")
        with suppress(KeyboardInterrupt):
            server.sleep_forever()
