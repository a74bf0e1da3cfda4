"""The live planner in the browser: a scene of viser with handles on every sensor, and a panel with
the figures.

viser shows the scene, drags and controls, the same in every browser that has the address; tables
are HTML of ours. Whatever a handle or control asks for is done by one thread, the latest position
of a drag first. A second thread refines what is coarse while nobody moves anything, a third does
what takes long: suggestions, searches, the detector, reports."""

import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from coview.live_ask import LongTasks
from coview.live_cameras import LiveCameras
from coview.live_clicks import GroundClicks
from coview.live_context import LiveContext
from coview.live_drags import SensorDrags
from coview.live_drawings import (
    AreaDrawing,
    Ghosts,
    PictureDrawing,
    SeenMapDrawing,
    SensorDrawings,
    TrafficDrawing,
)
from coview.live_head import PanelHead
from coview.live_jobs import Job, LiveJobs, Refining
from coview.live_names import add_long_names, hide_long_names
from coview.live_panel import LivePanel
from coview.live_signs import add_signs
from coview.live_tables import describe_stated
from placement_env.live.planner import LivePlanner
from placement_env.live.project import ProjectFile
from toolkit.viewing import scene
from toolkit.viewing.scene import Handle

if TYPE_CHECKING:
    from viser import ViserServer

    from placement_env.live.figures import LiveAnswer

PAINT_S = 1.2  # time that a browser gets to show the first figures, before controls and scene
PLAY_S = 0.25  # time between two frames of traffic that is played


class LivePage:
    """Scene and panel of a planner on a server.

    project: file that keeps the planner's work, also with the pictures in its folder, None for
    none; folder: folder for exports and reports, and for pictures without a project.

    Attributes:
        head: Hint, figures and note, which are shown from the start.
        jobs: Threads that do what a browser asks for.
        panel: Controls, made after a browser had time to show the figures.
        sensors: Drawings of the sensors.
        drags: Drags of sensors.
        clicks: Clicks on the ground.
        tasks: Suggestions, searches, measurements and files.
    """

    panel: LivePanel

    def __init__(
        self, server: "ViserServer", planner: LivePlanner, project: ProjectFile | None, folder: Path
    ) -> None:
        """Add panel and scene, start the page's threads, and show the first figures.

        project: file that keeps the work, None without one; folder: for files of the page."""
        self.server = server
        self.planner = planner
        self.project = project
        self.folder = folder
        self._answer: LiveAnswer | None = None  # figures that are shown
        self._begun = False  # True once controls and scene are there
        # by `time.monotonic`: when a frame of traffic was played last
        self._last_played_s = 0.0
        site = planner.yard.site
        self.cameras = LiveCameras(site.area)
        middle = self.cameras.middle
        eye = middle + self.cameras.slant
        scene.set_view(server, tuple(eye), tuple(middle))
        measured = "" if planner.stated is None else describe_stated(planner.stated)
        self.head = PanelHead(
            server, title=site.name, sensors=len(planner.sensors), measured=measured
        )
        self.jobs = LiveJobs(self.head, show=self.show, redraw=self.draw, draw_rest=self._draw_rest)
        self._add_drawings(folder if project is None else project.path.parent)
        server.on_client_connect(self._greet)
        server.scene.on_click()(self.clicks.follow)
        refining = Refining(
            planner, self.jobs, find_answer=self._find_answer, show_refined=self._show_refined
        )
        self.jobs.start(self._find_idle_job, refining.run)
        self.do(lambda: self.show(planner.answer()))  # the first figures

    def _add_drawings(self, picture_folder: Path) -> None:
        """Make the drawings of the scene, and what follows drags, clicks and long tasks.

        picture_folder: folder of the picture laid on the ground."""
        api = self.server.scene
        planner = self.planner
        add_long_names(api)
        self.sensors = SensorDrawings(api, planner)
        context = LiveContext(
            planner, jobs=self.jobs, head=self.head, show=self.show, redraw=self.draw
        )
        self.drags = SensorDrags(context, self.sensors, self.choose)
        self.ghosts = Ghosts(
            api, planner, lambda suggestion: self.change(planner.accept, suggestion)
        )
        self.areas = AreaDrawing(api, planner)
        self._picture = PictureDrawing(api, planner, picture_folder)
        self._traffic = TrafficDrawing(api, planner)
        self._maps = SeenMapDrawing(api, planner)
        self.clicks = GroundClicks(context, self.areas, picture_folder)
        self.tasks = LongTasks(context, self.ghosts, self.folder)

    def do(self, job: Job) -> None:
        """Do something in the page's thread, after what was asked before."""
        self.jobs.do(job)

    def change(self, change: "Callable[..., LiveAnswer]", *arguments: Any) -> None:
        """Make a change in the page's thread, after what was asked before, and show its answer.

        change: function of the planner that returns the figures after it, called with the
        arguments."""
        self.jobs.change(change, *arguments)

    def choose(self, name: str) -> None:
        """Choose a sensor, given by name, in the panel, in the page's thread."""
        self.do(lambda: self.panel.choose(name))

    def close(self) -> None:
        """End the threads, and save the project if there is one."""
        self.jobs.close()
        if self.project is not None:
            self.project.save()

    @property
    def has_begun(self) -> bool:
        """True once the controls and the scene are there."""
        return self._begun

    # what the threads do

    def _find_idle_job(self) -> Job | None:
        """Job to do while nothing is asked, None for none: draw the page, then play the traffic."""
        if not self._begun:
            is_ready = self.cameras.aims and self._answer is not None
            return self._begin if is_ready and self.jobs.is_quiet(PAINT_S) else None
        if not self.panel.view.is_playing or time.monotonic() - self._last_played_s <= PLAY_S:
            return None
        self._last_played_s = time.monotonic()
        return self.panel.view.show_next_frame

    def _begin(self) -> None:
        """Add controls and scene, which a browser shows after the first figures."""
        self.panel = LivePanel(
            self.server.gui,
            self.planner,
            self.jobs,
            self.cameras,
            self.clicks,
            self.tasks,
            draw_map=self._draw_map,
            draw_traffic=self._draw_traffic,
        )
        self._begun = True
        self.draw()
        yard = self.planner.yard
        poles = tuple(yard.mounts.values())
        self.sensors.label_poles(add_signs(self.server.scene, yard.site, poles))
        self.sensors.draw(self.drags.attach)

    def _find_answer(self) -> "LiveAnswer | None":
        """Answer that is shown, None before the controls are there."""
        return self._answer if self._begun else None

    def _show_refined(self) -> None:
        """Show the figures that are no longer coarse, in all frames once their views are made."""
        if self._answer is not None:
            self._answer = self.planner.answer(self._answer.what)
            if self.panel.view.offer_all_frames():
                self._maps.forget()
            self.draw()

    def _greet(self, client: Handle) -> None:
        """Aim the camera of a browser that has come, and give it time to show first figures."""
        self.jobs.touch()
        self.cameras.greet(client)
        if self.cameras.aims[client.client_id].is_phone:
            hide_long_names(client)

    # drawing

    def show(self, answer: "LiveAnswer") -> None:
        """Show an answer, and forget what was suggested and measured before the change."""
        self._answer = answer
        self.head.say("")
        if answer.what:
            self.ghosts.offer(())
            self.head.keep_measured("")
        self.draw()

    def draw(self) -> None:
        """Draw the figures, then sensors, suggestions, areas and the picture on the ground.

        Traffic and maps, which are slow to draw, follow in another job. Without an answer only the
        note is shown."""
        answer = self._answer
        self.head.show_note()
        if answer is None:
            return
        self.head.show_figures(answer)
        self.server.flush()  # figures do not wait for the scene
        if not self._begun:  # controls and scene are made after the first figures were shown
            return
        with self.server.atomic():
            self.sensors.draw(self.drags.attach)
            self.ghosts.draw()  # suggested sensors
            self.areas.draw(self.clicks.spots)
            self._picture.draw()  # on the ground
        self.jobs.draw_later()

    def _draw_rest(self) -> None:
        """Draw what the next answer does not wait for."""
        if self._answer is not None:
            self.panel.score.show(self._answer)
            self._draw_traffic()
            self._draw_map()
            self.panel.variants.show(self._answer)
            self.panel.fill()

    def _draw_traffic(self) -> None:
        self._traffic.draw(self._answer, int(self.panel.view.frame.value))

    def _draw_map(self) -> None:
        self._maps.draw(self.panel.view.map.value)
