"""`coview evaluate`: score fusion schemes and sensor sets on a recording."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from tyro.conf import Positional

from coview.arguments import (
    Label,
    check_errors,
    check_ious,
    check_least,
    check_positive,
    check_schemes,
    sensor_set,
)
from coview.detectors import recording_detector
from coview.exits import OK
from coview.outputs import check_folder
from coview.printing import print_result
from coview.progress_bar import progress_bar
from coview.recordings import Opening
from toolkit.detection.place import Place
from toolkit.runtime.run import Run

if TYPE_CHECKING:
    from toolkit.calibration.poses import FoundPose
    from toolkit.datasets.readings import Reads
    from toolkit.detection.evaluation import Comparison
    from toolkit.frame import Frame, Recording
    from toolkit.sites.site import Site


@dataclass(frozen=True)
class Rules:
    """Rules of scoring."""

    schemes: tuple[str, ...] | None = None
    """early, late, hybrid, foreground and differences (of foregrounds); by default the first three at a known site, all
    clouds at once elsewhere."""
    sensors: tuple[str, ...] = ("all",)
    """Sensor sets, each a comma-separated list of numbers or names, or all."""
    classes: tuple[Label, ...] | None = None
    """Classes to score; by default all that the detector says it knows, vehicle where it does not say."""
    iou: tuple[float, ...] | None = None
    """IoU thresholds; by default 0.7 0.8 0.9 for vehicle and heavy, 0.25 0.5 0.7 for cyclist and pedestrian."""
    metric: Literal["3d", "bev"] = "3d"
    """IoU of volumes or of footprints."""
    protocol: Literal["exact", "published", "measured"] | None = None
    """exact; published, as the published code counts; or measured, where only objects with a point are to be found. By
    default exact at a known site, measured elsewhere."""
    breakdown: bool | None = None
    """AP by footprint and volume, by range and points, in our protocol, KITTI's and nuScenes' too; by default where no
    site is known."""
    radius: float | None = None
    """Hybrid fusion shares points farther than this from their sensor (m); by default the site's."""


@dataclass(frozen=True)
class Link:
    """Link from sensors to the centre."""

    codec: str = "paper"
    """paper counts 96 bits a point and 256 a box, range-images sends bytes, as the foreground scheme always does."""
    step: float = 0.02
    """Resolution of the distances in bytes (m): 0.02, 0.04, 0.08."""
    refers_to: Literal["previous", "key"] = "previous"
    """Differences are taken from the previous message, or the last whole image (key), where messages may be lost.
    Frames must be close together (coview simulate --every 0.1)."""
    key_every: int = 10
    """Messages from one whole image to the next at most, where differences are sent."""
    rate: float | None = None
    """Frames per second (Hz): print what each scheme puts on a link."""


def evaluate(
    dataset: Positional[Path],
    /,
    *,
    detector: str | None = None,
    calibrate: str | None = None,
    errors: str = "paper",
    out: Path = Path("out/evaluation"),
    overwrite: bool = False,
    json: bool = False,
    opening: Opening = Opening(),
    place: Place = Place(),
    rules: Rules = Rules(),
    link: Link = Link(),
    run: Run = Run(),
) -> int:
    """Score fusion schemes and sensor sets on a recording: the paper's first table, as text, JSON and PR curves.

    Beside it stands what the detector's threshold is worth, class by class.

    Example: coview evaluate tjunction.hdf5 --schemes early late --sensors 0,2,5 all --iou 0.7 0.8

    Example: coview evaluate my-log --layout argoverse --detector general

    Example: coview evaluate my-junction --schemes early late foreground --calibrate together --still

    Args:
        dataset: Recording made by coview simulate, one of the authors' files, or clouds in any layout.
        detector: cluster, the default at a known site; a trained network: voxelnet for the site's own, general, the
            default elsewhere, another name, or a weights file; or your own, package.module:callable (see
            toolkit.detection.imported). With +background behind it (voxelnet+background), what stands in the empty site
            is left out.
        calibrate: First find where the sensors are: by a reference as in coview calibrate, or together, by each other.
        errors: Of sensors that measured images: paper (their own noise), surveyed, typical or poor; see
            toolkit.sensors.error_profiles.
        out: Folder for table.json and the PR curves.
        overwrite: Replace the table and curves of another run.
        json: Print rows and class figures, with the reliability diagram of the scores, as JSON.
        opening: How the recording is opened.
        place: Where to detect, and on what ground.
        rules: Schemes, sensor sets, classes and protocol.
        link: Link from sensors to the centre.
        run: The seed is of the sensors' noise and errors.
    """
    from toolkit.calibration.scenes import Scenes
    from toolkit.datasets.readings import ReadRecording, Reads
    from toolkit.datasets.recordings import Part
    from toolkit.detection.evaluation import curve_files, evaluate_recording, save_evaluation
    from toolkit.objects import check_known, known_labels

    _check(rules, link)
    check_errors(errors)
    inputs, reads = [dataset, *opening.files], Reads(errors, run.seed, run.frames)

    def check_outputs(labels: Sequence[str]) -> None:
        for name in ("table.json", *curve_files(labels, rules.iou)):
            check_folder(out, holds=name, inputs=inputs, overwrite=overwrite)

    check_outputs(rules.classes or ("vehicle",))
    with opening.open(dataset) as opened:
        poses, recording = ((), opened) if calibrate is None else _calibrate(opened, calibrate, reads)
        known = place.at(recording.site)
        asked = _compare(rules, link, known=known)
        first = recording[0] if len(recording) else None
        some = recording if known or first is None else Part(recording, run.frames)
        if first is not None and not known:
            wanted = [sensor_set(chosen) for chosen in rules.sensors]
            names = None if None in wanted else [name for chosen in wanted if chosen for name in chosen]
            some = some if names is None else _Seen(some, tuple(names))
        scenes = Scenes(ReadRecording(some, reads) if known else some)
        detect = recording_detector(detector, some, place, scenes)
        labels = rules.classes or known_labels(detect) or ("vehicle",)
        check_known(detect, labels)
        check_outputs(labels)
        with progress_bar("frame", reads.count(recording), hidden=json) as bar:
            found = evaluate_recording(
                recording,
                detect,
                replace(asked, classes=labels),
                place=place,
                reads=reads,
                scenes=scenes,
                run=replace(run, progress=bar.stage),
            )
    found = replace(found, poses=poses)
    save_evaluation(found, out)
    print_result(found.as_dict(), f"{found.text()}\nwritten to {out}/table.json, PR curves beside it", as_json=json)
    return OK


def _check(rules: Rules, link: Link) -> None:
    check_ious(rules.iou or ())
    check_schemes(rules.schemes or ())
    check_least("--radius", rules.radius, 0.0)
    check_positive("--rate", link.rate)
    check_least("--key-every", link.key_every, 1)


def _compare(rules: Rules, link: Link, *, known: bool) -> Comparison:
    """Return the comparison that the options ask for; known: at a known site."""
    from toolkit.detection.evaluation import Comparison
    from toolkit.detection.link.range_images import find_codec
    from toolkit.detection.schemes import PAPER_SCHEMES, schemes_in_steps

    named = schemes_in_steps(link.step, refers_to=link.refers_to, key_every=link.key_every)
    usual: tuple[str, ...] | None = PAPER_SCHEMES if known else None
    chosen = rules.schemes or usual
    return Comparison(
        schemes=(None,) if chosen is None else [named[name] for name in chosen],
        sensor_sets=[sensor_set(each) for each in rules.sensors],
        iou_thresholds=rules.iou,
        protocol=rules.protocol,
        metric=rules.metric,
        codec=find_codec(link.codec, step=link.step),
        radius=rules.radius,
        rate=link.rate,
        breakdown=rules.breakdown,
    )


@dataclass(frozen=True)
class _Seen:
    """A recording as some of its sensors saw it."""

    recording: Recording
    sensors: tuple[int | str, ...]

    @property
    def site(self) -> Site | None:
        return self.recording.site

    def __len__(self) -> int:
        return len(self.recording)

    def __getitem__(self, index: int) -> Frame:
        return self.recording[index].seen_by(list(dict.fromkeys(self.sensors)))

    def __iter__(self) -> Iterator[Frame]:
        return map(self.__getitem__, range(len(self)))


def _calibrate(recording: Recording, reference: str, reads: Reads) -> tuple[tuple[FoundPose, ...], Recording]:
    """Find where the sensors are; return that, and the recording with its sensors there."""
    from toolkit.calibration.poses import TOGETHER, Corrected, find_poses
    from toolkit.calibration.registration import read_surface

    surface = None if reference == TOGETHER else read_surface(reference)
    found = find_poses(recording, surface, frames=reads.frames)
    return found, Corrected.of(recording, found)
