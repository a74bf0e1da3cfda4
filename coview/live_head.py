"""Head of the live planner's panel: the hint, the figures and the note."""

from typing import TYPE_CHECKING

from coview.live_tables import figures_html, hint_html, note_html

if TYPE_CHECKING:
    from viser import ViserServer

    from placement_env.live.figures import LiveAnswer


class PanelHead:
    """Head of the panel, shown above its tabs and before them.

    Attributes:
        busy: Words for the long task that is being done, "" for none.
        note: Words for what was done last, or why it failed, "" for none.
        measured: Figures by the detector, which are shown while there is no note.
    """

    def __init__(self, server: "ViserServer", title: str, sensors: int, measured: str) -> None:
        """Dock the panel and add its head.

        title: name of the site; sensors: their number; measured: figures by the detector, or ""."""
        gui = server.gui
        gui.configure_theme(show_logo=False, show_share_button=False, brand_color=(68, 99, 246))
        gui.main_panel.dock_right()
        gui.set_panel_label(f"coview live: {title}")
        self._hint = gui.add_html(hint_html(sensors))  # sensors: their number
        self._figures = gui.add_html("")
        self._note_html = gui.add_html("")
        self.busy = ""  # words for the long task that is being done
        self.note = ""  # words for what was done last
        self.measured = measured  # figures by the detector, shown without a note

    def show_figures(self, answer: "LiveAnswer") -> None:
        """Show the figures of an answer, and the hint on what to do first."""
        hint = hint_html(answer.sensors)
        if self._hint.content != hint:
            self._hint.content = hint
        self._figures.content = figures_html(answer)

    @property
    def figures_content(self) -> str:
        """HTML of the figures that are shown."""
        return str(self._figures.content)

    @property
    def note_content(self) -> str:
        """HTML of the note that is shown."""
        return str(self._note_html.content)

    def show_note(self) -> None:
        """Show the long task that is being done, and the note, or else the measured figures."""
        self._note_html.content = note_html(self.busy, self.note or self.measured)

    def say(self, note: str) -> None:
        """Keep a note, to be shown by `show_note`."""
        self.note = note

    def begin(self, what: str) -> None:
        """Keep words for the long task that begins, to be shown by `show_note`."""
        self.busy = what

    def end(self) -> None:
        """Forget the long task, which has ended."""
        self.busy = ""

    def keep_measured(self, figures: str) -> None:
        """Keep figures by the detector; "" for none."""
        self.measured = figures
