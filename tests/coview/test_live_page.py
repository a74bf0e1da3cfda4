"""The live planner in Chromium: sensors dragged, added, failed and suggested, kept through a kill,
exported."""

import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from coview.live_cameras import DISTANCE_FACTOR
from coview.live_start import LiveSession
from placement_env import LivePlanner
from placement_env.live.project import ProjectFile
from placement_env.live.variant import Variant
from placement_env.setting import Setting
from toolkit.sites.files import load_site
from toolkit.viewing import scene

FRAMES = 16
ROOT = Path(__file__).parents[2]
SITE = load_site("tjunction")


class Page:
    """The planner's page and the server behind it, started anew after a kill."""

    def __init__(self, browser, folder):
        self.browser, self.folder, self.tab = browser, folder, None
        self.start()

    def start(self):
        command = (
            "-m",
            "coview",
            "live",
            "tjunction",
            "--frames",
            str(FRAMES),
            "--out",
            str(self.folder),
        )
        more = ("--cache", str(self.folder / "cache"), "--no-browser", "--json")
        self.server = subprocess.Popen(
            [sys.executable, *command, *more], stdout=subprocess.PIPE, text=True
        )
        self.url = json.loads(self.server.stdout.readline())["url"]
        self.open()

    def open(self):
        if self.tab is not None:
            self.tab.close()
        self.tab = self.browser.new_page(viewport={"width": 1280, "height": 720})
        self.tab.set_default_timeout(90_000)
        self.tab.goto(self.url)
        self.tab.wait_for_selector(".live-ap")
        self.tab.wait_for_function(
            "!document.querySelector('.live-ap').parentElement.innerText.includes('refining')"
        )
        self.tab.wait_for_timeout(1500)
        canvas = self.tab.locator("canvas").first.bounding_box()
        self.size = canvas["width"], canvas["height"]

    def kill(self):
        os.kill(self.server.pid, signal.SIGKILL)
        self.server.wait()

    @property
    def project(self):
        return json.loads((self.folder / "tjunction.live.json").read_text())

    @property
    def variant(self):
        found = self.project
        return Variant.from_dict(found["variants"][found["current"]])

    @property
    def ap(self):
        return float(self.tab.inner_text(".live-ap"))

    def until(self, condition):
        """Wait until the project says so, and the figures on the page have followed."""
        for _ in range(300):
            if condition(self.variant):
                break
            self.tab.wait_for_timeout(100)
        else:
            pytest.fail(f"it never came to that: {self.variant}")
        figures = lambda: self.tab.inner_text(".live-ap >> xpath=..")  # noqa: E731
        before = ""
        while (now := figures()) != before or "refining" in now:
            before = now
            self.tab.wait_for_timeout(600)
        return self.variant

    def pixel(self, point):
        """Where the first view shows a point of the scene."""
        eye, middle = (np.array(each) for each in scene.overview(tuple(SITE.area.tolist())))
        eye = middle + DISTANCE_FACTOR * (eye - middle)
        ahead = (middle - eye) / np.linalg.norm(middle - eye)
        right = np.cross(ahead, [0, 0, 1]) / np.linalg.norm(np.cross(ahead, [0, 0, 1]))
        way, (width, height) = np.array(point) - eye, self.size
        scale = height / 2 / np.tan(np.deg2rad(25.0)) / (way @ ahead)
        return width / 2 + scale * (way @ right), height / 2 - scale * (
            way @ np.cross(right, ahead)
        )

    def drag(self, start, end, steps=8):
        mouse = self.tab.mouse
        mouse.move(*start)
        self.tab.wait_for_timeout(200)
        mouse.down()
        for k in range(1, steps + 1):
            mouse.move(*(np.array(start) + (np.array(end) - start) * k / steps))
            self.tab.wait_for_timeout(70)
        mouse.up()

    def press(self, tab, button):
        self.tab.get_by_role("tab", name=tab).click()
        self.tab.get_by_role("button", name=button, exact=True).click()


def target(sensor):
    """Where a sensor's handle is: where it looks at the ground, no farther than 20 m."""
    ahead = sensor.world_SE3_body[:3, 0]
    down = (sensor.position[2] - float(SITE.ground(sensor.position[:2])) - 0.3) / max(
        -ahead[2], 1e-9
    )
    return sensor.position + ahead * min(down, 20.0 / np.hypot(*ahead[:2]))


@pytest.fixture(scope="module")
def page(browser, tmp_path_factory):
    made = Page(browser, tmp_path_factory.mktemp("live"))
    yield made
    made.kill()


@pytest.fixture(scope="module")
def engine():
    return LivePlanner("tjunction", frames=FRAMES, seed=3)


@pytest.mark.slow
def test_a_plan_is_made_by_hand(page, engine):
    variant = page.variant
    hung = {sensor.name: engine.yard.build_sensor(variant, sensor) for sensor in variant.sensors}

    for name, turn in (
        ("d5", (90, 30)),
        ("d2", (40, -15)),
        ("d0", (-30, 20)),
    ):  # turned by their handles
        place, before = page.pixel(target(hung[name])), page.variant.find(name)
        page.drag(place, np.add(place, turn))
        after = page.until(lambda v, name=name, before=before: v.find(name) != before).find(name)
        assert after.mount == before.mount
        assert max(abs(after.heading - before.heading), abs(after.tilt - before.tilt)) > 0.02
    engine.restore({"A": page.variant}, "A", [])
    assert page.ap == pytest.approx(engine.finish().ap, abs=0.002)
    assert page.ap == pytest.approx(engine.score().ap, abs=0.005)

    free = [
        mount
        for mount in SITE.mounts
        if mount.name not in {sensor.mount for sensor in page.variant.sensors}
    ]
    pole = min(free, key=lambda mount: np.hypot(*(mount.position[:2] - hung["d5"].position[:2])))
    end = page.pixel([*pole.position[:2], hung["d5"].position[2]])
    page.drag(page.pixel(hung["d5"].position), end)  # carried to another pole
    assert page.until(lambda v: v.find("d5").mount != "post05").find("d5").mount == pole.name

    page.tab.keyboard.press("Control+z")
    page.until(lambda v: v.find("d5").mount == "post05")
    page.tab.get_by_role("button", name="Redo").click()
    page.until(lambda v: v.find("d5").mount == pole.name)


def test_sensors_are_added_failed_and_suggested(page):
    count = len(page.variant.sensors)
    page.press("Sensor", "Add a sensor")
    refused = page.tab.locator(".live-note")
    refused.wait_for()
    assert "carries all the sensors" in refused.inner_text()  # the first pole has one
    page.tab.get_by_label("On pole").click()
    page.tab.get_by_role("option", name="pole07").click()
    page.press("Sensor", "Add a sensor")
    page.until(lambda v: len(v.sensors) == count + 1)
    before = page.ap
    page.tab.get_by_label("Failed").check()
    name = next(
        s.name for s in page.until(lambda v: any(s.failed for s in v.sensors)).sensors if s.failed
    )
    assert page.ap <= before
    page.press("Sensor", "Remove")
    page.until(lambda v: name not in {sensor.name for sensor in v.sensors})
    before = page.ap
    page.press("Ask", "add")
    page.tab.wait_for_function(
        "document.querySelector('.live-note')?.innerText.includes('next sensor: ')"
    )
    page.press("Ask", "Accept the best")
    page.until(lambda v: len(v.sensors) == count + 1)  # one added, one removed, one accepted
    assert page.ap >= before - 0.001


@pytest.mark.slow
def test_nothing_is_lost_by_a_reload_a_second_browser_and_a_kill(page):
    page.press("Variants", "Keep as a new variant")
    page.tab.wait_for_function("document.querySelectorAll('.live-variant').length == 2")
    kept, ap = page.project, page.ap
    second = page.browser.new_page(viewport={"width": 390, "height": 844})
    second.set_default_timeout(90_000)
    second.goto(page.url)
    second.wait_for_selector(".live-ap")
    assert float(second.inner_text(".live-ap")) == ap
    sheet = second.locator(
        "xpath=//*[@class='live-ap']/ancestor::*[contains(@style, 'fixed')]"
    ).bounding_box()
    assert (sheet["x"], sheet["width"]) == (0, 390)  # of the whole width of a telephone
    second.close()
    page.open()
    assert page.ap == ap
    page.kill()
    page.start()
    assert page.ap == pytest.approx(ap, abs=0.001)
    assert page.project == kept
    page.tab.get_by_role("button", name="Undo").click()
    page.until(lambda v: v.as_dict() != kept["variants"][kept["current"]])


@pytest.mark.slow
def test_an_area_is_drawn_and_another_question_is_asked(page):
    page.press("Draw", "Draw a keep-out area")
    page.tab.locator(".live-note").wait_for()
    xmin, ymin, xmax, ymax = SITE.area.tolist()
    for share in ((0.3, 0.3), (0.5, 0.3), (0.4, 0.5)):
        page.tab.mouse.click(
            *page.pixel([xmin + share[0] * (xmax - xmin), ymin + share[1] * (ymax - ymin), 0.0])
        )
        page.tab.wait_for_timeout(500)
    page.tab.get_by_role("button", name="Close the area").click()
    (area,) = page.until(lambda v: v.keep_out).keep_out
    assert area[1] == pytest.approx(
        (xmin + 0.5 * (xmax - xmin), ymin + 0.3 * (ymax - ymin)), abs=1.5
    )
    page.press("Draw", "Remove all areas")
    page.until(lambda v: not v.keep_out)
    before = page.ap
    page.tab.get_by_role("tab", name="Score").click()
    page.tab.get_by_label("IoU").click()
    page.tab.get_by_role("option", name="0.8").click()
    page.tab.wait_for_function(
        f"parseFloat(document.querySelector('.live-ap').innerText) < {before - 0.002}"
    )
    page.tab.get_by_label("IoU").click()
    page.tab.get_by_role("option", name="0.7").click()
    page.tab.wait_for_function(f"document.querySelector('.live-ap').innerText === '{before:.3f}'")


@pytest.mark.slow
def test_an_export_is_read_back(page, engine):
    page.press("Files", "Export site, map and schedule")
    page.tab.wait_for_function(
        "document.querySelector('.live-note')?.innerText.includes('site.json')"
    )
    again = LivePlanner(
        Setting(load_site(page.folder / "site.json"), candidates="pool"), frames=FRAMES, seed=3
    )
    page.until(lambda _: True)
    assert page.ap == pytest.approx(again.finish().ap, abs=0.005)
    assert len(again.sensors) == len(page.variant.sensors)


def test_the_map_and_the_traffic_are_drawn(page):
    said = page.tab.locator(".live-note").all_inner_texts()
    page.tab.get_by_role("tab", name="View").click()
    page.tab.get_by_label("Seen how often").click()
    page.tab.get_by_role("option", name="a child").click()
    page.tab.get_by_role("button", name="From above").click()
    page.tab.wait_for_timeout(1500)
    assert page.tab.locator(".live-note").all_inner_texts() == said  # no refusal
    page.tab.get_by_role("tab", name="Draw").click()
    upload = page.tab.locator("input[type=file]")
    upload.set_input_files({"name": "cow.png", "mimeType": "image/png", "buffer": b"moo"})
    page.tab.wait_for_function(
        "document.querySelector('.live-note')?.innerText.includes('cow.png is no whole')"
    )
    upload.set_input_files(ROOT / "docs" / "birds_eye.png")
    page.tab.wait_for_function(
        "document.querySelector('.live-note')?.innerText.includes('two points')"
    )
    laid = page.project["picture"]
    page.tab.locator("xpath=//label[text()='Two points']/following::input[1]").fill("30")
    page.tab.get_by_role("button", name="Place the picture by two points").click()
    page.tab.wait_for_function(
        "document.querySelector('.live-note')?.innerText.includes('click on the ground')"
    )
    for spot in ((300, 300), (500, 300)):
        page.tab.mouse.click(*spot)
        page.tab.wait_for_timeout(500)
    assert page.project["picture"]["scale"] != laid["scale"]
    assert (page.folder / laid["file"]).is_file()
    assert page.server.poll() is None


def test_only_pages_of_this_machine_with_the_token_are_served(page):
    port = page.url.split(":")[2].split("/")[0]
    tab = page.browser.new_page()
    assert tab.goto(f"http://127.0.0.1:{port}/").status == 403
    assert tab.goto(f"http://127.0.0.1:{port}/wrong/").status == 403
    tab.close()


def draw_street(path):
    """An OpenDRIVE street of 160 m that climbs by 4 %, with the bounds from which the page takes
    its middle."""
    lane = '<lane id="{}" type="{}"><width sOffset="0" a="{}" b="0" c="0" d="0"/></lane>'
    left = lane.format(2, "sidewalk", 2) + lane.format(1, "driving", 3.5)
    right = lane.format(-1, "driving", 3.5) + lane.format(-2, "sidewalk", 2)
    path.write_text(
        '<OpenDRIVE><header revMajor="1" revMinor="4" north="60" south="-60" east="80" west="-80"/>'
        '<road name="" length="160" id="1" junction="-1"><planView>'
        '<geometry s="0" x="-80" y="0" hdg="0" length="160"><line/></geometry></planView><elevationProfile>'
        '<elevation s="0" a="0" b="0.04" c="0" d="0"/></elevationProfile><lanes><laneSection s="0">'
        f'<left>{left}</left><center><lane id="0" type="none"/></center><right>{right}</right>'
        "</laneSection></lanes></road></OpenDRIVE>"
    )
    return path


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::UserWarning")
@pytest.mark.parametrize("kind", ["osm", "xodr"])
def test_a_map_is_opened_from_the_page(browser, tmp_path, kind):
    def begin(site):
        planner = LivePlanner(site, frames=8)
        return planner, ProjectFile(tmp_path / "own.live.json", planner)

    session = LiveSession(begin, port=18790, folder=tmp_path)
    tab = browser.new_page()
    tab.set_default_timeout(90_000)
    try:
        tab.goto(session.url)
        for wrong, said in (("cow.osm", "no map"), ("<b>nowhere", "no site")):
            for label, text in (
                ("Path or site", wrong),
                ("Centre", "8.0 49.5" if kind == "osm" else ""),
            ):
                tab.locator(f"xpath=//label[text()='{label}']/following::input[1]").fill(text)
            if kind == "osm":
                tab.get_by_role("button", name="Open").click()
                tab.wait_for_function(
                    f"document.querySelector('.live-note')?.innerText.includes('{said}')"
                )
        (tmp_path / "maps").mkdir()
        street = draw_street(tmp_path / "maps" / "street.xodr")
        tab.locator("input[type=file]").set_input_files(
            ROOT / "docs/own-junction.osm" if kind == "osm" else street
        )
        tab.wait_for_selector(".live-ap")
        site = "own-junction.json" if kind == "osm" else "street.json"
        assert sorted(path.name for path in tmp_path.glob("*.json")) == sorted(
            [site, "own.live.json"]
        )
        tab.get_by_role("button", name="Add a sensor", exact=True).click()
        tab.wait_for_function("parseFloat(document.querySelector('.live-ap').innerText) > 0")
    finally:
        tab.close()
        session.close()
