"""Requests that the live planner's page answers in the background: suggestions, searches, the
detector and files."""

from collections.abc import Callable, Iterable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from coview.live_context import LiveContext
from coview.live_drawings import Ghosts
from coview.live_tables import describe_ap, describe_suggestions, format_ap
from placement_env.live.planner import LivePlanner
from placement_env.live.project import export_variant, report_variant
from toolkit.display import describe_count

if TYPE_CHECKING:
    from viser import GuiApi

    from placement_env.live.figures import LiveAnswer

PATIENCE_S = 1.0  # time that a suggestion spends on views from further poles


class LongTasks:
    """Suggestions, searches, measurements and files of a page, which take long.

    Apart from `accept_best`, each is done in the thread for long jobs and leaves a note. ghosts:
    drawings of the suggested sensors; folder: folder of exports and reports."""

    def __init__(self, context: LiveContext, ghosts: Ghosts, folder: Path) -> None:
        """Keep what long tasks change and show. folder: for exports and reports."""
        self._planner = context.planner
        self._jobs = context.jobs  # runs long tasks in a separate thread
        self._head = context.head  # shows notes
        self._show = context.show  # shows an answer
        self._redraw = context.redraw
        self._ghosts = ghosts  # drawings of suggestions
        self._folder = folder  # for exports and reports

    def add_ask_controls(self, gui: "GuiApi", find_name: Callable[[], str]) -> None:
        """Add the controls of the tab Ask.

        find_name: function that returns the name of the chosen sensor."""
        kinds = gui.add_button_group("Best to", ("add", "move", "remove"))
        kinds.on_click(lambda _: self.suggest(kinds.value, find_name()))
        gui.add_button("Accept the best").on_click(lambda _: self._jobs.change(self.accept_best))
        gui.add_button("Search from here").on_click(
            lambda _: self._jobs.later("searching", self.search)
        )
        gui.add_button("Measure with the detector").on_click(
            lambda _: self._jobs.later("measuring", self.measure)
        )

    def add_file_controls(self, gui: "GuiApi") -> None:
        """Add the controls of the tab Files."""
        export = partial(self.write, export_variant, self._folder)
        report = partial(self.write, report_variant, self._folder / "report")
        gui.add_button("Export site, map and schedule").on_click(
            lambda _: self._jobs.later("exporting", export)
        )
        gui.add_button("Judge and write the report").on_click(
            lambda _: self._jobs.later("judging", report)
        )

    def suggest(self, kind: str, name: str | None = None) -> None:
        """Draw the best changes of a kind, and list them in the note, once they are found.

        kind: "add", "move" or "remove"; name: name of the sensor to move, not used for others."""
        moved_name = name if kind == "move" else None

        def job() -> None:
            suggestions = self._planner.suggest(kind, moved_name, patience=PATIENCE_S)
            self._ghosts.offer(suggestions)
            self._head.say(describe_suggestions(kind, suggestions))
            self._jobs.do(self._redraw)

        self._jobs.later("comparing poses", job)

    def accept_best(self) -> "LiveAnswer":
        """Make the best change that is suggested, and return the new figures.

        Raises ValueError if nothing is suggested."""
        return self._planner.accept(self._ghosts.take_best())

    def search(self) -> None:
        """Improve the variant until nothing helps, or the page closes."""
        ap_before = format_ap(self._planner.answer())
        count = 0
        for answer in self._planner.search(lambda: self._jobs.closed):
            count += 1
            changes = describe_count(count, "change")
            self._head.say(f"search: AP {format_ap(answer)} after {changes}")
            self._jobs.do(partial(self._show, answer))
        ap_after = format_ap(self._planner.answer())
        changes = describe_count(count, "change")
        self._head.say(f"search: AP {ap_before} to {ap_after} by {changes}; undo takes them back")

    def measure(self) -> None:
        """Measure the variant with the detector, and show AP and the predicted AP in the note."""
        prediction = self._planner.finish()  # the figures without coarse views
        measurement = self._planner.measure()
        figures = (
            f"measured {describe_ap(measurement)}, predicted {format_ap(prediction)}, "
            f"N = {describe_count(measurement.objects, 'road user')}"
        )
        self._head.keep_measured(figures)
        self._head.say(f"by the detector: {figures}")

    def write(
        self, write_files: Callable[[LivePlanner, Path], Iterable[Path]], folder: Path
    ) -> None:
        """Write files of the variant into a folder, and name them in the note.

        write_files: function that writes them and returns their paths."""
        names = ", ".join(path.name for path in write_files(self._planner, folder))
        self._head.say(f"written to {folder}: {names}")
