"""Progress of long work on stderr: a bar in a terminal, else a line now and then.

With JSON output there is no progress."""

import sys
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from threading import Event, Thread
from types import MappingProxyType

from tqdm import tqdm

from coview.outputs import say
from toolkit.runtime.text_tables import escape

Steps = Mapping[str, float]  # usual share of a command's time, by main stage in order
NO_STEPS: Steps = MappingProxyType({})
EVERY_S = 10.0  # time between two lines without a terminal
MIN_LEFT_S = 1.0  # a shorter time left is not stated
MIN_SHARE = 0.05  # share of the work before which no total time is stated


class Bar:
    """Progress bar of absolute counts, for the toolkit's callbacks.

    bar: bar that is drawn; hidden: True to print nothing; unit: name of the first stage; steps:
    usual share of the time of each main stage, by name in order."""

    def __init__(
        self, bar: "tqdm[object]", hidden: bool, unit: str = "", steps: Steps = NO_STEPS
    ) -> None:
        """Wrap a bar of tqdm, which has begun now."""
        self._bar = bar
        self._hidden = hidden  # True to print nothing
        self._stage = unit  # name of the stage
        self._steps = steps  # usual share of the time of each main stage, by name
        self._done = 0  # number done
        self._done_at_start = 0  # number done when the stage began
        self._step = 0  # number of the main stage, counted from 1; 0 before the first
        # times (s) at which the bar, the stage and the main stage began
        self._bar_began = self._stage_began = self._step_began = time.monotonic()

    def to(self, done: int) -> None:
        """Show the number done in all; a smaller one than before restarts the stage."""
        if done < self._done:  # the stage restarts
            self._stage_began = time.monotonic()
            self._done_at_start = done
        self._bar.update(done - self._bar.n)
        self._done = done

    def stage(self, name: str, done: int, total: int | None) -> None:
        """Show the progress of a stage; a new name restarts the bar.

        done: number done in all; total: number to do, None if unknown."""
        if name != self._stage:
            names = [*self._steps]
            step = names.index(name) + 1 if name in names else 0
            if step > self._step:
                self._step = step
                self._step_began = time.monotonic()
            self._stage = name
            self._done = 0
            self._done_at_start = 0
            self._stage_began = time.monotonic()
            self._bar.reset(total)
            self._bar.set_description(escape(name), refresh=False)
        self._bar.total = total
        self.to(done)

    def step(self, done: int, total: int, figures: dict[str, float]) -> None:
        """Show a step of training: its losses after the bar, or a line of measured AP above it.

        done, total: numbers of steps; figures: by name; AP@0.7 among them means a measurement."""
        self._bar.total = total
        self.to(done)
        if "AP@0.7" in figures:
            self.line("  ".join(f"{name} {value:.4f}" for name, value in figures.items()))
        else:
            self._bar.set_postfix(
                {name: f"{value:.3f}" for name, value in figures.items()}, refresh=False
            )

    def line(self, text: str) -> None:
        """Print a line above the bar."""
        if not self._hidden:
            self._bar.write(escape(text), file=sys.stderr)

    def describe(self) -> str:
        """Words for the stage, its progress, and the time left at the speed so far."""
        done = self._done
        total = self._bar.total
        spent_s = time.monotonic() - self._stage_began
        count = ""
        if total:
            count = f": {done} of {total}"
        elif done:
            count = f": {done}"
        text = f"{self._describe_step()}{self._stage or 'inputs prepared'}{count}"
        if not total or done <= self._done_at_start:
            return f"{text}, for {_describe_time(spent_s)}"
        # what was done before the stage began, such as in an earlier run, took none of this time
        left_s = spent_s / (done - self._done_at_start) * max(0, total - done)
        if left_s < MIN_LEFT_S:
            return f"{text}, finishing for {_describe_time(spent_s)}"
        return f"{text}, about {_describe_time(left_s)} left"

    def _describe_step(self) -> str:
        """Words for the number of this step, and the total time by the usual shares of the steps.

        The text ends with a comma and a space, and is "" outside the steps. The part of this step
        that is done is the smaller one by its count and by its time: other stages may follow the
        count within the step."""
        if not self._step:
            return ""
        shares = [*self._steps.values()]
        done_shares = sum(shares[: self._step - 1])  # shares of the steps before this one
        step_share = shares[self._step - 1]
        step_name = [*self._steps][self._step - 1]
        total = self._bar.total
        done_part = 1.0  # part of this step
        if total and step_name == self._stage:
            done_part = min(1.0, self._done / total)
        earlier_s = self._step_began - self._bar_began
        spent_s = time.monotonic() - self._step_began
        if done_shares and earlier_s:
            expected_s = earlier_s / done_shares * step_share
            done_part = min(done_part, spent_s / expected_s)
        share = done_shares + step_share * done_part
        text = f"step {self._step} of {len(shares)}"
        if share < MIN_SHARE or (not done_shares and step_name != self._stage):
            return f"{text}, "
        total_s = (earlier_s + spent_s) * sum(shares) / share
        return f"{text}, about {_describe_time(total_s)} in all, "


def _describe_time(seconds: float) -> str:
    """Words for a span of time: seconds, minutes from 90 s, or hours from 90 minutes."""
    if seconds < 90:
        return f"{seconds:.0f} s"
    if seconds < 5400:
        return f"{seconds / 60:.0f} min"
    return f"{seconds / 3600:.1f} h"


@contextmanager
def progress_bar(
    unit: str, total: int | None = None, *, hidden: bool = False, steps: Steps = NO_STEPS
) -> Iterator[Bar]:
    """Show a bar while the block runs; without a terminal, a line every `EVERY_S` seconds.

    unit: name of what is counted, and of the first stage; total: number to do, None if unknown;
    hidden: True to print nothing; steps: usual share of the time of each main stage."""
    with tqdm(total=total, unit=unit, disable=hidden or None, smoothing=0.1) as inner:
        bar = Bar(bar=inner, hidden=hidden, unit=unit, steps=steps)
        has_ended = Event()

        def print_lines() -> None:
            """Print a line every `EVERY_S` seconds until the block ends."""
            while not has_ended.wait(EVERY_S):
                say(f"coview: {bar.describe()}", error=True)

        if not hidden and not sys.stderr.isatty():
            Thread(target=print_lines, daemon=True).start()
        try:
            yield bar
        finally:
            has_ended.set()
