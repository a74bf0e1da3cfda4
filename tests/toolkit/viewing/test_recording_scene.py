from dataclasses import replace

import numpy as np
import pytest

from toolkit.plots.palette import OUTCOME
from toolkit.viewing import recording_scene, scene
from toolkit.viewing.colouring import COLOURINGS, Scales
from toolkit.viewing.drawing import Drawing
from toolkit.viewing.drawn import DrawnSample


@pytest.fixture(scope="module")
def drawn(samples, finds_the_car):
    return Drawing(finds_the_car).draw_all(samples)


@pytest.fixture(scope="module")
def api():
    with scene.viser_server() as server:
        yield server.scene


def style(drawn, most=1000, colourings=COLOURINGS):
    return recording_scene.SceneStyle(
        recording_scene.list_sensors(drawn), colourings, Scales.from_sample(drawn[0]), most
    )


def test_sensors_keep_numbers_and_the_first_view_has_most_points(drawn):
    assert recording_scene.list_sensors(drawn) == ("north", "south")
    assert recording_scene.list_sensors(drawn[::-1]) == ("north", "south")
    assert recording_scene.list_sensors([]) == ()
    assert recording_scene.find_view_area(drawn[0]) == (-30.0, -30.0, 30.0, 30.0)
    assert recording_scene.find_view_area(drawn[1]) == (-30.0, -30.0, 50.0, 40.0)
    boxes = DrawnSample("boxes", 0.0, (), drawn[0].truth, {})
    assert recording_scene.find_view_area(boxes) == (-10.0, -20.0, 20.0, 10.0)
    assert recording_scene.find_view_area(DrawnSample("nothing", 0.0, (), {}, {})) == (
        -10.0,
        -10.0,
        10.0,
        10.0,
    )


def test_scenes_have_groups_for_all_kinds(api, drawn):
    made = {handle.name: handle.visible for handle in recording_scene.add_groups(api, style(drawn))}
    assert [name for name in made if name.count("/") == 1] == [
        *(
            "/sensors",
            "/truth",
            "/detections",
            "/hits",
            "/missed",
            "/false_alarms",
            "/ignored",
            "/tags",
        )
    ]
    assert {name for name in made if name.startswith("/truth/")} == {
        f"/truth/{kind}" for kind in ("vehicle", "cyclist", "pedestrian", "heavy", "others")
    }
    assert [
        made[f"/sensors/1/{each}"] for each in ("sensor", "height", "intensity", "age", "place")
    ] == [*(True, False, False, False, True)]


def test_samples_have_nodes_for_all_in_them(api, drawn):
    made = {
        handle.name: handle
        for handle in recording_scene.add_sample(
            api, drawn[1], style(drawn), frame=7, visible=False
        )
    }
    sensors = {f"/sensors/{k}/{part}/7" for k in (0, 1) for part in ("place", *COLOURINGS)}
    boxes = {"/truth/vehicle/7", "/truth/others/7", "/false_alarms/vehicle/7", "/tags/vehicle/7-0"}
    assert set(made) == sensors | boxes
    assert not any(handle.visible for handle in made.values())
    assert made["/sensors/0/age/7"].points.shape == (400, 3)
    assert made["/sensors/1/height/7"].points.shape == (100, 3)
    np.testing.assert_array_equal(made["/sensors/0/sensor/7"].points, drawn[1].clouds[0].points)
    assert made["/truth/vehicle/7"].points.shape == (13, 2, 3)  # twelve edges and a heading
    assert made["/tags/vehicle/7-0"].text == "vehicle 0.90 false"


def test_points_are_thinned_in_one_colouring(api, drawn):
    made = {
        h.name: h
        for h in recording_scene.add_sample(
            api, drawn[0], style(drawn, most=50, colourings=("height",))
        )
    }
    assert set(made) == {
        *("/sensors/0/place/0", "/sensors/0/height/0", "/ignored/vehicle/0", "/tags/vehicle/0-0"),
        *(f"/truth/{kind}/0" for kind in ("vehicle", "pedestrian", "others")),
    }
    assert (
        made["/sensors/0/height/0"].points.shape
        == made["/sensors/0/height/0"].colors.shape
        == (50, 3)
    )
    assert made["/sensors/0/height/0"].visible


def test_outcomes_have_nodes_and_marks_of_their_own(api, touched, finds_the_car):
    (sample,) = Drawing(finds_the_car).draw_all([touched])
    sample = replace(
        sample, outcomes=sample.outcomes | {"false alarms": {"heavy": sample.truth["others"]}}
    )
    made = {
        handle.name: handle
        for handle in recording_scene.add_sample(api, sample, style([sample]), frame=3)
    }
    assert {"/hits/vehicle/3", "/missed/pedestrian/3", "/false_alarms/heavy/3"} < set(made)
    assert not any("others" in name for name in made if not name.startswith("/truth"))
    lines = {
        name: made[name].points.shape[0]
        for name in ("/hits/vehicle/3", "/missed/pedestrian/3", "/false_alarms/heavy/3")
    }
    assert list(lines.values()) == [
        12,
        12 + 2,
        12 + 3,
    ]  # edges; a cross on the roof; a spike with two bars
    colours = {tuple(made[name].colors.reshape(-1, 3)[0].tolist()) for name in lines}
    assert colours == {scene.rgb(OUTCOME[name].colour) for name in ("hit", "missed", "false alarm")}


def test_the_grid_lies_on_the_area_and_kinds_can_be_hidden(api):
    assert recording_scene.nodes_of_kind("heavy", with_outcomes=False) == [
        "/truth/heavy",
        "/detections/heavy",
        "/tags/heavy",
    ]
    assert recording_scene.nodes_of_kind("heavy", with_outcomes=True)[2:] == [
        "/hits/heavy",
        "/missed/heavy",
        "/false_alarms/heavy",
        "/ignored/heavy",
        "/tags/heavy",
    ]
    grid = recording_scene.add_grid(api, (-20.0, 0.0, 40.0, 30.0))
    assert (grid.name, grid.width, grid.height, grid.cell_size) == ("/grid", 60.0, 30.0, 10.0)
    np.testing.assert_allclose(grid.position[:2], [10, 15])
