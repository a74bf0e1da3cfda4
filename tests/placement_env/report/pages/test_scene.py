import re
import socket
from contextlib import suppress
from dataclasses import replace

import numpy as np
import pytest

from placement_env.report.pages.scene import MOST_DRAWN, Layer, build_scene
from toolkit.plots.palette import OUTCOME, sensor_colour


@pytest.fixture(scope="module")
def scene(example):
    return build_scene(example.plan, example.site, example.ground, example.moments)


def test_every_sensor_and_every_kind_of_box_can_be_hidden(scene):
    sensors, boxes = scene.layers[:4], scene.layers[4:]
    assert [(each.name, each.node) for each in sensors] == [
        *(("d0", "/sensors/0"), ("d1", "/sensors/1"), ("d3", "/sensors/2"), ("d5", "/sensors/3")),
    ]
    assert [each.colour for each in sensors] == [sensor_colour(k) for k in range(4)]
    assert [each.node for each in boxes] == ["/truth", "/hit", "/missed", "/false"]
    assert boxes[1] == Layer("Detections that hit", "/hit", OUTCOME["hit"].colour, "thick solid boxes")
    assert len({each.colour for each in boxes}) == len({each.mark for each in boxes}) == 4


def test_every_frame_has_nodes_of_its_own(scene):
    assert len(scene.frames) == 3
    assert scene.frames[1][:2] == ("/sensors/0/points 1", "/sensors/1/points 1")
    assert len(set(sum(scene.frames, ()))) == 3 * 8


def test_the_page_asks_for_nothing_and_is_small(scene):
    assert len(scene.html) < 4e6
    assert not re.search(r"<(script|link|img)[^>]+(src|href)=[\"']?(https?:|//|/)", scene.html)
    assert "__VISER_EMBED_DATA__" in scene.html


def test_the_same_plan_has_the_same_scene_and_says_nothing(example, scene, capsys):
    again = build_scene(example.plan, example.site, example.ground, example.moments)
    assert again == scene
    assert capsys.readouterr() == ("", "")


def test_the_default_port_may_be_taken_and_no_port_stays_open(example):
    """viser listens while the scene is written, on this machine alone, and at no port of ours."""
    with socket.socket() as taken:
        taken.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        with suppress(OSError):  # taken by someone else: as well
            taken.bind(("127.0.0.1", 8080))
            taken.listen()
        made = build_scene(example.plan, example.site, None, ())
    assert made.frames == ()


def test_clouds_are_thinned_to_what_a_page_can_hold(example, scene):
    rng = np.random.default_rng(0)
    heavy = tuple(rng.uniform(-20, 20, (60_000, 3)).astype(np.float32) for _ in range(4))
    moments = tuple(replace(moment, clouds=heavy) for moment in example.moments)
    html = build_scene(example.plan, example.site, example.ground, moments).html
    assert len(html) < len(scene.html) + MOST_DRAWN * 6 * 4 / 3 + 1e5


def test_a_sensor_that_the_site_does_not_have_has_no_edges_but_a_place(example):
    bare = replace(example.site, sensors=())
    assert len(build_scene(example.plan, bare, None, ()).layers) == 8
