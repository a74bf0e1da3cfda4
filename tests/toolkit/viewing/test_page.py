"""A recording as one page, opened from disk in a real browser."""

import re
from dataclasses import replace

import pytest

from toolkit.viewing.drawing import Drawing
from toolkit.viewing.recording_page import PageContent, Switch, page_content, page_html, write_page
from toolkit.viewing.recording_scene import nodes_of_kind

SECOND = (
    "second: 500 points, 2 labelled (0 hit, 0 missed, 2 not counted), 1 detected (0 hits, 1 "
    "false alarm, 0 ignored)"
)


@pytest.fixture(scope="module")
def drawn(samples, finds_the_car):
    return Drawing(finds_the_car).draw_all(samples)


@pytest.fixture(scope="module")
def written(drawn, tmp_path_factory):
    out = tmp_path_factory.mktemp("page") / "view.html"
    return out, write_page(drawn, "two <lidars>", out)


def test_every_frame_has_its_nodes_and_everything_a_switch(written):
    _, content = written
    assert [(each.name, each.nodes) for each in content.switches] == [
        *(("north", "/sensors/0"), ("south", "/sensors/1"), ("truth", "/truth")),
        *(
            ("hits", "/hits"),
            ("missed", "/missed"),
            ("false alarms", "/false_alarms"),
            ("ignored", "/ignored"),
        ),
        ("class and score", "/tags"),
        *(
            (kind, " ".join(nodes_of_kind(kind, with_outcomes=True)))
            for kind in ("vehicle", "pedestrian", "others")
        ),
        ("grid of 10 m", "/grid"),
    ]
    assert [(each.name.split(",")[0], each.checked) for each in content.colourings] == [
        *(("sensor", True), ("height", False), ("intensity", False), ("age", False))
    ]
    assert content.colourings[1].nodes == "/sensors/0/height /sensors/1/height"
    _, content = written
    assert content.frame_lines[1] == SECOND
    assert content.frame_lines[0].startswith(
        "first: 400 points, 3 labelled (0 hit, 0 missed, 3 not counted), 1 detected ("
    )
    assert "/truth/pedestrian/0" in content.frame_nodes[0]
    assert "/sensors/1/age/1" in content.frame_nodes[1]
    assert not set(content.frame_nodes[0]) & set(content.frame_nodes[1])
    assert (content.point_count, content.drawn_count) == (900, 900)


def test_pages_need_a_sample_and_thin_its_points(drawn, samples):
    content = page_content(drawn, "few", max_points=300)
    assert (content.point_count, content.drawn_count) == (900, 300)
    with pytest.raises(ValueError, match="no sample to view"):
        page_content([], "none")
    content = page_content([replace(drawn[0], clouds=())], "boxes")
    assert (content.point_count, content.drawn_count, content.switches[0].name) == (0, 0, "truth")
    names = [
        (each.name, each.nodes)
        for each in page_content(Drawing().draw_all(samples[1:]), "labels").switches
    ]
    assert ("vehicle", "/truth/vehicle /detections/vehicle /tags/vehicle") in names
    assert not {"hits", "missed", "false alarms"} & {name for name, _ in names}


def test_the_page_asks_for_nothing_and_takes_names_for_text(written, drawn, tmp_path):
    page = written[0].read_text()
    assert "two &lt;lidars&gt;" in page
    assert "<lidars>" not in page
    assert not re.search(r"<(script|link|img)[^>]+(src|href)=[\"']?(https?:|//|/)", page)
    hostile = Switch('"><script>alert(1)</script>', "/a", "#000000")
    content = PageContent("t", "</script>", (hostile,), (), (("/b",),), ("</script>",), 0, 0)
    assert "<script>alert" not in page_html(content)
    assert page_html(content).count("</script>") == 2
    write_page(drawn, "two <lidars>", tmp_path / "again.html")
    assert (tmp_path / "again.html").read_text() == page


def test_frames_colours_and_switches_work_in_a_browser(written, browser):
    page, troubles, asked = browser.new_page(viewport={"width": 500, "height": 600}), [], []
    page.on("pageerror", lambda error: troubles.append(str(error)))
    page.on("request", lambda request: asked.append(request.url))
    page.set_default_timeout(30_000)
    page.goto(f"file://{written[0]}")
    page.wait_for_selector("#scene[data-ready]")
    scene = next(frame for frame in page.frames if frame.parent_frame)

    def wait_until(node, expected):
        js = (
            "([node, expected]) => window.__viserSceneTree.getState()[node]?.effectiveVisibility "
            "=== expected"
        )
        scene.wait_for_function(js, arg=[node, expected])

    wait_until("/sensors/0/sensor/0", True)
    wait_until("/sensors/0/height/0", False)
    wait_until("/truth/vehicle/1", False)
    page.locator("input[type=radio]").nth(1).check()
    wait_until("/sensors/0/height/0", True)
    wait_until("/sensors/0/sensor/0", False)
    page.locator("#scene-time").fill("1")
    wait_until("/sensors/1/height/1", True)
    wait_until("/sensors/0/height/0", False)
    assert page.locator("#scene-now").inner_text() == f"2 of 2 · {SECOND}"
    page.get_by_label("vehicle").uncheck()
    wait_until("/truth/vehicle/1", False)
    wait_until("/false_alarms/vehicle/1", False)
    wait_until("/tags/vehicle/1-0", False)
    wait_until("/truth/others/1", True)
    page.get_by_label("north").uncheck()
    wait_until("/sensors/0/height/1", False)
    wait_until("/sensors/1/height/1", True)
    page.close()
    assert troubles == []
    assert [url for url in asked if not url.startswith(("data:", "blob:", "about:"))] == [
        f"file://{written[0]}"
    ]
