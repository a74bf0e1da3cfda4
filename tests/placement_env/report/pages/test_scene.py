"""The 3D scene, and its shapes."""

import re
import socket
from contextlib import suppress
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, strategies as st

from placement_env.handover.ground import GroundGrid
from placement_env.report.pages.scene import MAX_DRAWN_POINTS, build_plan_scene, seen_cells
from placement_env.report.pages.scene_layer import Layer
from toolkit.plots.palette import OUTCOME, sensor_colour
from toolkit.sites.site import Relief, Site


@pytest.fixture(scope="module")
def scene(example):
    return build_plan_scene(example.plan, example.site, example.ground, example.moments)


def test_every_sensor_and_box_has_a_node(scene):
    sensors, boxes = scene.layers[:4], scene.layers[4:]
    assert [(each.name, each.node) for each in sensors] == [
        *(("d0", "/sensors/0"), ("d1", "/sensors/1"), ("d3", "/sensors/2"), ("d5", "/sensors/3"))
    ]
    assert [each.colour for each in sensors] == [sensor_colour(k) for k in range(4)]
    assert [each.node for each in boxes] == ["/truth", "/hit", "/missed", "/false"]
    assert boxes[1] == Layer(
        "Detections that hit", "/hit", OUTCOME["hit"].colour, "thick solid boxes"
    )
    assert len({each.colour for each in boxes}) == len({each.mark for each in boxes}) == 4


def test_every_frame_has_nodes_of_its_own(scene):
    assert len(scene.frames) == 3
    assert scene.frames[1][:2] == ("/sensors/0/points 1", "/sensors/1/points 1")
    assert len(set(sum(scene.frames, ()))) == 3 * 8


def test_the_page_is_small_and_loads_nothing(scene):
    assert len(scene.html) < 4e6
    assert not re.search(r"<(script|link|img)[^>]+(src|href)=[\"']?(https?:|//|/)", scene.html)
    assert "__VISER_EMBED_DATA__" in scene.html


def test_the_same_plan_has_the_same_scene_and_says_nothing(example, scene, capsys):
    assert build_plan_scene(example.plan, example.site, example.ground, example.moments) == scene
    assert capsys.readouterr() == ("", "")


def test_ports_may_be_taken_and_sensors_be_none(example):
    """viser listens while the scene is written, on this machine alone, and at no port of ours."""
    with socket.socket() as taken:
        taken.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        with suppress(OSError):  # taken by someone else: as well
            taken.bind(("127.0.0.1", 8080))
            taken.listen()
        made = build_plan_scene(example.plan, example.site, None, ())
    assert made.frames == ()
    bare = replace(example.site, sensors=())
    assert len(build_plan_scene(example.plan, bare, None, ()).layers) == 8


def test_clouds_are_thinned_to_what_a_page_can_hold(example, scene):
    rng = np.random.default_rng(0)
    heavy = tuple(rng.uniform(-20, 20, (60_000, 3)).astype(np.float32) for _ in range(4))
    moments = tuple(replace(moment, clouds=heavy) for moment in example.moments)
    html = build_plan_scene(example.plan, example.site, example.ground, moments).html
    assert len(html) < len(scene.html) + MAX_DRAWN_POINTS * 6 * 4 / 3 + 1e5


FIELD = Site("field", np.array([0.0, 0.0, 12.0, 8.0]), relief=Relief(0.3, 5))


def area(mesh):
    a, b, c = (mesh.vertices[mesh.triangles[:, k], :2] for k in range(3))
    return float(np.abs(np.cross(b - a, c - a)).sum() / 2)


@given(st.integers(0, 2**32 - 1))
def test_visible_ground_covers_the_seen_cells_and_no_other(seed):
    seen = np.random.default_rng(seed).random((8, 24)) < 0.6
    x, y, zeros = np.arange(0.25, 12, 0.5), np.arange(0.5, 8, 1.0)[:8], np.zeros((8, 24))
    ground = GroundGrid(x, y * 0.5, seen[None], zeros[None].astype(np.float32), ~seen, seen, seen)
    mesh = seen_cells(FIELD, ground, 0)
    assert area(mesh) == pytest.approx(0.25 * seen.sum())
    np.testing.assert_allclose(mesh.vertices[:, 2], FIELD.ground(mesh.vertices[:, :2]) + 0.08)
    corners = mesh.vertices[mesh.triangles].mean(1)
    columns, rows = (
        np.floor(corners[:, 0] / 0.5).astype(int),
        np.round(corners[:, 1] / 0.5 - 0.5).astype(int),
    )
    assert seen[rows.clip(0, 7), columns.clip(0, 23)].all()
