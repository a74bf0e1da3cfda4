"""Signs of the live page: a map's north and scale where nothing covers them, poles, streets, first steps."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import shapely

from coview.live_signs import _find_room, add_signs
from coview.live_tables import describe_ap, describe_suggestions, figures_html, hint_html, variants_html
from placement_env.live.figures import FoundShare
from placement_env.live.planner import LivePlanner
from toolkit.plots.plan_view import north
from toolkit.runtime.run import Run
from toolkit.sites.files import load_site
from toolkit.sites.site import Mount, Site, Solid


class Scene:
    """Scene that keeps what is added, by name."""

    def __init__(self) -> None:
        self.added: dict[str, SimpleNamespace] = {}

    def __getattr__(self, kind: str):
        def add(name: str, *values: object, **options: object) -> SimpleNamespace:
            self.added[name] = SimpleNamespace(kind=kind, values=values, **options)
            return self.added[name]

        return add


@pytest.mark.parametrize(
    ("sensor", "pole", "place"),
    [("12-3", "12/3", "12-3"), ("12-3 b", "12/3", "12-3 b"), ("P10", "P1", "P10 on P1"), ("d0", "P1", "d0 on P1")],
)
def test_suggestions_name_a_pole_that_the_sensor_does_not(sensor, pole, place):
    answer = SimpleNamespace(ap=0.5, low=0.4, high=0.6)
    suggestion: Any = SimpleNamespace(sensor=SimpleNamespace(name=sensor, mount=pole), answer=answer, considered=9)
    assert describe_suggestions("remove", [suggestion]) == f"missed least: {place}: AP 0.500 (0.400 to 0.600)"


@pytest.fixture
def site() -> Site:
    return load_site("tjunction")


def test_poles_streets_north_and_scale_are_signs(site):
    scene, poles = Scene(), site.mounts[:3]
    labels = add_signs(scene, site, poles)
    assert sorted(labels) == sorted(pole.name for pole in poles)
    top = labels[poles[0].name].position[2]
    assert top == pytest.approx(poles[0].position[2] + poles[0].max_height)
    assert scene.added["/signs/north/letter"].values == ("N",)
    assert scene.added["/signs/scale/length"].values == ("20 m",)
    ends = scene.added["/signs/scale"].values[0][0]
    assert np.linalg.norm(ends[1, :2] - ends[0, :2]) == pytest.approx(20.0)
    shaft = scene.added["/signs/north"].values[0][0]
    np.testing.assert_allclose((shaft[1] - shaft[0])[:2] / 8.0, north(site), atol=1e-5)


def test_many_poles_have_no_names(site):
    many = [Mount(f"p{k}", np.array([0.1 * k, 0.0, 0.0])) for k in range(61)]
    assert add_signs(Scene(), site, many) == {}


def test_signs_are_where_no_solid_is(site):
    wall = Solid(np.array([[-9.0, -9.0], [9.0, -9.0], [9.0, 9.0], [-9.0, 9.0]]), 0.0, 5.0)
    bare = Site("s", np.array([-20.0, -20.0, 20.0, 20.0]), solids=(wall,))
    size = np.array([6.0, 6.0])
    spot = _find_room(bare, size, np.array([0.0, 0.0]))
    assert not shapely.box(*(spot - 3), *(spot + 3)).intersects(shapely.Polygon(wall.footprint))
    assert (np.abs(spot) <= 17.0).all()
    full = Site("s", np.array([-8.0, -8.0, 8.0, 8.0]), solids=(wall,))
    assert _find_room(full, size, np.array([5.0, 5.0])).tolist() == [5.0, 5.0]


def test_first_steps_speak_of_what_is_there():
    assert "Drag a ball" in hint_html(2)
    assert "No sensor is here yet" in hint_html(0)
    assert "ball" not in hint_html(0)


def test_long_names_break_and_figures_stay_whole():
    planner = LivePlanner("tjunction", run=Run(frames=2, seed=3, cache=None))
    answer, name = planner.answer(), "Friedrich-Ebert-Allee <b>, from the south-west to the middle junction"
    row = FoundShare(name, None, 0.5, float("nan"), float("nan"), 7)
    page = figures_html(replace(answer, approaches=(row,)))
    assert "Friedrich-Ebert-Allee &lt;b&gt;, from the south-west" in page
    assert "overflow-wrap:anywhere" in page
    assert "50%, N = 7" in page
    assert "white-space:nowrap" not in page


def test_ap_has_as_many_decimals_as_the_road_users_support():
    planner = LivePlanner("tjunction", run=Run(frames=2, seed=3, cache=None))
    known = {"ap": 0.51234, "low": 0.41234, "high": 0.61234, "worst": 0.31234, "change": 0.12345, "approaches": ()}
    few, many = (replace(planner.answer(), objects=count, **known) for count in (60, 600))
    assert describe_ap(few) == "AP 0.51 (0.41 to 0.61)"
    assert describe_ap(many) == "AP 0.512 (0.412 to 0.612)"
    assert ">0.51</span>" in figures_html(few)
    assert ">+0.12</b>" in figures_html(few)
    assert ">+0.123</b>" in figures_html(many)
    table = variants_html({"A": few, "B": many}, "A", {"A": "", "B": ""})
    assert ">0.31<br>" in table
    assert ">0.312<br>" in table
