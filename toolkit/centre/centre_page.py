"""Page of a running centre: points, tracks and the state of the sensors, in a browser of this
machine.

A thread draws the newest frame a few times a second, and only while somebody looks, so that the
page costs a centre without a viewer nothing."""

import secrets
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from threading import Event, Thread
from typing import TYPE_CHECKING

import numpy as np

from toolkit.arrays import Float64
from toolkit.centre.running_centre import CentreFrame
from toolkit.frame import SensorCloud
from toolkit.objects import LABELS
from toolkit.sensors.sensor import Sensor
from toolkit.tracking.tracks import Tracks
from toolkit.viewing import scene
from toolkit.viewing.colouring import Scales
from toolkit.viewing.drawn import DrawnCloud, DrawnSample, Tag, sort_kinds
from toolkit.viewing.live_view import escape_markdown
from toolkit.viewing.recording_scene import (
    SceneStyle,
    add_grid,
    add_groups,
    add_sample,
    find_view_area,
)

if TYPE_CHECKING:
    from viser import ViserServer

MAX_PAGE_POINTS = 20_000  # in a sensor's cloud
PAGE_EVERY_S = 0.5
_KMH = 3.6


class CentrePage:
    """Page that shows the newest frame.

    Args:
        server: Server of viser.
        sensors: Sensors by name.
    """

    def __init__(self, server: "ViserServer", sensors: Mapping[str, Sensor]) -> None:
        """Prepare the page of sensors, by name, and start the thread that draws."""
        self._server = server
        self._style = SceneStyle(
            sensors=tuple(sensors),
            colourings=("sensor",),
            scales=Scales(),
            max_points=MAX_PAGE_POINTS,
            precision="float16",
        )
        positions = np.array([sensor.position for sensor in sensors.values()])
        self._origin = np.array([*np.round(positions[:, :2].mean(axis=0)), 0.0])
        self._newest: CentreFrame | None = None
        self._shown: list[scene.Handle] = []
        self._ends = Event()
        self._has_grid = False
        add_groups(server.scene, self._style)
        server.gui.configure_theme(show_share_button=False, show_logo=False)
        self._text = server.gui.add_markdown("waiting for the first frame")
        self._thread = Thread(target=self._draw_newest, daemon=True)
        self._thread.start()

    def show(self, frame: CentreFrame) -> None:
        """Take a frame as the newest; it is drawn when its turn comes."""
        self._newest = frame

    def close(self) -> None:
        """End drawing."""
        self._ends.set()
        self._thread.join()

    def _draw_newest(self) -> None:
        """Draw the newest frame again and again, while somebody looks."""
        while not self._ends.wait(PAGE_EVERY_S):
            frame = self._newest
            if frame is not None and self._server.get_clients():
                self._newest = None
                self.draw(frame)

    def draw(self, frame: CentreFrame) -> None:
        """Draw a frame in place of the one before."""
        sample = draw_centre_frame(frame, self._origin)
        if not self._has_grid:
            self._has_grid = True
            area = find_view_area(sample)
            add_grid(self._server.scene, area)
            scene.set_view(self._server, *scene.overview(area))
        for handle in self._shown:
            handle.remove()
        self._shown = add_sample(self._server.scene, sample, self._style)
        self._text.content = describe_centre_frame(frame, self._style.sensors)


def draw_centre_frame(frame: CentreFrame, origin: Float64[np.ndarray, "3"]) -> DrawnSample:
    """Return points and tracks of a frame, counted from an origin (m, world frame)."""
    boxes = frame.tracks.boxes.copy()
    boxes[:, :3] -= origin
    return DrawnSample(
        name=frame.frame.name,
        time=frame.frame.time,
        clouds=tuple(_draw_cloud(cloud, origin) for cloud in frame.frame.clouds),
        truth={},
        detections=sort_kinds(boxes, frame.tracks.labels),
        tags=_make_tags(frame.tracks, boxes),
    )


def _draw_cloud(cloud: SensorCloud, origin: Float64[np.ndarray, "3"]) -> DrawnCloud:
    """Return a sensor's points and place, counted from an origin."""
    return DrawnCloud(
        cloud.name,
        (cloud.in_world() - origin).astype(np.float32),
        cloud.world_SE3_sensor[:3, 3] - origin,
    )


def _make_tags(tracks: Tracks, boxes: Float64[np.ndarray, "n 7"]) -> tuple[Tag, ...]:
    """Return a text above each track: class, number and speed. boxes: as drawn."""
    speeds = _KMH * np.linalg.norm(tracks.velocities, axis=1)
    tags = []
    for row, number in enumerate(tracks.ids.tolist()):
        kind = LABELS[tracks.labels[row]]
        x, y, z = boxes[row, :3].tolist()
        place = (x, y, z + float(boxes[row, 5]) / 2)
        tags.append(
            Tag(
                kind,
                outcome="detection",
                text=f"{kind} {number} {speeds[row]:.0f} km/h",
                place=place,
            )
        )
    return tuple(tags)


def describe_centre_frame(frame: CentreFrame, sensors: tuple[str, ...]) -> str:
    """Describe a frame, its times and the state of each sensor, in Markdown."""
    lines = [f"{frame.frame.time:.1f} s: {len(frame.tracks)} road users"]
    lines.append(f"{frame.latency_ms:.0f} ms from the last point to the tracks")
    if frame.detections is None and frame.detection_age_s is not None:
        lines.append(f"predicted from detections {1e3 * frame.detection_age_s:.0f} ms before")
    for name in sensors:
        fault = frame.faults.get(name)
        lines.append(f"{escape_markdown(name)}: {fault.value if fault else 'works'}")
    return "\n\n".join(lines)


@contextmanager
def open_centre_page(port: int, sensors: Mapping[str, Sensor]) -> Iterator[tuple[CentrePage, str]]:
    """Serve a running centre's live page to this machine for a block; yield page and address.

    port: port to serve at, or a later one if it is taken; sensors: sensors by name. Raises
    ImportError without viser."""
    token = secrets.token_urlsafe(16)  # 16 random bytes as text
    with scene.viser_server(port, token) as server:
        page = CentrePage(server, sensors)
        try:
            yield page, f"http://127.0.0.1:{server.get_port()}/{token}/"
        finally:
            page.close()
