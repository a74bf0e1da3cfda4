"""Clicks on the ground of the live planner's scene: new sensors, keep-out areas and pictures."""

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from coview.live_cameras import Spot
from coview.live_context import LiveContext
from coview.live_drawings import AreaDrawing
from placement_env.live.picture import GroundPicture, keep_picture
from toolkit.display import describe_count
from toolkit.viewing.scene import Handle

if TYPE_CHECKING:
    from viser import GuiApi

    from placement_env.live.figures import LiveAnswer


class GroundClicks:
    """Clicks on the ground of a page, and what they are for.

    areas: drawing of the keep-out areas; folder: folder of a picture that is laid under the scene.

    Attributes:
        spots: Spots clicked so far for the present purpose.
    """

    def __init__(self, context: LiveContext, areas: AreaDrawing, folder: Path) -> None:
        self._planner = context.planner
        self._jobs = context.jobs
        self._head = context.head
        self._show = context.show
        self._redraw = context.redraw
        self._areas = areas
        self._folder = folder
        self._awaited: Callable[[Spot], None] | None = None
        self.spots: list[Spot] = []

    def add_controls(self, gui: "GuiApi", model: Handle) -> None:
        """Add the controls of the tab. model: control with the model of new sensors."""
        gui.add_button("Add a sensor at a click").on_click(
            lambda _: self.pick(
                "the foot of its pole", lambda spot: self.add_sensor(spot, model.value)
            )
        )
        gui.add_button("Draw a keep-out area").on_click(
            lambda _: self.pick("its corners, then Close", self.add_corner)
        )
        gui.add_button("Close the area").on_click(lambda _: self._jobs.change(self.close_area))
        gui.add_button("Remove all areas").on_click(
            lambda _: self._jobs.change(self._planner.set_keep_out, ())
        )
        flat = "PNG or JPEG; it lies flat, at the height of the ground under its middle"
        upload = gui.add_upload_button(
            "Lay a picture under it", mime_type="image/png, image/jpeg", hint=flat
        )
        upload.on_upload(
            lambda _: self._jobs.do(
                lambda: self.take_picture(upload.value.name, upload.value.content)
            )
        )
        points = gui.add_text(
            "Two points", "", hint="x y x y of where they belong, or their distance (m)"
        )
        gui.add_button("Place the picture by two points").on_click(
            lambda _: self.pick(
                "two points of the picture", lambda spot: self.place_picture(spot, points.value)
            )
        )
        gui.add_button("Take the picture away").on_click(
            lambda _: self._jobs.do(lambda: self._lay(None))
        )

    def pick(self, what: str, then: Callable[[Spot], None]) -> None:
        """Await clicks. what: for the note; then: follows each."""
        self.spots = []
        self._awaited = then
        self._head.say(f"click on the ground: {what}")
        self._jobs.do(self._head.show_note)

    def follow(self, event: Handle) -> None:
        """Follow a click on the ground if one is awaited."""
        eye = np.array(event.ray_origin)
        ray = np.array(event.ray_direction)
        then = self._awaited
        if then is not None and ray[2] < -1e-6:
            look_at = np.array(event.client.camera.look_at)[:2]
            level = float(self._planner.yard.site.ground(look_at))
            spot = eye + ray * (level - eye[2]) / ray[2]
            self._jobs.do(lambda: then(spot))

    def add_sensor(self, spot: Spot, model: str) -> None:
        """Add a sensor at a spot, which looks at the middle of the area."""
        self._awaited = None
        x, y = self._planner.yard.site.area.reshape(2, 2).mean(axis=0) - spot[:2]
        foot = float(spot[0]), float(spot[1])
        self._show(self._planner.add(foot, float(np.arctan2(y, x)), model=model))

    def add_corner(self, spot: Spot) -> None:
        """Add a corner to the area that is being drawn."""
        self.spots.append(spot)
        self._head.say(describe_count(len(self.spots), "corner"))
        self._head.show_note()
        self._areas.draw(self.spots)

    def close_area(self) -> "LiveAnswer":
        """Keep poles out of the area that was drawn."""
        corners = tuple((float(x), float(y)) for x, y, _ in self.spots)
        self._forget()
        return self._planner.set_keep_out((*self._planner.variant.keep_out, corners))

    def take_picture(self, name: str, content: bytes) -> None:
        """Keep a picture that was uploaded, and lay it under the scene."""
        self._lay(keep_picture(name, content, self._folder, self._planner.yard.site.area))
        self._head.say("type two points of the picture, or their distance, and place it by them")
        self._head.show_note()

    def place_picture(self, spot: Spot, text: str) -> None:
        """Place the picture by the second of two spots. text: where they belong, or their
        distance."""
        self.spots.append(spot)
        picture = self._planner.picture
        if picture is None or len(self.spots) < 2:
            missing = "there is no picture: lay one first"
            self._head.say(missing if picture is None else "click on the other one")
            self._head.show_note()
            return
        spots = [clicked[:2].tolist() for clicked in self.spots]
        self._forget()
        try:
            numbers = [float(number) for number in text.replace(",", " ").split()]
        except ValueError:
            numbers = []
        self._lay(picture.place(spots, numbers))

    def _lay(self, picture: GroundPicture | None) -> None:
        self._planner.lay(picture)
        self._head.say("")
        self._redraw()

    def _forget(self) -> None:
        self.spots = []
        self._awaited = None
