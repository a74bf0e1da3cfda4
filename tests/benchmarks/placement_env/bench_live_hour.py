"""An hour on the live planner's page, time compressed, in two browsers: memory, speed at both ends,
agreement.

python tests/benchmarks/placement_env/bench_live_hour.py [ACTIONS]   (600: one every six seconds of
                                                                     the hour) Drags by mouse in one
                                                                     browser; in between failures,
                                                                     additions, removals, other
                                                                     poles, variants, suggestions,
                                                                     the map, other frames, undo and
                                                                     redo. Memory of the server is
                                                                     that of its process, from when
                                                                     all views are made; that of the
                                                                     page is its heap of JavaScript.
"""

import shutil
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from bench_live import resident
from bench_live_page import FLAGS, Bench
from playwright.sync_api import sync_playwright

from coview.live_start import LiveSession
from placement_env import LivePlanner
from placement_env.live.project import ProjectFile


def main(actions: int = 600) -> None:
    rng, planner = np.random.default_rng(0), LivePlanner("tjunction")
    planner.finish()
    begin = time.monotonic()
    while planner.refine():
        pass
    print(f"all views made in {time.monotonic() - begin:.0f} s", flush=True)
    folder = Path(tempfile.mkdtemp())
    session = LiveSession(
        planner, project=ProjectFile(folder / "tjunction.live.json", planner), folder=folder
    )
    page = session.page
    with sync_playwright() as playwright:
        path = shutil.which("chromium") or shutil.which("google-chrome")
        chromium = playwright.chromium.launch(executable_path=path, args=list(FLAGS))
        tab, other = (chromium.new_page(viewport={"width": 1280, "height": 720}) for _ in range(2))
        bench = Bench(tab, session)
        bench.open()
        other.goto(session.url)
        other.wait_for_selector(".live-ap")
        tab.get_by_role("tab", name="Ask").click()

        def act(k: int) -> None:
            """Something that is done in the panel."""
            names = [sensor.name for sensor in planner.sensors]
            name = names[int(rng.integers(len(names)))]
            poles = [
                mount.name
                for mount in planner.yard.stock.mounts
                if planner.yard.has_room(planner.variant, mount.name)
            ]
            pole = poles[int(rng.integers(len(poles)))]
            more = len(names) < 8
            jobs = (
                lambda: page.change(planner.fail, name, k % 4 < 2),
                lambda: page.change(planner.add, pole, float(rng.uniform(-3, 3))) if more else None,
                lambda: page.change(planner.remove, name) if len(names) > 5 else None,
                lambda: page.change(lambda: planner.move(name, position=pole)),
                lambda: page.change(planner.undo),
                lambda: page.change(planner.redo),
                lambda: page.tasks.suggest("add"),
                lambda: setattr(
                    page.panel.view.map, "value", ("off", "a child")[int(rng.integers(2))]
                ),
                lambda: setattr(page.panel.view.frame, "value", int(rng.integers(planner.frames))),
                lambda: (
                    page.change(lambda: planner.show(f"V{k}", copy=True))
                    if len(planner.variants) < 6
                    else None
                ),
                lambda: page.change(
                    planner.show, list(planner.variants)[int(rng.integers(len(planner.variants)))]
                ),
            )
            jobs[int(rng.integers(len(jobs)))]()
            tab.wait_for_timeout(150)

        times, memory, heap = [], [], []
        for k in range(actions):
            if k % 50 == 0 or k == actions - 1:
                memory.append(resident())
                heap.append(tab.evaluate("performance.memory.usedJSHeapSize") / 2**20)
                print(
                    (
                        f"{k} actions, {time.monotonic() - begin:.0f} s: {memory[-1]} MB, page "
                        f"{heap[-1]:.0f} MB"
                    ),
                    flush=True,
                )
            if k % 3:
                act(k)
                continue
            standing = [s.name for s in planner.sensors]
            name = standing[int(rng.integers(len(standing)))]
            start, middle = bench.place(name, False), np.array(bench.size) / 2
            found = bench.drag(
                name, start + (middle - start) * rng.uniform(0.05, 0.4) + rng.normal(0, 25, 2)
            )
            if found is not None:
                times.append(found["whole"])
        page.do(lambda: page.show(planner.finish()))
        tab.wait_for_timeout(6000)
        texts = [each.inner_text(".live-ap >> xpath=..") for each in (tab, other)]
        print(f"both browsers show the same: {texts[0] == texts[1]}", flush=True)
        fifth = max(len(times) // 5, 1)
        print(f"pointer to figures, {len(times)} drags:")
        for what, part in (("first", times[:fifth]), ("last", times[-fifth:])):
            print(
                f"  {what} fifth: p50 {np.median(part):.0f}, p95 {np.percentile(part, 95):.0f} ms"
            )
        print(f"server {memory[-1] - memory[0]:+d} MB, {max(memory)} MB at most", flush=True)
        chromium.close()
    session.close()
    shutil.rmtree(folder)


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
