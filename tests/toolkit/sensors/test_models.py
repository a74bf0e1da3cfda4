from dataclasses import dataclass, replace

import numpy as np
import pytest

from toolkit.bodies.fleet import catalogue
from toolkit.boxes import corners
from toolkit.geometry import invert, look, pose, transform
from toolkit.rendering.renderer import Renderer
from toolkit.sensors.models import (
    MODELS,
    DepthCamera,
    RowLidar,
    SolidStateLidar,
    SpinningLidar,
    class_names,
    find_model,
    find_model_class,
    make_model,
    register_sensor_model,
)
from toolkit.sensors.sensor import Sensor
from toolkit.sites.files import document, load_site, parse
from toolkit.sites.site import Site

CAMERA = DepthCamera(width=120, height=90, stride=2)


def test_strides_fill_the_view():
    for width, height, stride, shape in (
        (400, 300, 2, (150, 200)),
        (41, 30, 3, (10, 14)),
        (5, 5, 9, (1, 1)),
    ):
        camera = DepthCamera(width=width, height=height, stride=stride)
        assert camera.shape == shape
        assert camera.rays().shape == (*shape, 3)


def test_right_angles_fill_the_view():
    camera = DepthCamera(width=200, height=200, fov=np.pi / 2)
    assert camera.intrinsic[0, 0] == pytest.approx(100)
    assert camera.horizontal_fov == pytest.approx(camera.vertical_fov) == pytest.approx(np.pi / 2)
    inside = [(0, 0, 10), (9.9, 0, 10), (0, 7.4, 10), (0, 0, 999)]
    outside = [(10.1, 0, 10), (0, 7.6, 10), (0, 0, -10), (0, 0, 1001)]
    assert CAMERA.in_view(np.array([*inside, *outside], float)).tolist() == [True] * 4 + [False] * 4
    # its principal point is off the middle
    aside = DepthCamera(width=120, height=90, centre=(90.0, 45.0))
    assert aside.in_view(np.array([[-14.0, 0, 10], [14.0, 0, 10]])).tolist() == [True, False]


def test_lidars_view_their_sector():
    inside, outside = (
        [(10, 0, 0), (-10, 0, 0), (0, 10, 0), (119, 0, 0)],
        [(0, 0, 10), (10, 0, 3), (121, 0, 0)],
    )
    assert LIDAR.in_view(np.array([*inside, *outside], float)).tolist() == [True] * 4 + [False] * 3

    inside = polar((0, 0, 10), (0.99, 0, 10), (0, -0.24, 10), (0, 0, 59.9))
    outside = polar((1.01, 0, 10), (0, 0.26, 10), (3.1, 0, 10), (0, 0, 60.1))
    assert SECTOR.in_view(np.concatenate([inside, outside])).tolist() == [True] * 4 + [False] * 4
    degree = np.pi / 180
    inside = polar((0, 0, 10), (59 * degree, 12 * degree, 10), (0, 0, 149))
    outside = polar((61 * degree, 0, 10), (0, -13 * degree, 10), (np.pi, 0, 10), (0, 0, 151))
    assert (
        SOLID_STATE.in_view(np.concatenate([inside, outside])).tolist() == [True] * 3 + [False] * 4
    )
    inside = polar((1.5, 0, 10), (2.49, 0, 10), (1.5, -0.29, 10), (1.5, 0, 199))
    outside = polar((2.51, 0, 10), (0.49, 0, 10), (1.5, 0.11, 10), (1.5, -0.31, 10), (1.5, 0, 201))
    assert SIDEWAYS.in_view(np.concatenate([inside, outside])).tolist() == [True] * 4 + [False] * 5


def polar(*rows):
    """Points (azimuth, elevation, distance) in x, y, z."""
    azimuth, elevation, distance = np.array(rows, float).T
    flat = np.cos(elevation)
    return (distance * [flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(elevation)]).T


def test_windows_of_cameras_hold_boxes_ahead_and_around():
    sensor = Sensor("s", CAMERA, look((0.0, 0.0, 5.0), 0.0, 0.2))
    box = corners(np.array([[15.0, 1.0, 0.75, 4.0, 2.0, 1.5, 0.4]]))
    in_sensor = transform(invert(sensor.pose), box)
    ((row, top, bottom, left, right),) = CAMERA.windows(in_sensor)
    pixels = in_sensor[0] @ CAMERA.intrinsic.T
    u, v = pixels[:, 0] / pixels[:, 2] / 2, pixels[:, 1] / pixels[:, 2] / 2
    assert row == 0
    assert left <= u.min() <= left + 1
    assert right - 2 <= u.max() <= right
    assert top <= v.min() <= top + 1
    assert bottom - 2 <= v.max() <= bottom
    sensor = Sensor("s", CAMERA, look((0.0, 0.0, 0.0), 0.0))
    boxes = corners(np.array([[-15.0, 0, 0, 4, 2, 1.5, 0], [0, 0, 0, 4, 4, 4, 0]]))
    windows = CAMERA.windows(transform(invert(sensor.pose), boxes))
    assert windows.tolist() == [[1, 0, CAMERA.shape[0], 0, CAMERA.shape[1]]]


TURN = SpinningLidar(16, 0.2, -0.5, azimuth_step=np.pi / 45, max_range=60.0)
SECTOR = SolidStateLidar(24, 60, 2.0, 0.5, max_range=60.0)
ROW = SpinningLidar(1, 0.0, 0.0, azimuth_step=np.pi / 18, max_range=60.0)
grids = pytest.mark.parametrize("lidar", [TURN, SECTOR, ROW], ids=["turn", "sector", "row"])


@grids
def test_rays_are_unit_vectors_from_the_top_right_sideways(lidar):
    rays = lidar.rays().astype(np.float64)
    assert rays.shape == (*lidar.shape, 3)
    np.testing.assert_allclose(np.linalg.norm(rays, axis=-1), 1, atol=1e-6)
    elevation, azimuth = (
        np.arcsin(rays[..., 2]),
        np.unwrap(np.arctan2(rays[..., 1], rays[..., 0]), axis=1),
    )
    ends = {TURN: (0.2, -0.5), SECTOR: (0.25, -0.25), ROW: (0.0, 0.0)}[lidar]
    np.testing.assert_allclose(elevation[[0, -1]].T, np.tile(ends, (lidar.shape[1], 1)), atol=1e-6)
    np.testing.assert_allclose(
        np.diff(azimuth, axis=1), lidar.horizontal_fov / lidar.shape[1], atol=1e-5
    )
    np.testing.assert_allclose(azimuth.mean(axis=1), 0, atol=1e-5)


def test_turning_lidars_have_columns_seams_and_rays_made_once():
    assert TURN.rays() is replace(TURN).rays()
    with pytest.raises(ValueError, match="read-only"):
        TURN.rays()[0, 0] = 1
    assert len(TURN.windows(corners(np.array([[99.0, 0, 0, 4, 2, 1.5, 0]])))) == 0
    for step, sweep, columns in (
        (np.deg2rad(0.4), 2 * np.pi, 900),
        (0.1, 1.0, 10),
        (1.0, 1.0, 1),
        (0.4, 1.0, 2),
    ):
        assert SpinningLidar(azimuth_step=step, azimuth_fov=sweep).shape == (64, columns)
    lidar = SpinningLidar(fov_up=0.2, fov_down=-0.3, azimuth_fov=1.5)
    assert (lidar.horizontal_fov, lidar.vertical_fov) == (1.5, 0.5)
    assert LIDAR.deviation(np.zeros(LIDAR.shape, np.float32)) == np.float32(LIDAR.sigma)
    windows = LIDAR.windows(
        corners(np.array([[-10.0, 0, 0, 4, 2, 1.5, 0], [10, 0, 0, 4, 2, 1.5, 0]]))
    )
    assert windows[:, 0].tolist().count(0) == 2
    assert windows[:, 0].tolist().count(1) == 1
    assert {0} <= set(windows[windows[:, 0] == 0, 3].tolist())
    assert LIDAR.shape[1] in windows[windows[:, 0] == 0, 4].tolist()


@grids
def test_every_ray_that_meets_a_box_lies_in_one_of_its_windows(lidar):
    rng = np.random.default_rng(3)
    places = np.column_stack([rng.uniform(-15, 15, (60, 2)), rng.uniform(-4, 4, 60)])
    boxes = np.column_stack([places, rng.uniform(1, 6, (60, 3)), rng.uniform(-3, 3, 60)])
    windows = lidar.windows(corners(boxes))
    assert (windows[:, 1] < windows[:, 2]).all()
    assert (windows[:, 3] < windows[:, 4]).all()
    rays = lidar.rays().astype(np.float64)
    met = 0
    for number, (x, y, z, *size, yaw) in enumerate(boxes):
        turn = np.array([[np.cos(yaw), np.sin(yaw), 0], [-np.sin(yaw), np.cos(yaw), 0], [0, 0, 1]])
        origin, direction = -(turn @ [x, y, z]), rays @ turn.T
        half = np.array(size) / 2
        with np.errstate(divide="ignore"):
            low, high = np.sort([(-half - origin) / direction, (half - origin) / direction], axis=0)
        meets = (low.max(axis=-1) < high.min(axis=-1)) & (high.min(axis=-1) > 0)
        covered = np.zeros(meets.shape, bool)
        for _, top, bottom, left, right in windows[windows[:, 0] == number]:
            covered[top:bottom, left:right] = True
        assert covered[meets].all()
        met += meets.sum()
    assert met > 50


LIDAR = SpinningLidar(channels=16, azimuth_step=0.05)


SOLID_STATE = SolidStateLidar(rows=25, columns=120)


def test_solid_state_lidars_measure_in_their_field():
    assert np.allclose(
        np.rad2deg([SolidStateLidar().horizontal_fov, SolidStateLidar().vertical_fov]), [120, 25]
    )
    x, y, z = np.moveaxis(SOLID_STATE.rays().astype(np.float64), -1, 0)
    azimuth, elevation = np.rad2deg(np.arctan2(y, x)), np.rad2deg(np.arcsin(z))
    assert np.allclose(elevation[[0, 12, 24]], [[12.5], [0.0], [-12.5]], atol=1e-4)
    assert np.allclose(azimuth[:, [0, -1]], [-59.5, 59.5], atol=1e-4)
    assert np.allclose(x**2 + y**2 + z**2, 1, atol=1e-6)


def test_windows_hold_boxes_in_view():
    sensor = Sensor("s", SOLID_STATE, pose(0.0, 0.0, 1.0))
    boxes = np.array([[20.0, 0, 1, 2, 2, 2, 0], [-20, 0, 1, 2, 2, 2, 0], [-5, 40, 1, 2, 2, 2, 0]])
    found = SOLID_STATE.windows(transform(invert(sensor.pose), corners(boxes)))
    assert found[:, 0].tolist() == [0]
    _, top, bottom, left, right = found[0]
    assert (bottom - top) * (right - left) < 250


def test_solid_state_lidars_see_the_ground():
    sensor = Sensor("s", SOLID_STATE, pose(0.0, 0.0, 4.0, yaw=1.0))
    found = Renderer(
        Site("flat", np.array([-30.0, -20, 30, 20])), catalogue(), (sensor,)
    ).background[0]
    slope = SOLID_STATE.rays()[..., 2]
    near = slope < -0.1
    assert np.allclose(found[near], -4.0 / slope[near], rtol=1e-3)
    assert not found[slope > 0].any()


def test_noise_of_lidars_grows_with_range():
    model = SolidStateLidar(rows=100, columns=100, sigma=0.01, sigma_per_metre=0.001)
    close, far = (np.full(model.shape, metres, np.float32) for metres in (10.0, 90.0))
    assert (model.noisy(close, np.random.default_rng(0)) - close).std() == pytest.approx(
        0.02, rel=0.05
    )
    assert (model.noisy(far, np.random.default_rng(0)) - far).std() == pytest.approx(0.10, rel=0.05)
    assert not model.noisy(np.zeros(model.shape, np.float32), np.random.default_rng(0)).any()
    wide, clean = replace(ROWS, columns=4000, sigma=0.03), np.full((4, 4000), 20.0, np.float32)
    assert (wide.noisy(clean, np.random.default_rng(0)) - 20).std() == pytest.approx(0.03, rel=0.05)
    assert not wide.noisy(np.zeros_like(clean), np.random.default_rng(0)).any()


def test_row_lidars_look_along_their_heading():
    ahead = SIDEWAYS.body_SE3_sensor[:3, :3] @ [np.cos(1.5), np.sin(1.5), 0.0]
    np.testing.assert_allclose(ahead, [1, 0, 0], atol=1e-12)
    np.testing.assert_allclose(ROWS.body_SE3_sensor, np.eye(4))


def test_row_lidars_return_from_a_file_of_a_site():
    content = document(
        replace(load_site("tjunction"), sensors=(Sensor("r", SIDEWAYS, pose(1.0, 2.0, 5.0)),))
    )
    (model,) = [
        f["properties"]["model"]
        for f in content["features"]
        if f["properties"]["layer"] == "sensor"
    ]
    assert model["elevations_deg"] == pytest.approx(np.rad2deg(SIDEWAYS.elevations).tolist())
    (back,) = parse(content).sensors
    np.testing.assert_allclose(back.model.rays(), SIDEWAYS.rays(), atol=1e-6)
    assert back.model.deviation(np.ones(1)) == SIDEWAYS.deviation(np.ones(1))
    assert back.model.max_range == SIDEWAYS.max_range


def test_models_are_made_and_found_by_name():
    assert make_model("RowLidar", {"elevations": [0.2, 0.05, 0.0, -0.4], "columns": 90}) == ROWS
    assert find_model("row-lidar") == RowLidar()
    assert RowLidar().shape == (32, 1800)
    assert {"depth-camera", "spinning-lidar", "solid-state-lidar"} <= set(MODELS)
    assert find_model("solid-state-lidar") == find_model("solid_state_lidar") == SolidStateLidar()
    assert make_model("DepthCamera", {"centre": [30.0, 20.0]}) == DepthCamera(centre=(30.0, 20.0))
    assert make_model("DepthCamera", {"centre": None, "width": 300}) == DepthCamera(width=300)


ROWS = RowLidar((0.2, 0.05, 0.0, -0.4), columns=90)
SIDEWAYS = RowLidar((0.1, 0.0, -0.3), columns=40, azimuth_fov=2.0, heading=1.5)
lidars = pytest.mark.parametrize("lidar", [ROWS, SIDEWAYS], ids=["turn", "sideways"])


@lidars
def test_rays_lie_in_its_rows_and_columns(lidar):
    rays = lidar.rays().astype(np.float64)
    assert rays.shape == (*lidar.shape, 3)
    np.testing.assert_allclose(np.linalg.norm(rays, axis=-1), 1, atol=1e-6)
    np.testing.assert_allclose(
        np.arcsin(rays[..., 2]), np.tile(lidar.elevations, (lidar.columns, 1)).T, atol=1e-6
    )
    azimuth = np.unwrap(np.arctan2(rays[0, :, 1], rays[0, :, 0]))
    np.testing.assert_allclose(np.diff(azimuth), lidar.azimuth_fov / lidar.columns, atol=1e-5)
    assert azimuth.mean() == pytest.approx(lidar.heading, abs=1e-5)


@lidars
def test_every_ray_that_meets_a_box_lies_in_one_of_its_windows_of_row_lidar(lidar):
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
        own = transform(invert(pose(*box[:3], yaw=box[6])), along.reshape(-1, 3)).reshape(
            along.shape
        )
        hit = (np.abs(own) <= box[3:6] / 2).all(axis=-1).any(axis=0)
        assert held.ravel()[hit].all()
    assert (found[:, 1] < found[:, 2]).all()
    sizes = (found[:, 2] - found[:, 1]) * (found[:, 4] - found[:, 3])
    assert np.median(sizes) < 0.2 * np.prod(lidar.shape)


@pytest.mark.parametrize(
    ("model", "change", "message"),
    [
        (SolidStateLidar, {"rows": 0}, "at least 1"),
        (SolidStateLidar, {"columns": 1.5}, "columns must be a whole number, got 1.5"),
        (SolidStateLidar, {"horizontal_fov": 120.0}, "deg2rad"),
        (SolidStateLidar, {"vertical_fov": np.nan}, "vertical_fov must be a number, got nan"),
        *(
            (SolidStateLidar, {"sigma": -1.0}, "sigma"),
            (SolidStateLidar, {"sigma_per_metre": -0.1}, "sigma_per_metre"),
        ),
        (SolidStateLidar, {"max_range": 0.0}, "max_range"),
        *(
            (RowLidar, {"elevations": e}, "must fall from row to row")
            for e in ((), (0.0, 0.1), (0.1, 0.1), (np.nan,))
        ),
        *(
            (RowLidar, {"elevations": (1.6, 0.0)}, "-pi/2..pi/2"),
            (RowLidar, {"columns": 0}, "at least 1"),
        ),
        *(
            (RowLidar, {"azimuth_fov": 7.0}, "2 pi"),
            (RowLidar, {"heading": 4.0}, "heading within pi"),
        ),
        *((RowLidar, {"sigma": -1.0}, "sigma"), (RowLidar, {"max_range": 0.0}, "max_range")),
    ],
)
def test_impossible_lidars_are_refused(model, change, message):
    # values of another type meet the shape checker first, where tests run with it
    with pytest.raises((ValueError, TypeError), match=f"{message}|Type-check error"):
        model(**change)


@dataclass(frozen=True)
class Blind:
    pixels: int = 3


@dataclass(frozen=True)
class Bare:
    pixels: int


@dataclass
class Loose:
    pixels: int = 3


@dataclass(frozen=True)
class Typed:
    type: str = "x"


@pytest.mark.parametrize("model", [DepthCamera, SpinningLidar, SolidStateLidar])
def test_shipped_models_have_a_name_in_files_and_one_in_words(model):
    assert model.__name__ in class_names()
    assert find_model_class(model.__name__) is model
    assert find_model(model.__name__) == model()


@pytest.mark.parametrize(
    "name", ["radar", "", "os.system", "DepthCamera()", "toolkit.sensors.models"]
)
def test_other_names_are_refused_with_those_there_are(name):
    with pytest.raises(
        ValueError, match=r"choose among DepthCamera, SpinningLidar, SolidStateLidar"
    ) as refusal:
        find_model(name)
    assert "\n" not in str(refusal.value)


@pytest.mark.parametrize(
    ("name", "values", "message"),
    [
        ("DepthCamera", {"zoom": 2}, "zoom is unknown to DepthCamera: it has width"),
        ("DepthCamera", {"centre": 3}, "centre"),
        ("DepthCamera", {"width": "wide"}, "width must be a whole number, got 'wide'"),
        ("SolidStateLidar", {"rows": [1, 2]}, "rows must be a whole number"),
        ("SpinningLidar", {"sigma": None}, "sigma must be a number, got None"),
    ],
)
def test_nonsense_of_files_is_refused(name, values, message):
    # values of another type meet the shape checker first, where tests run with it
    with pytest.raises(ValueError, match=f"{message}|Type-check error"):
        make_model(name, values)


@pytest.mark.parametrize(
    ("model", "message"),
    [
        *(
            (Blind, "Blind is not a SensorModel, it lacks .*rays"),
            (int, "int must be a frozen dataclass"),
        ),
        *(
            (Loose, "Loose must be a frozen dataclass"),
            (Bare, "fields of Bare need defaults"),
            (Typed, "no name of"),
        ),
        (type("DepthCamera", (DepthCamera,), {}), "sensor model DepthCamera exists already"),
    ],
)
def test_what_is_no_model_is_not_registered(model, message):
    before = dict(MODELS)
    with pytest.raises(ValueError, match=message):
        register_sensor_model(model)
    assert before == MODELS
