"""The lidar of uneven rows. What any model can, it does in `test_model`."""

from dataclasses import replace

import numpy as np
import pytest

from toolkit.boxes import corners
from toolkit.geometry import invert, pose, transform
from toolkit.sensors.catalogue import make_model, model_named
from toolkit.sensors.row_lidar import RowLidar
from toolkit.sensors.sensor import Sensor
from toolkit.sites.files import load_site
from toolkit.sites.geojson import document, parse

LIDAR = RowLidar((0.2, 0.05, 0.0, -0.4), columns=90)
SIDEWAYS = RowLidar((0.1, 0.0, -0.3), columns=40, azimuth_fov=2.0, heading=1.5)
lidars = pytest.mark.parametrize("lidar", [LIDAR, SIDEWAYS], ids=["turn", "sideways"])


@lidars
def test_rays_lie_in_its_rows_and_columns(lidar):
    rays = lidar.rays().astype(np.float64)
    assert rays.shape == (*lidar.shape, 3)
    np.testing.assert_allclose(np.linalg.norm(rays, axis=-1), 1, atol=1e-6)
    np.testing.assert_allclose(np.arcsin(rays[..., 2]), np.tile(lidar.elevations, (lidar.columns, 1)).T, atol=1e-6)
    azimuth = np.unwrap(np.arctan2(rays[0, :, 1], rays[0, :, 0]))
    np.testing.assert_allclose(np.diff(azimuth), lidar.azimuth_fov / lidar.columns, atol=1e-5)
    assert azimuth.mean() == pytest.approx(lidar.heading, abs=1e-5)


def test_its_body_looks_along_the_heading():
    ahead = SIDEWAYS.body_SE3_sensor[:3, :3] @ [np.cos(1.5), np.sin(1.5), 0.0]
    np.testing.assert_allclose(ahead, [1, 0, 0], atol=1e-12)
    np.testing.assert_allclose(LIDAR.body_SE3_sensor, np.eye(4))


@pytest.mark.parametrize(
    ("azimuth", "elevation", "distance", "seen"),
    [(1.5, 0, 10, True), (2.49, 0, 10, True), (2.51, 0, 10, False), (0.49, 0, 10, False), (1.5, 0.11, 10, False),
     (1.5, -0.29, 10, True), (1.5, -0.31, 10, False), (1.5, 0, 199, True), (1.5, 0, 201, False)],
)  # fmt: skip
def test_what_is_in_view(azimuth, elevation, distance, seen):
    flat = np.cos(elevation)
    point = distance * np.array([flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(elevation)])
    assert SIDEWAYS.in_view(point[None]).tolist() == [seen]


@lidars
def test_every_ray_that_meets_a_box_lies_in_one_of_its_windows(lidar):
    rng = np.random.default_rng(3)
    places = np.column_stack([rng.uniform(-15, 15, (40, 2)), rng.uniform(-4, 4, 40)])
    boxes = np.column_stack([places, rng.uniform(1, 6, (40, 3)), rng.uniform(-3, 3, 40)])
    found = lidar.windows(transform(invert(np.eye(4)), corners(boxes)))
    rays = lidar.rays().astype(np.float64).reshape(-1, 3)
    for number, box in enumerate(boxes):
        held = np.zeros(lidar.shape, bool)
        for _, top, bottom, left, right in found[found[:, 0] == number]:
            held[top:bottom, left:right] = True
        along = np.linspace(0.0, 30.0, 400)[:, None, None] * rays
        own = transform(invert(pose(*box[:3], yaw=box[6])), along.reshape(-1, 3)).reshape(along.shape)
        hit = (np.abs(own) <= box[3:6] / 2).all(axis=-1).any(axis=0)
        assert held.ravel()[hit].all()
    assert (found[:, 1] < found[:, 2]).all()
    sizes = (found[:, 2] - found[:, 1]) * (found[:, 4] - found[:, 3])
    assert np.median(sizes) < 0.2 * np.prod(lidar.shape)


def test_noise_is_that_of_its_sigma():
    wide, clean = replace(LIDAR, columns=4000, sigma=0.03), np.full((4, 4000), 20.0, np.float32)
    assert (wide.noisy(clean, np.random.default_rng(0)) - 20).std() == pytest.approx(0.03, rel=0.05)
    assert not wide.noisy(np.zeros_like(clean), np.random.default_rng(0)).any()


def test_files_hold_it_with_its_rows_in_degrees():
    site = replace(load_site("tjunction"), sensors=(Sensor("r", SIDEWAYS, pose(1.0, 2.0, 5.0)),))
    content = document(site)
    (model,) = [f["properties"]["model"] for f in content["features"] if f["properties"]["layer"] == "sensor"]
    assert model["elevations_deg"] == pytest.approx(np.rad2deg(SIDEWAYS.elevations).tolist())
    (back,) = parse(content).sensors
    np.testing.assert_allclose(back.model.rays(), SIDEWAYS.rays(), atol=1e-6)
    assert back.model.deviation(np.ones(1)) == SIDEWAYS.deviation(np.ones(1))
    assert back.model.max_range == SIDEWAYS.max_range
    assert make_model("RowLidar", {"elevations": [0.2, 0.05, 0.0, -0.4], "columns": 90}) == LIDAR
    assert model_named("row-lidar") == RowLidar()
    assert RowLidar().shape == (32, 1800)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"elevations": ()}, "must fall from row to row"),
        ({"elevations": (0.0, 0.1)}, "must fall from row to row"),
        ({"elevations": (0.1, 0.1)}, "must fall from row to row"),
        ({"elevations": (np.nan,)}, "must fall from row to row"),
        ({"elevations": (1.6, 0.0)}, "-pi/2..pi/2"),
        ({"columns": 0}, "at least 1"),
        ({"azimuth_fov": 7.0}, "2 pi"),
        ({"heading": 4.0}, "heading within pi"),
        ({"sigma": -1.0}, "sigma"),
        ({"max_range": 0.0}, "max_range"),
    ],
)
def test_impossible_lidars_are_refused(change, message):
    with pytest.raises(ValueError, match=message):
        RowLidar(**change)
