"""Threads of the live planner's page: one does what is asked, one refines, one does what takes
long."""

import threading
import time
import traceback
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from typing import TYPE_CHECKING, Any

from coview.live_head import PanelHead
from placement_env.live.planner import LivePlanner
from toolkit.runtime.allocation import return_freed_memory

if TYPE_CHECKING:
    from placement_env.live.figures import LiveAnswer

# times since the last job after which refining does more
MOVING_S = 0.1  # until then rays that are being cast pause
QUIET_S = 0.4  # from then on coarse views that are shown are refined
CALM_S = 2.0  # from then on other views are made ahead
MAX_WAIT_S = 0.3  # time between two looks of a thread whether it is to end
LATE_S = 0.3  # time after which slow drawing no longer waits for the pointer to rest
TIDY_S = 10.0  # time of use after which freed memory is handed back
GO_ON = "go on, and report the lines in the terminal"
Job = Callable[[], None]


class LiveJobs:
    """Jobs of a page, done one after another in one thread.

    The latest position of a drag is followed when nothing else waits. Jobs that take long have
    another thread. head: shows notes and errors; show: function that shows an answer; redraw:
    function that draws all after a failure; draw_rest: function that draws what no answer waits
    for.

    Attributes:
        closed: True once the threads are to end.
        threads: Threads for jobs, for refining and for long jobs, in this order.
    """

    def __init__(
        self, head: PanelHead, *, show: "Callable[[LiveAnswer], None]", redraw: Job, draw_rest: Job
    ) -> None:
        """Queue without jobs; `start` begins its threads."""
        self._head = head  # shows notes and errors
        self._show = show  # shows an answer
        self._redraw = redraw  # draws all after a failure
        self._draw_rest = draw_rest  # draws what no answer waits for
        self._jobs: deque[Job] = deque()  # waiting, in order
        self._long: deque[Job] = deque()  # waiting, for the other thread
        self._drag: Job | None = None  # for the latest position of a drag
        self._wake = threading.Condition()  # held to change these; wakes both threads
        # by `time.monotonic`: time (s) of the last job, and since when slow drawing is due, else 0
        self._used_at_s = 0.0
        self._rest_due_s = 0.0
        self.closed = False
        self.threads: list[threading.Thread] = []

    def start(self, find_idle_job: Callable[[], Job | None], refine: Job) -> None:
        """Start the threads.

        find_idle_job: function that returns a job for the time while nothing is asked, or None;
        refine: function that runs in a separate thread until `closed`."""
        targets = (lambda: self._work(find_idle_job), refine, self._work_long)
        self.threads = [threading.Thread(target=target, daemon=True) for target in targets]
        for thread in self.threads:
            thread.start()

    def close(self) -> None:
        """End the threads; what takes long is not waited for."""
        with self._wake:
            self.closed = True
            self._wake.notify_all()
        for thread in self.threads[:2]:  # not the one for long jobs
            thread.join(timeout=5)

    @property
    def waiting(self) -> int:
        """Number of jobs that wait, without drags and long jobs."""
        return len(self._jobs)

    @property
    def touched(self) -> float:
        """Time (s) of the last job, by the monotonic clock."""
        return self._used_at_s

    def touch(self) -> None:
        """Count now as the time of the last job, as somebody uses the page."""
        self._used_at_s = time.monotonic()

    def is_quiet(self, seconds: float) -> bool:
        """True if no job has been done for so many seconds."""
        return time.monotonic() - self._used_at_s >= seconds

    def do(self, job: Job) -> None:
        """Do something in the page's thread, after what was asked before."""
        with self._wake:
            self._jobs.append(job)
            self._wake.notify_all()

    def change(self, change: "Callable[..., LiveAnswer]", *arguments: Any) -> None:
        """Make a change in the page's thread, after what was asked before, and show its answer.

        change: function of the planner that returns the figures after it, called with the
        arguments."""
        self.do(lambda: self._show(change(*arguments)))

    def drag(self, job: Job, *, last: bool) -> None:
        """Follow a drag in the page's thread, in place of its earlier positions that still wait.

        job: function for the present position; last: True at the end of the drag, whose job is
        never left out."""
        with self._wake:
            if last:
                self._drag = None
                self._jobs.append(job)
            else:
                self._drag = job
            self._wake.notify_all()

    def later(self, what: str, job: Job) -> None:
        """Do something that takes long in a separate thread, after other long jobs.

        what: words for it in the note while it is done."""
        with self._wake:
            self._head.begin(what)
            self._long.append(job)
            self._wake.notify_all()
        self.do(self._head.show_note)

    def draw_later(self) -> None:
        """Let slow drawing follow once nothing else waits, or `LATE_S` has passed."""
        self._rest_due_s = self._rest_due_s or time.monotonic()

    def attempt(self, job: Job) -> bool:
        """Do a job, and return True if it did not fail.

        A failure never ends the page: its reason becomes the note, and everything is drawn again.
        If drawing itself failed, it waits for the next job, because it would fail again."""
        try:
            job()
        except (ValueError, OSError, ImportError) as error:
            self._head.say(str(error))
        except Exception as error:  # one control, drag or drawing failed: the page lives on
            traceback.print_exc()
            self._head.say(
                f"that did not work, by a fault of coview ({type(error).__name__}: "
                f"{error!s:.80}); {GO_ON}"
            )
        else:
            return True
        with suppress(Exception):  # such as of a browser that has gone
            self._head.show_note()
        if job not in (self._redraw, self._draw_rest):
            self.do(self._redraw)
        return False

    def _work(self, find_idle_job: Callable[[], Job | None]) -> None:
        """Do jobs until the page closes; idle jobs do not count as use of the page.

        find_idle_job: function that returns a job for the time while nothing is asked, or None."""
        while not self.closed:
            job = self._next_job()
            if job is not None:
                self.touch()
            else:
                job = find_idle_job()
            if job is not None:
                self.attempt(job)

    def _next_job(self) -> Job | None:
        """Take the next job, after waiting up to `MAX_WAIT_S` for one; None if there is none.

        Slow drawing that is late comes first, then jobs in order, then the drag. Slow drawing that
        is not late waits until nothing else is to do."""
        with self._wake:
            if not self._jobs and self._drag is None and not self._rest_due_s:
                self._wake.wait(MAX_WAIT_S)
            is_idle = not self._jobs and self._drag is None
            if self._rest_due_s and (is_idle or time.monotonic() > self._rest_due_s + LATE_S):
                self._rest_due_s = 0.0
                return self._draw_rest
            if self._jobs:
                return self._jobs.popleft()
            job = self._drag
            self._drag = None
            return job

    def _work_long(self) -> None:
        """Do long jobs until the page closes."""
        while not self.closed:
            with self._wake:
                if not self._long:
                    self._wake.wait(MAX_WAIT_S)
                job = self._long.popleft() if self._long else None
            if job is not None:
                self.attempt(job)
                return_freed_memory()  # comparing poses takes much
                self._head.end()
                self.do(self._head.show_note)


class Refining:
    """Thread that refines coarse figures while nobody moves anything.

    find_answer: function that returns the answer that is shown, None before there is one;
    show_refined: function that shows the figures of the same variant again once they are fine."""

    def __init__(
        self,
        planner: LivePlanner,
        jobs: LiveJobs,
        find_answer: "Callable[[], LiveAnswer | None]",
        show_refined: Job,
    ) -> None:
        """Thread that waits until there is something coarse."""
        self._planner = planner
        self._jobs = jobs
        self._find_answer = find_answer  # returns the shown answer, None before the first
        self._show_refined = show_refined  # shows the figures once nothing coarse is in them
        self._thread: threading.Thread | None = None

    def run(self) -> None:
        """Refine in this thread until the page closes."""
        self._thread = threading.current_thread()
        while not self._jobs.closed:
            if not self._jobs.attempt(self._refine_views):
                self._jobs.touch()  # a pause before it is tried again

    def _refine_views(self) -> None:
        """Compute missing views of sensors until the page closes, whenever nobody uses it."""
        views_are_missing = True  # using the page may make some missing again
        tidied_at_s = time.monotonic()
        while not self._jobs.closed:
            # figures of the sensors that are shown; None while they are computed
            answer = self._find_answer()
            # the page was used again some time after memory was handed back
            if self._jobs.touched > tidied_at_s + TIDY_S:
                tidied_at_s = time.monotonic()
                return_freed_memory()
            # a short pause is enough to refine coarse views that are shown
            quiet_s = QUIET_S if answer is not None and answer.coarse else CALM_S
            if answer is None or not views_are_missing or not self._jobs.is_quiet(quiet_s):
                time.sleep(0.1)
                # a use of the page in the last second may have made views missing
                views_are_missing = views_are_missing or not self._jobs.is_quiet(1.0)
                continue
            views_are_missing = self._planner.refine(self._is_in_use)
            time.sleep(0.01)  # lets other threads cast rays
            # coarse figures are shown, and exact ones can now be
            if answer.coarse and not self._planner.coarse:
                self._jobs.do(self._show_refined)

    def _is_in_use(self) -> bool:
        """True if this is the refining thread and somebody moved something just now.

        Other threads that cast rays never pause."""
        is_refining = threading.current_thread() is self._thread
        return is_refining and not self._jobs.is_quiet(MOVING_S)
