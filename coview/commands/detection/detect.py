"""`coview detect`: find road users in recordings in any layout."""

import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Literal, NamedTuple

from tyro.conf import Positional

from coview.arguments import check_ending, check_least
from coview.detector_spec import DetectorSpec
from coview.detectors import check_detector, open_detector
from coview.exchange import Exchange
from coview.outputs import OK, check_empty_folder, check_file, print_result
from coview.progress_bar import progress_bar
from coview.recordings import Opening
from toolkit.calibration.place import Place
from toolkit.objects import Detector

if TYPE_CHECKING:
    from toolkit.datasets.recording_views import Part
    from toolkit.detection.detect import FrameDetections
    from toolkit.detection.standing import StandingScene
    from toolkit.frame import Recording


def detect_command(
    clouds: Positional[tuple[Path, ...]],
    /,
    *,
    out: Path,
    detector: str = "general",
    frames: int | None = None,
    format: Literal["boxes", "openlabel", "kitti"] = "boxes",
    opening: Opening = Opening(),
    place: Place = Place(),
    writing: Exchange = Exchange(),
) -> int:
    """Find road users in clouds, bags, public sets and simulated recordings, on level ground.

    Example: coview detect my-recording --level map --out boxes.json

    Example: coview detect junction.bag --layout rosbag --still --area -40 -40 40 40
        --out boxes.json

    Example: coview detect junction.bag --layout rosbag --still --to mcap --out found.mcap

    Args:
        clouds: Cloud files, folders, bags or recordings.
        out: File of boxes, or folder of OpenLABEL or KITTI files, one per frame.
        detector: general, another shipped network, a file of weights or in ONNX, or
            package.module:callable; +background, which plan.json names too, drops what is
            always at the recording's site or in its empty scene; general has it if the site is
            known, or learns it if the sensors stand still over ten frames and more;
            general-background has not; +phases4 detects on four shifted grids; +float32 in exact
            numbers even if the processor has quicker ones.
        frames: Number of first frames of each recording; all when left out.
        format: One JSON file (boxes), openlabel or kitti."""
    from toolkit.datasets.recording_views import Part
    from toolkit.detection.detect import describe_summary, summarise, write_detections
    from toolkit.detection.exports import export_detections
    from toolkit.detection.standing import learn_standing_scene

    check_least("--frames", frames, 1, "leave it out for all")
    if not clouds:
        raise ValueError("give clouds to detect in: files, folders or bags")
    spec = DetectorSpec.from_name(detector)
    check_detector(spec)
    detectors = _Detectors(spec, place)
    inputs = [*clouds, *opening.files]
    files = writing.check(out, inputs) if writing.to else {}
    if files:
        _check_one_format(format, clouds)
    else:
        _check_boxes(out, format, inputs, overwrite=writing.overwrite)
    with ExitStack() as stack:
        recordings = [stack.enter_context(opening.open(path)) for path in clouds]
        origin = writing.place(recordings[0].site)
        parts = [Part(recording, frames) for recording in recordings]
        scenes: list[StandingScene | None] = []
        for recording, samples in zip(recordings, parts, strict=True):
            learns_scene = recording.site is None and spec.learns_scene
            scenes.append(learn_standing_scene(samples) if learns_scene else None)
        placed = detectors.choose(recordings, scenes)
        level = placed[0].place.level or "none"
        bar = stack.enter_context(progress_bar("cloud", sum(map(len, parts)), hidden=writing.json))
        jobs = list(zip(parts, placed, scenes, strict=True))
        results = _detect(jobs, bar.to)
        if files:
            written = export_detections(results, files, origin)
        else:
            written = write_detections(results, out, format, detector=detector, level=level)
        figures = summarise(written)
    print_result(
        figures | {"out": str(out)}, f"{out}: {describe_summary(figures)}", as_json=writing.json
    )
    return OK


def _check_one_format(format: str, clouds: Sequence[Path]) -> None:
    """Raise ValueError for --format next to --to, and for several recordings in one file."""
    if format != "boxes":
        raise ValueError("--format and --to both name what is written: leave one out")
    if len(clouds) > 1:
        raise ValueError(f"--to writes one recording, got {len(clouds)}: detect in them one by one")


def _check_boxes(out: Path, format: str, inputs: Sequence[Path], *, overwrite: bool) -> None:
    """Raise ValueError or OSError if a file of boxes, or folder of labels, cannot be written."""
    if format == "boxes":
        check_ending(out, (".json",), "a file of boxes")
    check = check_file if format == "boxes" else check_empty_folder
    check(out, inputs=inputs, overwrite=overwrite)


class _PlacedDetector(NamedTuple):
    """Detector, and how its frames are put on level ground."""

    detector: Detector
    place: Place


class _Detectors:
    """Detectors by what is known about a recording.

    spec: parsed name of the detector; place: area and ground as the options give them."""

    def __init__(self, spec: DetectorSpec, place: Place) -> None:
        self.spec = spec.in_bfloat16()
        self.place = place
        self.levelled = replace(place, level=place.level or "map")
        self.network: Detector | None = None
        if not self.spec.knows_background():
            self.network = open_detector(self.spec, self.levelled)

    def choose(
        self, recordings: "Sequence[Recording]", scenes: "Sequence[StandingScene | None]"
    ) -> list[_PlacedDetector]:
        """Return the detector for each recording.

        scenes: standing scene of each recording, None if it is not learnt."""
        network_for_scenes = self.network
        if any(scene is not None for scene in scenes):
            network_for_scenes = open_detector(self.spec.without_background(), self.levelled)
        placed_detectors = []
        for recording, scene in zip(recordings, scenes, strict=True):
            site = recording.site if self.place.at(recording.site) else None
            if self.network is None or self.spec.knows_background(site):
                detector = open_detector(self.spec, recording, self.place)
                placed_detectors.append(_PlacedDetector(detector, self.place))
            elif scene is None or network_for_scenes is None:
                placed_detectors.append(_PlacedDetector(self.network, self.levelled))
            else:
                placed_detectors.append(_PlacedDetector(network_for_scenes, self.levelled))
        return placed_detectors


def _detect(
    jobs: "Sequence[tuple[Part, _PlacedDetector, StandingScene | None]]",
    progress: Callable[[int], None],
) -> "Iterator[FrameDetections]":
    """Yield the detections of each frame, and warn once of a missing ground.

    jobs: frames of each recording, with detector and standing scene; progress: function that is
    called with the number of frames done."""
    from toolkit.detection.detect import detect_frames

    has_warned = False
    done = 0
    for frames, placed, scene in jobs:
        left_out_count = 0  # detections that belong to the standing scene
        for result in detect_frames(frames, placed.detector, placed.place, scene):
            if result.stand.warning is not None and not has_warned:
                has_warned = True
                warnings.warn(f"{result.frame.name}: {result.stand.warning}", stacklevel=2)
            done += 1
            left_out_count += result.left_out
            progress(done)
            yield result
        if scene is not None and left_out_count:
            warnings.warn(scene.describe(left_out_count), stacklevel=2)
