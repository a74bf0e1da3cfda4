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
        status_text: text above the controls: the frame's contents, or the reason why it cannot be
            shown.
        colouring: current colouring of points.
        origin: x, y, z (m, world) of the origin of all drawings, from the first frame.
        style: sensors so far, colourings and their ranges, the latter from the first frame.
        groups: handles of the nodes above all others, by path.
        shown: handles of the current frame's nodes, removed before another frame is added.
        switches: controls of the page, by the part that they show; the slider is "frame".
        sensor_switches: folder of the sensors' switches.
    """

    def __init__(self, server: "ViserServer", samples: Part, drawing: Drawing) -> None:
        """Fill the page's panel, and show the first frame.

        server: viser's server of the page; samples: frames of the recording; drawing: how they are
        drawn."""
        self.server = server
        self.samples = samples
        self.drawing = drawing
        self.status_text = ""
        self._lock = Lock()
        self.colouring: Colouring = COLOURINGS[0]
        self._drawn_sample: DrawnSample | None = None  # None if the frame cannot be shown
        first_frame = samples[0]
        self.origin = drawing.find_origin(first_frame)
        first_drawn = drawing.draw(first_frame, self.origin)
        self.style = SceneStyle(
            sensors=list_sensors([first_drawn]),
            colourings=COLOURINGS,
            scales=Scales.from_sample(first_drawn),
            max_points=LIVE_POINTS,
            has_trails=drawing.tracks is not None,
        )
        area = find_view_area(first_drawn)
        group_handles = [add_grid(server.scene, area), *add_groups(server.scene, self.style)]
        self.groups: dict[str, scene.Handle] = {handle.name: handle for handle in group_handles}
        self.shown: list[scene.Handle] = []
        self.switches: dict[str, scene.Handle] = {}  # by the part that they show
        self._wanted_frame = 0  # index of the frame that was asked for last
        scene.show_area(server, area)
        server.gui.configure_theme(show_share_button=False, show_logo=False)
        self._status_line = server.gui.add_markdown("")
        if len(samples) > 1:
            self._add_slider()
        self._add_colouring_choice()
        self.sensor_switches = server.gui.add_folder("Sensors")
        for sensor_index, name in enumerate(self.style.sensors):
            self._add_switch(self.sensor_switches, name, [f"/sensors/{sensor_index}"])
        self._add_box_switches()
        self.show(0)

    def show(self, frame: int) -> None:
        """Show a frame, or the reason why it cannot be shown.

        frame: its index. Calls from several threads wait for each other; a call that is outdated
        when its turn comes does nothing."""
        self._wanted_frame = frame
        with self._lock:
            if frame != self._wanted_frame:  # the slider has gone on meanwhile
                return
            try:
                drawn_sample = self.drawing.draw(self.samples[frame], self.origin)
                sentences = [drawn_sample.describe()]
                if any(len(cloud.points) > LIVE_POINTS for cloud in drawn_sample.clouds):
                    sentences.append(f"of larger clouds {LIVE_POINTS} points are drawn")
                if drawn_sample.warning:
                    sentences.append(drawn_sample.warning)
                self._drawn_sample = drawn_sample
                self.status_text = ". ".join(sentences)
            except (ValueError, OSError) as error:
                self._drawn_sample = None
                self.status_text = f"sample {frame} cannot be shown: {error}"
            self._redraw()
            self._status_line.content = escape_markdown(self.status_text)

    def colour_by(self, colouring: Colouring) -> None:
        """Colour the points of the shown frame, and of later ones, by another attribute."""
        with self._lock:
            self.colouring = colouring
            self._redraw()

    def _redraw(self) -> None:
        """Replace the nodes of the previous frame by the current one's, in the current colouring.

        A frame that cannot be shown gets none. New sensors get nodes and switches first."""
        for handle in self.shown:
            handle.remove()
        self.shown = []
        if self._drawn_sample is not None:
            for name in list_sensors([self._drawn_sample]):
                if name not in self.style.sensors:
                    self._add_sensor(name)
            style = replace(self.style, colourings=(self.colouring,))
            self.shown = add_sample(self.server.scene, self._drawn_sample, style)
        # nodes above the points of one sensor in one colouring
        for sensor_index in range(len(self.style.sensors)):
            for colouring in self.style.colourings:
                group = self.groups[f"/sensors/{sensor_index}/{colouring}"]
                group.visible = colouring == self.colouring

    def _add_sensor(self, name: str) -> None:
        """Add nodes and a switch for a sensor that earlier frames did not have.

        name: the sensor's; its colour and nodes are numbered after those so far."""
        sensor_index = len(self.style.sensors)
        self.style = replace(self.style, sensors=(*self.style.sensors, name))
        handles = add_sensor(self.server.scene, self.style, sensor_index)
        self.groups |= {handle.name: handle for handle in handles}
        self._add_switch(self.sensor_switches, name, [f"/sensors/{sensor_index}"])

    def _add_colouring_choice(self) -> None:
        """Add a menu of the colourings of points, each with its range of values."""
        colouring_by_text = {
            self.style.scales.describe(colouring): colouring for colouring in self.style.colourings
        }
        menu = self.server.gui.add_dropdown("Points coloured by", tuple(colouring_by_text))
        menu.on_update(lambda _: self.colour_by(colouring_by_text[menu.value]))

    def _add_box_switches(self) -> None:
        """Add switches of labels, detections, outcomes, tags, trails, kinds of boxes, and grid."""
        folder = self.server.gui.add_folder("Boxes")
        for group, text in zip(BOXES, ("truth, solid", "detections, dashed"), strict=True):
            self._add_switch(folder, text, [f"/{group}"])
        if self.drawing.has_detections:
            for name, node in OUTCOME_NODES.items():
                self._add_switch(folder, f"{name}, {SHOWN_AS[name]}", [f"/{node}"])
            self._add_switch(folder, TAGS_NAME, [f"/{TAGS}"])
        if self.style.has_trails:
            self._add_switch(folder, TRAILS, [f"/{TRAILS}"])
        for kind in BOX_KINDS:
            nodes = nodes_of_kind(kind, with_outcomes=True, with_trails=self.style.has_trails)
            self._add_switch(folder, kind, nodes)
        self._add_switch(folder, "grid of 10 m", [GRID_NODE])

    def _add_slider(self) -> None:
        """Add a slider of frames, and a button for the next frame, after the last the first."""
        last_frame = len(self.samples) - 1
        slider: scene.Handle = self.server.gui.add_slider(
            "Frame", min=0, max=last_frame, step=1, initial_value=0
        )
        self.switches["frame"] = slider
        slider.on_update(lambda _: self.show(int(slider.value)))

        def show_next(_: scene.Handle) -> None:
            # the slider shows the frame that its value is set to
            slider.value = (int(slider.value) + 1) % len(self.samples)

        self.server.gui.add_button("Next frame").on_click(show_next)

    def _add_switch(self, folder: scene.Handle, name: str, nodes: list[str]) -> None:
        """Add a checkbox that shows or hides nodes, and register it under its name.

        folder: part of the page for the checkbox; nodes: paths of nodes in the scene."""
        with folder:
            switch = self.server.gui.add_checkbox(name, initial_value=True)
        self.switches[name] = switch

        def apply_switch(_: scene.Handle) -> None:
            for node in nodes:
                self.groups[node].visible = bool(switch.value)

        switch.on_update(apply_switch)


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
