import numpy as np
import pytest

from toolkit.sites.gate_names import name_gates
from toolkit.traffic.flow import DRAWN_PER_HOUR, Flow, Movement

POSSIBLE = {"vehicle": {"east": ["west", "north"], "north": ["east"]}, "pedestrian": {}}


def test_a_drawn_flow_has_all_movements_and_survives_a_table(tmp_path):
    flow = Flow.draw(POSSIBLE, np.random.default_rng(4))
    assert [movement[:3] for movement in flow.movements] == [
        ("vehicle", "east", "west"),
        ("vehicle", "east", "north"),
        ("vehicle", "north", "east"),
    ]
    low, high = DRAWN_PER_HOUR["vehicle"]
    assert low <= flow.movements[0].per_hour + flow.movements[1].per_hour <= high
    (tmp_path / "flow.csv").write_text(flow.text())
    read = Flow.read(tmp_path / "flow.csv")
    assert [movement[:3] for movement in read.movements] == [
        movement[:3] for movement in flow.movements
    ]
    assert [movement.per_hour for movement in read.movements] == pytest.approx(
        [movement.per_hour for movement in flow.movements], rel=1e-5
    )
    flow.check(POSSIBLE)


def test_pedestrians_may_have_their_earlier_name(tmp_path):
    path = tmp_path / "flow.csv"
    path.write_text("kind,entry,exit,per_hour\nwalker,east,west,60\n")
    assert Flow.read(path).movements == (Movement("pedestrian", "east", "west", 60.0),)
    path.write_text(path.read_text() + "pedestrian,east,west,30\n")
    with pytest.raises(ValueError, match="pedestrians from east to west are listed twice"):
        Flow.read(path)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "must begin with the columns kind,entry,exit,per_hour, got $"),
        ("kind,from,to,per_hour\n", "got kind,from,to,per_hour"),
        ("kind,entry,exit,per_hour\nvehicle,east,west\n", "line 2: 4 cells are needed, got 3"),
        (
            "kind,entry,exit,per_hour\n\nvehicle,east,west,many\n",
            "line 3: per_hour must be a number, got 'many'",
        ),
        ("kind,entry,exit,per_hour\ntram,east,west,3\n", "got 'tram'"),
        ("kind,entry,exit,per_hour\n" + "x" * 200_000, "line 2: field larger than field limit"),
        ("kind,entry,exit,per_hour\nvehicle,east,west,-1\n", "0 to 3600, got -1"),
        ("kind,entry,exit,per_hour\nvehicle,east,west,nan\n", "0 to 3600, got nan"),
        ("kind,entry,exit,per_hour\nvehicle,a,b,1\nvehicle,a,b,2\n", "listed twice"),
    ],
)
def test_other_tables_are_refused_with_the_line(tmp_path, text, message):
    path = tmp_path / "flow.csv"
    path.write_text(text)
    with pytest.raises(ValueError, match=message):
        Flow.read(path)


@pytest.mark.parametrize(
    ("movement", "message"),
    [
        (
            Movement("pedestrian", "east", "west", 1.0),
            "no pedestrian can come in at 'east': .* are none",
        ),
        (Movement("vehicle", "south", "west", 1.0), "its gates are east, north"),
        (Movement("vehicle", "north", "west", 1.0), "to 'west': exits there are east"),
    ],
)
def test_movements_without_a_way_are_refused(movement, message):
    with pytest.raises(ValueError, match=message):
        Flow((movement,)).check(POSSIBLE)


def test_gates_are_named_by_their_direction_the_nearest_first():
    names = name_gates([2.0, 359.0, 91.0, 200.0, 315.0], [50.0, 20.0, 9.0, 9.0, 9.0])
    assert names == ["north 2", "north", "east", "south", "north-west"]
