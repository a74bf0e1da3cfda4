"""Pictures of a site and of a frame show what is handed over, and come out the same each time."""

from xml.etree import ElementTree

import numpy as np
import pytest
from matplotlib.image import imread

from toolkit.geometry import look
from toolkit.objects import CYCLIST, VEHICLE, Detections, Objects
from toolkit.plots.palette import OUTCOME
from toolkit.plots.plan_view import FrameOutcome, draw_frame, draw_site
from toolkit.plots.pole_marks import pole_entries
from toolkit.plots.sensor_marks import sensor_entries
from toolkit.sensors.models import DepthCamera
from toolkit.sensors.sensor import Sensor
from toolkit.sites.site import Mount, Site

SQUARE = np.array([[-9.0, -9], [9, -9], [9, 9], [-9, 9]])
CAMERA = Sensor("d0", DepthCamera(), look((-10.0, 0.0, 5.0), 0.0, 0.2))
SITE = Site("square", np.array([-10.0, -10, 10, 10]), lanes=(SQUARE,), sensors=(CAMERA,))
BOXES = np.array([[0.0, 0, 0.75, 4, 2, 1.5, 0.3], [5, 5, 0.9, 1.8, 0.6, 1.8, 0]])
TRUTH, FOUND = (
    Objects(BOXES, np.array([VEHICLE, CYCLIST])),
    Detections(BOXES[::-1], np.array([0.9, 0.4])),
)
SEEN = {"truth": TRUTH, "detections": FOUND}
YES, NO = np.array([True, True]), np.array([False, False])


def picture(path):
    image = imread(path)
    assert np.ptp(image) > 0.5, "an empty picture"
    return image


@pytest.fixture(scope="module")
def bare(tmp_path_factory):
    path = tmp_path_factory.mktemp("bare") / "bare.png"
    draw_frame(SITE, path)
    return picture(path)


def test_sites_are_drawn_the_same_again(tmp_path):
    bare = Site("square", SITE.area, lanes=SITE.lanes)
    poles = Site("square", SITE.area, lanes=SITE.lanes, mounts=(Mount("p", np.array([3.0, 3, 0])),))
    for name, site in (("with", SITE), ("without", bare), ("poles", poles)):
        draw_site(site, tmp_path / f"{name}.png")
    assert (picture(tmp_path / "with.png") != picture(tmp_path / "without.png")).any()
    more = picture(tmp_path / "poles.png").min(axis=2) < 0.2
    ink = picture(tmp_path / "without.png").min(axis=2) < 0.2
    assert (more & ~ink)[: len(ink) // 2].sum() > 20  # the edge of a square in the map


def test_legends_name_sensors_and_poles():
    far = Sensor("north-east pole", DepthCamera(), CAMERA.pose)
    assert [name for _, name in sensor_entries([CAMERA])] == []
    assert [name for _, name in sensor_entries([CAMERA, far])] == ["1  d0", "2  north-east pole"]
    names = [name for _, name in pole_entries(used=2, unused=3)]
    assert names == ["pole with a sensor (2)", "pole without a sensor (3)"]
    assert [name for _, name in pole_entries(unused=1)] == ["pole (1)"]
    assert pole_entries() == []


def test_frames_are_drawn_the_same_again(tmp_path):
    cloud = np.random.default_rng(0).uniform(-9, 9, (500, 3))
    for name in ("a.png", "b.png"):
        draw_frame(
            SITE,
            tmp_path / name,
            clouds=[cloud],
            outcome=FrameOutcome(0.7, YES, NO, YES, NO),
            **SEEN,
        )
    assert (tmp_path / "a.png").read_bytes() == (tmp_path / "b.png").read_bytes()
    cloud = np.random.default_rng(0).uniform(-9, 9, (500, 3))
    draw_frame(SITE, tmp_path / "frame.svg", clouds=[cloud], title="a & b", **SEEN)
    root = ElementTree.parse(tmp_path / "frame.svg").getroot()
    assert len(root.findall(".//{*}image")) == 1
    assert len(root.findall(".//{*}path")) > 30
    with pytest.raises(ValueError, match="match the same frame"):
        draw_frame(
            SITE, tmp_path / "a.png", outcome=FrameOutcome(0.7, YES[:1], NO[:1], YES, NO), **SEEN
        )


@pytest.mark.one_in(3)
@pytest.mark.parametrize(
    "shown",
    [
        *(
            {"clouds": [np.random.default_rng(0).uniform(-9, 9, (500, 3))]},
            {"truth": SEEN["truth"]},
        ),
        {"detections": SEEN["detections"]},
        *(
            {"sensors": [CAMERA, Sensor("d1", DepthCamera(), look((10.0, 0.0, 5.0), 3.0, 0.2))]},
            {"title": "frame 3"},
        ),
        {"outcome": FrameOutcome(0.7, YES, NO, YES, NO)} | SEEN,
    ],
    ids=lambda shown: next(iter(shown)),
)
def test_a_frame_shows_what_is_handed_over(tmp_path, bare, shown):
    draw_frame(SITE, tmp_path / "a.png", **shown)
    one = picture(tmp_path / "a.png")
    assert one.shape != bare.shape or (one != bare).any()


@pytest.mark.one_in(2)
@pytest.mark.parametrize(
    ("outcome", "there"),
    [
        (FrameOutcome(0.7, YES, NO, YES, NO), {"hit"}),
        (FrameOutcome(0.7, ~YES, NO, ~YES, YES), {"missed", "not scored"}),
        (FrameOutcome(0.7, ~YES, YES, ~YES, NO), {"false alarm"}),
        (FrameOutcome(0.7, ~YES, NO, ~YES, NO), {"missed", "false alarm"}),
    ],
)
def test_hits_misses_and_false_alarms_are_told_apart(tmp_path, outcome, there):
    draw_frame(SITE, tmp_path / "frame.png", outcome=outcome, **SEEN)
    shown = picture(tmp_path / "frame.png")
    map_only = (shown[: int(0.85 * len(shown)), :, :3] * 255).round().astype(int)
    for name in ("hit", "missed", "false alarm"):
        colour = tuple(bytes.fromhex(OUTCOME[name].colour[1:]))
        assert ((map_only == colour).all(axis=2).sum() > 20) == (name in there), name
