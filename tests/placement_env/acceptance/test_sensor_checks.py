"""Sensors of a street with planted faults, rendered at a built-in site."""

from dataclasses import replace

import numpy as np
import pytest

from placement_env.acceptance.sensor_checks import check_sensors
from placement_env.acceptance.sensor_figures import (
    find_distances,
    image_distances,
    promise_figures,
    render_scenes,
)
from toolkit.calibration.reference_surface import site_surface
from toolkit.frame import Frame, SensorCloud
from toolkit.objects import Objects
from toolkit.rendering.renderer import Renderer
from toolkit.sensors.models import DepthCamera
from toolkit.sites.files import load_site

BUILT_IN = load_site("tjunction")
CAMERA = DepthCamera(width=160, height=120)
SITE = replace(
    BUILT_IN, sensors=tuple(replace(sensor, model=CAMERA) for sensor in BUILT_IN.sensors[:2])
)
FRAMES = 6


@pytest.fixture(scope="module")
def surface():
    return site_surface(SITE)


def turned(sensor, degrees):
    """The sensor turned about the vertical."""
    angle = np.deg2rad(degrees)
    turn = np.eye(4)
    turn[:2, :2] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
    pose = turn @ sensor.pose
    pose[:3, 3] = sensor.pose[:3, 3]
    return replace(sensor, pose=pose)


def record(hung=SITE.sensors, change=lambda image, rng: image, stated=SITE.sensors):
    """Frames of sensors that hang in one pose and state another, with a change of the first."""
    images = Renderer(SITE, (), hung).background
    rng = np.random.default_rng(0)
    frames = []
    for number in range(FRAMES):
        noisy = [CAMERA.noisy(image, rng) for image in images]
        noisy[0] = change(noisy[0], rng).astype(np.float32)
        frames.append(Frame(stated, tuple(noisy), Objects.empty(), 5.0 * number, number))
    return frames


def faults(frames, surface):
    return [check.faults() for check in check_sensors(frames, SITE, surface, len(frames))]


def test_a_sound_street_has_no_fault(surface):
    checks = check_sensors(record(), SITE, surface, FRAMES)
    assert [check.faults() for check in checks] == [(), ()]
    for check in checks:
        assert check.returns_share == pytest.approx(1, abs=0.01)
        assert check.measured.range_m == pytest.approx(check.promised.range_m, rel=0.02)
        assert check.promised.noise_m == pytest.approx(CAMERA.sigma)
        assert check.pose_error.turn_deg < 0.1
        assert check.as_dict()["faults"] == []


def test_a_turned_sensor_is_found_whatever_pose_it_states(surface):
    hung = (turned(SITE.sensors[0], 1.0), SITE.sensors[1])
    first, second = check_sensors(record(hung), SITE, surface, FRAMES)
    assert second.faults() == ()
    assert first.pose_error.turn_deg == pytest.approx(1.0, abs=0.1)
    assert "off its stated pose" in first.faults()[0]
    honest, _ = check_sensors(record(hung, stated=hung), SITE, surface, FRAMES)
    assert honest.pose_error.turn_deg < 0.1
    assert honest.mount_error.turn_deg == pytest.approx(1.0, abs=0.1)
    assert "off its planned pose" in honest.faults()[0]


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda image, rng: 0 * image, "returns nothing in any frame"),
        (lambda image, rng: image * (rng.random(image.shape) > 0.3), "returns 70%"),
        (lambda image, rng: np.where(image < 15, image, 0), "m far instead of"),
        (lambda image, rng: image + (image > 0) * rng.normal(0, 0.05, image.shape), "has noise of"),
    ],
)
def test_each_fault_is_named(surface, change, said):
    first, second = faults(record(change=change), surface)
    assert any(said in sentence for sentence in first), first
    assert second == ()


def test_a_missing_sensor_and_one_that_fails_now_and_then(surface):
    frames = [frame.seen_by([SITE.sensors[1].name]) for frame in record()]
    assert faults(frames, surface) == [("is not in the recording",), ()]
    frames = record()
    for number in (1, 4):
        blind = (0 * frames[number].images[0], frames[number].images[1])
        frames[number] = replace(frames[number], measurements=blind)
    first, second = faults(frames, surface)
    assert "returns something in only 67% of the frames" in first
    assert second == ()
    with pytest.raises(ValueError, match="4 frames do not show"):
        check_sensors(frames, SITE, surface, 4)


def test_images_and_clouds_of_one_view_have_the_same_distances():
    scene = render_scenes(SITE)[SITE.sensors[0].name]
    distances = image_distances(scene.first, CAMERA)
    assert promise_figures(scene).returns == len(distances) == (scene.first > 0).sum()
    points = (CAMERA.rays()[scene.first > 0] * scene.first[scene.first > 0][:, None]).astype(
        np.float32
    )
    cloud = SensorCloud("s", points, np.eye(4))
    frame = Frame.of_clouds("0", (cloud,), Objects.empty())
    np.testing.assert_allclose(find_distances(frame, "s"), distances, rtol=1e-5)
    assert not len(find_distances(frame, "t"))
