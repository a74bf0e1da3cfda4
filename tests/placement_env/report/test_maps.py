"""Maps of a plan: sound SVG of a small size, the same each time, that change with what they
show."""

import base64
import re
from io import BytesIO
from xml.etree import ElementTree

import numpy as np
import pytest
from matplotlib.colors import to_rgb
from matplotlib.image import imread

from placement_env.handover.ground import GroundGrid
from placement_env.report.maps import (
    PIXELS_PER_CELL,
    blind_map,
    coverage_map,
    density_map,
    plan_view,
    smooth,
)
from toolkit.geometry import look
from toolkit.plots.palette import BLIND, VIEW_COLOURS, point_colours
from toolkit.sensors.models import DepthCamera
from toolkit.sensors.sensor import Sensor
from toolkit.sites.files import load_site
from toolkit.sites.site import Mount, Site

LANE = np.array([[-10.0, -3], [10, -3], [10, 3], [-10, 3]])
MOUNTS = tuple(
    Mount(name, np.array([2.0 * k - 8, 5.0, 0.0]))
    for k, name in enumerate(("a", "$b_1$", "<c>", "_d"))
)
SITE = Site("cross & <road>", np.array([-10.0, -6, 10, 6]), lanes=(LANE,), mounts=MOUNTS)
SENSORS = [
    Sensor(f"pole $_{k}", DepthCamera(), look((3.0 * k, 6.0, 5.0), -1.5, 0.3)) for k in range(2)
]
X, Y = np.arange(10) * 2.0 - 9, np.arange(6) * 2.0 - 5
SEEN = np.zeros((2, 6, 10), bool)
SEEN[0, :, :6] = SEEN[1, :, 4:8] = True
OPEN = np.ones((6, 10), bool)
OPEN[0, 0] = False
LANES = np.zeros((6, 10), bool)
LANES[2:4] = True
GROUND = GroundGrid(
    X, Y, SEEN, SEEN * np.float32(30), OPEN, LANES, ~LANES & (np.arange(6) < 2)[:, None]
)
MAPS = [coverage_map, density_map, blind_map]


def cells_of(text):
    """The picture of cells in a map, from the bottom up: it is turned over where it is shown."""
    (image,) = [each for each in ElementTree.fromstring(text).iter() if each.tag.endswith("image")]
    (data,) = [value for key, value in image.attrib.items() if key.endswith("href")]
    pixels = imread(BytesIO(base64.b64decode(data.partition(",")[2])))
    rows, columns = pixels.shape[0] // 6, pixels.shape[1] // 10
    assert rows >= PIXELS_PER_CELL
    assert columns >= PIXELS_PER_CELL
    return pixels[rows // 2 :: rows, columns // 2 :: columns][:6, :10]


@pytest.mark.parametrize("draw", MAPS)
def test_maps_are_sound_the_same_each_time_and_of_their_sensors(draw):
    one, other = (draw(SITE, GROUND, SENSORS) for _ in range(2))
    assert one == other
    assert ElementTree.fromstring(one).tag == "{http://www.w3.org/2000/svg}svg"
    with pytest.raises(ValueError, match="2 sensors, got 1"):
        draw(SITE, GROUND, SENSORS[:1])


def test_coverage_has_the_colours_of_views():
    cells = cells_of(coverage_map(SITE, GROUND, SENSORS))
    views = SEEN.sum(axis=0)
    for k in range(3):
        wanted = OPEN & (views == k)
        assert np.abs(cells[wanted][:, :3] - to_rgb(VIEW_COLOURS[k])).max() < 0.01
    assert (cells[OPEN][:, 3] == 1).all()
    assert cells[0, 0, 3] == 0


def test_blind_spots_have_the_colour_of_their_ground():
    cells = cells_of(blind_map(SITE, GROUND, SENSORS))
    blind = OPEN & ~SEEN.any(axis=0)
    assert np.array_equal(cells[..., 3] == 1, blind)
    for kind, mask in (
        ("lanes", LANES),
        ("footways", GROUND.footways),
        ("elsewhere", ~LANES & ~GROUND.footways),
    ):
        assert np.abs(cells[blind & mask][:, :3] - to_rgb(BLIND[kind])).max() < 0.01


def test_density_is_in_the_colours_of_points():
    cells = cells_of(density_map(SITE, GROUND, SENSORS))  # cells of 2 m are not averaged
    expected = point_colours(30.0 * SEEN.sum(axis=0))
    assert np.abs(cells[OPEN] - expected[OPEN]).max() < 0.01


def test_means_are_of_counted_cells():
    values = np.zeros((5, 5))
    values[2, 2], values[0, 0] = 9.0, 100.0
    counted = np.ones((5, 5), bool)
    counted[0, 0] = False
    mean = smooth(values, counted, 0.5)
    assert mean[2, 2] == pytest.approx(1.0)
    assert mean[1, 1] == pytest.approx(9 / 8)
    assert mean[4, 4] == 0
    assert np.array_equal(smooth(values, counted, 2.0), np.where(counted, values, 0))
    assert not smooth(values, counted & False, 0.5).any()


@pytest.mark.slow
def test_plan_views_show_poles_none_or_thirty_sensors():
    bare = plan_view(SITE, SENSORS)
    assert bare == plan_view(SITE, SENSORS)
    with_poles = plan_view(SITE, SENSORS, ["a"], ["$b_1$", "<c>", "_d"])
    with_ground = plan_view(SITE, SENSORS, ["a"], ["$b_1$", "<c>", "_d"], GROUND)
    assert len({bare, with_poles, with_ground}) == 3
    for text in (bare, with_poles, with_ground):
        ElementTree.fromstring(text)
        assert "<image" not in text
    with pytest.raises(ValueError, match="has no pole 'z'"):
        plan_view(SITE, SENSORS, ["z"])
    with pytest.raises(ValueError, match="got 1"):
        plan_view(SITE, SENSORS[:1], ground=GROUND)
    nothing = GroundGrid(
        X, Y, SEEN[:0], GROUND.density[:0], OPEN & False, LANES & False, LANES & False
    )
    for draw in MAPS:
        ElementTree.fromstring(draw(SITE, nothing, []))
    ElementTree.fromstring(plan_view(SITE, [], ground=nothing))
    site = load_site("roundabout")
    many = [
        Sensor(f"north-east pole {k}", DepthCamera(), look((k, -k / 2, 5.0), k, 0.3))
        for k in range(30)
    ]
    x = np.arange(96) + 0.5 - 48
    seen = np.array([np.hypot(x - k, x[:, None] + k) < 20 for k in range(30)])
    free = np.ones((96, 96), bool)
    ground = GroundGrid(x, x, seen, seen.astype(np.float32) * 3, free, free, ~free)
    text = coverage_map(site, ground, many)
    assert len(text) < 300_000
    assert len(plan_view(site, many, [], [mount.name for mount in site.mounts], ground)) < 300_000
    assert len(re.findall("<path", text)) > 60
