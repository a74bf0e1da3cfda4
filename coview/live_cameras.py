"""Cameras of the browsers that show the live page: the area whole in any window, from above, or
through a sensor."""

import numpy as np

from toolkit.arrays import Float64
from toolkit.sensors.sensor import Sensor
from toolkit.viewing import scene
from toolkit.viewing.scene import Handle

# times as far from the area as the report's view, in windows at least so wide for their height
AWAY = 1.25
WIDE = 1.3
# from a sensor to the camera that looks through it, and to what it looks at
HOUSING_M = 1.2
LOOK_M = 12.0
MIN_LOOK_FOV_RAD = 0.7
MAX_LOOK_FOV_RAD = 1.4
# px of width below which the panel is a sheet over this share of the scene
PHONE = 576
SHEET = 0.6
UP = np.array([0.0, 0.0, 1.0])
Spot = Float64[np.ndarray, "3"]


class LiveCameras:
    """Cameras by browser. middle: of the area (m); slant: from there to a camera that sees it
    whole, in wide windows.

    aimed: view, aspect, whether it is a telephone, and place of each browser's camera, by the
    browser's number."""

    def __init__(self, area: Float64[np.ndarray, "4"]) -> None:
        eye, self.middle = (np.array(point) for point in scene.overview(tuple(area.tolist())))
        self.slant = AWAY * (eye - self.middle)
        self.aimed: dict[int, tuple[Spot, float, bool, Spot]] = {}

    def greet(self, client: Handle) -> None:
        """Aim the camera of a browser that has come, and again when its window changes and nobody
        has moved it."""
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
        """Show the whole area aslant."""
        if client is not None:
            client.camera.fov = scene.VERTICAL_FOV
            self.aim(client, self.slant)

    def look_down(self, client: Handle) -> None:
        """Show the whole area from above, north as on the map."""
        if client is not None:
            client.camera.fov = scene.VERTICAL_FOV
            self.aim(client, np.array([0.0, -0.02, 1.0]) * np.linalg.norm(self.slant))

    def look_through(self, client: Handle, sensor: Sensor) -> None:
        """Put a browser's camera in a sensor's place, with as much of its view as a screen
        holds."""
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
        """Aim a browser's camera at the area, from farther away where the window is narrow or a
        sheet covers it.

        way: from the area's middle to the camera (m); phone: None for as before."""
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
