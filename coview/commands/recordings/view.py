"""`coview view`: look at a recording in three dimensions."""

from __future__ import annotations

import sys
from functools import partial
from pathlib import Path
from typing import Literal

from tyro.conf import Positional

from coview.arguments import Label, check_least, names_of
from coview.clouds import open_clouds
from coview.detectors import area_about, sample_detector
from coview.exits import OK
from coview.outputs import check_file
from coview.printing import print_result
from coview.progress_bar import progress_bar


def view(
    recording: Positional[Path],
    /,
    *,
    out: Path | None = None,
    still: Path | None = None,
    frame: int = 0,
    colour: Literal["sensor", "height", "intensity", "age"] = "sensor",
    layout: str | None = None,
    poses: Path | None = None,
    inverted: bool = False,
    level: Literal["map", "plane", "none"] | None = None,
    detector: str | None = None,
    area: tuple[float, float, float, float] | None = None,
    score: float = 0.0,
    classes: tuple[Label, ...] | None = None,
    sensors: str | None = None,
    frames: int | None = None,
    every: int = 1,
    port: int = 8080,
    overwrite: bool = False,
    json: bool = False,
) -> int:
    """Look at a recording: points, sensors, what is labelled and what is detected, in a browser of this machine.

    Frames have a slider; sensors, truth, detections and classes can be hidden; points are coloured by sensor, height,
    intensity or age. With --detector its boxes are marked as hits and false alarms, and labels as missed. Served to
    this machine alone until Ctrl-C; with --out written as one page that works from disk, with --still as a picture.

    Example: coview view tjunction.hdf5

    Example: coview view my-clouds --layout folder --detector general --out my-clouds.html

    Example: coview view tjunction.hdf5 --still frame.png --frame 3 --colour height

    Args:
        recording: Our HDF5; with --layout a cloud file, folder or bag.
        out: Page of HTML to write in place of serving: all its frames are in it, of at most 600,000 points together.
        still: Picture of one frame from above to write in place of serving, .png or .svg.
        frame: Which one, of those that --every and --frames leave, counted from 0.
        colour: Of its points: by sensor, height, intensity or age.
        layout: Of a recording of clouds, as in coview detect; our HDF5 when left out.
        poses: As in coview detect.
        inverted: As in coview detect.
        level: As in coview detect; map for clouds, none for our HDF5 when left out.
        detector: Show what it finds too: general, another shipped name, a weights file, or package.module:callable.
        area: The detector's, as in coview detect, and of a picture.
        score: Show only what it finds with at least this score.
        classes: Show only boxes of these, labelled or detected.
        sensors: Show, and detect in, the clouds of these alone: a,b,c.
        frames: Only the first so many; with --out 20 when left out.
        every: Only every so many-th frame.
        port: Of the address in the browser; the next one that is free where it is taken.
        overwrite: Replace a page that is there.
        json: Print as JSON.
    """
    from toolkit.plots.canvas import check_picture
    from toolkit.viewing.drawn import ChosenSamples, Drawing
    from toolkit.viewing.live import view_live
    from toolkit.viewing.page import PAGE_FRAMES, write_page
    from toolkit.viewing.scene import check_viser
    from toolkit.viewing.still import write_still

    check_least("--frames", frames, 1, "leave it out for all")
    check_least("--every", every, 1)
    check_least("--frame", frame, 0)
    if still is not None and out is not None:
        raise ValueError("--out writes a page, --still a picture: give one of them")
    if still is not None:
        check_picture(still)
    check_file(still or out, inputs=[recording, *([poses] if poses else [])], overwrite=overwrite)
    if still is None:
        check_viser()
    opened = open_clouds(recording, layout or "hdf5", poses=poses, inverted=inverted)
    samples = ChosenSamples(opened, frames=frames if out is None else frames or PAGE_FRAMES, every=every)
    network, (middle, half) = None, area_about(area)
    if detector is not None:
        network, middle, half = sample_detector(detector, area)
    drawing = Drawing(
        network, level or ("none" if layout in (None, "hdf5") else "map"), middle, half, score, classes,
        None if sensors is None else names_of(sensors),
    )  # fmt: skip
    if still is not None:
        sample = samples.at(frame)
        drawn = drawing.drawn(sample, drawing.origin(sample))
        title, shown = f"{recording.name}, {drawn.name}", None if area is None else half
        write_still(drawn, still, title=title, colouring=colour, half=shown)
        print_result({"still": str(still), "said": drawn.described()}, f"{still}: {drawn.described()}", as_json=json)
        return OK
    if out is None:
        view_live(samples, drawing, port=port, ready=partial(_say_where, as_json=json))
        return OK
    with progress_bar("frame", len(samples), hidden=json) as bar:
        page = write_page(drawing.all_of(samples, progress=bar.to), recording.name or str(recording), out)
    figures = {"out": str(out), "frames": len(page.frames), "points": page.points, "drawn": page.drawn}
    text = f"{out}: {len(page.frames)} of {len(opened)} frames, {page.drawn} of {page.points} points drawn"
    print_result(figures | {"of_frames": len(opened), "said": list(page.names)}, text, as_json=json)
    return OK


def _say_where(url: str, *, as_json: bool) -> None:
    print_result({"url": url}, f"{url} (this machine alone; Ctrl-C ends it)", as_json=as_json)
    sys.stdout.flush()  # here, as nothing else is printed while it is served
