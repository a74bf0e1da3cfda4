"""The sheet of a map, and sensors, poles and boxes on it."""

import numpy as np
import pytest
import shapely

from toolkit.geometry import look, pose
from toolkit.objects import LABELS, Objects
from toolkit.plots import (
    ground_map,
    map_sheet,
    north_arrow,
    outcome_marks,
    pole_marks,
    sensor_marks,
)
from toolkit.plots.canvas import blank_figure, house_style, render_pixels
from toolkit.plots.ground_map import ground_entries
from toolkit.plots.palette import CLASS, GROUND, INK, OUTCOME, PAPER_WHITE, SOLID
from toolkit.sensors.models import DepthCamera, SpinningLidar
from toolkit.sensors.sensor import Sensor
from toolkit.sites.site import Site, Solid

AREA = np.array([-20.0, -10, 20, 10])
HOUSE = Solid(np.array([[5.0, 4], [15, 4], [15, 9], [5, 9]]), 0.0, 6.0)
SITE = Site(
    "crossing", AREA, lanes=(np.array([[-20.0, -3], [20, -3], [20, 3], [-20, 3]]),), solids=(HOUSE,)
)


def colour_at(sheet, pixels, x, y):
    column, up = sheet.axes.transData.transform((x, y))
    return "#{:02x}{:02x}{:02x}".format(*pixels[pixels.shape[0] - 1 - int(up), int(column)])


TALL, WIDE = Site("tall", np.array([0.0, 0, 10, 80])), Site("wide", np.array([0.0, 0, 300, 9]))


@pytest.mark.parametrize("site", [SITE, TALL, WIDE])
def test_the_map_is_to_scale(site):
    with house_style():
        sheet = map_sheet.map_sheet(site, "a title", legend=ground_entries(site))
    box = sheet.axes.get_window_extent()
    metres = np.array([np.ptp(sheet.axes.get_xlim()), np.ptp(sheet.axes.get_ylim())])
    assert np.array([box.width, box.height]) / 100 * 72 / metres == pytest.approx(
        sheet.points_per_metre
    )
    strip = sheet.figure.axes[1]
    bars = [
        patch for patch in strip.patches if np.asarray(patch.get_path().vertices)[:, 1].max() < 0
    ]
    inches = max(np.asarray(patch.get_path().vertices)[:, 0].max() for patch in bars)
    (label,) = [text.get_text() for text in strip.texts if text.get_text().endswith(" m")]
    assert float(label[:-2]) * sheet.points_per_metre == pytest.approx(72 * inches)
    assert strip.get_window_extent().width / 100 == pytest.approx(
        np.ptp(strip.get_xlim())
    )  # its unit is the inch


def test_maps_show_streets_and_texts():
    with house_style():
        sheet = map_sheet.map_sheet(SITE, "a title")
        pixels = render_pixels(sheet.figure)
    assert colour_at(sheet, pixels, -10, 0) == GROUND["lanes"]
    assert colour_at(sheet, pixels, 10, 6) == SOLID["building"]
    assert colour_at(sheet, pixels, -10, 6) == "#ffffff"
    entries = [
        (handle, name)
        for name in ("_hidden", "$5", "x" * 60)
        for handle, _ in ground_entries(SITE)[:1]
    ]
    with house_style():
        sheet = map_sheet.map_sheet(SITE, "a $title$", "below", legend=entries)
        render_pixels(sheet.figure)
    shown = sheet.figure.axes[1].get_legend()
    assert [text.get_text() for text in shown.get_texts()] == ["_hidden", "$5", "x" * 60]
    assert [text.get_text() for text in sheet.figure.texts] == ["a $title$", "below"]
    box, whole = shown.get_window_extent(), sheet.figure.bbox
    assert whole.x0 <= box.x0 < box.x1 <= whole.x1
    assert whole.y0 - 1 <= box.y0 < box.y1 <= sheet.axes.get_window_extent().y0


def test_maps_point_north_and_have_a_scale():
    for yaw in (0.0, 0.5, np.pi / 2, -3.0):
        site = Site("turned", AREA, map_SE3_site=pose(100.0, -5.0, yaw=yaw))
        assert pose(yaw=yaw)[:2, :2] @ north_arrow.north(site) == pytest.approx([0, 1])
    for metres, length in ((0.09, 0.05), (1, 1), (1.99, 1), (2, 2), (49, 20), (50, 50), (4e3, 2e3)):
        assert map_sheet.scale_length(float(metres)) == length
    assert np.ravel(map_sheet.extent(SITE)).tolist() == [
        *(
            -20 - map_sheet.MAP_MARGIN_M,
            -10 - map_sheet.MAP_MARGIN_M,
            20 + map_sheet.MAP_MARGIN_M,
            10 + map_sheet.MAP_MARGIN_M,
        )
    ]
    assert np.ravel(map_sheet.extent(SITE, np.array([[50.0, 0], [0, -31]]))).tolist() == [
        -30,
        -36,
        55,
        20,
    ]


@pytest.mark.one_in(2)
@pytest.mark.parametrize("count", [1, 4, 30])
def test_a_long_legend_lies_below_the_map(count):
    handle, _ = ground_entries(SITE)[0]
    with house_style():
        sheet = map_sheet.map_sheet(
            SITE, "a title", legend=[(handle, f"north-east pole, camera {k}") for k in range(count)]
        )
        render_pixels(sheet.figure)
    box = sheet.figure.axes[1].get_legend().get_window_extent()
    assert 0 <= box.y0 < box.y1 < sheet.axes.get_window_extent().y0
    assert box.x1 <= sheet.figure.bbox.x1


def test_arrows_point_north_and_holes_stay_open():
    with house_style():
        figure = blank_figure(2.0, 2.0)
        axes = figure.add_axes((0, 0, 1, 1))
        axes.set_axis_off()
        north_arrow.draw_north(axes, (0.5, 0.5), np.array([1.0, 0.0]))
        dark = render_pixels(figure).max(axis=2) < 128
    rows, columns = np.nonzero(dark)
    assert abs(rows.mean() - 100) < 3
    assert columns.max() - 100 > 1.3 * (100 - columns.min())  # the letter is at the right
    ring = np.array([[0.0, 0], [10, 0], [10, 10], [0, 10]])
    shape = shapely.Polygon(ring, [ring * 0.5 + 2.5])
    with house_style():
        figure = blank_figure(1.0, 1.0)
        axes = figure.add_axes((0, 0, 1, 1))
        axes.set_axis_off()
        axes.set(xlim=(0, 10), ylim=(0, 10))
        ground_map.fill_polygons(axes, [shape], "#000000", order=1.0)
        ground_map.fill_polygons(axes, [], "#000000", order=1.0)
        pixels = render_pixels(figure)
    assert pixels[50, 50].tolist() == [255, 255, 255]
    assert pixels[50, 10].tolist() == [0, 0, 0]
    assert (pixels[..., 0] == 0).mean() == pytest.approx(0.75, abs=0.04)


TOWER = np.array([[10.0, -5], [20, -5], [20, 5], [10, 5]])
BOX = np.array([[3.0, 4, 0.75, 4, 2, 1.5, 0.5]])


@pytest.fixture
def axes():
    with house_style():
        made = blank_figure(4.0, 4.0).add_axes((0, 0, 1, 1))
        made.set(xlim=(-20, 20), ylim=(-20, 20))
        yield made


def sensor(name="d0", at=(0.0, 0.0, 5.0), heading=0.0, fov=1.0):
    return Sensor(name, DepthCamera(fov=fov), look(at, heading, 0.2))


def test_poles_sensors_and_objects_are_told_apart(axes):
    many = [sensor(f"north-east pole {k}", (3.0 * k, 0.0, 5.0)) for k in range(30)]
    sensor_marks.draw_sensors(axes, many, 40.0)
    assert [text.get_text() for text in axes.texts] == [str(k + 1) for k in range(30)]
    pole_marks.draw_poles(axes, np.array([[0.0, 0], [3, 3]]))
    pole_marks.draw_poles(axes, np.array([[5.0, 5]]), carries_sensor=True)
    hollow, filled = axes.get_lines()[-2:]
    assert hollow.get_markersize() == filled.get_markersize() >= 6
    assert (hollow.get_markerfacecolor(), filled.get_markerfacecolor()) == (PAPER_WHITE, INK)


def test_discs_have_room_and_short_names():
    for names, labels in (
        *(([], []), (["d0", "d11"], ["d0", "d11"])),
        *((["d0", "post"], ["1", "2"]), (["_a", "$"], ["_a", "$"])),
    ):
        assert sensor_marks.sensor_labels(names) == labels
    assert outcome_marks.text_colour("#ffffff") == outcome_marks.text_colour("#f500c7") == INK
    assert (
        outcome_marks.text_colour("#000000") == outcome_marks.text_colour("#4463f6") == PAPER_WHITE
    )
    places, headings = np.zeros((6, 2)), np.arange(6.0)
    discs = sensor_marks.spread_discs(places, headings, 10.0)
    apart = np.linalg.norm(discs[:, None] - discs[None], axis=2)[np.triu_indices(6, 1)]
    assert apart.min() >= 10 * (1 - 1e-9)
    assert discs[0].tolist() == [0, 0]
    assert np.linalg.norm(discs, axis=1).max() < 25
    places = np.array([[0.0, 0], [20, 0], [0, 20]])
    assert np.array_equal(sensor_marks.spread_discs(places, np.zeros(3), 10.0), places)
    assert sensor_marks.spread_discs(np.zeros((0, 2)), np.zeros(0), 10.0).shape == (0, 2)
    discs = sensor_marks.spread_discs(np.zeros((2, 2)), np.array([0.0, np.pi / 2]), 10.0)
    assert discs[1] == pytest.approx([0, 11])


@pytest.mark.parametrize("model", [DepthCamera(), SpinningLidar()], ids=["camera", "lidar"])
def test_the_heading_is_that_of_the_optical_axis(model):
    placed = pose(1.0, 2.0, 5.0, yaw=0.7, pitch=0.3) @ model.body_SE3_sensor
    assert sensor_marks.sensor_heading(Sensor("s", model, placed)) == pytest.approx(0.7)


def test_a_field_of_view_ends_at_a_building_but_its_own_and_may_be_a_full_turn():
    free, cut = (
        sensor_marks.wedge(sensor(), []),
        sensor_marks.wedge(sensor(), [shapely.Polygon(TOWER)]),
    )
    assert np.linalg.norm(free[1:], axis=1) == pytest.approx(sensor_marks.VIEW_RANGE_M)
    assert free[0].tolist() == [0, 0]
    ahead = np.abs(np.arctan2(*free[1:].T[::-1])) < np.arctan2(5, 10)
    assert cut[1:][ahead][:, 0] == pytest.approx(10)
    assert np.linalg.norm(cut[1:][~ahead], axis=1) == pytest.approx(sensor_marks.VIEW_RANGE_M)
    assert shapely.Polygon(free).area == pytest.approx(
        sensor_marks.VIEW_RANGE_M**2 * 1.0 / 2, rel=0.01
    )
    west = sensor_marks.wedge(sensor(at=(10.0, 0.0, 5.0), heading=np.pi), [shapely.Polygon(TOWER)])
    assert west[1:, 0].min() == pytest.approx(-15, abs=0.01)
    ring = sensor_marks.wedge(Sensor("l", SpinningLidar(), pose(1.0, 2.0, 3.0)), [])
    assert np.linalg.norm(ring - [1, 2], axis=1) == pytest.approx(sensor_marks.VIEW_RANGE_M)


KINDS = [("building", 6.0, True), ("building", 1.0, False), ("pond", 6.0, False)]


@pytest.mark.parametrize(("kind", "top", "cut"), KINDS)
def test_only_tall_buildings_cut_fields_of_view(axes, kind, top, cut):
    sensor_marks.draw_wedges(axes, [sensor()], [Solid(TOWER, 0.0, top, kind)])
    assert (axes.patches[0].get_xy()[:, 0].max() < 24) == cut


def test_names_of_poles_keep_clear_of_each_other_and_of_sensors(axes):
    places = np.array([[0.0, 0], [0.5, 0], [1.0, 0.2], [9, 9]])
    pole_marks.name_poles(
        axes, places, ["pole1", "pole2", "pole3", "pole4"], 10.0, np.array([[10.0, 9.0]])
    )
    boxes = [(t.get_position()[0] * 10, t.get_position()[1] * 10, 3.9 * 5 + 1) for t in axes.texts]
    assert len(boxes) >= 3
    for k, (x, y, width) in enumerate(boxes):
        for u, v, _ in boxes[:k]:
            assert abs(x - u) >= width - 1e-6 or abs(y - v) >= 7.5 - 1e-6
        assert np.abs([100 - x - width / 2, 90 - y - 3.75]).max() > sensor_marks.DISC_POINTS / 2


def test_objects_are_filled_by_class(axes):
    boxes = np.repeat(BOX, 4, axis=0)
    boxes[:, 0] += 9.0 * np.arange(4)
    outcome_marks.draw_objects(axes, Objects(boxes, np.arange(4)))
    faces = [patch.get_facecolor()[:3] for patch in axes.patches]
    assert [f"#{''.join(f'{round(255 * c):02x}' for c in face)}" for face in faces] == [
        CLASS[name] for name in LABELS
    ]
    assert np.allclose(axes.patches[1].get_xy()[:4].mean(axis=0), [12, 4])


@pytest.mark.parametrize("outcome", list(OUTCOME))
def test_outcomes_have_their_lines_and_marks(axes, outcome):
    outcome_marks.draw_outcome(axes, BOX, outcome)
    ring, nose, *marks = axes.get_lines()
    assert ring.get_color() == OUTCOME[outcome].colour
    assert ring.get_xydata()[:4].mean(axis=0) == pytest.approx(BOX[0, :2])
    towards = nose.get_xydata()[1] - nose.get_xydata()[0]
    assert np.arctan2(*towards[::-1]) == pytest.approx(0.5)
    assert [mark.get_marker() for mark in marks] == [OUTCOME[outcome].marker] * bool(
        OUTCOME[outcome].marker
    )
