"""Tabs of the live planner's panel, and the state that they show."""

from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from coview.live_ask import LongTasks
from coview.live_cameras import LiveCameras
from coview.live_clicks import GroundClicks
from coview.live_jobs import LiveJobs
from coview.live_tables import MAP_KEY, details_html, draw_small_maps, site_html, variants_html
from placement_env.classes import SMALL_CLASSES
from placement_env.live.directions import parse_heading, parse_height, parse_tilt, show_bearing
from placement_env.live.planner import LivePlanner
from placement_env.live.seen_map import MAP_HEIGHTS
from placement_env.live.variant import Variant
from toolkit.detection.schemes import PAPER_SCHEMES
from toolkit.sensors.error_profiles import PROFILES
from toolkit.viewing.scene import Handle

if TYPE_CHECKING:
    from viser import GuiApi

    from placement_env.live.figures import LiveAnswer
    from placement_env.setting import Setting

# classes of road users by the text of the choice
CLASSES = {
    "vehicle": ("vehicle",),
    "cyclist and pedestrian": SMALL_CLASSES,
    "all three": ("vehicle", *SMALL_CLASSES),
}


class FieldGuard:
    """Separate changes of fields that a person makes from changes that the page makes.

    Both call the same functions of the fields."""

    def __init__(self) -> None:
        self._filling = False

    @contextmanager
    def filling(self) -> Iterator[None]:
        """Let `typed` ignore all changes of fields during the block.

        A change by the program calls the fields' functions as typing does."""
        self._filling = True
        try:
            yield
        finally:
            self._filling = False

    def typed(self, then: Callable[[], None]) -> None:
        """Call `then`, unless the page is filling in fields."""
        if not self._filling:
            then()


class SensorTab:
    """Tab with the sensor that is chosen, and with what a new one is made of.

    guard: ignores changes that the page makes; fill: function that fills in the whole panel.

    Attributes:
        bearing: Field with the sensor's compass bearing (degrees).
        tilt: Field with its tilt below the horizon (degrees).
        height: Field with its height above the foot of the pole (m).
        model: Field with the model of a new sensor.
        pole: Field with the pole of a new sensor.
    """

    def __init__(
        self,
        gui: "GuiApi",
        planner: LivePlanner,
        jobs: LiveJobs,
        cameras: LiveCameras,
        guard: FieldGuard,
        fill: Callable[[], None],
    ) -> None:
        """Add the tab's fields and buttons. fill: shows the chosen sensor in the fields."""
        self._planner = planner
        self._jobs = jobs
        self._cameras = cameras
        self._guard = guard
        self._chosen: Handle = gui.add_dropdown("Sensor", ("none",))
        self.bearing: Handle = gui.add_number(
            "Bearing (deg)", 0.0, step=1.0, hint="clockwise from north, as in the schedule"
        )
        self.tilt: Handle = gui.add_number("Tilt (deg)", 0.0, step=1.0, hint="below the horizon")
        self.height: Handle = gui.add_number(
            "Height (m)", 0.0, step=0.1, hint="above the foot of the pole"
        )
        self._lock: Handle = gui.add_checkbox("Locked", False)
        self._fail: Handle = gui.add_checkbox("Failed", False)
        changes = gui.add_button_group("This one", ("Duplicate", "Remove"))
        look_button = gui.add_button(
            "Look through it", hint="from where it hangs; Overview on the tab View leads back"
        )
        look_button.on_click(lambda event: jobs.do(lambda: self._look_through(event.client)))
        self.model: Handle = gui.add_dropdown("New model", tuple(planner.yard.models))
        self.pole: Handle = gui.add_dropdown("On pole", tuple(planner.yard.mounts))
        gui.add_button("Add a sensor").on_click(lambda _: jobs.change(self.add))
        self._chosen.on_update(lambda _: guard.typed(lambda: jobs.do(fill)))
        for field in (self.bearing, self.tilt, self.height):
            field.on_update(lambda _: guard.typed(self._move_typed))
        self._lock.on_update(
            lambda _: guard.typed(lambda: jobs.change(planner.lock, self.name, self._lock.value))
        )
        self._fail.on_update(
            lambda _: guard.typed(lambda: jobs.change(planner.fail, self.name, self._fail.value))
        )
        changes.on_click(
            lambda _: jobs.change(
                planner.duplicate if changes.value == "Duplicate" else planner.remove, self.name
            )
        )

    @property
    def name(self) -> str:
        """Name of the sensor that is chosen, "none" without sensors."""
        return str(self._chosen.value)

    def choose(self, name: str) -> bool:
        """Choose a sensor; False if the panel does not offer it."""
        if name not in self._chosen.options:  # another browser may have removed it
            return False
        self._chosen.value = name
        return True

    def fill_names(self) -> None:
        """Offer the sensors of the variant."""
        names = tuple(sensor.name for sensor in self._planner.sensors) or ("none",)
        if self._chosen.options != names:
            self._chosen.options = names

    def fill(self) -> None:
        """Show the state of the chosen sensor in the fields, in degrees and m; nothing if it is
        gone."""
        with suppress(ValueError):  # another browser may have removed it
            sensor = self._planner.variant.find(self.name)
            self.bearing.value = show_bearing(self._planner.yard.site, sensor)
            self.tilt.value = round(float(np.rad2deg(sensor.tilt)), 1)
            self.height.value = round(sensor.height, 2)
            self._lock.value = sensor.locked
            self._fail.value = sensor.failed

    def _move_typed(self) -> None:
        """Move the chosen sensor as the fields are now, in the page's thread."""
        self._jobs.change(
            self.move_as_typed, self.name, self.bearing.value, self.tilt.value, self.height.value
        )

    def move_as_typed(
        self, name: str, bearing: object, tilt: object, height: object
    ) -> "LiveAnswer":
        """Move a sensor as typed, and return the new figures.

        Numbers that are typed as they were printed change nothing. name: name of the sensor;
        bearing: degrees clockwise from north; tilt: degrees below the horizon; height: m above the
        foot of the pole. Raises ValueError for other texts, and beyond the limits."""
        yard = self._planner.yard
        sensor = self._planner.variant.find(name)
        mount = yard.find_mount(self._planner.variant, sensor.mount)
        return self._planner.move(
            name,
            heading=parse_heading(yard.site, str(bearing), sensor.heading),
            tilt=parse_tilt(float(str(tilt)), sensor.tilt),
            height=parse_height(mount, float(str(height)), sensor.height),
        )

    def add(self) -> "LiveAnswer":
        """Add a sensor of the chosen model on the chosen pole, and return the new figures.

        It looks at the middle of the area."""
        site = self._planner.yard.site
        pole = self._planner.yard.find_mount(self._planner.variant, str(self.pole.value))
        middle = (site.area[:2] + site.area[2:]) / 2
        x, y = middle - pole.position[:2]  # from the pole to the middle
        heading = float(np.arctan2(y, x))
        return self._planner.add(pole.name, heading=heading, model=self.model.value)

    def _look_through(self, client: Handle) -> None:
        """Show the view of the chosen sensor in one browser. client: the browser."""
        variant = self._planner.variant
        sensor = self._planner.yard.build_sensor(variant, variant.find(self.name))
        self._cameras.look_through(client, sensor)


class ScoreTab:
    """Tab with the question that sensors are scored by, and figures in detail."""

    def __init__(self, gui: "GuiApi", planner: LivePlanner, jobs: LiveJobs) -> None:
        """Add the fields that change the setting of the figures, with the present values."""
        self._planner = planner
        first_setting = planner.first_setting  # at the start of the page
        setting = planner.asked_setting  # at present
        self._details = gui.add_html("")

        def add_choice(label: str, options: Iterable[str], at_first: str, value: str) -> Handle:
            """Add a dropdown that lists the value at the start first, and chooses the present."""
            different_options = tuple(dict.fromkeys((at_first, *options, value)))
            return gui.add_dropdown(label, different_options, initial_value=value)

        self._classes = add_choice(
            "Classes", CLASSES, at_first=_name_classes(first_setting), value=_name_classes(setting)
        )
        self._iou = add_choice(
            "IoU",
            ("0.5", "0.7", "0.8"),
            at_first=f"{first_setting.cases.ious[0]:g}",
            value=f"{setting.cases.ious[0]:g}",
        )
        self._scheme = add_choice(
            "Scheme", PAPER_SCHEMES, at_first=first_setting.fusion.name, value=setting.fusion.name
        )
        self._errors = add_choice(
            "Errors if measured",
            PROFILES,
            at_first=first_setting.cases.names[0],
            value=setting.cases.names[0],
        )
        budget = 0.0 if np.isinf(setting.most_price) else setting.most_price
        self._limit = gui.add_number("Budget (0: none)", budget, min=0)
        for field in (self._classes, self._iou, self._scheme, self._errors, self._limit):
            field.on_update(lambda _: jobs.change(self._ask))

    def _ask(self) -> "LiveAnswer":
        """Score by the setting in the fields, and return the new figures.

        A choice of the start means what was given then, which may be more than its name, such as a
        scheme with options."""
        first = self._planner.first_setting
        cases = replace(
            self._planner.asked_setting.cases,
            iou=float(self._iou.value),
            errors=(self._errors.value,),
        )
        scheme = self._scheme.value
        return self._planner.ask(
            classes=CLASSES.get(self._classes.value, first.classes),
            cases=cases,
            scheme=scheme if scheme != first.fusion.name else first.scheme,
            most_price=self._limit.value or np.inf,  # 0 means no limit
        )

    def show(self, answer: "LiveAnswer") -> None:
        """Show the figures of an answer in detail."""
        self._details.content = details_html(answer)


class VariantsTab:
    """Tab with a table and small maps of the variants."""

    def __init__(
        self, gui: "GuiApi", planner: LivePlanner, jobs: LiveJobs, guard: FieldGuard
    ) -> None:
        """Add the table, the choice of the variant that is shown, and a field for a new one."""
        self._planner = planner
        self._small_maps: dict[Variant, str] = {}  # HTML by variant, so that none is drawn twice
        gui.add_html(site_html(planner.yard.site))  # hidden; the small maps show it
        self._table = gui.add_html("")
        self._shown: Handle = gui.add_dropdown("Shown", ("A",))
        self._shown.on_update(
            lambda _: guard.typed(lambda: jobs.change(planner.show, self._shown.value))
        )
        name_field = gui.add_text("New name", "B")
        gui.add_button("Keep as a new variant").on_click(
            lambda _: jobs.change(lambda: planner.show(name_field.value, copy=True))
        )

    def fill(self) -> None:
        """Offer the variants, and choose the one that is shown."""
        if tuple(self._shown.options) != tuple(self._planner.variants):
            self._shown.options = tuple(self._planner.variants)
        self._shown.value = self._planner.current

    def show(self, answer: "LiveAnswer") -> None:
        """Show the variants side by side. answer: figures of the one that is shown."""
        planner = self._planner
        variants = planner.variants
        self._small_maps = draw_small_maps(planner.yard, variants.values(), self._small_maps)
        current = planner.current
        answers = {
            name: answer if name == current else planner.estimate(variant)
            for name, variant in variants.items()
        }
        maps = {name: self._small_maps[variant] for name, variant in variants.items()}
        self._table.content = variants_html(answers, planner.current, maps)


class ViewTab:
    """Tab with the map, the frame of traffic and the cameras.

    draw_map, draw_traffic: functions that draw the map and the frame as the controls are set.

    Attributes:
        map: Control with the kind of road user of the map, or "off".
        frame: Control with the number of the frame, from 0; the busiest one at first.
    """

    def __init__(
        self,
        gui: "GuiApi",
        planner: LivePlanner,
        jobs: LiveJobs,
        cameras: LiveCameras,
        *,
        draw_map: Callable[[], None],
        draw_traffic: Callable[[], None],
    ) -> None:
        """Add the tab's fields. draw_map, draw_traffic: draw what the fields choose."""
        self._planner = planner
        self.map: Handle = gui.add_dropdown("Seen how often", ("off", *MAP_HEIGHTS))
        self.map.on_update(lambda _: jobs.do(draw_map))
        gui.add_html(MAP_KEY)
        # `frame`: frame of each road user; the busiest frame is shown first
        busiest_frame = int(np.bincount(planner.unseen.frame, minlength=1).argmax())
        last_frame = max(planner.frames - 1, 1)
        self.frame: Handle = gui.add_slider(
            "Frame", min=0, max=last_frame, step=1, initial_value=busiest_frame
        )
        self.frame.on_update(lambda _: jobs.do(draw_traffic))
        self._play = gui.add_checkbox("Play the traffic", False)
        gui.add_button("From above").on_click(
            lambda event: jobs.do(lambda: cameras.look_down(event.client))
        )
        gui.add_button("Overview").on_click(
            lambda event: jobs.do(lambda: cameras.show_all(event.client))
        )

    @property
    def is_playing(self) -> bool:
        """True while the box to play the traffic is checked."""
        return bool(self._play.value)

    def show_next_frame(self) -> None:
        """Go on to the next frame, after the last one to the first."""
        self.frame.value = (int(self.frame.value) + 1) % self._planner.frames

    def offer_all_frames(self) -> bool:
        """Let all frames of the planner be chosen; False if they could be already."""
        if self.frame.max >= self._planner.frames - 1:
            return False
        self.frame.max = self._planner.frames - 1
        return True


class LivePanel:
    """Controls below the figures: undo, redo and the tabs.

    jobs: threads that do what controls ask for; clicks, tasks: make the controls of the tabs Draw,
    Ask and Files; drawing: the functions `draw_map` and `draw_traffic` for the tab View.

    Attributes:
        sensor: Tab with the sensor that is chosen.
        score: Tab with the question.
        variants: Tab with the variants.
        view: Tab with map, traffic and cameras.
    """

    def __init__(
        self,
        gui: "GuiApi",
        planner: LivePlanner,
        jobs: LiveJobs,
        cameras: LiveCameras,
        clicks: GroundClicks,
        tasks: LongTasks,
        **drawing: Callable[[], None],
    ) -> None:
        """Add all controls in the panel's tabs.

        drawing: functions of the tab View by name, `draw_map` and `draw_traffic`; others are for
        several tabs."""
        self._guard = FieldGuard()  # ignores changes of fields by the program
        steps = gui.add_button_group("Changes", ("Undo", "Redo"))
        steps.on_click(
            lambda _: jobs.change(planner.undo if steps.value == "Undo" else planner.redo)
        )
        _add_command(gui, label="Undo", key="Z", then=lambda: jobs.change(planner.undo))
        _add_command(gui, label="Redo", key="Y", then=lambda: jobs.change(planner.redo))
        tabs = gui.add_tab_group()
        with tabs.add_tab("Sensor"):
            self.sensor = SensorTab(gui, planner, jobs, cameras, guard=self._guard, fill=self.fill)
        with tabs.add_tab("Ask"):
            tasks.add_ask_controls(gui, lambda: self.sensor.name)
        with tabs.add_tab("Draw"):
            clicks.add_controls(gui, self.sensor.model)
        with tabs.add_tab("Score"):
            self.score = ScoreTab(gui, planner, jobs)
        with tabs.add_tab("Variants"):
            self.variants = VariantsTab(gui, planner, jobs, guard=self._guard)
        with tabs.add_tab("View"):
            self.view = ViewTab(gui, planner, jobs, cameras, **drawing)
        with tabs.add_tab("Files"):
            tasks.add_file_controls(gui)

    def fill(self) -> None:
        """Put the state of the planner into the controls, whose changes are then ignored."""
        with self._guard.filling():
            self.sensor.fill_names()
            self.variants.fill()
            self.sensor.fill()

    def choose(self, name: str) -> None:
        """Choose a sensor by name and fill in its state, unless it is gone."""
        self.fill()
        if self.sensor.choose(name):
            self.fill()


def _add_command(gui: "GuiApi", label: str, key: Any, then: Callable[[], None]) -> None:
    """Add a command with a hotkey: Ctrl or Cmd and `key`. then: function that it calls."""
    gui.add_command(label, hotkey=key, modifier="cmd/ctrl").on_trigger(lambda _: then())


def _name_classes(setting: "Setting") -> str:
    """Text of the choice for a setting's classes, "as given" for other classes."""
    names = setting.counted.names
    return next((name for name, classes in CLASSES.items() if classes == names), "as given")
