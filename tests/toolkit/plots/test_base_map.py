"""The sheet of a plan: its extent, scale bar, north, and what is drawn of the ground."""

import numpy as np
import pytest
import shapely

from toolkit.geometry import pose
from toolkit.plots.base_map import AROUND, draw_north, extent, fill_polygons, map_sheet, north, scale_length
from toolkit.plots.canvas import blank_figure, drawn_pixels, house_style
from toolkit.plots.palette import GROUND, SOLID
from toolkit.plots.plan_view import ground_entries
from toolkit.sites.site import Site, Solid

AREA = np.array([-20.0, -10, 20, 10])
LANE = np.array([[-20.0, -3], [20, -3], [20, 3], [-20, 3]])
HOUSE = Solid(np.array([[5.0, 4], [15, 4], [15, 9], [5, 9]]), 0.0, 6.0)
SITE = Site("crossing", AREA, lanes=(LANE,), solids=(HOUSE,))


def colour_at(sheet, pixels, x, y):
    column, up = sheet.axes.transData.transform((x, y))
    return "#{:02x}{:02x}{:02x}".format(*pixels[pixels.shape[0] - 1 - int(up), int(column)])


TALL, WIDE = Site("tall", np.array([0.0, 0, 10, 80])), Site("wide", np.array([0.0, 0, 300, 9]))


@pytest.mark.parametrize("site", [SITE, TALL, WIDE])
def test_the_map_is_to_scale(site):
    with house_style():
        sheet = map_sheet(site, "a title", legend=ground_entries(site))
    box = sheet.axes.get_window_extent()
    metres = np.array([np.ptp(sheet.axes.get_xlim()), np.ptp(sheet.axes.get_ylim())])
    assert np.array([box.width, box.height]) / 100 * 72 / metres == pytest.approx(sheet.points_per_metre)
    strip = sheet.figure.axes[1]
    bars = [patch for patch in strip.patches if np.asarray(patch.get_path().vertices)[:, 1].max() < 0]
    inches = max(np.asarray(patch.get_path().vertices)[:, 0].max() for patch in bars)
    (label,) = [text.get_text() for text in strip.texts if text.get_text().endswith(" m")]
    assert float(label[:-2]) * sheet.points_per_metre == pytest.approx(72 * inches)
    assert strip.get_window_extent().width / 100 == pytest.approx(np.ptp(strip.get_xlim()))  # its unit is the inch


def test_streets_and_houses_lie_where_they_are():
    with house_style():
        sheet = map_sheet(SITE, "a title")
        pixels = drawn_pixels(sheet.figure)
    assert colour_at(sheet, pixels, -10, 0) == GROUND["lanes"]
    assert colour_at(sheet, pixels, 10, 6) == SOLID["building"]
    assert colour_at(sheet, pixels, -10, 6) == "#ffffff"


def test_legend_and_title_hold_every_text():
    entries = [(handle, name) for name in ("_hidden", "$5", "x" * 60) for handle, _ in ground_entries(SITE)[:1]]
    with house_style():
        sheet = map_sheet(SITE, "a $title$", "below", legend=entries)
        drawn_pixels(sheet.figure)
    shown = sheet.figure.axes[1].get_legend()
    assert [text.get_text() for text in shown.get_texts()] == ["_hidden", "$5", "x" * 60]
    assert [text.get_text() for text in sheet.figure.texts] == ["a $title$", "below"]
    box, whole = shown.get_window_extent(), sheet.figure.bbox
    assert whole.x0 <= box.x0 < box.x1 <= whole.x1
    assert whole.y0 - 1 <= box.y0 < box.y1 <= sheet.axes.get_window_extent().y0


@pytest.mark.parametrize("count", [1, 4, 30])
def test_a_long_legend_lies_below_the_map(count):
    handle, _ = ground_entries(SITE)[0]
    with house_style():
        sheet = map_sheet(SITE, "a title", legend=[(handle, f"north-east pole, camera {k}") for k in range(count)])
        drawn_pixels(sheet.figure)
    box = sheet.figure.axes[1].get_legend().get_window_extent()
    assert 0 <= box.y0 < box.y1 < sheet.axes.get_window_extent().y0
    assert box.x1 <= sheet.figure.bbox.x1


@pytest.mark.parametrize("yaw", [0.0, 0.5, np.pi / 2, -3.0])
def test_north_is_that_of_the_map(yaw):
    site = Site("turned", AREA, map_SE3_site=pose(100.0, -5.0, yaw=yaw))
    on_map = pose(yaw=yaw)[:2, :2] @ north(site)
    assert on_map == pytest.approx([0, 1])


def test_the_arrow_points_north():
    with house_style():
        figure = blank_figure(2.0, 2.0)
        axes = figure.add_axes((0, 0, 1, 1))
        axes.set_axis_off()
        draw_north(axes, (0.5, 0.5), np.array([1.0, 0.0]))
        dark = drawn_pixels(figure).max(axis=2) < 128
    rows, columns = np.nonzero(dark)
    assert abs(rows.mean() - 100) < 3
    assert columns.max() - 100 > 1.3 * (100 - columns.min())  # the letter is at the right


def test_the_extent_holds_what_it_must():
    low, high = extent(SITE)
    assert (*low, *high) == (-20 - AROUND, -10 - AROUND, 20 + AROUND, 10 + AROUND)
    low, high = extent(SITE, np.array([[50.0, 0], [0, -31]]))
    assert (*low, *high) == (-30, -36, 55, 20)


@pytest.mark.parametrize(
    ("metres", "length"), [(0.09, 0.05), (1, 1), (1.99, 1), (2, 2), (49, 20), (50, 50), (4e3, 2e3)]
)
def test_scale_bars_are_round(metres, length):
    assert scale_length(float(metres)) == length


def test_holes_stay_open():
    ring = np.array([[0.0, 0], [10, 0], [10, 10], [0, 10]])
    shape = shapely.Polygon(ring, [ring * 0.5 + 2.5])
    with house_style():
        figure = blank_figure(1.0, 1.0)
        axes = figure.add_axes((0, 0, 1, 1))
        axes.set_axis_off()
        axes.set(xlim=(0, 10), ylim=(0, 10))
        fill_polygons(axes, [shape], "#000000", order=1.0)
        fill_polygons(axes, [], "#000000", order=1.0)
        pixels = drawn_pixels(figure)
    assert pixels[50, 50].tolist() == [255, 255, 255]
    assert pixels[50, 10].tolist() == [0, 0, 0]
    assert (pixels[..., 0] == 0).mean() == pytest.approx(0.75, abs=0.04)
