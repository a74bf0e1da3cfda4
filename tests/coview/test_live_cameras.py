"""Cameras of the live page: all sensors in view in any window, a look through a sensor, and what
people have moved."""

from contextlib import nullcontext
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from coview.live_cameras import LiveCameras
from toolkit.sensors.models import DepthCamera
from toolkit.sites.files import load_site
from toolkit.viewing import scene

SITE = load_site("tjunction")


class Browser:
    """Browser with a camera that keeps what it is told."""

    def __init__(self, width=1280, aspect=1.6):
        follow = []  # what follows the camera
        self.client_id, self.atomic, self.follow = 0, nullcontext, follow
        self.camera = SimpleNamespace(
            image_width=width, aspect=aspect, fov=np.deg2rad(75.0), on_update=follow.append
        )

    @property
    def ahead(self):
        way = self.camera.look_at - self.camera.position
        return way / np.linalg.norm(way)

    def resize(self, aspect):
        self.camera.aspect = aspect
        self.follow[0](self.camera)

    def project(self, point):
        """Place of a point: across and up, in halves of the window's height."""
        right = np.cross(self.ahead, [0, 0, 1]) / np.linalg.norm(np.cross(self.ahead, [0, 0, 1]))
        way = point - self.camera.position
        upwards = np.cross(right, self.ahead)
        return (
            np.array([way @ right, way @ upwards])
            / (way @ self.ahead)
            / np.tan(scene.VERTICAL_FOV / 2)
        )


@pytest.mark.parametrize(
    ("width", "height", "shown"),
    [(390, 844, 0.4), (444, 1024, 1.0), (956, 720, 1.0), (1900, 600, 1.0)],
)
@pytest.mark.parametrize("above", [False, True])
def test_all_sensors_are_in_view_in_any_window(width, height, shown, above):
    browser, cameras = Browser(width, width / height), LiveCameras(SITE.area)
    if width == 444:  # a tablet, whose panel docks after the page has opened
        browser.camera.image_width, browser.camera.aspect = 768, 768 / height
    cameras.greet(browser)
    browser.resize(width / height)
    if above:
        cameras.look_down(browser)
    for sensor in SITE.sensors:
        across, up = browser.project(sensor.position)
        assert abs(across) <= browser.camera.aspect
        assert 1 - 2 * shown <= up <= 1


def test_wide_windows_are_no_farther_away_than_the_first_view():
    wide, wider, cameras = Browser(1400, 1.3), Browser(1900, 3.0), LiveCameras(SITE.area)
    cameras.greet(wide)
    cameras.greet(wider)
    np.testing.assert_allclose(wide.camera.position, wider.camera.position)
    np.testing.assert_allclose(wide.camera.look_at, cameras.middle)
    narrow = Browser(650, 0.65)
    cameras.greet(narrow)
    twice = 2 * np.linalg.norm(wide.camera.position - cameras.middle)
    assert np.linalg.norm(narrow.camera.position - cameras.middle) == pytest.approx(twice)


def test_from_above_north_is_up_and_the_middle_in_the_middle():
    browser, cameras = Browser(), LiveCameras(SITE.area)
    cameras.greet(browser)
    cameras.look_down(browser)
    assert browser.camera.fov == scene.VERTICAL_FOV
    assert browser.ahead[2] < -0.99
    np.testing.assert_allclose(browser.project(cameras.middle), 0.0, atol=1e-9)
    across, up = browser.project(cameras.middle + np.array([0.0, 10.0, 0.0]))
    assert across == pytest.approx(0.0, abs=1e-9)
    assert up > 0.1
    assert browser.project(cameras.middle + np.array([10.0, 0.0, 0.0]))[0] > 0.1


def test_a_window_that_changes_is_filled_again_unless_somebody_has_moved_the_camera():
    browser, cameras = Browser(), LiveCameras(SITE.area)
    cameras.greet(browser)
    first = browser.camera.position
    browser.resize(0.65)
    farther = browser.camera.position
    browser.camera.position = farther + 0.05  # as a browser rounds it
    browser.resize(1.6)
    np.testing.assert_allclose(browser.camera.position, first)
    browser.resize(0.65)
    assert np.linalg.norm(farther - cameras.middle) == pytest.approx(
        2 * np.linalg.norm(first - cameras.middle)
    )
    browser.camera.position = moved = farther + np.array([3.0, 0.0, 0.0])
    browser.resize(1.6)
    assert browser.camera.position is moved


def test_a_telephone_shows_the_area_above_its_sheet():
    browser, cameras = Browser(390, 0.6), LiveCameras(SITE.area)
    cameras.greet(browser)
    across, up = browser.project(cameras.middle)
    assert across == pytest.approx(0.0, abs=1e-9)
    assert 0.3 < up < 0.8
    cameras.look_down(browser)
    assert 0.3 < browser.project(cameras.middle)[1] < 0.8
    tablet = Browser(576, 0.6)  # as wide as a panel that docks needs
    cameras.greet(tablet)
    np.testing.assert_allclose(tablet.project(cameras.middle), 0.0, atol=1e-9)


def test_a_camera_looks_through_a_sensor_and_back():
    browser, cameras = Browser(), LiveCameras(SITE.area)
    cameras.greet(browser)
    before, sensor = browser.camera.position, SITE.sensors[0]
    cameras.look_through(browser, sensor)
    ahead = sensor.world_SE3_body[:3, 0]
    np.testing.assert_allclose(browser.camera.position, sensor.position + 1.2 * ahead)
    np.testing.assert_allclose(browser.ahead, sensor.world_SE3_body[:3, 0], atol=1e-9)
    np.testing.assert_allclose(browser.camera.look_at, sensor.position + 12.0 * browser.ahead)
    cameras.show_all(browser)
    np.testing.assert_allclose(browser.camera.position, before)
    assert browser.camera.fov == scene.VERTICAL_FOV
    cameras.look_through(None, sensor)  # of a browser that has gone
    cameras.look_down(None)
    cameras.show_all(None)


@pytest.mark.parametrize(("height", "seen"), [(4, 0.7), (90, None), (9000, 1.4)])
def test_a_look_through_a_sensor_shows_its_field_of_view_as_far_as_a_screen_can(height, seen):
    model = DepthCamera(width=120, height=height)
    browser, cameras = Browser(), LiveCameras(SITE.area)
    cameras.look_through(browser, replace(SITE.sensors[0], model=model))
    assert browser.camera.fov == pytest.approx(model.vertical_fov if seen is None else seen)


def test_an_area_elsewhere_is_seen_from_as_far():
    here, there = LiveCameras(SITE.area), LiveCameras(SITE.area + 500.0)
    np.testing.assert_allclose(there.slant, here.slant)
    np.testing.assert_allclose(there.middle - here.middle, [500.0, 500.0, 0.0])
