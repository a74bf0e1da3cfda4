"""Tables of the live page's panel: figures with intervals and numbers, notes, small maps and the
table of variants."""

import math
import re
from dataclasses import replace
from types import SimpleNamespace
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest

from coview.live_tables import (
    MAP_REACH_M,
    describe_ap,
    describe_suggestions,
    details_html,
    draw_small_maps,
    figures_html,
    hint_html,
    map_html,
    note_html,
    site_html,
    variants_html,
)
from placement_env.handover.mounted import build_load
from placement_env.live.figures import FoundShare, LiveAnswer
from placement_env.live.planner import LivePlanner
from placement_env.live.suggestions import Suggestion
from placement_env.live.variant import LiveSensor
from toolkit.geometry import look
from toolkit.plots.palette import FAINT, OUTCOME, sensor_colour
from toolkit.runtime.run import Run
from toolkit.sensors.models import DepthCamera, SpinningLidar
from toolkit.sensors.sensor import Sensor
from toolkit.sites.site import Site, Solid

ROW = FoundShare("vehicle", None, 0.5, math.nan, math.nan, 7)
LINKS = tuple(
    replace(load, packets_s=20.0, airtime_ms_s=21.8)
    for load in (
        build_load("north", 9.0, 30.0, 12.0, 20.0, limited=True),
        build_load("south <b>", 15.0, 30.0, 18.0, 20.0, limited=True),
    )
)
ANSWER = LiveAnswer(
    what="moved <d0>",
    sensors=2,
    ap=0.75,
    low=0.7,
    high=0.8,
    recall=0.9,
    kbit=1234.4,
    price=2.0,
    worst=0.5,
    worst_low=0.4,
    worst_high=0.6,
    worst_sensor="d<1>",
    spread=0.02,
    change=0.0,
    change_low=0.0,
    change_high=0.0,
    classes=(ROW,),
    approaches=(ROW,),
    levels=(replace(ROW, name="dense"),),
    links=LINKS,
    objects=900,
    frames=16,
    unseen=1,
)


@pytest.fixture(scope="module")
def planner() -> LivePlanner:
    return LivePlanner("tjunction", run=Run(frames=2, seed=3, cache=None))


def read(page: str) -> str:
    """Words of a page as a person reads them."""
    return " ".join(re.sub(r"<[^>]*>", " ", page).split())


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({}, "0.750 AP, predicted 95 %: 0.700 to 0.800; N = 900 road users, 16 frames"),
        ({"coarse": True}, "AP, predicted (refining) 95 %"),
        ({"low": math.nan}, "95 %: no interval from few frames;"),
        ({"high": math.nan}, "95 %: no interval from few frames;"),
        ({}, "standard error of the prediction: 0.020."),
        ({"spread": math.nan}, "standard error of the prediction: unknown."),
        ({}, "Worst failure leaves AP 0.500 (0.400 to 0.600) without d&lt;1&gt;"),
        ({"worst_low": math.nan}, "Worst failure leaves AP 0.500 without d&lt;1&gt;"),
        ({"worst_sensor": ""}, "Worst failure leaves AP no sensor is left"),
        (
            {},
            (
                "Data 1,234 kbit per frame Price 2 poles, 2 sensors Seen by no sensor 1 of 900 "
                "road users"
            ),
        ),
        ({"price": 1.0}, "Price 1 pole, 2 sensors"),
        ({"price": 1.0, "budget": 3.0}, "Price 1 of 3 poles, 2 sensors"),
        (
            {"price": 2500.0, "budget": 9000.0, "currency": "EUR"},
            "Price 2,500 of 9,000 EUR, 2 sensors",
        ),
        ({}, "Fullest link 90% of 20 Mbit/s, south &lt;b&gt;"),
        ({"links": ()}, "Fullest link none"),
        ({"links": ()}, "Radio 0 packets a second, 0.0 % of the airtime of 802.11p"),
        ({}, "Radio 40 packets a second, 4.4 % of the airtime of 802.11p"),
        ({"problems": ("north carries <more>",)}, "&#9888; north carries &lt;more&gt;"),
        ({"approaches": (replace(ROW, recall=math.nan),)}, "vehicle none there, N = 7"),
        ({"approaches": (replace(ROW, low=0.4, high=0.65),)}, "vehicle 50% (40% to 65%), N = 7"),
        (
            {"classes": (ROW, replace(ROW, ap=0.6, low=0.5, high=0.7))},
            "vehicle 50% , AP 0.60 (0.50 to 0.70), N = 7",
        ),
        (
            {"classes": (ROW, replace(ROW, ap=math.nan))},
            "Found, by class (95 % interval) vehicle 50% , N = 7",
        ),
    ],
)
def test_figures_have_units_intervals_and_numbers(values, words):
    assert words.replace(" ,", ",") in read(figures_html(replace(ANSWER, **values)))


def test_one_class_is_no_table_of_classes():
    assert "by class" not in figures_html(ANSWER)
    assert "by class" in figures_html(replace(ANSWER, classes=(ROW, ROW)))
    assert "Found, by approach" in figures_html(ANSWER)


@pytest.mark.parametrize(
    ("change", "low", "words", "colour"),
    [
        (0.0123, 0.002, "+0.012 (+0.002 to +0.020) moved &lt;d0&gt;", OUTCOME["hit"].colour),
        (-0.0123, -0.05, "-0.012 (-0.050 to +0.020) moved &lt;d0&gt;", OUTCOME["missed"].colour),
        (0.0123, math.nan, "+0.012 moved &lt;d0&gt;", OUTCOME["hit"].colour),
    ],
)
def test_a_change_has_a_sign_an_interval_and_the_colour_of_gain_or_loss(change, low, words, colour):
    page = figures_html(replace(ANSWER, change=change, change_low=low, change_high=0.02))
    assert words in read(page)
    assert f'color:{colour}"><b class="live-change"' in page
    assert "live-change" not in figures_html(ANSWER)


def test_bars_are_as_long_as_shares():
    page = figures_html(
        replace(ANSWER, approaches=(ROW, replace(ROW, recall=math.nan), replace(ROW, recall=1.0)))
    )
    assert re.findall(r"width:(\d+)%\"></div>", page) == ["50", "0", "100"]


def test_details_tell_each_link_and_level():
    page = read(details_html(ANSWER))
    assert page.startswith(
        "Found, by traffic (95 % interval) dense 50%, N = 7 Links, over 16 frames"
    )
    assert "north 9.0, load 12.0 of 20 Mbit/s south &lt;b&gt; 15.0, load 18.0 of 20 Mbit/s" in page


def test_notes_tell_work_and_findings():
    assert read(note_html("", "")) == ""
    assert read(note_html("searching <x>", "")) == "searching &lt;x&gt; &#8230;"
    assert read(note_html("searching", "found <y>")) == "searching &#8230; found &lt;y&gt;"
    assert "<br>" not in note_html("", "found")


SQUARE = np.array([[-9.0, -9.0], [9.0, -9.0], [9.0, 9.0], [-9.0, 9.0]])


def test_the_site_of_small_maps_has_streets_and_buildings_with_north_up():
    solids = [Solid(SQUARE + 1, 0.0, 5.0, kind) for kind in ("building", "pond", "tree")]
    page = site_html(
        Site("s", np.array([-20.0, -10.0, 20.0, 30.0]), lanes=(SQUARE,), solids=tuple(solids))
    )
    paths = [path.get("d") for path in ElementTree.fromstring(page).iter("path")]
    assert paths == [
        "M-9.0,9.0 9.0,9.0 9.0,-9.0 -9.0,-9.0Z",
        *["M-8.0,8.0 10.0,8.0 10.0,-10.0 -8.0,-10.0Z"] * 2,
    ]


def read_view(path: str) -> np.ndarray:
    """Corners of a field of view on a small map, as x and y (m)."""
    return np.array([corner.split(",") for corner in path[1:-1].split()], float) * [1.0, -1.0]


def test_small_maps_show_each_sensor_with_its_field_of_view():
    camera = Sensor("a", DepthCamera(), look(np.array([3.0, 4.0, 5.0]), 0.5))
    lidar = Sensor("b", SpinningLidar(), look(np.array([-3.0, 4.0, 5.0]), 0.5))
    site = Site("s", np.array([-20.0, -10.0, 20.0, 30.0]))
    drawn = ElementTree.fromstring(map_html(site, [(camera, False), (lidar, True)]))
    assert drawn.get("viewBox") == "-20.0 -30.0 40.0 40.0"
    views, feet = list(drawn.iter("path")), list(drawn.iter("circle"))
    assert (
        [foot.get("fill") for foot in feet]
        == [view.get("fill") for view in views]
        == [sensor_colour(0), FAINT]
    )
    assert (feet[0].get("cx"), feet[0].get("cy")) == ("3.0", "-4.0")
    for sensor, view in zip((camera, lidar), views, strict=True):
        corners = read_view(view.get("d"))
        np.testing.assert_allclose(corners[0], sensor.position[:2], atol=0.06)
        ways = corners[1:] - corners[0]
        np.testing.assert_allclose(np.hypot(*ways.T), MAP_REACH_M, atol=0.1)
        ahead = sensor.world_SE3_body[:2, 0]
        turns = np.arctan2(ahead[0] * ways[:, 1] - ahead[1] * ways[:, 0], ways @ ahead)
        np.testing.assert_allclose(turns[4], 0.0, atol=0.01)
        assert np.unwrap(turns)[-1] - np.unwrap(turns)[0] == pytest.approx(
            sensor.model.horizontal_fov, abs=0.02
        )


def test_maps_that_are_drawn_already_are_kept(planner):
    yard = planner.yard
    old = yard.place(yard.site.sensors)
    failed = replace(old, sensors=tuple(replace(sensor, failed=True) for sensor in old.sensors))
    maps = draw_small_maps(yard, [old, failed], {old: "drawn"})
    assert maps[old] == "drawn"
    assert maps[failed].count(f'fill="{FAINT}" fill-opacity') == len(old.sensors)


def test_variants_are_side_by_side_with_the_one_that_is_shown_in_bold():
    answers = {
        "A<1>": ANSWER,
        "B": replace(ANSWER, ap=0.6, low=math.nan, kbit=5.0, price=2500.0, currency="EUR"),
    }
    page = variants_html(answers, "B", {"A<1>": "<i>map</i>", "B": ""})
    assert read(page) == (
        "AP (95&nbsp;%) AP, worst failure kbit per frame price, EUR A&lt;1&gt; map 0.750 0.700 "
        "to 0.800 0.500 0.400 to 0.600 1,234 2 B 0.600 no interval from few frames 0.500 0.400 "
        "to 0.600 5 2,500 N = 900 road users, 16 frames"
    )
    assert re.findall(r'live-variant" style="font-weight:(\d+)', page) == ["400", "700"]
    assert "price, poles" in variants_html({"A": ANSWER}, "A", {"A": ""})


def make_suggestion(kind: str, name: str, mount: str) -> Suggestion:
    return Suggestion(kind, LiveSensor(name, "eye", mount, 1.0, 2.0, 5.0, 0.0, 0.1), ANSWER, 40)


@pytest.mark.parametrize(
    ("kind", "suggestions", "words"),
    [
        (
            "add",
            [("d1", "d1")],
            "next sensor: d1: AP 0.750 (0.700 to 0.800) (of 40 placements so far)",
        ),
        (
            "move",
            [("d1", "p7")],
            "best place: d1 on p7: AP 0.750 (0.700 to 0.800) (of 40 placements so far)",
        ),
        ("remove", [("d1", "d1")], "missed least: d1: AP 0.750 (0.700 to 0.800)"),
        ("remove", [], "missed least: none"),
        ("add", [], "next sensor: none among the poles looked at so far; ask again"),
    ],
)
def test_suggestions_are_one_line(kind, suggestions, words):
    assert (
        describe_suggestions(kind, [make_suggestion(kind, *names) for names in suggestions])
        == words
    )


def test_first_steps_speak_of_what_is_there():
    assert "Drag a ball" in hint_html(2)
    assert "No sensor is here yet" in hint_html(0)
    assert "ball" not in hint_html(0)


def test_long_names_break_and_figures_stay_whole(planner):
    answer, name = (
        planner.answer(),
        "Friedrich-Ebert-Allee <b>, from the south-west to the middle junction",
    )
    row = FoundShare(name, None, 0.5, float("nan"), float("nan"), 7)
    page = figures_html(replace(answer, approaches=(row,)))
    assert "Friedrich-Ebert-Allee &lt;b&gt;, from the south-west" in page
    assert "overflow-wrap:anywhere" in page
    assert "50%, N = 7" in page
    assert "white-space:nowrap" not in page


def test_ap_has_as_many_decimals_as_the_road_users_support(planner):
    known = {
        "ap": 0.51234,
        "low": 0.41234,
        "high": 0.61234,
        "worst": 0.31234,
        "change": 0.12345,
        "approaches": (),
    }
    few, many = (replace(planner.answer(), objects=count, **known) for count in (60, 600))
    assert describe_ap(few) == "AP 0.51 (0.41 to 0.61)"
    assert describe_ap(many) == "AP 0.512 (0.412 to 0.612)"
    assert ">0.51</span>" in figures_html(few)
    assert ">+0.12</b>" in figures_html(few)
    assert ">+0.123</b>" in figures_html(many)
    table = variants_html({"A": few, "B": many}, "A", {"A": "", "B": ""})
    assert ">0.31<br>" in table
    assert ">0.312<br>" in table


@pytest.mark.parametrize(
    ("sensor", "pole", "place"),
    [
        ("12-3", "12/3", "12-3"),
        ("12-3 b", "12/3", "12-3 b"),
        ("P10", "P1", "P10 on P1"),
        ("d0", "P1", "d0 on P1"),
    ],
)
def test_suggestions_name_a_pole_that_the_sensor_does_not(sensor, pole, place):
    answer = SimpleNamespace(ap=0.5, low=0.4, high=0.6, objects=900)
    suggestion: Any = SimpleNamespace(
        sensor=SimpleNamespace(name=sensor, mount=pole), answer=answer, considered=9
    )
    assert (
        describe_suggestions("remove", [suggestion])
        == f"missed least: {place}: AP 0.500 (0.400 to 0.600)"
    )
