"""Cameras of the browsers that show the live page: the area whole in any window, from above, or
through a sensor."""

from typing import NamedTuple

import numpy as np

from toolkit.arrays import Float64
from toolkit.sensors.sensor import Sensor
from toolkit.viewing import scene
from toolkit.viewing.scene import Handle

DISTANCE_FACTOR = 1.25  # distance from the area, as a multiple of the distance in the report's view
WIDE_ASPECT = 1.3  # width of a window by its height from which this distance is enough
# from a sensor to the camera that looks through it, and to the point that this looks at
HOUSING_M = 1.2
LOOK_M = 12.0
# a camera that differs less from its last aim was not moved by anybody
MIN_ASPECT_CHANGE = 0.01
MIN_MOVE_M = 0.1
MIN_LOOK_FOV_RAD = 0.7
MAX_LOOK_FOV_RAD = 1.4
# px of width below which the panel is a sheet over this share of the scene
MAX_PHONE_WIDTH_PX = 576
SHEET_SHARE = 0.6
UP = np.array([0.0, 0.0, 1.0])
Spot = Float64[np.ndarray, "3"]  # x, y and z (m) in the site's frame


class CameraAim(NamedTuple):
    """Camera of a browser as it was aimed last.

    Attributes:
        way: Way (m) from the area's middle to the camera in a wide window.
        aspect: Width of the window divided by its height.
        is_phone: True for a telephone.
        position: Position of the camera (m).
    """

    way: Spot
    aspect: float
    is_phone: bool
    position: Spot


class LiveCameras:
    """Cameras of the browsers that show a page.

    area: xmin, ymin, xmax and ymax (m) of the detection area.

    Attributes:
        middle: Middle of the area (m).
        slant: Way (m) from the middle to a camera that sees the area whole in a wide window.
        aims: Last aim of each camera, by the browser's number.
    """

    def __init__(self, area: Float64[np.ndarray, "4"]) -> None:
        eye, self.middle = (np.array(point) for point in scene.overview(tuple(area.tolist())))
        self.slant = DISTANCE_FACTOR * (eye - self.middle)
        self.aims: dict[int, CameraAim] = {}

    def greet(self, client: Handle) -> None:
        """Aim the camera of a browser that has come, and again if its window changes.

        A camera that somebody has moved is left as it is."""
        camera = client.camera
        self.aim(client, self.slant, is_phone=camera.image_width < MAX_PHONE_WIDTH_PX)

        def fit(_: Handle) -> None:
            """Aim again if the window's shape has changed and nobody has moved the camera.

            The panel changes the shape, too, when it is docked."""
            last = self.aims[client.client_id]
            has_changed = abs(camera.aspect - last.aspect) > MIN_ASPECT_CHANGE
            if has_changed and np.allclose(camera.position, last.position, atol=MIN_MOVE_M):
                self.aim(client, last.way)

        camera.on_update(fit)

    def show_all(self, client: Handle) -> None:
        """Show the whole area aslant. client: browser, None if it has gone."""
        if client is not None:
            client.camera.fov = scene.VERTICAL_FOV
            self.aim(client, self.slant)

    def look_down(self, client: Handle) -> None:
        """Show the whole area from above, with the site's y axis upwards.

        client: browser, None if it has gone."""
        if client is not None:
            client.camera.fov = scene.VERTICAL_FOV
            # a little aslant: with no way straight down the screen has an upward direction
            self.aim(client, np.array([0.0, -0.02, 1.0]) * np.linalg.norm(self.slant))

    def look_through(self, client: Handle, sensor: Sensor) -> None:
        """Put a browser's camera just before a sensor, with as much of its view as a screen holds.

        client: browser, None if it has gone."""
        if client is None:
            return
        ahead = sensor.world_SE3_body[:3, 0]  # unit vector in which the sensor looks
        with client.atomic():
            client.camera.fov = min(
                max(sensor.model.vertical_fov, MIN_LOOK_FOV_RAD), MAX_LOOK_FOV_RAD
            )
            client.camera.position = sensor.position + HOUSING_M * ahead
            client.camera.look_at = sensor.position + LOOK_M * ahead

    def aim(self, client: Handle, way: Spot, *, is_phone: bool | None = None) -> None:
        """Aim a browser's camera at the area, from farther away if the window is narrow.

        On a telephone it is aimed below the middle, as the panel's sheet covers part of the scene.
        way: from the area's middle to the camera in a wide window (m); is_phone: True for a
        telephone, None for the value of the last aim."""
        camera = client.camera
        if is_phone is None:
            is_phone = self.aims[client.client_id].is_phone
        away = way * max(WIDE_ASPECT / camera.aspect, 1.0)
        right = np.cross(-away, UP)  # never 0, as no way is straight down
        upwards = np.cross(right, -away)  # in the plane of the screen
        shift_m = 0.0
        if is_phone:
            shift_m = SHEET_SHARE * np.tan(scene.VERTICAL_FOV / 2) * np.linalg.norm(away)
        look_at = self.middle - shift_m * upwards / np.linalg.norm(upwards)
        position = look_at + away
        self.aims[client.client_id] = CameraAim(
            way, aspect=camera.aspect, is_phone=is_phone, position=position
        )
        with client.atomic():
            camera.position = position
            camera.look_at = look_at
