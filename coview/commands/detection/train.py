"""`coview train`, `coview adapt` and `coview export`: networks of your own."""

import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from tyro.conf import Positional

from coview.arguments import check_ending, check_least
from coview.detectors import BACKGROUND, GENERAL, check_detector, recording_detector
from coview.outputs import CARD_KIND, OK, Writing, check_file, check_folder, print_result
from coview.progress_bar import progress_bar
from coview.recordings import Opening
from models.training.options import TrainingOptions
from toolkit.detection.place import Corners, Place

if TYPE_CHECKING:
    from models.network.voxelnet import VoxelNet
    from toolkit.frame import Recording

UNSURE = 0.1  # least score of the detections that are joined
BESIDE = 0.3  # m around an object within which points are its own
# frames, and one in so many, the last ones, is not trained on
FEWEST_TO_ADAPT = 40
HELD_OUT = 4


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
        remedy = (
            "name the files of each frame by its time, in seconds since 1970, or write times to "
            "labels.json"
        )
        raise ValueError(
            f"{path}: its frames have no times, by which objects are followed: {remedy}"
        )


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
    from models.training.adaptation import LONGEST, adapt_network, join_detections
    from models.training.loop import CHECKPOINT, Machine
    from models.training.packing import LevelSample, pack, sample_recordings
    from models.weight_files import Header, load_weights, save_weights
    from toolkit.boxes import points_in_boxes
    from toolkit.datasets.recordings import Part, ReadRecording, Reads
    from toolkit.detection.background import KnownBackground
    from toolkit.detection.place import crop_points
    from toolkit.geometry import level_rows
    from toolkit.points import frame_points
    from toolkit.runtime.resumable import ShardFolder
    from toolkit.sites.site import Site

    check_least("--seed", settings.seed, 0)
    check_least("--frames", settings.frames, FEWEST_TO_ADAPT)
    check_least("--seconds", settings.seconds, 1)
    check_detector(settings.start, place)
    check_folder(
        out, holds=WEIGHTS, inputs=[recording, *opening.files], overwrite=writing.overwrite
    )
    network, header = load_weights(weights_file(settings.start))
    with (
        opening.open(recording) as opened,
        progress_bar("frame", min(settings.frames, len(opened)), hidden=writing.json) as bar,
    ):
        if len(opened) < FEWEST_TO_ADAPT:
            raise ValueError(
                f"there must be {FEWEST_TO_ADAPT} frames at least to adapt to, got {len(opened)}"
            )
        _check_times(opened, recording)
        known = recording_detector(settings.start + BACKGROUND, opened, place)
        assert isinstance(known, KnownBackground)
        area = known.detector.area  # type: ignore[attr-defined]
        some = Part(
            ReadRecording(opened, Reads(settings.errors, settings.seed))
            if opened[0].has_images
            else opened,
            settings.frames,
        )
        clouds = list[list[np.ndarray]]()
        times = list[float]()
        for done, (frame, stand) in enumerate(place.stands(some, opened.site), 1):
            if isinstance(stand.area, Site):
                slope = stand.area.relief.slope
                clouds.append(
                    [level_rows(each, slope) for each in frame_points(frame, area=stand.area)]
                )
            else:
                clouds.append(
                    [crop_points(stand.lift(each.in_world()), stand.area) for each in frame.clouds]
                )
            times.append(frame.time)
            bar.to(done)
    apart = np.diff(times)
    if not (apart > 0).all() or np.median(apart) > LONGEST:
        got = f"got {apart.min():g} to {apart.max():g} s"
        raise ValueError(
            f"frames must ascend in time, at most {LONGEST:g} s apart, {got}: record more often"
        )
    last = len(clouds) // HELD_OUT
    labelled = out / "labelled.packed"

    def label(network: "VoxelNet", held_out: bool) -> Path:
        """Pack frames with what a network finds in them over time."""
        part = slice(-last, None) if held_out else slice(-last)
        detect = replace(known, detector=VoxelNetDetector(network, score_threshold=UNSURE))
        found = [
            detect(np.concatenate([np.zeros((0, 3), np.float32), *each])) for each in clouds[part]
        ]
        samples = list[LevelSample]()
        for own, objects in zip(clouds[part], join_detections(found, times[part]), strict=True):
            grown = objects.boxes + np.array([0, 0, 0, 2 * BESIDE, 2 * BESIDE, 2 * BESIDE, 0])
            kept = (
                each[known.background.holds(each) | points_in_boxes(each, grown).any(axis=1)]
                for each in own
            )
            samples.append((tuple(map(str, range(len(own)))), tuple(kept), objects, area))
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
        save_weights(out / WEIGHTS, saved, Header(header.site, settings.seed, commit(), figures))
        for path in (labelled, out / CHECKPOINT):
            path.unlink()
    said = (
        "a better network" if after > before else "the old network, since the new one is not better"
    )
    text = (
        f"{out / WEIGHTS}: {said}, by its own labels of the held out part (mean AP {before:.3f}, "
        f"now {after:.3f})"
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
