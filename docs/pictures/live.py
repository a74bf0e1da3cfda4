"""Draw the live planner's page in Chromium, a picture and a film: `python docs/pictures/live.py
[FOLDER]`.

live.png: a map of what is seen, and a suggestion; live.webp: some 30 s of use, four pictures a
second.
"""

import shutil
import sys
from io import BytesIO
from pathlib import Path

import numpy as np
from PIL import Image
from playwright.sync_api import Page, sync_playwright

from coview.live_cameras import DISTANCE_FACTOR
from coview.live_start import LiveSession
from placement_env import LivePlanner
from toolkit.runtime.run import Run
from toolkit.viewing import scene
from toolkit.viewing.sensor_parts import find_target

FLAGS = ("--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader")
COLOURS = 96  # of the picture's palette, so that the file is small
# px of the page and the film; ms between two pictures of it
SIZE = (1280, 720)
FILM = (896, 504)
PAUSE = 250
POINTER = """
addEventListener('DOMContentLoaded', () => {
    const dot = document.createElement('div')
    dot.style = 'position:fixed;z-index:9999;width:18px;height:18px;margin:-9px;' +
        'border-radius:50%;' +
        'pointer-events:none;background:#e2197888;border:2px solid #fff;left:-99px'
    document.body.append(dot)
    const follow = e => Object.assign(dot.style, {left: e.clientX + 'px', top: e.clientY + 'px'})
    addEventListener('pointermove', follow, true)
})
"""


class Film:
    """Pictures of a tab, one after another."""

    def __init__(self, tab: Page, session: LiveSession) -> None:
        self.tab = tab
        self.session = session
        self.frames = list[Image.Image]()

    def shoot(self, count: int = 1) -> None:
        """Take pictures, with time between them."""
        for _ in range(count):
            self.tab.wait_for_timeout(120)
            self.frames.append(
                Image.open(BytesIO(self.tab.screenshot())).convert("RGB").resize(FILM)
            )

    def pixel(self, point: np.ndarray) -> np.ndarray:
        """Where the first view shows a point of the scene."""
        box = self.tab.locator("canvas").first.bounding_box()
        assert box is not None
        eye, middle = (
            np.array(each)
            for each in scene.overview(tuple(self.session.planner.yard.site.area.tolist()))
        )
        eye = middle + DISTANCE_FACTOR * (eye - middle)
        ahead = (middle - eye) / np.linalg.norm(middle - eye)
        right = np.cross(ahead, [0, 0, 1]) / np.linalg.norm(np.cross(ahead, [0, 0, 1]))
        way = point - eye
        size = np.array([box["width"], box["height"]])
        scale = size[1] / 2 / np.tan(np.deg2rad(25.0)) / (way @ ahead)
        return size / 2 + scale * np.array([way @ right, -(way @ np.cross(right, ahead))])

    def drag(
        self, name: str, by: tuple[float, float], steps: int = 10, *, housing: bool = False
    ) -> None:
        """Drag a sensor's handle, or its box, by some pixels."""
        planner = self.session.planner
        sensor = planner.yard.build_sensor(planner.variant, planner.variant.find(name))
        start = self.pixel(sensor.position if housing else find_target(planner.yard.site, sensor))
        self.tab.mouse.move(*start)
        self.shoot(2)
        self.tab.mouse.down()
        for k in range(1, steps + 1):
            self.tab.mouse.move(*(start + np.array(by) * k / steps))
            self.shoot()
        self.tab.mouse.up()
        self.shoot(5)

    def press(self, tab: str, button: str) -> None:
        """Press a button of a tab."""
        self.tab.get_by_role("tab", name=tab).click()
        self.tab.get_by_role("button", name=button, exact=True).click()

    def map(self, what: str) -> None:
        """Choose the map of what is seen."""
        self.tab.get_by_role("tab", name="View").click()
        self.tab.get_by_label("Seen how often").click()
        self.tab.get_by_role("option", name=what).click()

    def suggest(self) -> None:
        """Ask for the next sensor, until the poles that help have been looked at."""
        for _ in range(20):
            self.press("Ask", "add")
            self.tab.wait_for_timeout(5000)
            if "none among" not in self.tab.locator(".live-note").inner_text():
                return


def main(folder: Path) -> None:
    """Turn sensors of the T-junction, map what is seen, ask for the next sensor, and write live.png
    and live.webp."""
    planner = LivePlanner("tjunction", run=Run(frames=60, seed=3, cache=Path("out/cache")))
    planner.finish()
    session = LiveSession(planner, folder=folder)
    try:
        with sync_playwright() as playwright:
            path = shutil.which("chromium") or shutil.which("google-chrome")
            chromium = playwright.chromium.launch(executable_path=path, args=list(FLAGS))
            tab = chromium.new_page(viewport={"width": SIZE[0], "height": SIZE[1]})
            tab.set_default_timeout(120_000)
            tab.add_init_script(POINTER)
            tab.goto(session.url)
            tab.wait_for_selector(".live-ap")
            tab.wait_for_timeout(3000)
            film = Film(tab, session)
            film.shoot(6)
            film.drag("d5", (90.0, 30.0))
            film.drag("d2", (60.0, -20.0))
            film.drag("d3", (-60.0, 25.0), housing=True)
            tab.keyboard.press("Control+z")
            film.shoot(5)
            film.map("a child")
            film.shoot(6)
            film.drag("d5", (-90.0, -30.0))
            film.press("Variants", "Keep as a new variant")
            film.shoot(6)
            film.suggest()
            film.shoot(8)
            picture = Image.open(BytesIO(tab.screenshot())).convert("RGB")
            picture.quantize(COLOURS, dither=Image.Dither.NONE).save(
                folder / "live.png", optimize=True
            )
            film.press("Ask", "Accept the best")
            film.shoot(6)
            film.map("off")
            tab.get_by_role("tab", name="Variants").click()
            film.shoot(10)
            first, *rest = film.frames
            how = {
                "save_all": True,
                "append_images": rest,
                "duration": PAUSE,
                "loop": 0,
                "quality": 45,
                "method": 4,
            }
            first.save(folder / "live.webp", minimize_size=True, **how)
            print(
                f"{len(film.frames) * PAUSE / 1000:.0f} s, "
                f"{(folder / 'live.webp').stat().st_size / 1e6:.1f} MB"
            )
            chromium.close()
    finally:
        session.close()


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent)
