"""What nouns show: short reprs, HTML in which every name is escaped, tables for pandas."""

from collections.abc import Callable
from dataclasses import replace
from html.parser import HTMLParser

import numpy as np
import pandas
import pytest

from placement_env import Objective, Setting, greedy
from placement_env.report.content import Plan, Planned, Verdict
from placement_env.search.result import Result
from toolkit import Detections, Objects, Run, load_site
from toolkit.datasets.listing import Listing
from toolkit.datasets.recording_views import Part
from toolkit.display import MOST_ROWS, Card, Displayed
from toolkit.frame import Frame, SensorCloud
from toolkit.sites.site import Site

EVIL = '<script>alert("&")</script>'
BOXES = np.array([[0.0, 0, 1, 4, 2, 1.5, 0], [10, 5, 1, 2, 1, 1.5, 1]])


def frame(name: str = "a") -> Frame:
    rng = np.random.default_rng(0)
    cloud = SensorCloud(name, rng.uniform(-20, 20, (50, 3)).astype(np.float32), np.eye(4))
    return Frame.of_clouds(name, (cloud,), Objects(BOXES, np.array([0, 2])))


def recording(name: str = "a") -> Listing:
    return Listing((name,), frame)


def pool(count: int = 12):
    site = load_site("tjunction")
    return Objective(
        Setting(site, candidates="paper", fidelity="coverage"), Run(frames=1)
    ).candidates


NOUNS: dict[str, Callable[[str], Displayed]] = {
    "site": lambda name: replace(load_site("tjunction"), name=name, solids=(), network=""),
    "frame": frame,
    "recording": recording,
    "part": lambda name: Part(recording(name), 1),
    "objects": lambda name: Objects(BOXES),
    "detections": lambda name: Detections(BOXES, np.array([0.5, 0.25])),
    "candidates": lambda name: pool(),
    "plan": lambda name: Plan(
        {}, name, "", 0.7, "early", "EUR", Verdict(False, f"{name}: nothing may be built"), None
    ),
}


class _Tags(HTMLParser):
    def __init__(self) -> None:
        super().__init__()
        self.opened: list[str] = []
        self.images: list[str] = []

    def handle_starttag(self, tag, attributes) -> None:
        self.opened.append(tag)
        self.images += [dict(attributes)["src"]] if tag == "img" else []


def html(noun: Displayed) -> str:
    """What a notebook shows of a noun."""
    return noun._repr_html_()


def tags(html: str) -> _Tags:
    parser = _Tags()
    parser.feed(html)
    return parser


@pytest.mark.parametrize("kind", NOUNS)
def test_reprs_are_short_and_pages_show_a_picture_and_a_table(kind):
    noun = NOUNS[kind]("place")
    assert len(repr(noun)) < 400
    assert "\n" not in repr(noun)
    seen = tags(html(noun))
    assert len(seen.images) == (kind != "plan")
    assert all(
        source.startswith("data:image/png;base64,") and len(source) > 2000 for source in seen.images
    )
    assert ("table" in seen.opened) == (kind != "plan")


@pytest.mark.parametrize("kind", ["site", "frame", "recording", "plan"])
def test_names_from_outside_are_escaped(kind):
    noun = NOUNS[kind](EVIL)
    shown = html(noun)
    assert "script" not in tags(shown).opened
    assert "&lt;script&gt;" in shown


def test_repr_of_boxes_counts_them_by_class():
    assert repr(Objects(BOXES, np.array([0, 2]))) == "Objects: 2 boxes, 1 vehicle, 1 pedestrian"
    assert repr(Detections.empty()) == "Detections: 0 boxes"
    assert "<table" not in html(Detections.empty())


def test_rows_keep_their_repr_and_pick_rows_as_before():
    assert repr(Objects(BOXES)[:1]) == "Objects: 1 box, 1 vehicle"


def test_a_missing_picture_is_said_in_its_place():
    class Broken(Displayed):
        def _card(self) -> Card:
            return Card("Broken", ("no file",), {}, "toolkit.plots.plan_view:draw_site")

    class Gone(Listing):
        pass

    empty = Gone((), frame)
    assert "no picture" in html(empty)
    assert repr(empty) == "Gone: 0 frames"
    with pytest.raises(AttributeError):  # a fault of ours is not hidden
        html(Broken())


def test_long_tables_are_cut_and_say_so():
    many = Detections(np.tile(BOXES, (30, 1)), np.linspace(0, 1, 60))
    shown = html(many)
    assert tags(shown).opened.count("tr") == MOST_ROWS + 1
    assert f"{MOST_ROWS} of 60 rows" in shown


class TestFrames:
    """`to_frame` gives what the fields hold."""

    def test_boxes(self):
        found = Detections(BOXES, np.array([0.5, 0.25]), np.array([0, 2]))
        table = found.to_frame()
        assert list(table["label"]) == ["vehicle", "pedestrian"]
        np.testing.assert_array_equal(
            table[["x", "y", "z", "length", "width", "height", "yaw"]], BOXES
        )
        np.testing.assert_array_equal(table["score"], found.scores)
        assert list(Objects(BOXES).to_frame()["id"]) == [0, 1]

    def test_result(self):
        result: Result = greedy.search(Objective(Setting("tjunction", fidelity="table")), 2)
        history = result.to_frame("history")
        np.testing.assert_array_equal(history["reward"], result.history.reward)
        assert len(repr(result)) < 300
        assert tags(html(result)).images
        with pytest.raises(
            ValueError, match="table must be one of history, front, got 'contenders'"
        ):
            result.to_frame("contenders")

    def test_plan_lists_what_was_considered(self):
        plan = NOUNS["plan"]("place")
        assert list(plan.to_frame().columns)[:2] == ["pole", "model"]
        assert plan.to_frame("considered").empty
        assert repr(Planned(plan, load_site("tjunction"))) == repr(plan)

    def test_candidates_have_one_row_each(self):
        candidates = pool()
        table = candidates.to_frame()
        assert isinstance(table, pandas.DataFrame)
        assert list(table["name"]) == [sensor.name for sensor in candidates.sensors]
        headings = np.degrees(candidates.axes.headings)[candidates.factors[:, 2]]
        np.testing.assert_allclose(table["heading_deg"], headings)

    def test_mounts_of_a_site(self):
        site: Site = load_site("tjunction")
        assert len(site.to_frame("mounts")) == len(site.mounts)

    def test_without_pandas_one_line_says_what_to_install(self, without_packages):
        without_packages("pandas")
        with pytest.raises(ImportError, match=r"^to_frame needs pandas.*: pip install pandas$"):
            Objects(BOXES).to_frame()
