"""`coview view`: look at a recording in three dimensions."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Literal

from tyro.conf import Positional

from coview.arguments import Label, check_least, sensor_set
from coview.detectors import place_detector
from coview.exits import OK
from coview.outputs import check_file
from coview.printing import print_result
from coview.progress_bar import progress_bar
from coview.recordings import Opening
from toolkit.detection.place import Corners, Level, Place


@dataclass(frozen=True)
class Shown:
    """Contents of the view."""

    detector: str | None = None
    """Show what it finds too: general, another shipped name, a weights file, or package.module:callable."""
    score: float = 0.0
    """Only what it finds with at least this score."""
    classes: tuple[Label, ...] | None = None
    """Only boxes of these, labelled or detected."""
    sensors: str | None = None
    """Only the clouds of these: a,b,c; it detects in them alone."""
    frames: int | None = None
    """Only the first frames; with --out 20 by default."""
    every: int = 1
    """Only every n-th frame."""
    frame: int = 0
    """Frame of a picture, of those that --every and --frames leave, counted from 0."""
    colour: Literal["sensor", "height", "intensity", "age"] = "sensor"
    """Colour of a picture's points."""


def view(
    recording: Positional[Path],
    /,
    *,
    out: Path | None = None,
    still: Path | None = None,
    port: int = 8080,
    overwrite: bool = False,
    json: bool = False,
    opening: Opening = Opening(),
    level: Level | None = None,
    area: Corners | None = None,
    shown: Shown = Shown(),
) -> int:
    """Look at a recording: points, sensors, what is labelled and what is detected, in a browser of this machine.

    Frames have a slider; sensors, truth, detections and classes can be hidden; points are coloured by sensor, height,
    intensity or age. With --detector its boxes are marked as hits and false alarms, and labels as missed. Served to
    this machine alone until Ctrl-C; with --out written as one page that works from disk, with --still as a picture.

    Example: coview view tjunction.hdf5

    Example: coview view my-clouds --detector general --out my-clouds.html

    Example: coview view tjunction.hdf5 --still frame.png --frame 3 --colour height

    Args:
        recording: As in coview detect.
        out: Page of HTML to write in place of serving: all its frames are in it, of at most 600,000 points together.
        still: Picture of one frame from above to write in place of serving, .png or .svg.
        port: Of the address in the browser; the next one that is free where it is taken.
        overwrite: Replace a page that is there.
        json: Print as JSON.
        opening: How the recording is opened.
        level: As in coview detect; by default map for clouds, none at a known site.
        area: The detector's, as in coview detect, and of a picture.
        shown: Contents of the view.
    """
    from toolkit.datasets.recordings import Part
    from toolkit.plots.canvas import check_picture
    from toolkit.viewing.drawn import Drawing
    from toolkit.viewing.live import view_live
    from toolkit.viewing.page import PAGE_FRAMES, write_page
    from toolkit.viewing.scene import check_viser
    from toolkit.viewing.still import write_still

    check_least("--frames", shown.frames, 1, "leave it out for all")
    check_least("--every", shown.every, 1)
    check_least("--frame", shown.frame, 0)
    if still is not None and out is not None:
        raise ValueError("--out writes a page, --still a picture: give one of them")
    if still is not None:
        check_picture(still)
    check_file(still or out, inputs=[recording, *opening.files], overwrite=overwrite)
    if still is None:
        check_viser()
    with opening.open(recording) as opened:
        samples = Part(opened, shown.frames if out is None else shown.frames or PAGE_FRAMES, shown.every)
        place = Place(level or ("map" if opened.site is None else "none"), area=area)
        network = None if shown.detector is None else place_detector(shown.detector, place)
        sensors = None if shown.sensors is None else sensor_set(shown.sensors)
        drawing = Drawing(network, place, shown.score, shown.classes, sensors)
        if still is not None:
            if shown.frame >= len(samples):
                raise ValueError(f"there is no frame {shown.frame}: {len(samples)} are chosen, counted from 0")
            sample = samples[shown.frame]
            drawn = drawing.draw(sample, drawing.origin(sample))
            half = None if area is None else place.half
            write_still(drawn, still, title=f"{recording.name}, {drawn.name}", colouring=shown.colour, half=half)
            said = drawn.describe()
            print_result({"still": str(still), "said": said}, f"{still}: {said}", as_json=json)
        elif out is None:
            view_live(samples, drawing, port=port, ready=partial(_say_where, as_json=json))
        else:
            with progress_bar("frame", len(samples), hidden=json) as bar:
                every = drawing.draw_all(samples, progress=bar.to)
                page = write_page(every, recording.name or str(recording), out)
            figures = {"out": str(out), "frames": len(page.frames), "points": page.points, "drawn": page.drawn}
            text = f"{out}: {len(page.frames)} of {len(opened)} frames, {page.drawn} of {page.points} points drawn"
            print_result(figures | {"of_frames": len(opened), "said": list(page.names)}, text, as_json=json)
    return OK


def _say_where(url: str, *, as_json: bool) -> None:
    print_result({"url": url}, f"{url} (this machine alone; Ctrl-C ends it)", as_json=as_json)
    sys.stdout.flush()  # here, as nothing else is printed while it is served
