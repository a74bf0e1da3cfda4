"""The report as people get it: two files, opened from disk in a real browser."""

import io
import os
from dataclasses import replace

import numpy as np
import pytest

from placement_env.report.content import Plan, Verdict
from placement_env.report.pages.report import build_document, write_report

BOXES = ("/truth", "/hit", "/missed", "/false")


@pytest.fixture(scope="module")
def report(example, tmp_path_factory):
    folder = tmp_path_factory.mktemp("report")
    write_report(example, folder)
    return folder


@pytest.fixture
def page(browser, report):
    """The report opened from disk; afterwards nothing was asked from anywhere and nothing went
    wrong."""
    opened = browser.new_page(viewport={"width": 620, "height": 440})
    troubles, asked = [], []
    opened.on("pageerror", lambda error: troubles.append(str(error)))
    opened.on(
        "console",
        lambda message: troubles.append(message.text) if message.type == "error" else None,
    )
    opened.on("request", lambda request: asked.append(request.url))
    opened.set_default_timeout(60_000)
    opened.goto(f"file://{report}/report.html")
    yield opened
    opened.close()
    assert troubles == []
    assert [url for url in asked if not url.startswith(("data:", "blob:", "about:"))] == [
        f"file://{report}/report.html"
    ]


def test_both_files_are_written_and_small(report):
    assert sorted(os.listdir(report)) == ["report.html", "report.pdf"]
    assert (report / "report.html").stat().st_size < 12e6


def test_the_files_are_the_same_every_time(example, tmp_path):
    quick = replace(example, ground=None, moments=example.moments[:1])
    for folder in ("once", "again/and/again"):
        write_report(quick, tmp_path / folder)
    for name in ("report.html", "report.pdf"):
        assert (tmp_path / "once" / name).read_bytes() == (
            tmp_path / "again/and/again" / name
        ).read_bytes()


def test_neither_file_is_written_where_one_fails(nothing_chosen, tmp_path, fail):
    fail("placement_env.report.pages.report", "to_pdf", OSError("disk full"))
    with pytest.raises(OSError, match="disk full"):
        write_report(nothing_chosen, tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_plans_without_sensors_have_reports_in_sentences(nothing_chosen, tmp_path):
    write_report(nothing_chosen, tmp_path)
    assert "<iframe" not in (tmp_path / "report.html").read_text()
    document = build_document(nothing_chosen.plan, nothing_chosen.site, nothing_chosen.ground)
    assert tuple(section.key for section in document.sections) == ORDER
    assert document.subtitle == "VoxelNet; AP at IoU 0.7; late fusion"
    assert [section.key for section in document.sections if section.blocks] == [
        "decision",
        "method",
    ]
    assert all(section.conclusion.endswith(".") for section in document.sections)
    plan = replace(
        nothing_chosen.plan, detector="", verdict=Verdict(False, "No set can be planned.")
    )
    document = build_document(plan, nothing_chosen.site, None)
    assert document.subtitle == "No set was judged"
    assert document.sections[0].conclusion == "No set can be planned."


def test_names_that_are_code_stay_names(browser, hostile_example, tmp_path):
    write_report(hostile_example, tmp_path)
    opened = browser.new_page()
    opened.goto(f"file://{tmp_path}/report.html")
    assert opened.title() == f"Deployment plan for {hostile_example.plan.site}"
    assert hostile_example.plan.verdict.sentence in opened.locator("#decision .facts").inner_text()
    opened.close()


def pixels(page, frame):
    from PIL import Image

    png = frame.screenshot(animations="disabled")
    return np.asarray(Image.open(io.BytesIO(png)).convert("RGB")).astype(int)


def magenta(image):
    """How many pixels have the colour of the second sensor."""
    red, green, blue = np.moveaxis(image, -1, 0)
    return int(((red > 190) & (green < 110) & (blue > 120)).sum())


@pytest.mark.slow
def test_the_scene_turns_and_hides_what_is_switched_off(page):
    page.locator("#scene-frame").scroll_into_view_if_needed()
    page.wait_for_selector("#scene[data-ready]")
    view = page.locator("#scene-frame")
    scene = next(frame for frame in page.frames if frame.parent_frame)

    def shown(node):
        return scene.evaluate(
            "node => window.__viserSceneTree.getState()[node].effectiveVisibility", node
        )

    def wait_until(node, expected):
        js = (
            "([node, expected]) => window.__viserSceneTree.getState()[node].effectiveVisibility "
            "=== expected"
        )
        scene.wait_for_function(js, arg=[node, expected])
        page.wait_for_timeout(500)

    wait_until("/sensors/1/points 0", True)
    assert [shown(f"/sensors/1/points {frame}") for frame in range(3)] == [True, False, False]
    first = pixels(page, view)
    assert magenta(first) > 300

    page.locator("input[data-node='/sensors/1']").uncheck()
    wait_until("/sensors/1/points 0", False)
    assert not any(shown(f"/sensors/1/{part}") for part in ("ground", "view", "label"))
    assert shown("/sensors/0/points 0")
    assert magenta(pixels(page, view)) < 0.02 * magenta(first)

    page.locator("#scene-time").fill("2")
    wait_until("/sensors/0/points 2", True)
    assert not shown("/sensors/0/points 0")
    assert not shown("/sensors/1/points 2")
    for node in BOXES:
        page.locator(f"input[data-node='{node}']").uncheck()
    wait_until("/false/2", False)
    assert not any(shown(f"{node}/2") for node in BOXES)

    before, box = pixels(page, view), view.bounding_box()
    middle = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
    page.mouse.move(*middle)
    page.mouse.down()
    page.mouse.move(middle[0] + 120, middle[1] + 10, steps=4)
    page.mouse.up()
    page.wait_for_timeout(1500)
    assert (np.abs(pixels(page, view) - before).max(-1) > 30).mean() > 0.1


def test_tables_sort_and_contents_lead_to_sections(page):
    page.set_viewport_size({"width": 1280, "height": 800})
    table = page.locator("#failures table")

    def column(number):
        return table.locator(f"tbody td:nth-child({number})").all_inner_texts()

    table.locator("th button", has_text="AP").first.click()
    assert column(2) == ["0.520", "0.780", "0.880", "0.910", "0.930", "0.934"]
    assert table.locator("th[aria-sort]").get_attribute("aria-sort") == "ascending"
    table.locator("th button", has_text="AP").first.click()
    assert column(2)[0] == "0.934"
    table.locator("th button", has_text="Failed").click()
    assert column(1) == ["d0", "d0 and d3", "d1", "d1 and d5", "d3", "d5"]
    ranges = page.locator("#detection table").nth(1)
    for _ in range(2):  # a row without a figure is last both ways
        ranges.locator("th button", has_text="AP").first.click()
        assert ranges.locator("tbody tr").last.locator("td").first.inner_text() == ">30 m"
    page.set_viewport_size({"width": 620, "height": 440})
    page.locator("nav summary").click()  # closed on narrow screens
    page.locator("nav a").last.click()
    assert page.url.endswith("#method")
    page.emulate_media(media="print")
    assert not page.locator("nav").is_visible()
    assert not page.locator("#scene-frame").is_visible()
    assert page.locator(".printed").is_visible()
    assert page.pdf(format="A4").startswith(b"%PDF-")


OVERFLOWING = """() => {  // elements that leave the page or their own box, and neighbours that lie on each other
  const wide = document.documentElement.clientWidth, wrong = [], seen = e => e.checkVisibility();
  const name = e => `${e.tagName} ${(e.closest("section") || {}).id} ${e.textContent.trim().slice(0, 30)}`;
  const all = [...document.querySelectorAll("body *:not(script):not(style):not(.skip)")].filter(seen);
  for (const e of all) {
    const box = e.getBoundingClientRect();
    if (box.right > wide + 1 || box.left < -1) wrong.push(`out: ${name(e)}`);
    if (e.scrollWidth > e.clientWidth + 1 && e.clientWidth && getComputedStyle(e).display !== "inline")
      wrong.push(`cut: ${name(e)}`);
  }
  const words = [...document.querySelectorAll("h1, h2, h3, p, li, dt, dd, th, td, caption, figcaption, img, label")]
    .filter(e => seen(e) && !e.querySelector("p, li, label") && !e.closest(".skip, .view"));
  const boxes = words.map(e => e.getBoundingClientRect());
  boxes.forEach((a, i) => boxes.slice(i + 1, i + 40).forEach((b, k) => {
    const [x, y] = [["left", "right"], ["top", "bottom"]].map(([l, h]) => Math.min(a[h], b[h]) - Math.max(a[l], b[l]));
    if (x > 1 && y > 1)
      wrong.push(`on each other: ${name(words[i])} / ${name(words[i + 1 + k])}`);
  }));
  return wrong;
}"""
FAINT = """() => {  // texts whose contrast is below 4.5 (WCAG 2.1 AA)
  const parts = colour => colour.match(/[\\d.]+/g).map(Number);
  const light = colour => parts(colour).slice(0, 3).map(v => v / 255)
    .map(v => v <= 0.03928 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4)
    .reduce((sum, v, k) => sum + v * [0.2126, 0.7152, 0.0722][k], 0);
  const behind = e => { const own = getComputedStyle(e).backgroundColor;
    return (parts(own)[3] ?? 1) > 0 || !e.parentElement ? own : behind(e.parentElement); };
  return [...document.querySelectorAll("body *")].filter(e => e.getClientRects().length &&
      [...e.childNodes].some(node => node.nodeType === 3 && node.textContent.trim())).map(e => {
    const [low, high] = [light(getComputedStyle(e).color), light(behind(e))].sort((a, b) => a - b);
    return [(high + 0.05) / (low + 0.05), `${e.tagName} ${e.textContent.trim().slice(0, 30)}`];
  }).filter(each => each[0] < 4.5);
}"""


@pytest.mark.one_in(3)
@pytest.mark.parametrize("width", [390, 768, 1280])
def test_nothing_is_cut_or_overlaps_at_any_width_and_all_is_legible(page, width):
    page.set_viewport_size({"width": width, "height": 800})
    page.wait_for_function("(width) => innerWidth === width", arg=width)
    # laid out anew
    page.evaluate(
        "() => new Promise(done => requestAnimationFrame(() => requestAnimationFrame(done)))"
    )
    page.wait_for_timeout(300)  # and what scripts do then
    assert page.evaluate(OVERFLOWING) == []
    for scheme in ("light", "dark"):
        page.emulate_media(color_scheme=scheme)
        assert page.evaluate(FAINT) == []
        bright = [
            sum(map(int, page.evaluate(f"getComputedStyle(document.body).{name}")[4:-1].split(",")))
            for name in ("color", "backgroundColor")
        ]
        assert (bright[0] > bright[1]) == (scheme == "dark")


@pytest.mark.slow
def test_the_tabulator_goes_down_the_page(page):
    page.set_viewport_size({"width": 1280, "height": 800})
    order = "a[href], button, input, summary, iframe"
    count = page.evaluate(
        (
            "(order) => [...document.querySelectorAll(order)].filter(e => "
            "e.getClientRects().length).length"
        ),
        order,
    )
    places = []
    for _ in range(count):
        page.keyboard.press("Tab")
        places.append(
            page.evaluate(
                "(order) => [...document.querySelectorAll(order)].indexOf(document.activeElement)",
                order,
            )
        )
        if places[-1] >= 0 and page.evaluate("document.activeElement.id") == "scene-frame":
            break  # the scene has an order of its own
    assert places == sorted(set(places))
    assert len(places) >= 20


ORDER = (
    *("decision", "schedule", "materials", "ground", "views", "detection", "failures"),
    *("links", "order", "others", "schemes", "worth", "method"),
)


def test_sections_stand_in_order_and_open_with_a_sentence(document):
    assert tuple(section.key for section in document.sections) == ORDER
    assert document.title == "Deployment plan for tjunction"
    for section in document.sections:
        assert section.conclusion.endswith((".", "?"))
        for block in section.blocks:
            if block.kind == "drawing":
                assert block.caption.endswith(".")
                assert block.caption != section.conclusion
                assert len(block.alt) > 20
                assert block.svg.lstrip().startswith(("<svg", "<?xml"))
            if block.kind == "table":
                assert block.rows


def test_ap_stands_beside_its_interval_and_the_number_of_vehicles(document):
    for section in document.sections:
        for block in section.blocks:
            if block.kind == "table" and any(column.title == "AP" for column in block.columns):
                titles = [column.title for column in block.columns]
                assert titles[titles.index("AP") + 1] == "95% interval"
                assert "vehicles" in titles


def test_one_sensor_and_nothing_more_is_known_of_it(example):
    """All that a plan may leave out is left out."""
    full = example.plan
    one = replace(full.chosen, sensors=full.chosen.sensors[:1], judged=None)
    verdict = Verdict(None, "Best of all.")
    plan = Plan(
        full.question,
        full.site,
        full.detector,
        0.7,
        "late",
        "",
        verdict,
        one,
        sensors=full.sensors[:1],
    )
    document = build_document(plan, replace(example.site, sensors=example.site.sensors[:1]), None)
    said = {section.key: section.conclusion for section in document.sections}
    assert said["decision"] == (
        "Build 1 depth camera on pole post00. The price is that of 6 ordinary poles."
    )
    assert said["worth"] == "The worth of the sensors was not computed."
    assert said["failures"] == "No failure leaves a working sensor."
    assert (
        said["others"] == "No other judged set comes near the chosen one, costs less or sends less."
    )
