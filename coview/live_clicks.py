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

    A control awaits clicks; each click then adds a sensor, a corner of an area, or a point of a
    picture. areas: drawing of the keep-out areas; folder: folder of a picture under the scene.

    Attributes:
        spots: Points of the ground (x, y, z in m) clicked so far for the present purpose.
    """

    def __init__(self, context: LiveContext, areas: AreaDrawing, folder: Path) -> None:
        """Wait for no click at first. folder: for pictures that are laid on the ground."""
        self._planner = context.planner
        self._jobs = context.jobs  # runs functions in the page's thread
        self._head = context.head  # shows notes
        self._show = context.show  # shows an answer
        self._redraw = context.redraw
        self._areas = areas
        self._folder = folder  # for pictures
        self._awaited: Callable[[Spot], None] | None = None  # called with the next clicks
        self.spots: list[Spot] = []  # clicked so far, of an area or picture

    def add_controls(self, gui: "GuiApi", model: Handle) -> None:
        """Add the controls of the tab Draw. model: control with the model of new sensors."""
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
        upload = gui.add_upload_button(
            "Lay a picture under it",
            mime_type="image/png, image/jpeg",
            hint="PNG or JPEG; it lies flat, at the height of the ground under its middle",
        )
        upload.on_upload(
            lambda _: self._jobs.do(
                lambda: self.take_picture(upload.value.name, upload.value.content)
            )
        )
        points_field = gui.add_text(
            "Two points", "", hint="x y x y of where they belong, or their distance (m)"
        )
        gui.add_button("Place the picture by two points").on_click(
            lambda _: self.pick(
                "two points of the picture",
                lambda spot: self.place_picture(spot, points_field.value),
            )
        )
        gui.add_button("Take the picture away").on_click(
            lambda _: self._jobs.do(lambda: self._lay(None))
        )

    def pick(self, what: str, use_spot: Callable[[Spot], None]) -> None:
        """Await clicks on the ground, in place of any that were awaited.

        what: words for the points to click on, for the note; use_spot: function that is called
        with each point of the ground (x, y, z in m)."""
        self.spots = []
        self._awaited = use_spot
        self._head.say(f"click on the ground: {what}")
        self._jobs.do(self._head.show_note)

    def follow(self, event: Handle) -> None:
        """Call the function that awaits a click, with the clicked point of the ground.

        Without one, and for a ray that does not go down, nothing happens. The point is on the level
        of the ground at which the browser's camera looks. event: viser's click, with the ray."""
        eye = np.array(event.ray_origin)
        ray = np.array(event.ray_direction)
        use_spot = self._awaited
        if use_spot is not None and ray[2] < -1e-6:
            look_at_xy = np.array(event.client.camera.look_at)[:2]
            ground_z = float(self._planner.yard.site.ground(look_at_xy))
            spot = eye + ray * (ground_z - eye[2]) / ray[2]
            self._jobs.do(lambda: use_spot(spot))

    def add_sensor(self, spot: Spot, model: str) -> None:
        """Add a sensor at a spot (m), which looks at the middle of the area.

        model: name of its model in the stock."""
        self._awaited = None
        xmin, ymin, xmax, ymax = self._planner.yard.site.area.tolist()
        spot_x, spot_y = float(spot[0]), float(spot[1])
        to_middle_x = (xmin + xmax) / 2 - spot_x
        to_middle_y = (ymin + ymax) / 2 - spot_y
        heading = float(np.arctan2(to_middle_y, to_middle_x))
        self._show(self._planner.add((spot_x, spot_y), heading=heading, model=model))

    def add_corner(self, spot: Spot) -> None:
        """Add a corner (m) to the area that is being drawn."""
        self.spots.append(spot)
        self._head.say(describe_count(len(self.spots), "corner"))
        self._head.show_note()
        self._areas.draw(self.spots)

    def close_area(self) -> "LiveAnswer":
        """Keep sensors out of the clicked area too, and return the new figures."""
        corners = tuple((float(x), float(y)) for x, y, _ in self.spots)
        self._forget_clicks()
        return self._planner.set_keep_out((*self._planner.variant.keep_out, corners))

    def take_picture(self, name: str, content: bytes) -> None:
        """Keep a picture that was uploaded, and lay it under the scene, as wide as the area.

        name: name of the uploaded file; content: its bytes."""
        self._lay(keep_picture(name, content, self._folder, self._planner.yard.site.area))
        self._head.say("type two points of the picture, or their distance, and place it by them")
        self._head.show_note()

    def place_picture(self, spot: Spot, text: str) -> None:
        """Place the picture by two points, once the second is clicked.

        spot: clicked point (m); text: typed numbers: x y x y of the right positions of both points,
        or their right distance (m)."""
        self.spots.append(spot)
        picture = self._planner.picture
        if picture is None or len(self.spots) < 2:
            no_picture = "there is no picture: lay one first"
            self._head.say(no_picture if picture is None else "click on the other one")
            self._head.show_note()
            return
        clicked_xy = [clicked_spot[:2].tolist() for clicked_spot in self.spots]
        self._forget_clicks()
        try:
            numbers = [float(number) for number in text.replace(",", " ").split()]
        except ValueError:
            numbers = []  # `place` refuses these with what it needs
        self._lay(picture.place(clicked_xy, numbers))

    def _lay(self, picture: GroundPicture | None) -> None:
        """Lay a picture under the scene and draw it. picture: None to remove the present one."""
        self._planner.lay(picture)
        self._head.say("")
        self._redraw()

    def _forget_clicks(self) -> None:
        """Await no more clicks."""
        self.spots = []
        self._awaited = None
