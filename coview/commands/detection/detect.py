"""`coview detect`: find road users in recordings in any layout."""

from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from tyro.conf import Positional

from coview.arguments import check_ending, check_least
from coview.commands.detection.placed_detectors import Detectors, detect_in_turn
from coview.detector_spec import DetectorSpec
from coview.detectors import check_detector
from coview.exchange import Exchange
from coview.outputs import OK, check_empty_folder, check_file, print_result
from coview.progress_bar import progress_bar
from coview.recordings import Opening
from toolkit.calibration.place import Place

if TYPE_CHECKING:
    from toolkit.detection.standing import StandingScene


@dataclass(frozen=True, kw_only=True)
class Scope:
    """Frames, and what is said of them."""

    frames: int | None = None
    """Number of first frames of each recording; all when left out."""
    format: Literal["boxes", "openlabel", "kitti"] = "boxes"
    """One JSON file (boxes), openlabel or kitti."""
    timings: bool = False
    """Print median, 95th and 99th percentile of the milliseconds of each stage."""


def detect_command(
    clouds: Positional[tuple[Path, ...]],
    /,
    *,
    out: Path,
    detector: str = "general",
    scope: Scope = Scope(),
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
            numbers even if the processor has quicker ones."""
    from toolkit.datasets.recording_views import Part
    from toolkit.detection.detect import describe_summary, summarise, write_detections
    from toolkit.detection.exports import export_detections
    from toolkit.detection.standing import learn_standing_scene
    from toolkit.runtime.stage_times import describe_times

    check_least("--frames", scope.frames, 1, "leave it out for all")
    if not clouds:
        raise ValueError("give clouds to detect in: files, folders or bags")
    spec = DetectorSpec.from_name(detector)
    check_detector(spec)
    detectors = Detectors(spec, place)
    inputs = [*clouds, *opening.files]
    files = writing.check(out, inputs) if writing.to else {}
    if files:
        _check_one_format(scope.format, clouds)
    else:
        _check_boxes(out, scope.format, inputs, overwrite=writing.overwrite)
    with ExitStack() as stack:
        recordings = [stack.enter_context(opening.open(path)) for path in clouds]
        origin = writing.place(recordings[0].site)
        parts = [Part(recording, scope.frames) for recording in recordings]
        scenes: list[StandingScene | None] = []
        for recording, samples in zip(recordings, parts, strict=True):
            learns_scene = recording.site is None and spec.learns_scene
            scenes.append(learn_standing_scene(samples) if learns_scene else None)
        placed = detectors.choose(recordings, scenes)
        level = placed[0].place.level or "none"
        bar = stack.enter_context(progress_bar("cloud", sum(map(len, parts)), hidden=writing.json))
        jobs = list(zip(parts, placed, scenes, strict=True))
        results = detect_in_turn(jobs, bar.to)
        if files:
            written = export_detections(results, files, origin=origin, asn1=writing.asn1)
        else:
            written = write_detections(results, out, scope.format, detector=detector, level=level)
        figures = summarise(written, timings=scope.timings)
    text = f"{out}: {describe_summary(figures)}"
    if scope.timings:
        text += f"\n{describe_times(figures['timings'])}"
    print_result(figures | {"out": str(out)}, text, as_json=writing.json)
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
