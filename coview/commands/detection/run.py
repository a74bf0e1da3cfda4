"""`coview run`: a centre that detects and tracks as its sensors measure."""

from contextlib import ExitStack
from pathlib import Path
from threading import Event
from typing import TYPE_CHECKING, Any

from tyro.conf import Positional

from coview.arguments import check_positive
from coview.commands.detection.centre_parts import open_centre
from coview.outputs import OK, print_result, say

if TYPE_CHECKING:
    from toolkit.centre.running_centre import CentreEvent


def run_command(
    config: Positional[Path], /, *, seconds: float | None = None, json: bool = False
) -> int:
    """Run a centre: fuse, detect, track and write what sensors measure, as they measure it.

    A recording is replayed at its pace, a junction is simulated, or Velodyne lidars send their
    packets over the network. A sensor that is silent, late, frozen, blind or turned is
    named, and the others go on. SIGTERM or Ctrl-C ends the run.

    Example: coview run centre.toml --seconds 60

    Args:
        config: Configuration in TOML: inputs, sensors, detector, outputs, page and health.
        seconds: Time after which it ends; at the end of its inputs when left out.
        json: Print the figures of the run and the faults as JSON, a line each."""
    from toolkit.centre.centre_config import load_centre_config
    from toolkit.centre.centre_run import run_centre
    from toolkit.centre.health import HealthLog
    from toolkit.centre.stop_signals import stopping_by_signals

    check_positive("--seconds", seconds)
    settings = load_centre_config(config)
    stop = Event()

    def report(event: "CentreEvent") -> None:
        """Print an event that the centre reports."""
        if json:
            print_result(event.as_dict(), "", as_json=True)
        else:
            say(f"coview: {event}", error=True)

    with ExitStack() as stack:
        stack.enter_context(stopping_by_signals(stop))
        parts = stack.enter_context(open_centre(settings))
        show = None
        if settings.page_port is not None:
            from toolkit.centre.centre_page import open_centre_page

            opened = open_centre_page(settings.page_port, parts.place_sensors())
            page, address = stack.enter_context(opened)
            show = page.show
            say(f"coview: {address} (this machine only)", error=True)
        health = HealthLog(settings.health_file, settings.health_every_s)
        figures = run_centre(
            parts, health, stop, seconds=seconds, show=show or _show_nothing, report=report
        )
    print_result(figures, _describe(figures), as_json=json)
    return OK


def _show_nothing(frame: object) -> None:
    """Show no frame."""


def _describe(figures: dict[str, Any]) -> str:
    """Describe the figures of a run."""
    from toolkit.runtime.stage_times import describe_times

    counts = f"{figures['frames']} frames, {figures['dropped_frames']} dropped"
    if figures["predicted_frames"]:
        counts += f", {figures['predicted_frames']} with predicted tracks"
        if figures["late_detections"]:  # which are those of frames that were predicted
            counts += f" ({figures['late_detections']} of them detected later)"
    return f"{counts}\n{describe_times(figures['ms'])}".rstrip()
