"""Drags in the live planner's scene: a sensor turned by its handle, carried or raised by its
housing."""

from collections.abc import Callable

import numpy as np

from coview.live_cameras import Spot
from coview.live_context import LiveContext
from coview.live_drawings import SensorDrawings
from toolkit.viewing.scene import Handle

CATCH_M = 3.0  # distance from the pointer within which a pole catches a sensor that is carried


class SensorDrags:
    """Drags and clicks of the sensors of a page.

    drawings: housings and handles of the sensors; choose: function that chooses a sensor, given by
    name, in the panel."""

    def __init__(
        self, context: LiveContext, drawings: SensorDrawings, choose: Callable[[str], None]
    ) -> None:
        """Follow the sensors of a page. choose: chooses a sensor in the panel, by name."""
        self._planner = context.planner
        self._jobs = context.jobs  # runs functions in the page's thread
        self._show = context.show  # shows an answer
        self._drawings = drawings
        self._choose = choose  # chooses a sensor in the panel, by name

    def attach(self, name: str, housing: Handle, handle: Handle) -> None:
        """Let a sensor be dragged by its housing and handle, and chosen by a click on either.

        The handle turns it, the housing carries it, with Shift up and down. name: name of the
        sensor; housing, handle: meshes in viser's scene."""

        async def turn(event: Handle) -> None:
            self._follow(event, handle, lambda spot, last: self.turn(name, spot, last=last))

        async def carry(event: Handle) -> None:
            self._follow(event, housing, lambda spot, last: self.carry(name, spot, last=last))

        async def lift(event: Handle) -> None:
            z = float(event.end_position[2])
            last = event.phase == "end"
            self._jobs.drag(lambda: self.lift(name, z, last=last), last=last)

        handle.on_drag("left")(turn)
        housing.on_drag("left")(carry)
        housing.on_drag("left", modifier="shift")(lift)
        for mesh in (housing, handle):
            mesh.on_click(lambda _: self._choose(name))

    def _follow(self, event: Handle, mesh: Handle, move: Callable[[Spot, bool], None]) -> None:
        """Follow a drag if the ray from the camera to the pointer goes down.

        event: viser's drag; mesh: what is dragged; move: function that is called with the point (m)
        at which the ray meets the height of the mesh, and True at the end of the drag."""
        eye = np.array(event.client.camera.position)
        pointer = np.array(event.end_position)
        mesh_z = float(mesh.position[2])
        ray = pointer - eye
        last = event.phase == "end"
        if ray[2] < -1e-6:  # downwards, as a level ray never meets the height
            spot = eye + ray * (mesh_z - eye[2]) / ray[2]
            self._jobs.drag(lambda: move(spot, last), last=last)

    def turn(self, name: str, spot: Spot, *, last: bool) -> None:
        """Turn and tilt a sensor towards a spot (m). last: True at the end of the drag."""
        variant = self._planner.variant
        sensor = self._planner.yard.build_sensor(variant, variant.find(name))
        x, y, z = (spot - sensor.position).tolist()
        heading = float(np.arctan2(y, x))
        tilt = float(np.arctan2(-z, np.hypot(x, y)))
        self._show(self._planner.move(name, heading=heading, tilt=tilt, dragging=True))
        self._finish_drag(name, last)

    def carry(self, name: str, spot: Spot, *, last: bool) -> None:
        """Carry a sensor to the pole within `CATCH_M` of a spot (m).

        If there is none, its drawing follows the pointer, and at the end of the drag (`last`) the
        sensor is carried to the spot itself, to a new pole."""
        present_pole = self._planner.variant.find(name).mount
        poles = [*self._planner.yard.stock.mounts, *self._planner.variant.poles]
        distances = np.array([np.hypot(*(pole.position[:2] - spot[:2])) for pole in poles])
        if distances.min() <= CATCH_M:
            nearest_pole = poles[int(distances.argmin())].name
            if nearest_pole != present_pole:
                self._show(self._planner.move(name, position=nearest_pole, dragging=True))
        elif last:
            position = float(spot[0]), float(spot[1])
            self._show(self._planner.move(name, position=position, dragging=True))
        else:
            self._drawings.put_housing(name, spot)
        self._finish_drag(name, last)

    def lift(self, name: str, z: float, *, last: bool) -> None:
        """Raise or lower a sensor. z: its new z (m); last: True at the end of the drag."""
        variant = self._planner.variant
        mount = self._planner.yard.find_mount(variant, variant.find(name).mount)
        height = z - float(mount.position[2])  # above the foot of the pole
        self._show(self._planner.move(name, height=height, dragging=True))
        self._finish_drag(name, last)

    def _finish_drag(self, name: str, last: bool) -> None:
        """Close the step of undo and draw the sensor in its new pose, if the drag ends (`last`)."""
        if last:
            self._planner.end_drag()
            self._choose(name)
            self._drawings.draw(self.attach)
