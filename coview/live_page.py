"""The live planner in the browser: a scene of viser with handles on every sensor, and a panel with
the figures.

viser shows the scene, drags and controls, the same in every browser that has the address; tables
are HTML of ours. Whatever a handle or control asks for is done by one thread, the latest position
of a drag first. A second thread refines what is coarse while nobody moves anything, a third does
what takes long: suggestions, searches, the detector, reports."""

import secrets
import threading
import time
import traceback
from collections import deque
from collections.abc import Callable, Iterable
from contextlib import suppress
from dataclasses import replace
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from coview.live_cameras import LiveCameras, Spot
from coview.live_signs import add_signs, draw_view, find_target, lay_picture
from coview.live_tables import (
    MAP_KEY,
    describe_ap,
    describe_stated,
    describe_suggestions,
    details_html,
    draw_small_maps,
    figures_html,
    format_ap,
    hint_html,
    note_html,
    site_html,
    variants_html,
)
from placement_env.classes import SMALL
from placement_env.live.directions import parse_heading, parse_height, parse_tilt, show_bearing
from placement_env.live.picture import GroundPicture, keep_picture
from placement_env.live.planner import LivePlanner, Suggestion
from placement_env.live.project import ProjectFile, export_variant, report_variant
from placement_env.live.seen_map import MAP_HEIGHTS, SeenMaps
from placement_env.live.variant import LiveSensor, Variant
from toolkit.detection.schemes import PAPER_SCHEMES
from toolkit.display import describe_count
from toolkit.plots.canvas import FAINT, INK, OUTCOME, sensor_colour
from toolkit.runtime.parallel import return_freed_memory
from toolkit.sensors.error_profiles import PROFILES
from toolkit.sensors.sensor import Sensor
from toolkit.viewing import scene
from toolkit.viewing.scene import Handle

if TYPE_CHECKING:
    from viser import ViserServer

    from placement_env.live.figures import LiveAnswer
    from placement_env.setting import Setting
FOUND = 0.5  # hit probability from which a road user is drawn as found
PATIENCE = 1.0  # s that a suggestion waits for more poles to be looked at
# s after a change until work goes on; views that are shown are refined; others
MOVING = 0.1
QUIET = 0.4
CALM = 2.0
LATE = 0.3  # s after which what is slow to draw no longer waits for the pointer to rest
PAINT = 1.2  # s that a browser gets for the first figures alone
TIDY = 10.0  # s of use after which freed memory is handed back
CATCH = 3.0  # m from the pointer within which a pole catches a sensor that is carried
GHOST = "#4463f6"
KEPT_OUT = "#b3261e"
GO_ON = "go on, and report the lines in the terminal"
CLASSES = {
    "vehicle": ("vehicle",),
    "cyclist and pedestrian": SMALL,
    "all three": ("vehicle", *SMALL),
}


class LivePage:
    """Scene and panel of a planner on a server. folder: for exports and reports."""

    _chosen: Handle  # controls of the panel
    _bearing: Handle
    _tilt: Handle
    _height: Handle
    _lock: Handle
    _fail: Handle
    _wanted: Handle
    _frame: Handle

    def __init__(
        self, server: "ViserServer", planner: LivePlanner, project: ProjectFile | None, folder: Path
    ) -> None:
        self.server = server
        self.planner = planner
        self.project = project
        self.folder = folder
        self._jobs: deque[Callable[[], None]] = deque()
        self._long: deque[Callable[[], None]] = deque()
        self._wake = threading.Condition()
        self._closed = False
        self._touched = 0.0
        self._behind = 0.0  # since when what is slow to draw is to be drawn
        self._played = 0.0  # when a frame of traffic was played
        self._drag: Callable[[], None] | None = None
        self._nodes: dict[str, list[Handle]] = {}
        self._ghosts: list[Suggestion] = []
        self._busy = ""
        self._note = ""
        self._measured = ""
        if planner.stated is not None:
            self._measured = describe_stated(planner.stated)
        self._answer: LiveAnswer | None = None
        self._maps: dict[float, SeenMaps] = {}
        self._beside = folder if project is None else project.path.parent  # where a picture is kept
        self._traffic: list[Handle] = []
        self._pole_labels: dict[str, Handle] = {}
        self._small: dict[Variant, str] = {}  # maps beside the table
        # what the scene shows, so that only what has changed is sent again
        self._drawn: dict[str, object] = {}
        self._spots: list[Spot] = []  # clicked on the ground
        self._await_spot: Callable[[Spot], None] | None = None
        self._filling = False
        self._begun = (
            False  # once a browser has had time to show the figures, it gets controls and the scene
        )
        self._cameras = LiveCameras(planner.yard.site.area)
        scene.set_view(
            server, tuple(self._cameras.middle + self._cameras.slant), tuple(self._cameras.middle)
        )
        server.on_client_connect(self._greet)
        server.scene.on_click()(self._click)
        self._add_figures()
        self._threads = [
            threading.Thread(target=t, daemon=True)
            for t in (self._work, self._refine, self._work_long)
        ]
        for thread in self._threads:
            thread.start()
        self.do(lambda: self._show(planner.answer()))

    def do(self, job: Callable[[], None]) -> None:
        """Do something in the page's thread, after what was asked before."""
        with self._wake:
            self._jobs.append(job)
            self._wake.notify_all()

    def close(self) -> None:
        """End the threads, and keep what was done last."""
        with self._wake:
            self._closed = True
            self._wake.notify_all()
        for thread in self._threads[:2]:
            thread.join(timeout=5)
        if self.project is not None:
            self.project.save()

    # threads

    def _work(self) -> None:
        while not self._closed:
            job = self._next_job()
            if job is not None:
                self._touched = time.monotonic()
                self._try(job)
            elif not self._begun:
                if (
                    self._cameras.aimed
                    and self._answer is not None
                    and time.monotonic() > self._touched + PAINT
                ):
                    self._try(self._begin)
            elif self._play.value and time.monotonic() - self._played > 0.25:
                self._played = time.monotonic()
                self._try(self._show_next_frame)

    def _next_job(self) -> Callable[[], None] | None:
        """Take what is to be done next, after a short wait for it; None for nothing."""
        with self._wake:
            if not self._jobs and self._drag is None and not self._behind:
                self._wake.wait(0.3)
            idle = not self._jobs and self._drag is None
            if self._behind and (idle or time.monotonic() > self._behind + LATE):
                return self._draw_rest
            if self._jobs:
                return self._jobs.popleft()
            job = self._drag
            self._drag = None
            return job

    def _show_next_frame(self) -> None:
        self._frame.value = (int(self._frame.value) + 1) % self.planner.frames

    def _refine(self) -> None:
        while not self._closed:
            if not self._try(self._refine_views):
                self._touched = time.monotonic()  # a pause before it is tried again

    def _refine_views(self) -> None:
        """Refine until the page closes."""
        more = True
        tidied = time.monotonic()
        while not self._closed:
            answer = self._answer
            if self._touched > tidied + TIDY:
                tidied = time.monotonic()
                return_freed_memory()
            wait = QUIET if answer is not None and answer.coarse else CALM
            if (
                answer is None
                or time.monotonic() - self._touched < wait
                or not (more and self._begun)
            ):
                time.sleep(0.1)
                more = more or self._touched > time.monotonic() - 1
                continue
            more = self.planner.refine(self._in_use)
            time.sleep(0.01)  # for those who wait to cast rays
            if answer is not None and answer.coarse and not self.planner.coarse:
                self.do(self._show_refined)

    def _in_use(self) -> bool:
        """True for the thread that refines while others move something."""
        return (
            threading.current_thread() is self._threads[1]
            and time.monotonic() - self._touched < MOVING
        )

    def _show_refined(self) -> None:
        if self._answer is not None:
            self._answer = self.planner.answer(self._answer.what)
            if self._frame.max < self.planner.frames - 1:  # the first frames are followed by all
                self._maps.clear()
                self._frame.max = self.planner.frames - 1
            self._draw()

    def _work_long(self) -> None:
        while not self._closed:
            with self._wake:
                if not self._long:
                    self._wake.wait(0.3)
                job = self._long.popleft() if self._long else None
            if job is not None:
                self._try(job)
                return_freed_memory()  # comparing poses takes much
                self._busy = ""
                self.do(self._show_note)

    def _try(self, job: Callable[[], None]) -> bool:
        """Do something, and show why it failed; True if it did not. Nothing that fails ends the
        page."""
        try:
            job()
        except (ValueError, OSError, ImportError) as error:
            self._note = str(error)
        except Exception as error:  # one control, drag or drawing failed: the page lives on
            traceback.print_exc()
            self._note = (
                f"that did not work, by a fault of coview ({type(error).__name__}: "
                f"{error!s:.80}); {GO_ON}"
            )
        else:
            return True
        with suppress(Exception):  # such as of a browser that has gone
            self._show_note()
        if job != self._draw:
            self.do(self._draw)
        return False

    def _later(self, what: str, job: Callable[[], None]) -> None:
        with self._wake:
            self._busy = what
            self._long.append(job)
            self._wake.notify_all()
        self.do(self._show_note)

    # panel

    def _add_figures(self) -> None:
        gui = self.server.gui
        gui.configure_theme(show_logo=False, show_share_button=False, brand_color=(68, 99, 246))
        gui.main_panel.dock_right()
        gui.set_panel_label(f"coview live: {self.planner.yard.site.name}")
        self._hint = gui.add_html(hint_html(len(self.planner.sensors)))
        self._figures = gui.add_html("")
        self._said = gui.add_html("")

    def _begin(self) -> None:
        self._add_controls()
        self._begun = True
        self._draw()
        yard = self.planner.yard
        self._pole_labels = add_signs(self.server.scene, yard.site, tuple(yard.mounts.values()))
        self._draw_sensors()

    def _add_controls(self) -> None:
        gui = self.server.gui
        planner = self.planner
        steps = gui.add_button_group("Changes", ("Undo", "Redo"))
        steps.on_click(
            lambda _: self._change(planner.undo if steps.value == "Undo" else planner.redo)
        )
        self._add_command("Undo", "Z", lambda: self._change(planner.undo))
        self._add_command("Redo", "Y", lambda: self._change(planner.redo))
        tabs = gui.add_tab_group()
        with tabs.add_tab("Sensor"):
            self._add_sensor_tab()
        with tabs.add_tab("Ask"):
            ask = gui.add_button_group("Best to", ("add", "move", "remove"))
            ask.on_click(lambda _: self._suggest(ask.value))
            gui.add_button("Accept the best").on_click(lambda _: self._change(self._accept_best))
            gui.add_button("Search from here").on_click(
                lambda _: self._later("searching", self._search)
            )
            gui.add_button("Measure with the detector").on_click(
                lambda _: self._later("measuring", self._measure)
            )
        with tabs.add_tab("Draw"):
            gui.add_button("Add a sensor at a click").on_click(
                lambda _: self._pick("the foot of its pole", self._plant)
            )
            gui.add_button("Draw a keep-out area").on_click(
                lambda _: self._pick("its corners, then Close", self._bound)
            )
            gui.add_button("Close the area").on_click(lambda _: self._change(self._close_area))
            gui.add_button("Remove all areas").on_click(
                lambda _: self._change(planner.set_keep_out, ())
            )
            flat = "PNG or JPEG; it lies flat, at the height of the ground under its middle"
            upload = gui.add_upload_button(
                "Lay a picture under it", mime_type="image/png, image/jpeg", hint=flat
            )
            upload.on_upload(
                lambda _: self.do(
                    lambda: self._take_picture(upload.value.name, upload.value.content)
                )
            )
            self._two = gui.add_text(
                "Two points", "", hint="x y x y of where they belong, or their distance (m)"
            )
            gui.add_button("Place the picture by two points").on_click(
                lambda _: self._pick("two points of the picture", self._place_picture)
            )
            gui.add_button("Take the picture away").on_click(
                lambda _: self.do(lambda: self._lay(None))
            )
        with tabs.add_tab("Score"):
            self._add_score_tab()
        with tabs.add_tab("Variants"):
            gui.add_html(site_html(planner.yard.site))
            self._table = gui.add_html("")
            self._wanted = gui.add_dropdown("Shown", ("A",))
            self._wanted.on_update(
                lambda _: self._typed(lambda: self._change(planner.show, self._wanted.value))
            )
            name = gui.add_text("New name", "B")
            gui.add_button("Keep as a new variant").on_click(
                lambda _: self._change(lambda: planner.show(name.value, copy=True))
            )
        with tabs.add_tab("View"):
            self._map = gui.add_dropdown("Seen how often", ("off", *MAP_HEIGHTS))
            self._map.on_update(lambda _: self.do(self._draw_map))
            gui.add_html(MAP_KEY)
            busiest = int(np.bincount(planner.unseen.frame, minlength=1).argmax())
            self._frame = gui.add_slider("Frame", 0, max(planner.frames - 1, 1), 1, busiest)
            self._frame.on_update(lambda _: self.do(self._draw_traffic))
            self._play = gui.add_checkbox("Play the traffic", False)
            gui.add_button("From above").on_click(
                lambda event: self.do(lambda: self._cameras.look_down(event.client))
            )
            gui.add_button("Overview").on_click(
                lambda event: self.do(lambda: self._cameras.show_all(event.client))
            )
        with tabs.add_tab("Files"):
            export = partial(self._write, export_variant, self.folder)
            report = partial(self._write, report_variant, self.folder / "report")
            gui.add_button("Export site, map and schedule").on_click(
                lambda _: self._later("exporting", export)
            )
            gui.add_button("Judge and write the report").on_click(
                lambda _: self._later("judging", report)
            )

    def _add_score_tab(self) -> None:
        gui = self.server.gui
        first = self.planner.first
        now = self.planner.asked
        self._details = gui.add_html("")

        def choose(label: str, options: Iterable[str], at_first: str, value: str) -> Handle:
            return gui.add_dropdown(
                label, tuple(dict.fromkeys((at_first, *options, value))), initial_value=value
            )

        def name(setting: "Setting") -> str:
            return next(
                (k for k, names in CLASSES.items() if names == setting.counted.names), "as given"
            )

        classes = choose("Classes", CLASSES, name(first), name(now))
        iou = choose(
            "IoU", ("0.5", "0.7", "0.8"), f"{first.cases.ious[0]:g}", f"{now.cases.ious[0]:g}"
        )
        scheme = choose("Scheme", PAPER_SCHEMES, first.fusion.name, now.fusion.name)
        errors = choose("Errors if measured", PROFILES, first.cases.names[0], now.cases.names[0])
        limit = gui.add_number(
            "Budget (0: none)", 0.0 if np.isinf(now.most_price) else now.most_price, min=0
        )

        def ask() -> "LiveAnswer":
            return self.planner.ask(
                classes=CLASSES.get(classes.value, first.classes),
                cases=replace(
                    self.planner.asked.cases, iou=float(iou.value), errors=(errors.value,)
                ),
                scheme=scheme.value if scheme.value != first.fusion.name else first.scheme,
                most_price=limit.value or np.inf,
            )

        for field in (classes, iou, scheme, errors, limit):
            field.on_update(lambda _: self._change(ask))

    def _pick(self, what: str, then: Callable[[Spot], None]) -> None:
        self._spots = []
        self._await_spot = then
        self._note = f"click on the ground: {what}"
        self.do(self._show_note)

    def _click(self, event: Handle) -> None:
        """Follow a click on the ground where one is awaited."""
        eye = np.array(event.ray_origin)
        way = np.array(event.ray_direction)
        if self._await_spot is not None and way[2] < -1e-6:
            level = float(self.planner.yard.site.ground(np.array(event.client.camera.look_at)[:2]))
            spot = eye + way * (level - eye[2]) / way[2]
            then = self._await_spot
            self.do(lambda: then(spot))

    def _plant(self, spot: Spot) -> None:
        self._await_spot = None
        x, y = self.planner.yard.site.area.reshape(2, 2).mean(axis=0) - spot[:2]
        where = float(spot[0]), float(spot[1])
        self._show(self.planner.add(where, float(np.arctan2(y, x)), model=self._model.value))

    def _bound(self, spot: Spot) -> None:
        self._spots.append(spot)
        self._note = describe_count(len(self._spots), "corner")
        self._show_note()
        self._draw_areas()

    def _close_area(self) -> "LiveAnswer":
        corners = tuple((float(x), float(y)) for x, y, _ in self._spots)
        self._spots = []
        self._await_spot = None
        return self.planner.set_keep_out((*self.planner.variant.keep_out, corners))

    def _take_picture(self, name: str, content: bytes) -> None:
        self._lay(keep_picture(name, content, self._beside, self.planner.yard.site.area))
        self._note = "type two points of the picture, or their distance, and place it by them"
        self._show_note()

    def _place_picture(self, spot: Spot) -> None:
        self._spots.append(spot)
        if len(self._spots) < 2 or self.planner.picture is None:
            self._note = (
                "click on the other one"
                if self.planner.picture
                else "there is no picture: lay one first"
            )
            self._show_note()
            return
        spots = [each[:2].tolist() for each in self._spots]
        self._spots = []
        self._await_spot = None
        try:
            given = [float(each) for each in self._two.value.replace(",", " ").split()]
        except ValueError:
            given = []
        self._lay(self.planner.picture.place(spots, given))

    def _lay(self, picture: GroundPicture | None) -> None:
        self.planner.lay(picture)
        self._note = ""
        self._draw()

    def _draw_picture(self) -> None:
        picture = self.planner.picture
        site = self.planner.yard.site
        if self._drawn.get("/picture") == picture:
            return
        self._drawn["/picture"] = picture
        self.server.scene.remove_by_name("/picture")
        if picture is not None:
            lay_picture(self.server.scene, site, picture, self._beside)

    def _draw_areas(self) -> None:
        """Draw the keep-out areas, and the one that is being drawn."""
        site = self.planner.yard.site
        lines = []
        ways = [(*corners, corners[0]) for corners in self.planner.variant.keep_out]
        ways.append(tuple((float(x), float(y)) for x, y, _ in self._spots))
        if self._drawn.get("/areas") == ways:
            return
        self._drawn["/areas"] = ways
        for way in ways:
            spots = [np.array([x, y, float(site.ground(np.array([x, y]))) + 0.2]) for x, y in way]
            lines += [[start, end] for start, end in pairwise(spots)]
        self.server.scene.remove_by_name("/areas")
        rows = np.array(lines).reshape(-1, 2, 3)
        scene.add_lines(self.server.scene, "/areas", rows, KEPT_OUT, width=4.0, visible=True)

    def _add_command(self, label: str, key: Any, then: Callable[[], None]) -> None:
        self.server.gui.add_command(label, hotkey=key, modifier="cmd/ctrl").on_trigger(
            lambda _: then()
        )

    def _add_sensor_tab(self) -> None:
        gui = self.server.gui
        planner = self.planner
        self._chosen = gui.add_dropdown("Sensor", ("none",))
        self._bearing = gui.add_number(
            "Bearing (deg)", 0.0, step=1.0, hint="clockwise from north, as in the schedule"
        )
        self._tilt = gui.add_number("Tilt (deg)", 0.0, step=1.0, hint="below the horizon")
        self._height = gui.add_number(
            "Height (m)", 0.0, step=0.1, hint="above the foot of the pole"
        )
        self._lock = gui.add_checkbox("Locked", False)
        self._fail = gui.add_checkbox("Failed", False)
        act = gui.add_button_group("This one", ("Duplicate", "Remove"))
        through = gui.add_button(
            "Look through it", hint="from where it hangs; Overview on the tab View leads back"
        )
        through.on_click(lambda event: self.do(lambda: self._look_through(event.client)))
        self._model = gui.add_dropdown("New model", tuple(planner.yard.models))
        self._pole = gui.add_dropdown("On pole", tuple(planner.yard.mounts))
        gui.add_button("Add a sensor").on_click(lambda _: self._change(self._add))
        self._chosen.on_update(lambda _: self._typed(lambda: self.do(self._fill)))
        for field in (self._bearing, self._tilt, self._height):
            field.on_update(lambda _: self._typed(self._move_typed))
        self._lock.on_update(
            lambda _: self._typed(lambda: self._change(planner.lock, self._name, self._lock.value))
        )
        self._fail.on_update(
            lambda _: self._typed(lambda: self._change(planner.fail, self._name, self._fail.value))
        )
        act.on_click(
            lambda _: self._change(
                planner.duplicate if act.value == "Duplicate" else planner.remove, self._name
            )
        )

    @property
    def _name(self) -> str:
        return str(self._chosen.value)

    def _typed(self, then: Callable[[], None]) -> None:
        """Follow what a person typed or chose, not what the page itself fills in."""
        if not self._filling:
            then()

    def _change(self, change: "Callable[..., LiveAnswer]", *arguments: Any) -> None:
        self.do(lambda: self._show(change(*arguments)))

    def _move_typed(self) -> None:
        self._change(
            self._move_as_typed,
            self._name,
            self._bearing.value,
            self._tilt.value,
            self._height.value,
        )

    def _move_as_typed(
        self, name: str, bearing: object, tilt: object, height: object
    ) -> "LiveAnswer":
        yard = self.planner.yard
        sensor = self.planner.variant.find(name)
        mount = yard.find_mount(self.planner.variant, sensor.mount)
        return self.planner.move(
            name,
            parse_heading(yard.site, str(bearing), sensor.heading),
            parse_tilt(float(str(tilt)), sensor.tilt),
            parse_height(mount, float(str(height)), sensor.height),
        )

    def _add(self) -> "LiveAnswer":
        site = self.planner.yard.site
        pole = self.planner.yard.find_mount(self.planner.variant, str(self._pole.value))
        x, y = (site.area[:2] + site.area[2:]) / 2 - pole.position[:2]
        return self.planner.add(pole.name, float(np.arctan2(y, x)), model=self._model.value)

    def _suggest(self, kind: str) -> None:
        name = self._name if kind == "move" else None

        def job() -> None:
            found = self._ghosts = list(self.planner.suggest(kind, name, patience=PATIENCE))
            self._note = describe_suggestions(kind, found)
            self.do(self._draw)

        self._later("comparing poses", job)

    def _accept_best(self) -> "LiveAnswer":
        if not self._ghosts:
            raise ValueError("nothing is suggested: ask for a suggestion first")
        best = self._ghosts[0]
        self._ghosts = []
        return self.planner.accept(best)

    def _search(self) -> None:
        before = self.planner.answer()
        count = 0
        for answer in self.planner.search(lambda: self._closed):
            count += 1
            self._note = f"search: AP {format_ap(answer)} after {describe_count(count, 'change')}"
            self.do(lambda answer=answer: self._show(answer))  # type: ignore[misc]
        after = format_ap(self.planner.answer())
        changes = describe_count(count, "change")
        self._note = f"search: AP {format_ap(before)} to {after} by {changes}; undo takes them back"

    def _measure(self) -> None:
        predicted = self.planner.finish()
        found = self.planner.measure()
        number = f"N = {describe_count(found.objects, 'road user')}"
        self._measured = (
            f"measured {describe_ap(found)}, predicted {format_ap(predicted)}, {number}"
        )
        self._note = f"by the detector: {self._measured}"

    def _write(self, write: Callable[[LivePlanner, Path], Iterable[Path]], folder: Path) -> None:
        self._note = (
            f"written to {folder}: {', '.join(path.name for path in write(self.planner, folder))}"
        )

    # drawing

    def _show(self, answer: "LiveAnswer") -> None:
        self._answer = answer
        self._note = ""
        if answer.what:
            self._ghosts = []
            self._measured = ""
        self._draw()

    def _draw(self) -> None:
        answer = self._answer
        self._show_note()
        if answer is None:
            return
        hint = hint_html(answer.sensors)
        if self._hint.content != hint:
            self._hint.content = hint
        self._figures.content = figures_html(answer)
        self.server.flush()  # figures do not wait for the scene
        if not self._begun:
            return
        with self.server.atomic():
            self._draw_sensors()
            self._draw_ghosts()
            self._draw_areas()
            self._draw_picture()
        self._behind = self._behind or time.monotonic()

    def _draw_rest(self) -> None:
        """Draw what the next answer does not wait for."""
        self._behind = 0.0
        if self._answer is not None:
            self._details.content = details_html(self._answer)
            self._draw_traffic()
            self._draw_map()
            self._draw_variants()
            self._fill()

    def _draw_variants(self) -> None:
        yard = self.planner.yard
        variants = self.planner.variants
        self._small = draw_small_maps(yard, variants.values(), self._small)
        shown = self.planner.current
        estimate = self.planner.estimate
        known = {} if self._answer is None else {shown: self._answer}
        answers = {name: known.get(name) or estimate(each) for name, each in variants.items()}
        maps = {name: self._small[each] for name, each in variants.items()}
        self._table.content = variants_html(answers, self.planner.current, maps)

    def _show_note(self) -> None:
        self._said.content = note_html(self._busy, self._note or self._measured)

    def _fill(self) -> None:
        """Put the state into the controls."""
        self._filling = True
        try:
            names = tuple(sensor.name for sensor in self.planner.sensors) or ("none",)
            if self._chosen.options != names:
                self._chosen.options = names
            if tuple(self._wanted.options) != tuple(self.planner.variants):
                self._wanted.options = tuple(self.planner.variants)
            self._wanted.value = self.planner.current
            with suppress(ValueError):
                sensor = self.planner.variant.find(self._name)
                self._bearing.value = show_bearing(self.planner.yard.site, sensor)
                self._tilt.value = round(float(np.rad2deg(sensor.tilt)), 1)
                self._height.value = round(sensor.height, 2)
                self._lock.value = sensor.locked
                self._fail.value = sensor.failed
        finally:
            self._filling = False

    def _draw_sensors(self) -> None:
        variant = self.planner.variant
        used = {sensor.mount for sensor in variant.sensors}  # whose sensors bear their names
        for pole, label in self._pole_labels.items():
            if label.visible == (pole in used):
                label.visible = pole not in used
        kept = {"", *(sensor.name for sensor in variant.sensors)}
        for name in [name for name in self._nodes if name not in kept]:
            self._drawn.pop(name, None)
            for handle in self._nodes.pop(name):
                handle.remove()
        for index, live in enumerate(variant.sensors):
            if live.name in self._nodes and self._drawn.get(live.name) == (index, live):
                continue
            self._drawn[live.name] = index, live
            sensor = self.planner.yard.build_sensor(variant, live)
            colour = scene.rgb(FAINT if live.failed else sensor_colour(index))
            if live.name not in self._nodes:
                self._nodes[live.name] = self._add_sensor(live, sensor, colour)
            housing, handle, way, label = self._nodes[live.name]
            target = find_target(self.planner.yard.site, sensor)
            housing.position = sensor.position
            handle.position = target
            housing.color = handle.color = colour
            way.points = draw_view(self.planner.yard.site, sensor, target)
            way.colors = np.array(colour, np.uint8)
            label.position = target + np.array([0.0, 0.0, 1.1])  # apart, where two hang on a pole
            state = (" (failed)" if live.failed else "") + (" (locked)" if live.locked else "")
            label.text = f"{live.name}{state}"

    def _add_sensor(
        self, live: LiveSensor, sensor: Sensor, colour: tuple[int, int, int]
    ) -> list[Handle]:
        api = self.server.scene
        node = f"/planned/{secrets.token_hex(4)}"
        housing = api.add_box(f"{node}/housing", colour, (1.2, 1.2, 0.9))
        handle = api.add_icosphere(f"{node}/handle", 0.8, colour, subdivisions=2)
        lines = draw_view(
            self.planner.yard.site, sensor, find_target(self.planner.yard.site, sensor)
        )
        way = api.add_line_segments(
            f"{node}/view", lines, colour, thickness=2.5, thickness_units="screen"
        )
        label = api.add_label(
            f"{node}/label", live.name, font_screen_scale=1.2, anchor="bottom-center"
        )
        name = live.name

        @handle.on_drag("left")
        async def _(event: Handle) -> None:
            self._take(name, event, lambda spot, last: self._turn(name, spot, last=last), handle)

        @housing.on_drag("left")
        async def _(event: Handle) -> None:
            self._take(name, event, lambda spot, last: self._carry(name, spot, last=last), housing)

        @housing.on_drag("left", modifier="shift")
        async def _(event: Handle) -> None:
            up = float(event.end_position[2])
            self._drag_now(
                lambda: self._lift(name, up, last=event.phase == "end"), last=event.phase == "end"
            )

        for part in (housing, handle):
            part.on_click(lambda _: self._choose(name))
        return [housing, handle, way, label]

    def _choose(self, name: str) -> None:
        self.do(lambda: self._choose_now(name))

    def _choose_now(self, name: str) -> None:
        self._fill()
        if name in self._chosen.options:  # another browser may have removed it
            self._chosen.value = name
            self._fill()

    def _take(
        self, name: str, event: Handle, then: Callable[[Spot, bool], None], node: Handle
    ) -> None:
        """Follow a drag: where the pointer meets the level of what is dragged."""
        eye = np.array(event.client.camera.position)
        through = np.array(event.end_position)
        level = float(node.position[2])
        way = through - eye
        last = event.phase == "end"
        if way[2] < -1e-6:
            spot = eye + way * (level - eye[2]) / way[2]
            self._drag_now(lambda: then(spot, last), last=last)

    def _drag_now(self, job: Callable[[], None], *, last: bool) -> None:
        with self._wake:
            if last:
                self._drag = None
                self._jobs.append(job)
            else:
                self._drag = job
            self._wake.notify_all()

    def _turn(self, name: str, spot: Spot, *, last: bool) -> None:
        sensor = self.planner.yard.build_sensor(
            self.planner.variant, self.planner.variant.find(name)
        )
        x, y, z = (spot - sensor.position).tolist()
        heading = float(np.arctan2(y, x))
        tilt = float(np.arctan2(-z, np.hypot(x, y)))
        self._show(self.planner.move(name, heading, tilt, dragging=True))
        self._end_drag(name, last)

    def _carry(self, name: str, spot: Spot, *, last: bool) -> None:
        mount = self.planner.variant.find(name).mount
        mounts = [*self.planner.yard.stock.mounts, *self.planner.variant.poles]
        away = np.array([np.hypot(*(mount.position[:2] - spot[:2])) for mount in mounts])
        if away.min() <= CATCH:
            pole = mounts[int(away.argmin())].name
            if pole != mount:
                self._show(self.planner.move(name, position=pole, dragging=True))
        elif last:
            self._show(
                self.planner.move(name, position=(float(spot[0]), float(spot[1])), dragging=True)
            )
        elif name in self._nodes:  # another browser may have brought it a moment ago
            self._nodes[name][0].position = spot
            self._drawn.pop(name, None)
        self._end_drag(name, last)

    def _lift(self, name: str, up: float, *, last: bool) -> None:
        sensor = self.planner.variant.find(name)
        foot = float(self.planner.yard.find_mount(self.planner.variant, sensor.mount).position[2])
        self._show(self.planner.move(name, height=up - foot, dragging=True))
        self._end_drag(name, last)

    def _end_drag(self, name: str, last: bool) -> None:
        if last:
            self.planner.end_drag()
            self._choose(name)
            self._draw_sensors()

    def _draw_ghosts(self) -> None:
        for handle in self._nodes.pop("", []):
            handle.remove()
        made: list[Handle] = []
        for k, each in enumerate(self._ghosts):
            sensor = self.planner.yard.build_sensor(self.planner.variant, each.sensor)
            node = f"/ghosts/{k}"
            target = find_target(self.planner.yard.site, sensor)
            api = self.server.scene
            colour = scene.rgb(GHOST)
            made.append(
                api.add_box(
                    f"{node}/housing",
                    colour,
                    (1.1, 1.1, 0.9),
                    opacity=0.4,
                    position=sensor.position,
                )
            )
            made[-1].on_click(lambda _, each=each: self._change(self.planner.accept, each))
            made.append(
                api.add_line_segments(
                    f"{node}/view", draw_view(self.planner.yard.site, sensor, target), colour
                )
            )
            text = f"{'without ' * (each.kind == 'remove')}AP {format_ap(each.answer)}"
            place = sensor.position + np.array([0.0, 0.0, 2.2])
            made.append(
                api.add_label(f"{node}/label", text, position=place, anchor="bottom-center")
            )
        self._nodes[""] = made

    def _draw_traffic(self) -> None:
        answer = self._answer
        seen = self.planner.unseen
        if answer is None or len(answer.probability) != len(
            seen.boxes
        ):  # all frames come in a moment
            return
        here = np.flatnonzero(seen.frame == int(self._frame.value))
        found = answer.probability[here] >= FOUND
        hidden = answer.hidden[here]
        if self._drawn.get("/traffic") == (here.tolist(), found.tolist(), hidden.tolist()):
            return
        self._drawn["/traffic"] = here.tolist(), found.tolist(), hidden.tolist()
        for handle in self._traffic:
            handle.remove()
        boxes = seen.boxes[here[found]]
        missed = seen.boxes[here[~found]]
        crossed = np.concatenate([scene.box_edges(missed), scene.roof_crosses(missed)])
        drawn = (
            ("found", scene.box_edges(boxes), OUTCOME["hit"].colour),
            ("missed", crossed, OUTCOME["missed"].colour),
            ("unseen", scene.arrows(seen.boxes[here[hidden]]), INK),
        )
        made = [
            scene.add_lines(
                self.server.scene, f"/traffic/{name}", lines, colour, width=2.5, visible=True
            )
            for name, lines, colour in drawn
        ]
        self._traffic = [handle for handle in made if handle is not None]

    def _draw_map(self) -> None:
        self.server.scene.remove_by_name("/seen")
        if self._map.value not in MAP_HEIGHTS:
            return
        from matplotlib import colormaps

        height = MAP_HEIGHTS[self._map.value]
        if height not in self._maps:
            self._maps[height] = SeenMaps(self.planner.preparation, height)
        standing = [each for each in self.planner.sensors if not each.failed]
        variant = self.planner.variant
        found = self._maps[height].draw(
            self.planner.yard.build_sensor(variant, each) for each in standing
        )
        colours = (255 * np.asarray(colormaps["viridis_r"](np.nan_to_num(found.share)))).astype(
            np.uint8
        )
        colours[..., 3] = np.where(np.isnan(found.share), 0, 190)
        cell = float(found.x[1] - found.x[0])
        middle = np.array([found.x.mean(), found.y.mean()])
        place = (*middle.tolist(), float(self.planner.yard.site.ground(middle)) + 0.1)
        self.server.scene.add_image(
            "/seen",
            colours,
            len(found.x) * cell,
            len(found.y) * cell,
            position=place,
            cast_shadow=False,
        )

    def _greet(self, client: Handle) -> None:
        self._touched = time.monotonic()
        self._cameras.greet(client)

    def _look_through(self, client: Handle) -> None:
        variant = self.planner.variant
        self._cameras.look_through(
            client, self.planner.yard.build_sensor(variant, variant.find(self._name))
        )
