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
        planner: Planner.
        jobs: Threads that do what is asked.
        head: Hint, figures and note.
        show: Function that shows an answer.
        redraw: Function that draws everything.
    """

    planner: LivePlanner
    jobs: LiveJobs
    head: PanelHead
    show: "Callable[[LiveAnswer], None]"
    redraw: Job
