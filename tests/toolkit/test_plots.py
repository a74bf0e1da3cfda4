"""Pictures are written whole, show what is handed over, and come out the same each time."""

import numpy as np
import pytest
from matplotlib.image import imread

from toolkit.geometry import look
from toolkit.objects import CYCLIST, VEHICLE, Detections, Objects
from toolkit.plots import draw_density_cdf, draw_frame, draw_pr_curves, draw_site, draw_training, sensor_colour
from toolkit.sensors.depth_camera import DepthCamera
from toolkit.sensors.sensor import Sensor
from toolkit.sites.site import Site

SQUARE = np.array([[-9.0, -9], [9, -9], [9, 9], [-9, 9]])
CAMERA = Sensor("d0", DepthCamera(), look((-10.0, 0.0, 5.0), 0.0, 0.2))
SITE = Site("square", np.array([-10.0, -10, 10, 10]), lanes=(SQUARE,), sensors=(CAMERA,))
BOXES = np.array([[0.0, 0, 0.75, 4, 2, 1.5, 0.3], [5, 5, 0.9, 1.8, 0.6, 1.8, 0]])
LINE = np.linspace(0, 1, 5)


def picture(path):
    image = imread(path)
    assert np.ptp(image) > 0.5, "an empty picture"
    return image


def test_every_tenth_sensor_has_the_same_colour():
    colours = [sensor_colour(index) for index in range(20)]
    assert len(set(colours)) == 10
    assert colours[:10] == colours[10:]
    assert all(0 <= part <= 1 for colour in colours for part in colour)


def test_a_site_with_sensors_is_drawn_with_them(tmp_path):
    draw_site(SITE, tmp_path / "with.png")
    draw_site(Site("square", SITE.area, lanes=SITE.lanes), tmp_path / "without.png")
    assert (picture(tmp_path / "with.png") != picture(tmp_path / "without.png")).any()


@pytest.mark.parametrize(
    "shown",
    [
        {"clouds": [np.random.default_rng(0).uniform(-9, 9, (500, 3))]},
        {"truth": Objects(BOXES, np.array([VEHICLE, CYCLIST]))},
        {"detections": Detections(BOXES, np.array([0.9, 0.4]))},
        {"sensors": [CAMERA, Sensor("d1", DepthCamera(), look((10.0, 0.0, 5.0), 3.0, 0.2))]},
        {"title": "frame 3"},
    ],
    ids=lambda shown: next(iter(shown)),
)
@pytest.mark.filterwarnings("ignore:No artists with labels")
def test_a_frame_shows_what_is_handed_over(tmp_path, shown):
    draw_frame(SITE, tmp_path / "bare.png")
    for name in ("a.png", "b.png"):
        draw_frame(SITE, tmp_path / name, **shown)
    one, other, bare = (picture(tmp_path / name) for name in ("a.png", "b.png", "bare.png"))
    assert np.array_equal(one, other)
    assert one.shape != bare.shape or (one != bare).any()


def test_curves(tmp_path):
    draw_pr_curves({"early": (LINE, 1 - LINE)}, tmp_path / "pr.png", title="IoU 0.7")
    draw_density_cdf({"0, 2": np.array([3, 0, 8]), "none": np.zeros(0, np.int64)}, tmp_path / "cdf.png")
    assert picture(tmp_path / "pr.png").shape == picture(tmp_path / "cdf.png").shape


LOSS = {"loss": ([1.0, 2.0], [3.0, 1.0])}
AP = {"AP 0.7": ([2.0], [0.5])}


@pytest.mark.parametrize(
    ("curves", "files"), [(LOSS, {"losses.png"}), (LOSS | AP, {"losses.png", "ap.png"}), ({}, set())]
)
def test_a_training_has_a_picture_of_what_was_measured(tmp_path, curves, files):
    draw_training(curves, tmp_path)
    assert {path.name for path in tmp_path.iterdir()} == files
