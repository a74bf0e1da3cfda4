"""Time from the pointer to the figures on the live planner's page, in headless Chromium, which
renders in software.

python tests/benchmarks/placement_env/bench_live_page.py [DRAGS [WIDTH [HEIGHT]]]   (200 1280 720)
                                                                                    The T-junction:
                                                                                    six sensors, 60
                                                                                    frames, the pool
                                                                                    of 2,363 poses.
                                                                                    Each drag
                                                                                    presses a
                                                                                    sensor's handle,
                                                                                    moves it in
                                                                                    steps of a
                                                                                    screen's frame
                                                                                    and rests; timed
                                                                                    is the last
                                                                                    step, from the
                                                                                    pointer's event
                                                                                    until the first
                                                                                    figures that
                                                                                    answer it stand
                                                                                    in the page,
                                                                                    coarse or not,
                                                                                    and until the
                                                                                    scene is
                                                                                    painted. How it
                                                                                    divides: until
                                                                                    the page's
                                                                                    script gets the
                                                                                    event, until the
                                                                                    server gets it,
                                                                                    until the server
                                                                                    starts on it,
                                                                                    its answer with
                                                                                    all that is
                                                                                    drawn, the way
                                                                                    back from the
                                                                                    end of that
                                                                                    (negative, as
                                                                                    figures go
                                                                                    first), and
                                                                                    until the
                                                                                    figures change.
                                                                                    Then a tenth as
                                                                                    many drags to
                                                                                    poles that were
                                                                                    never used, a
                                                                                    fifth as many
                                                                                    lifts, after a
                                                                                    rest of 20 s,
                                                                                    and turns while
                                                                                    the map of what
                                                                                    is seen is
                                                                                    shown.
"""

import shutil
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

import numpy as np
from playwright.sync_api import Page, sync_playwright

from coview.live_cameras import DISTANCE_FACTOR
from coview.live_start import LiveSession
from placement_env import LivePlanner
from placement_env.live.project import ProjectFile
from toolkit.viewing import scene
from toolkit.viewing.sensor_parts import find_target

FLAGS = ("--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader")
STEPS, STEP = 5, 0.016  # of the pointer in a drag, and s between two
REST = 0.35  # s without news after which the figures have settled
RECORD = """
window.live = []
const now = () => performance.timeOrigin + performance.now()
addEventListener('pointerrawupdate', e => live.push(['pointer', performance.timeOrigin + e.timeStamp, now()]), true)
const Plain = Worker
window.Worker = class extends Plain {
    constructor(...given) {
        super(...given)
        this.addEventListener('message', e => {
            for (const m of e.data.messages ?? []) {
                const content = String(m.updates?.content ?? '')
                if (content.includes('live-ap')) live.push(['message', now(), content])
                if (m.type.includes('Image') && m.name === '/seen') live.push(['map', now()])
            }
        })
    }
}
new MutationObserver(() => {
    const text = document.querySelector('.live-ap')?.parentElement.innerText
    if (text && text !== window.shown) {
        window.shown = text
        const entry = ['figures', now(), null]
        live.push(entry)
        requestAnimationFrame(() => setTimeout(() => entry[2] = now()))
    }
}).observe(document, {subtree: true, childList: true, characterData: true})
"""


class Bench:
    """The page, its server in this process, and the times of both. All times are ms of the system's
    clock."""

    def __init__(self, tab: Page, session: LiveSession) -> None:
        self.tab, self.session, self.planner = tab, session, session.planner
        self.served: list[list[float]] = []
        self.answered = ""  # the page's figures after the latest step
        self.why = list[str]()  # why figures did not change
        page = session.page
        for name in ("turn", "carry", "lift"):
            setattr(page.drags, name, self._timed(getattr(page.drags, name)))
        follow = page.jobs.drag
        self.heard: list[float] = []

        def heard(*given, **more):
            self.heard.append(1000 * time.time())
            return follow(*given, **more)

        page.jobs.drag = heard  # type: ignore[method-assign]
        self.size = (0.0, 0.0)

    def _timed(self, job):
        def timed(*given, **more):
            start = time.time()
            job(*given, **more)
            self.answered = self.session.page.head.figures_content
            self.served.append([1000 * start, 1000 * time.time()])

        return timed

    def open(self) -> None:
        self.tab.add_init_script(RECORD)
        self.tab.goto(self.session.url)
        self.tab.wait_for_selector(".live-ap")
        self.tab.wait_for_timeout(3000)
        box = self.tab.locator("canvas").first.bounding_box()
        assert box is not None
        self.size = box["width"], box["height"]

    def pixel(self, point) -> np.ndarray:
        """Where the first view shows a point of the scene."""
        eye, middle = (
            np.array(each) for each in scene.overview(tuple(self.planner.yard.site.area.tolist()))
        )
        eye = middle + DISTANCE_FACTOR * (eye - middle)
        ahead = (middle - eye) / np.linalg.norm(middle - eye)
        right = np.cross(ahead, [0, 0, 1]) / np.linalg.norm(np.cross(ahead, [0, 0, 1]))
        way, (width, height) = np.array(point) - eye, self.size
        scale = height / 2 / np.tan(np.deg2rad(25.0)) / (way @ ahead)
        return np.array(
            [width / 2 + scale * (way @ right), height / 2 - scale * (way @ np.cross(right, ahead))]
        )

    def plain(self, html: str) -> str:
        """Text of HTML without spaces."""
        return "".join(
            self.tab.evaluate(
                "h => new DOMParser().parseFromString(h, 'text/html').body.innerText", html
            ).split()
        )

    def agree(self) -> bool:
        """True where the page shows what the server sent last, at once or, as it may refine, a
        second later."""
        for wait in (0, 1000):
            self.tab.wait_for_timeout(wait)
            read = self.tab.evaluate("document.querySelector('.live-ap').parentElement.outerHTML")
            if self.plain(read) == self.plain(self.session.page.head.figures_content):
                return True
        return False

    def place(self, name: str, housing: bool) -> np.ndarray:
        """Pixel of a sensor's handle, or housing."""
        sensor = self.planner.yard.build_sensor(
            self.planner.variant, self.planner.variant.find(name)
        )
        return self.pixel(
            sensor.position if housing else find_target(self.session.planner.yard.site, sensor)
        )

    def drag(
        self, name: str, end, *, housing: bool = False, shift: bool = False
    ) -> dict[str, float] | None:
        """Drag a sensor; return the parts of the time of its last step."""
        start, mouse = self.place(name, housing), self.tab.mouse
        mouse.move(*start)
        self.tab.wait_for_timeout(60)
        if shift:
            self.tab.keyboard.down("Shift")
        mouse.down()
        for k in range(1, STEPS + 1):
            if k == STEPS:
                self.tab.evaluate("window.live = []")
                self.served.clear()
                self.heard.clear()
            mouse.move(*(start + (end - start) * k / STEPS))
            time.sleep(STEP)
        news = None
        while news != (news := (len(self.served), self.tab.evaluate("live.length"))):
            self.tab.wait_for_timeout(1000 * REST)
        found, served, heard = self.tab.evaluate("live"), list(self.served), list(self.heard)
        answered, same = self.answered, self.agree()
        mouse.up()
        self.tab.keyboard.up("Shift")
        self.tab.wait_for_timeout(1000 * REST)
        pointer = [row for row in found if row[0] == "pointer"]
        messages = [row for row in found if row[0] == "message" and row[2] == answered]
        figures = [
            row for row in found if row[0] == "figures" and messages and row[1] >= messages[0][1]
        ]
        maps = [row[1] - pointer[-1][1] for row in found if row[0] == "map" and pointer]
        if not (pointer and figures and messages and served and heard):
            missed = "beside the handle" if not heard else "nothing new" if same else "PIPE_LOST"
            self.why.append(missed)
            for client in (
                self.session._server.get_clients().values()
            ):  # a drag beside the handle turns the camera
                self.session.page.cameras.aim(client, self.session.page.cameras.slant)
            self.tab.wait_for_timeout(1000)
            return None
        at = pointer[-1][1]
        # a refined answer may follow
        shown, painted = (figures[0][1], figures[0][2] or figures[0][1])
        times = [at, pointer[-1][2], heard[-1], *served[-1], messages[0][1], shown]
        parts = ("page gets it", "server gets it", "waits", "answers", "way back", "figures change")
        whole = {
            "whole": shown - at,
            "painted": painted - at,
            **({"map": maps[-1]} if maps else {}),
        }
        return whole | dict(zip(parts, np.diff(times).tolist(), strict=True))


def say(what: str, rows: list[dict[str, float] | None], why: list[str]) -> None:
    """Print percentiles of a kind of drag."""
    kept = [row for row in rows if row is not None]
    print(
        (
            f"{what}: {len(kept)} of {len(rows)} drags changed the figures; the others: "
            f"{dict(Counter(why))}"
        ),
        flush=True,
    )
    why.clear()
    for name in dict.fromkeys(name for row in kept for name in row):
        p50, p95, worst = np.percentile([row[name] for row in kept if name in row], [50, 95, 100])
        print(f"  {name:>15}: p50 {p50:5.0f}, p95 {p95:5.0f}, worst {worst:5.0f} ms", flush=True)


def main(drags: int = 200, width: int = 1280, height: int = 720) -> None:
    rng, planner = np.random.default_rng(0), LivePlanner("tjunction")
    planner.finish()
    folder = Path(tempfile.mkdtemp())
    project = ProjectFile(folder / "tjunction.live.json", planner)
    session = LiveSession(planner, project=project, folder=folder)
    with sync_playwright() as playwright:
        path = shutil.which("chromium") or shutil.which("google-chrome")
        chromium = playwright.chromium.launch(executable_path=path, args=list(FLAGS))
        tab = chromium.new_page(viewport={"width": width, "height": height})
        tab.set_default_timeout(120_000)
        bench = Bench(tab, session)
        bench.open()
        names = [sensor.name for sensor in planner.sensors]

        def turn(k: int) -> dict[str, float] | None:
            start, middle = bench.place(names[k % len(names)], False), np.array(bench.size) / 2
            towards = (middle - start) * rng.uniform(0.05, 0.4) + rng.normal(0, 25, 2)
            return bench.drag(names[k % len(names)], start + towards)

        say("turns and tilts", [turn(k) for k in range(drags)], bench.why)
        free = [
            m for m in planner.yard.stock.mounts if m.name not in {s.mount for s in planner.sensors}
        ]
        level = float(
            planner.yard.build_sensor(planner.variant, planner.variant.find("d0")).position[2]
        )
        ends = [bench.pixel([*mount.position[:2], level]) for mount in free]
        there = [
            end for end in ends if (end > 20).all() and (end < np.array(bench.size) - 20).all()
        ]
        say(
            "a pole never used",
            [bench.drag("d0", end, housing=True) for end in there[: drags // 10]],
            bench.why,
        )
        # views from other heights are made while nobody moves anything
        tab.wait_for_timeout(20_000)
        lifts = [(names[k % len(names)], rng.uniform(-40, 40)) for k in range(drags // 5)]
        say(
            "lifts",
            [
                bench.drag(n, bench.place(n, True) + np.array([0, by]), housing=True, shift=True)
                for n, by in lifts
            ],
            bench.why,
        )
        tab.get_by_role("tab", name="View").click()
        tab.get_by_label("Seen how often").click()
        tab.get_by_role("option", name="a child").click()
        tab.wait_for_timeout(3000)
        say("turns with the map", [turn(k) for k in range(drags // 5)], bench.why)
        chromium.close()
    session.close()
    shutil.rmtree(folder)


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
