"""Recordings of clouds for the commands that take --layout."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import partial
from itertools import count, islice
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from coview.arguments import check_errors, check_least, sensor_set
from coview.detectors import area_about, of_background, sample_detector
from coview.progress_bar import progress_bar

TOGETHER, CLUSTER = "together", "cluster"

if TYPE_CHECKING:
    from models.training.packing import PackedRecording
    from toolkit.calibration.poses import FoundPose
    from toolkit.datasets.records import Samples
    from toolkit.datasets.sample import Sample
    from toolkit.detection.codec import Codec
    from toolkit.detection.detect import Detected
    from toolkit.detection.sample_evaluation import SampleEvaluation
    from toolkit.detection.scheme import Scheme
    from toolkit.objects import Detector


def open_clouds(path: Path, layout: str, *, poses: Path | None = None, inverted: bool = False) -> Samples:
    """The samples of a recording of clouds; poses: a file of them, which only plain folders take."""
    from toolkit.datasets.layouts.folder import folder
    from toolkit.datasets.recordings import open_samples

    if poses is None and not inverted:
        return open_samples(path, layout)
    if layout != "folder":
        raise ValueError(f"--poses and --inverted are for --layout folder: {layout} has its own")
    return folder(path, poses=poses, inverted=inverted)


def open_with_errors(path: Path, layout: str, errors: str, seed: int) -> Samples:
    """The samples of one of our recordings as sensors with such errors say them."""
    from toolkit.datasets.layouts.hdf5 import hdf5

    if layout != "hdf5":
        raise ValueError(f"--errors are for --layout hdf5: clouds of {layout} have their own")
    check_errors(errors)
    return hdf5(path, errors=errors, noise_seed=seed)


def first_of(samples: Iterable[Sample], frames: int | None) -> Iterator[Sample]:
    """The first so many, all for None."""
    return islice(samples, frames)


def watched(found: Iterable[Detected], progress: Callable[[int], None]) -> Iterator[Detected]:
    """Detections as they come by; the bar moves, and the first thing to be said of the ground is."""
    said = False
    for done, each in enumerate(found, 1):
        if each.warning is not None and not said:
            warnings.warn(f"{each.sample.name}: {each.warning}", stacklevel=2)
            said = True
        progress(done)
        yield each


def passing(samples: Iterable[Sample], problems: dict[str, int], progress: Callable[[int], None]) -> Iterator[Sample]:
    """Samples as they come by; the bar moves, and what was met in reading them is added up."""
    from toolkit.datasets.records import add_problems

    for done, sample in enumerate(samples, 1):
        add_problems(problems, sample.problems)
        progress(done)
        yield sample


def cloud_recordings(
    opened: Sequence[Samples],
    frames: int | None,
    *,
    level: Literal["map", "plane", "none"],
    still: bool,
    area: tuple[float, float, float, float] | None,
) -> Iterator[PackedRecording]:
    """Recordings of clouds on level ground, ready to be packed."""
    from models.training.packing import sample_recordings
    from toolkit.detection.detect import level_samples

    middle, half = area_about(area)
    for samples in opened:
        levelled = level_samples(first_of(samples, frames), levelling=level, middle=middle, half=half, still=still)
        yield from sample_recordings(levelled)


def score_clouds(
    path: Path,
    layout: str,
    detector: str,
    *,
    schemes: Sequence[Scheme],
    codec: Codec,
    sensors: Sequence[str],
    classes: Sequence[str] | None,
    iou: Sequence[float] | None,
    level: Literal["map", "plane", "none"],
    still: bool,
    area: tuple[float, float, float, float] | None,
    frames: int | None,
    rate: float | None,
    calibrate: str | None,
    hidden: bool,
) -> SampleEvaluation:
    """A detector scored on a recording of clouds, with a bar. Raises ValueError for several sets of sensors."""
    from toolkit.calibration.poses import corrections, with_corrections
    from toolkit.calibration.scenes import SampleScenes
    from toolkit.detection.background import KnownBackground
    from toolkit.detection.detect import middle_of
    from toolkit.detection.foreground_clusters import learn_cluster_detector
    from toolkit.detection.sample_evaluation import evaluate_samples
    from toolkit.objects import known_labels

    check_least("--frames", frames, 1, "leave it out for all")
    if len(sensors) != 1:
        raise ValueError(f"with --layout there is one set of sensors, got {len(sensors)}: say them as a,b,c")
    chosen = sensor_set(sensors[0])
    names = None if chosen is None else [str(name) for name in chosen]
    samples = open_clouds(path, layout)
    total = min(len(samples), frames or len(samples)) * max(1, len(schemes))
    steps = count(1)
    opened: Callable[[], Iterable[Sample]] = partial(first_of, samples, frames)
    found = () if calibrate is None else found_poses(opened, calibrate)
    corrected = corrections(found)

    def put_right() -> Iterator[Sample]:
        return with_corrections(opened(), corrected)

    def of_chosen() -> Iterator[Sample]:
        return (sample if names is None else sample.seen_by(names) for sample in put_right())

    scenes = SampleScenes(of_chosen)
    bare, known = of_background(detector)
    if bare == CLUSTER or known:
        middle, half = area_about(area)
        first, seen = next(put_right(), None), next(of_chosen(), None)
        if first is None or seen is None:
            raise ValueError("there is no sample to evaluate: check the path and the layout")
        x, y = middle_of(first).tolist() if middle is None else middle
        middle = (x, y)
        learnt = learn_cluster_detector(scenes, seen, levelling=level, middle=middle, half=half)
        named = None if bare == CLUSTER else sample_detector(bare, area)[0]
        network: Detector = learnt if named is None else KnownBackground(named, learnt.clusters.background)
    else:
        network, middle, half = sample_detector(detector, area)
    with progress_bar("cloud", total, hidden=hidden) as bar:
        figures = evaluate_samples(
            put_right, network, scenes=scenes, schemes=schemes, codec=codec,
            classes=classes or known_labels(network) or ("vehicle",), iou_thresholds=iou, levelling=level,
            middle=middle, half=half, still=still, sensors=names,
            rate=rate, seen=partial(watched, progress=lambda _: bar.to(next(steps))),
        )  # fmt: skip
    return figures.with_poses(found)


def found_poses(
    opened: Callable[[], Iterable[Sample]],
    reference: str,
    *,
    held: Sequence[int | str] = (),
    frames: int | None = None,
) -> tuple[FoundPose, ...]:
    """Where the lidars of a recording are, by a reference as in coview calibrate, of a recording its first so many
    frames, or "together" by each other."""
    from toolkit.calibration.poses import find_sample_poses
    from toolkit.calibration.registration import read_surface

    surface = None if reference == TOGETHER else read_surface(reference, frames=frames)
    return find_sample_poses(opened, surface, held=held)


def opened_clouds(path: Path, layout: str, frames: int | None) -> Callable[[], Iterable[Sample]]:
    """What gives the first so many samples of a recording, all for None, as often as it is asked."""
    check_least("--frames", frames, 1, "leave it out for all")
    return partial(first_of, open_clouds(path, layout), frames)


def write_corrected_clouds(opened: Callable[[], Iterable[Sample]], found: Sequence[FoundPose], out: Path) -> int:
    """Write samples as a plain folder, their sensors where they were found to be."""
    from toolkit.calibration.poses import corrections, with_corrections
    from toolkit.datasets.recordings import write_samples

    return write_samples(with_corrections(opened(), corrections(found)), out, "folder")
