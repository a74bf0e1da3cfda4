"""`coview view`: look at a recording in three dimensions."""

import sys
from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path
from typing import Literal

from tyro.conf import Positional

from coview.arguments import Label, check_least, sensor_set
from coview.detector_spec import DetectorSpec
from coview.detectors import check_detector, open_detector
from coview.outputs import OK, Writing, check_file, print_result
from coview.progress_bar import progress_bar
from coview.recordings import Opening
from coview.tracks import find_sequence, number_frames, read_tracks
from toolkit.calibration.place import Corners, Level, Place
from toolkit.datasets.recording_views import Part
from toolkit.exchange.track_lookup import TrackLookup
from toolkit.frame import Frame, Recording, select_sensors
from toolkit.objects import Detector
from toolkit.plots.canvas import check_picture
from toolkit.sites.site import PlaceMismatch
from toolkit.viewing.drawing import Drawing
from toolkit.viewing.live_view import view_live
from toolkit.viewing.recording_page import PAGE_FRAMES, write_page
from toolkit.viewing.scene import check_viser
from toolkit.viewing.still import write_still
from toolkit.viewing.track_overlay import TrackOverlay


@dataclass(frozen=True)
class ViewOptions:
    """Contents of the view."""

    detector: str | None = None
    """Detector to show: general, another shipped name, a weights file, or
    package.module:callable."""
    tracks: Path | None = None
    """File of tracks to show in place of detections, as in coview evaluate, with numbers and
    trails."""
    score: float = 0.0
    """Least score of detections or tracks to show."""
    classes: tuple[Label, ...] | None = None
    """Classes of boxes to show, labelled or detected."""
    sensors: str | None = None
    """Sensors whose clouds are shown and detected in: a,b,c."""
    frames: int | None = None
    """Number of first frames; 20 with --out when left out."""
    every: int = 1
    """Step from one frame to the next."""
    frame: int = 0
    """Frame of a picture, counted from 0 among those that --every and --frames leave."""
    colour: Literal["sensor", "height", "intensity", "age"] = "sensor"
    """Colour of a picture's points."""
    level: Level | None = None
    """Ground below points, as in coview detect; map for clouds, none at a known site when left
    out."""
    area: Corners | None = None
    """Area of the detector, as in coview detect, and of a picture."""

    @cached_property
    def detector_spec(self) -> DetectorSpec | None:
        """Parsed name of the detector, None without one."""
        return None if self.detector is None else DetectorSpec.from_name(self.detector)

    def make_drawing(self, recording: Recording, sequence: Path | None = None) -> Drawing:
        """Return the options for drawing frames, with the detector or the tracks loaded.

        recording: if its site is unknown, the ground is found, unless the options forbid it;
        sequence: KITTI's sequence whose camera a text of tracks is in, None for any other
        recording."""
        default_level: Level = "map" if recording.site is None else "none"
        place = Place(self.level or default_level, area=self.area)
        spec = self.detector_spec
        overlay = None
        if self.tracks is not None:
            overlay = TrackOverlay(TrackLookup(read_tracks(self.tracks, sequence)))
        return Drawing(
            detector=None if spec is None else self._open_detector(spec, recording, place),
            place=place,
            least_score=self.score,
            classes=self.classes,
            sensors=None if self.sensors is None else sensor_set(self.sensors),
            tracks=overlay,
        )

    def _open_detector(self, spec: DetectorSpec, recording: Recording, place: Place) -> Detector:
        """Open a detector for the place, or for the recording's site if it is for no other."""
        try:
            return open_detector(spec, place)
        except PlaceMismatch:
            whole_site = Place(self.level, area=self.area)
            if recording.site is None or not whole_site.uses_site(recording.site):
                raise
        return open_detector(spec, recording, whole_site)


def view_command(
    recording: Positional[Path],
    /,
    *,
    out: Path | None = None,
    still: Path | None = None,
    port: int = 8080,
    shown: ViewOptions = ViewOptions(),
    opening: Opening = Opening(),
    writing: Writing = Writing(),
) -> int:
    """Look at a recording: points, sensors, what is labelled and what is detected, in a browser of
    this machine.

    Frames have a slider; sensors, truth, detections and classes can be hidden; points are coloured
    by sensor, height, intensity or age. With --detector its boxes are marked as hits and false
    alarms, and labels as missed. Served to this machine only, until Ctrl-C; with --out written as
    one page that works from disk, with --still as a picture.

    Example: coview view tjunction.hdf5

    Example: coview view my-clouds --detector general --out my-clouds.html

    Example: coview view street.hdf5 --tracks tracks.json

    Example: coview view tjunction.hdf5 --still frame.png --frame 3 --colour height

    Args:
        recording: Recording in any layout.
        out: HTML page to write instead of serving, with at most 600,000 points.
        still: Picture (.png or .svg) of one frame from above to write instead of serving.
        port: Port of the address in the browser; the next free one if it is taken."""
    _check_options(shown, out, still)
    with opening.open(recording) as opened:
        max_frames = shown.frames if out is None else shown.frames or PAGE_FRAMES
        sequence = None if shown.tracks is None else find_sequence(recording, opening)
        numbered = opened if shown.tracks is None else number_frames(opened, sequence)
        samples = Part(numbered, frames=max_frames, every=shown.every)
        drawing = shown.make_drawing(opened, sequence)
        if still is not None and shown.frame >= len(samples):
            raise ValueError(
                f"there is no frame {shown.frame}: {len(samples)} are chosen, counted from 0"
            )
        if len(samples):
            select_sensors(samples[0].sensors, drawing.sensors)  # refuses unknown ones
        track_files = [] if shown.tracks is None else [shown.tracks]
        inputs = [recording, *opening.files, *track_files]
        check_file(still or out, inputs=inputs, overwrite=writing.overwrite)
        if still is not None:
            _draw_still(
                samples[shown.frame],
                drawing,
                still,
                title=recording.name,
                options=shown,
                as_json=writing.json,
            )
        elif out is not None:
            _write_page(
                samples,
                drawing,
                out,
                title=recording.name or str(recording),
                recorded_frames=len(opened),
                as_json=writing.json,
            )
        else:
            view_live(samples, drawing, port=port, ready=partial(_print_url, writing.json))
    return OK


def _check_options(options: ViewOptions, out: Path | None, still: Path | None) -> None:
    """Raise ValueError for impossible options, ImportError without viser.

    out: page to write; still: picture to write; None for neither."""
    check_least(
        "--frames", value=options.frames, minimum=1, remedy="leave it out for all"
    )  # None passes
    check_least("--every", options.every, 1)
    check_least("--frame", options.frame, 0)
    if still is not None and out is not None:
        raise ValueError("--out writes a page, --still a picture: give only one")
    if still is not None:
        check_picture(still)
    spec = options.detector_spec
    if spec is not None and options.tracks is not None:
        raise ValueError("--detector and --tracks both give boxes: leave one out")
    if spec is not None:
        check_detector(spec)
    if still is None:
        check_viser()


def _draw_still(
    sample: Frame, drawing: Drawing, still: Path, *, title: str, options: ViewOptions, as_json: bool
) -> None:
    """Write a picture of one frame, `still`, and print what it shows.

    drawing: how frames are drawn; title: name of the recording; options: area and colours; as_json:
    True to print JSON."""
    drawn_frame = drawing.draw(sample, drawing.find_origin(sample))
    # half sizes of the picture's area (m)
    half = None if options.area is None else drawing.place.half
    write_still(
        drawn_frame,
        still,
        title=f"{title}, {drawn_frame.name}",
        colouring=options.colour,
        half=half,
    )
    description = drawn_frame.describe()
    summary = {"still": str(still), "said": description}
    print_result(summary, f"{still}: {description}", as_json=as_json)


def _write_page(
    samples: Part, drawing: Drawing, out: Path, *, title: str, recorded_frames: int, as_json: bool
) -> None:
    """Write a page of all samples, and print their number.

    samples: frames to draw; drawing: how they are drawn; out: file of the page; title: name of the
    recording; recorded_frames: number of frames of the whole recording; as_json: True to print
    JSON."""
    with progress_bar("frame", len(samples), hidden=as_json) as bar:
        drawn_frames = drawing.draw_all(samples, progress=bar.to)
        page = write_page(drawn_frames, title, out)
    figures = {
        "out": str(out),
        "frames": len(page.frame_nodes),
        "points": page.point_count,
        "drawn": page.drawn_count,
        "of_frames": recorded_frames,
        "said": list(page.frame_lines),
    }
    text = (
        f"{out}: {len(page.frame_nodes)} of {recorded_frames} frames, {page.drawn_count} of "
        f"{page.point_count} points drawn"
    )
    print_result(figures, text, as_json=as_json)


def _print_url(as_json: bool, url: str) -> None:
    """Print the address at which a recording is served."""
    text = f"{url} (this machine only; Ctrl-C ends it)"
    print_result({"url": url}, text, as_json=as_json)
    sys.stdout.flush()  # here, as nothing else is printed while it is served
