"""Cameras of the browsers that show the live page: the area whole in any window, from above, or
through a sensor."""

import numpy as np

from toolkit.arrays import Float64
from toolkit.sensors.sensor import Sensor
from toolkit.viewing import scene
from toolkit.viewing.scene import Handle

AWAY = 1.25  # distance from the area, as a multiple of the distance in the report's view
WIDE = 1.3  # width of a window by its height from which this distance is enough
# from a sensor to the camera that looks through it, and to the point that this looks at
HOUSING_M = 1.2
LOOK_M = 12.0
MIN_LOOK_FOV_RAD = 0.7
MAX_LOOK_FOV_RAD = 1.4
# px of width below which the panel is a sheet over this share of the scene
PHONE = 576
SHEET = 0.6
UP = np.array([0.0, 0.0, 1.0])
Spot = Float64[np.ndarray, "3"]  # x, y and z (m) in the site's frame


class LiveCameras:
    """Cameras of the browsers that show a page.

    area: xmin, ymin, xmax and ymax (m) of the detection area.

    Attributes:
        middle: Middle of the area (m).
        slant: Way (m) from the middle to a camera that sees the area whole in a wide window.
        aimed: Way from the middle to the camera, width by height of the window, True for a
            telephone, and position of the camera, by the browser's number.
    """

    def __init__(self, area: Float64[np.ndarray, "4"]) -> None:
        eye, self.middle = (np.array(point) for point in scene.overview(tuple(area.tolist())))
        self.slant = AWAY * (eye - self.middle)
        self.aimed: dict[int, tuple[Spot, float, bool, Spot]] = {}

    def greet(self, client: Handle) -> None:
        """Aim the camera of a browser that has come.

        It is aimed again if its window changes before somebody has moved the camera."""
        camera = client.camera
        self.aim(client, self.slant, phone=camera.image_width < PHONE)

        def fit(
            _: Handle,
        ) -> None:  # the panel docks, or the window changes: fit what nobody has moved
            away, aspect, _, position = self.aimed[client.client_id]
            if abs(camera.aspect - aspect) > 0.01 and np.allclose(
                camera.position, position, atol=0.1
            ):
                self.aim(client, away)

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
            self.aim(client, np.array([0.0, -0.02, 1.0]) * np.linalg.norm(self.slant))

    def look_through(self, client: Handle, sensor: Sensor) -> None:
        """Put a browser's camera just before a sensor, with as much of its view as a screen holds.

        client: browser, None if it has gone."""
        if client is None:
            return
        ahead = sensor.world_SE3_body[:3, 0]
        with client.atomic():
            client.camera.fov = min(
                max(sensor.model.vertical_fov, MIN_LOOK_FOV_RAD), MAX_LOOK_FOV_RAD
            )
            client.camera.position = sensor.position + HOUSING_M * ahead
            client.camera.look_at = sensor.position + LOOK_M * ahead

    def aim(self, client: Handle, way: Spot, *, phone: bool | None = None) -> None:
        """Aim a browser's camera at the area, from farther away if the window is narrow.

        On a telephone it is aimed below the middle, as the panel's sheet covers part of the scene.
        way: from the area's middle to the camera in a wide window (m); phone: True for a telephone,
        None for the value of the last aim."""
        camera = client.camera
        if phone is None:
            phone = self.aimed[client.client_id][2]
        away = way * max(WIDE / camera.aspect, 1.0)
        right = np.cross(-away, UP)  # no way is straight down
        upwards = np.cross(right, -away)
        covered = SHEET * np.tan(scene.VERTICAL_FOV / 2) * np.linalg.norm(away) if phone else 0.0
        middle = self.middle - covered * upwards / np.linalg.norm(upwards)
        self.aimed[client.client_id] = way, camera.aspect, phone, middle + away
        with client.atomic():
            camera.position = middle + away
            camera.look_at = middle
