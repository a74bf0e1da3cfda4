"""`coview train`, `coview adapt` and `coview export`: networks of your own."""

import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from tyro.conf import Positional

from coview.arguments import check_ending, check_least
from coview.detector_spec import GENERAL, DetectorSpec
from coview.detectors import check_detector, open_detector
from coview.outputs import CARD_KIND, OK, Writing, check_file, check_folder, print_result
from coview.progress_bar import progress_bar
from coview.recordings import Opening
from models.training.options import TrainingOptions
from toolkit.detection.place import Corners, Place

if TYPE_CHECKING:
    from models.network.voxelnet import VoxelNet
    from toolkit.detection.background import Background
    from toolkit.detection.place import Stand
    from toolkit.frame import Frame, Recording
    from toolkit.objects import Objects

MIN_JOINED_SCORE = 0.1  # of the detections that are joined
OBJECT_MARGIN_M = 0.3  # points so near an object belong to it
MIN_ADAPT_FRAMES = 40
HELD_OUT_DIVISOR = 4  # the last one in so many frames is not trained on


def train(
    site: Positional[str | None] = None, /, *, training: TrainingOptions, json: bool = False
) -> int:
    """Train VoxelNet on a packed file.

    If killed and started again, it resumes and ends with the same weights. The same arguments train
    on a bare machine, without pictures: python -m models.train.

    Example: coview train tjunction --preset fast --data tjunction.packed --out runs/tjunction
        --validate test.packed

    Args:
        site: Area to train for: tjunction, roundabout, a site file, or general for any place; the
            data's when left out.
        json: Print the summary as JSON."""
    from models.train import run
    from models.training.loop import LOG, read_curves
    from toolkit.plots.curves import draw_training

    with progress_bar("step", hidden=json) as bar:
        weights, measured = run(site, training, progress=bar.step)
    draw_training(read_curves(training.out / LOG), training.out)
    pictures = "losses.png, ap.png" if training.validate else "losses.png"
    text = f"{training.out}: {weights.name}, {LOG}, {pictures}"
    print_result({"weights": str(weights), "ap": measured}, text, as_json=json)
    return OK


@dataclass(frozen=True)
class Adaptation:
    """Network to fit, and for how long."""

    start: str = GENERAL
    """Shipped weights, or a weights file."""
    seconds: float = 900.0
    """Wall time of the training (s)."""
    frames: int = 600
    """Number of frames to use at most, the first ones."""
    errors: str = "paper"
    """Error profile of sensors that measured images, as in coview evaluate."""
    seed: int = 0
    """Seed of order and augmentation."""


def _check_times(opened: "Recording", path: Path) -> None:
    """Raise ValueError for a recording whose first frames have no times."""
    if not all(math.isfinite(opened[number].time) for number in range(2)):
        raise ValueError(
            f"{path}: its frames have no times, by which objects are followed: name the files of "
            "each frame by its time, in seconds since 1970, or write times to labels.json"
        )


def _crop_level_clouds(frame: "Frame", stand: "Stand") -> list[np.ndarray]:
    """Return the cloud of each sensor on level ground, cropped to the area."""
    from toolkit.detection.place import crop_points
    from toolkit.geometry import level_rows
    from toolkit.points import frame_points
    from toolkit.sites.site import Site

    if isinstance(stand.area, Site):
        slope = stand.area.relief.slope
        return [level_rows(cloud, slope) for cloud in frame_points(frame, area=stand.area)]
    lifted = [stand.lift(cloud.in_world()) for cloud in frame.clouds]
    return [crop_points(cloud, stand.area) for cloud in lifted]


def _keep_labelled(cloud: np.ndarray, objects: "Objects", background: "Background") -> np.ndarray:
    """Return the points of a cloud on labelled objects or the empty site."""
    from toolkit.boxes import points_in_boxes

    margin = 2 * OBJECT_MARGIN_M
    grown_boxes = objects.boxes + np.array([0, 0, 0, margin, margin, margin, 0])
    is_object = points_in_boxes(cloud, grown_boxes).any(axis=1)
    return cloud[background.holds(cloud) | is_object]


def adapt(
    recording: Positional[Path],
    /,
    *,
    out: Path,
    settings: Adaptation = Adaptation(),
    opening: Opening = Opening(),
    place: Place = Place(),
    writing: Writing = Writing(),
) -> int:
    """Fit a network to the junction of a recording that nobody labelled.

    The empty site is learnt. What the network detects is joined over time, and is the truth: an
    object has one class, and one that never moves needs higher scores. Points of neither an object
    nor the empty site are left out. The network is trained on the first three quarters, and stays
    as it was unless the new one is better on the last. Scores and thresholds are those of the old
    one. Sensors must stand still, frames lie at most 1.6 s apart. If killed and started again, it
    resumes.

    Example: coview adapt junction.bag --layout rosbag --area -40 -40 40 40 --out runs/junction

    Args:
        recording: Recording in any layout; its labels are not read.
        out: Folder for weights.safetensors, which every command takes for a detector."""
    from models.detector import VoxelNetDetector, relocate, weights_file
    from models.train import WEIGHTS, commit
    from models.training.adaptation import MAX_PAUSE_S, adapt_network, join_detections
    from models.training.loop import CHECKPOINT, Machine
    from models.training.packing import LevelSample, pack, sample_recordings
    from models.weight_files import WeightsHeader, load_weights, save_weights
    from toolkit.datasets.recordings import Part, ReadRecording, Reads
    from toolkit.detection.background import KnownBackground
    from toolkit.runtime.resumable import ShardFolder

    check_least("--seed", settings.seed, 0)
    check_least("--frames", settings.frames, MIN_ADAPT_FRAMES)
    check_least("--seconds", settings.seconds, 1)
    start = DetectorSpec.from_name(settings.start)
    check_detector(start, place)
    check_folder(
        out, holds=WEIGHTS, inputs=[recording, *opening.files], overwrite=writing.overwrite
    )
    network, header = load_weights(weights_file(settings.start))
    with (
        opening.open(recording) as opened,
        progress_bar("frame", min(settings.frames, len(opened)), hidden=writing.json) as bar,
    ):
        if len(opened) < MIN_ADAPT_FRAMES:
            raise ValueError(
                f"there must be {MIN_ADAPT_FRAMES} frames at least to adapt to, got {len(opened)}"
            )
        _check_times(opened, recording)
        background_detector = open_detector(start.with_background(), opened, place)
        assert isinstance(background_detector, KnownBackground)
        area = background_detector.detector.area  # type: ignore[attr-defined]
        read: Recording = opened
        if opened[0].has_images:
            read = ReadRecording(opened, Reads(settings.errors, settings.seed))
        read_frames = Part(read, settings.frames)
        clouds = list[list[np.ndarray]]()
        times = list[float]()
        for done, (frame, stand) in enumerate(place.stands(read_frames, opened.site), 1):
            clouds.append(_crop_level_clouds(frame, stand))
            times.append(frame.time)
            bar.to(done)
    intervals = np.diff(times)
    if not (intervals > 0).all() or np.median(intervals) > MAX_PAUSE_S:
        raise ValueError(
            f"frames must ascend in time, at most {MAX_PAUSE_S:g} s apart, got "
            f"{intervals.min():g} to {intervals.max():g} s: record more often"
        )
    held_out_count = len(clouds) // HELD_OUT_DIVISOR
    labelled = out / "labelled.packed"

    def label(network: "VoxelNet", held_out: bool) -> Path:
        """Pack frames with what a network finds in them over time."""
        frame_range = slice(-held_out_count, None) if held_out else slice(-held_out_count)
        detector = VoxelNetDetector(network, score_threshold=MIN_JOINED_SCORE)
        detect = replace(background_detector, detector=detector)
        no_points = np.zeros((0, 3), np.float32)
        detections = [
            detect(np.concatenate([no_points, *frame_clouds]))
            for frame_clouds in clouds[frame_range]
        ]
        frame_objects = join_detections(detections, times[frame_range])
        samples = list[LevelSample]()
        for sensor_clouds, objects in zip(clouds[frame_range], frame_objects, strict=True):
            labelled_clouds = [
                _keep_labelled(cloud, objects, background_detector.background)
                for cloud in sensor_clouds
            ]
            sensor_names = tuple(map(str, range(len(sensor_clouds))))
            samples.append((sensor_names, tuple(labelled_clouds), objects, area))
        pack(sample_recordings(samples), labelled)
        return labelled

    local = relocate(network, area, header.site or GENERAL).eval()
    with ShardFolder(out, {}).lock(), progress_bar("step", hidden=writing.json) as bar:
        if writing.overwrite:  # a run of other settings may have been killed there
            (out / CHECKPOINT).unlink(missing_ok=True)
        adapted, before, after = adapt_network(
            local,
            label,
            out,
            Machine(seconds=settings.seconds),
            seed=settings.seed,
            progress=bar.step,
        )
        figures = {"AP held out before": before, "AP held out": after}
        saved = relocate(adapted, network.config.area, GENERAL)
        save_weights(
            out / WEIGHTS, saved, WeightsHeader(header.site, settings.seed, commit(), figures)
        )
        for path in (labelled, out / CHECKPOINT):
            path.unlink()
    outcome = "the old network, since the new one is not better"
    if after > before:
        outcome = "a better network"
    text = (
        f"{out / WEIGHTS}: {outcome}, by its own labels of the held out part (mean AP "
        f"{before:.3f}, now {after:.3f})"
    )
    print_result(
        {"weights": str(out / WEIGHTS), "before": before, "after": after},
        text,
        as_json=writing.json,
    )
    return OK


def export(
    weights: Positional[str],
    out: Positional[Path],
    /,
    *,
    area: Corners | None = None,
    writing: Writing = Writing(),
) -> int:
    """Write a network as ONNX, with a card of its area, voxels, anchors, classes, thresholds and
    calibration beside it.

    Every command takes the file in place of a detector's name.

    Example: coview export general junction.onnx --area -40 -20 40 20

    Args:
        weights: Shipped weights, or a weights file.
        out: ONNX file to write; the card is NAME.onnx.json beside it.
        area: Area xmin ymin xmax ymax (m), for weights that go anywhere; that of the weights when
            left out."""
    from models.detector import weights_file
    from models.onnx_files import card_file, export_onnx

    check_ending(out, (".onnx",), "a network in ONNX")
    inputs = [weights_file(weights)]
    check_file(out, inputs=inputs, overwrite=writing.overwrite)
    unfinished = not out.exists()  # a killed export may have left its card
    check_file(
        card_file(out), inputs=inputs, overwrite=writing.overwrite or unfinished, kind=CARD_KIND
    )
    out.parent.mkdir(parents=True, exist_ok=True)
    export_onnx(weights, out, area)
    print_result(
        {"out": str(out), "card": str(card_file(out))},
        f"{out}, card {card_file(out)}",
        as_json=writing.json,
    )
    return OK
