"""`LiveContext`: what every part of the live planner's page works with."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

from coview.live_head import PanelHead
from coview.live_jobs import Job, LiveJobs
from placement_env.live.planner import LivePlanner

if TYPE_CHECKING:
    from placement_env.live.figures import LiveAnswer


@dataclass(frozen=True, eq=False)
class LiveContext:
    """Planner of a page, its threads, and how it shows what changed.

    Attributes:
        planner: Planner whose variants the page shows and changes.
        jobs: Threads that do what a browser asks for.
        head: Hint, figures and note at the top of the panel.
        show: Function that shows an answer: its figures, and the variant in the scene.
        redraw: Function that draws figures and scene again as they are.
    """

    planner: LivePlanner
    jobs: LiveJobs
    head: PanelHead
    show: "Callable[[LiveAnswer], None]"
    redraw: Job
