"""Draw the picture of the live planner's page, in Chromium: `python docs/pictures/live.py [FOLDER] [WIDTH]`."""

from __future__ import annotations

import shutil
import sys
from io import BytesIO
from pathlib import Path

from PIL import Image
from playwright.sync_api import sync_playwright

from coview.live_page import LiveSession
from placement_env import LivePlanner
from toolkit.runtime.run import Run

FLAGS = ("--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader")
COLOURS = 96  # of the palette, so that the file is small


def main(folder: Path, width: int = 1280) -> None:
    """Turn a sensor of the T-junction, map what is seen, ask for the next sensor, and write live.png."""
    planner = LivePlanner("tjunction", run=Run(frames=60, seed=3, cache=Path("out/cache")))
    planner.move("d2", heading=planner.variant.find("d2").heading - 0.5)
    planner.finish()
    session = LiveSession(planner, folder=folder)
    try:
        with sync_playwright() as playwright:
            path = shutil.which("chromium") or shutil.which("google-chrome")
            chromium = playwright.chromium.launch(executable_path=path, args=list(FLAGS))
            tab = chromium.new_page(viewport={"width": width, "height": 720 if width > 1000 else 1024})
            tab.set_default_timeout(120_000)
            tab.goto(session.url)
            tab.wait_for_selector(".live-ap")
            tab.get_by_role("tab", name="View").click()
            tab.get_by_label("Seen how often").click()
            tab.get_by_role("option", name="a child").click()
            tab.get_by_role("tab", name="Ask").click()
            for _ in range(20):  # until the poles that help have been looked at
                tab.get_by_role("button", name="add", exact=True).click()
                tab.wait_for_timeout(5000)
                if "none among" not in tab.locator(".live-note").inner_text():
                    break
            tab.wait_for_timeout(1000)
            shot = Image.open(BytesIO(tab.screenshot())).convert("RGB")
            shot.quantize(COLOURS, dither=Image.Dither.NONE).save(folder / "live.png", optimize=True)
            chromium.close()
    finally:
        session.close()


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent, *map(int, sys.argv[2:]))
