"""The page of a centre: what it draws, and what it writes next to it."""

from dataclasses import replace

import numpy as np
import pytest

from toolkit.centre.centre_page import (
    CentrePage,
    describe_centre_frame,
    draw_centre_frame,
    open_centre_page,
)
from toolkit.centre.running_centre import CentreFrame
from toolkit.centre.sensor_monitor import Fault
from toolkit.frame import Frame, SensorCloud
from toolkit.geometry import pose
from toolkit.objects import Detections, Objects
from toolkit.sensors.models import SpinningLidar
from toolkit.sensors.sensor import Sensor
from toolkit.tracking.tracks import Tracks

SENSORS = {"north_1": Sensor("north_1", SpinningLidar(), pose(100.0, 50.0, 5.0))}


def centre_frame():
    points = np.array([[1.0, 2.0, -5.0], [3.0, 4.0, -4.0]], np.float32)
    cloud = SensorCloud("north_1", points, SENSORS["north_1"].pose)
    box = np.array([[103.0, 54.0, 1.0, 4.0, 2.0, 1.6, 0.0]])
    tracks = Tracks(
        box, np.array([0.9]), ids=np.array([7]), velocities=np.array([[10.0, 0.0, 0.0]])
    )
    return CentreFrame(
        Frame.of_clouds("000000", [cloud], Objects.empty(), time=12.0),
        Detections.empty(),
        tracks,
        {"north_1": Fault.SHIFTED},
        {},
        latency_ms=83.0,
    )


def test_tracks_have_number_and_speed_and_points_their_places():
    sample = draw_centre_frame(centre_frame(), np.array([100.0, 50.0, 0.0]))
    assert [tag.text for tag in sample.tags] == ["vehicle 7 36 km/h"]
    assert sample.detections["vehicle"][0, :3].tolist() == [3.0, 4.0, 1.0]
    assert sample.clouds[0].points.tolist() == [[1.0, 2.0, 0.0], [3.0, 4.0, 1.0]]


def test_the_text_names_who_fails():
    text = describe_centre_frame(centre_frame(), ("north_1", "south"))
    assert "12.0 s: 1 road users" in text
    assert "83 ms" in text
    assert r"north\_1: shifted" in text
    assert "south: works" in text


def test_the_text_names_predicted_tracks():
    predicted = replace(centre_frame(), detections=None, detection_age_s=0.1)
    assert "predicted from detections 100 ms before" in describe_centre_frame(predicted, ())
    assert "predicted" not in describe_centre_frame(centre_frame(), ())


def test_a_frame_is_drawn_and_replaced():
    pytest.importorskip("viser")
    with open_centre_page(8099, SENSORS) as (page, address):
        assert isinstance(page, CentrePage)
        assert address.startswith("http://127.0.0.1:")
        page.draw(centre_frame())
        count = len(page._shown)
        page.draw(centre_frame())
        assert len(page._shown) == count > 3
        page.show(centre_frame())
