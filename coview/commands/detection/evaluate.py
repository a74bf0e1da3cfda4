"""`coview evaluate`: score schemes and sensor sets on a recording."""

from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from tyro.conf import Positional

from coview import arguments
from coview.detector_spec import DetectorSpec
from coview.detectors import check_detector, open_detector
from coview.outputs import OK, Writing, check_folder, claim, print_result
from coview.progress_bar import progress_bar
from coview.recordings import Opening
from toolkit.detection.place import Place
from toolkit.display import describe_count
from toolkit.frame import Frame, RecordingView
from toolkit.runtime.run import Run
from toolkit.sensors.error_profiles import find_profile

if TYPE_CHECKING:
    from toolkit.calibration.poses import FoundPose
    from toolkit.detection.evaluation import Comparison
    from toolkit.frame import Frame


@dataclass(frozen=True)
class Link:
    """Link from sensors to the centre."""

    codec: str = "paper"
    """Coding: paper counts 96 bits a point and 256 a box, range-images sends bytes, as scheme
    foreground does."""
    step: float = 0.02
    """Resolution of the distances in bytes (m): 0.02, 0.04, 0.08."""
    refers_to: Literal["previous", "key"] = "previous"
    """Reference of differences: the previous message, or the last whole image where messages may be
    lost."""
    key_every: int = 10
    """Maximum number of messages from one whole image to the next, where differences are sent."""
    rate: float | None = None
    """Frame rate (Hz); prints each scheme's load on the link."""


@dataclass(frozen=True)
class Rules:
    """Rules of scoring."""

    schemes: tuple[str, ...] | None = None
    """Fusion schemes: early, late, hybrid, foreground, differences; when left out, the first three
    at a known site."""
    sensors: tuple[str, ...] = ("all",)
    """Sensor sets, each a comma-separated list of numbers or names, or all."""
    classes: tuple[arguments.Label, ...] | None = None
    """Classes to score; those that the detector knows when left out."""
    iou: tuple[float, ...] | None = None
    """IoU thresholds; 0.7 0.8 0.9 for vehicle and heavy, 0.25 0.5 0.7 for cyclist and pedestrian
    when left out."""
    metric: Literal["3d", "bev"] = "3d"
    """IoU of volumes or of footprints."""
    protocol: Literal["exact", "published", "measured"] | None = None
    """Objects that count: exact, as the published code counts, or with a point (measured, usual
    without a site)."""
    breakdown: bool | None = None
    """Print AP by range and points, and in other protocols; usual without a known site."""
    radius: float | None = None
    """Distance (m) beyond which hybrid fusion shares points; the site's when left out."""
    link: Link = Link()


@dataclass(frozen=True)
class Subject:
    """Detector and sensors to score."""

    detector: str | None = None
    """Detector: voxelnet (the site's network, or general), cluster, general, a file of weights or
    in ONNX, or package.module:callable; +background drops what stands, +phases4 detects on four
    shifted grids, +bfloat16 in coarser numbers."""
    calibrate: str | None = None
    """Reference, as in coview calibrate, to find the sensors' poses by first, or together."""
    errors: str = "paper"
    """Error profile of sensors that measured images: paper (their own noise), surveyed, typical,
    glare, typical-clock, poor."""


def evaluate(
    dataset: Positional[Path],
    /,
    *,
    out: Path = Path("out/evaluation"),
    subject: Subject = Subject(),
    rules: Rules = Rules(),
    opening: Opening = Opening(),
    place: Place = Place(),
    run: Run = Run(),
    writing: Writing = Writing(),
) -> int:
    """Score fusion schemes and sensor sets on a recording, as text, JSON and PR curves.

    A second table shows, class by class, what the detector's threshold yields. The usual detector
    is the network of the site's sensors, elsewhere general. Without a known site all clouds are
    fused at once.

    Example: coview evaluate tjunction.hdf5 --schemes early late --sensors 0,2,5 all --iou 0.7 0.8

    Example: coview evaluate my-log --layout argoverse --detector general

    Example: coview evaluate my-junction --schemes early late foreground --calibrate together
        --still

    Args:
        dataset: Recording made by coview simulate, one of the authors' files, or clouds in any
            layout.
        out: Folder for table.json and the PR curves."""
    from toolkit.calibration.empty_scene import Scenes
    from toolkit.calibration.poses import TOGETHER, Corrected, find_poses
    from toolkit.calibration.registration import read_surface
    from toolkit.datasets.recordings import Part, ReadRecording, Reads
    from toolkit.datasets.records import check_labels
    from toolkit.detection.evaluation import curve_files, evaluate_recording, save_evaluation
    from toolkit.frame import select_sensors
    from toolkit.objects import check_known, known_labels

    for name in ("schemes", "sensors", "classes", "iou"):
        arguments.check_each_once(f"--{name}", getattr(rules, name))
    arguments.check_ious(rules.iou or ())
    arguments.check_schemes(rules.schemes or ())
    arguments.check_least("--radius", rules.radius, 0.0)
    arguments.check_positive("--rate", rules.link.rate)
    arguments.check_least("--key-every", rules.link.key_every, 1)
    arguments.check_share("--step", rules.link.step)
    find_profile(subject.errors)
    inputs = [dataset, *opening.files]
    reads = Reads(subject.errors, run.seed, run.frames)

    def check_outputs(
        overwrite: bool, labels: Sequence[str] = rules.classes or ("vehicle",)
    ) -> None:
        for name in ("table.json", *curve_files(labels, rules.iou)):
            check_folder(out, holds=name, inputs=inputs, overwrite=overwrite)

    sets = [arguments.sensor_set(names_of_set) for names_of_set in rules.sensors]
    spec = None if subject.detector is None else DetectorSpec.from_name(subject.detector)
    if spec is not None:
        check_detector(spec, place)
    surface = None if subject.calibrate in (None, TOGETHER) else read_surface(subject.calibrate)
    with ExitStack() as stack:
        recording = opened = stack.enter_context(opening.open(dataset))
        is_known = place.at(opened.site)
        comparison = _compare(rules, is_known=is_known)
        check_labels(opened, reads.count(opened))
        sensors = opened[0].sensors if len(opened) else ()
        for names_of_set in sets if len(opened) else ():
            select_sensors(sensors, names_of_set)
        claimed = claim(
            out, (inputs, subject, rules, place, run), check_outputs, overwrite=writing.overwrite
        )
        may_overwrite = stack.enter_context(claimed)
        poses: tuple[FoundPose, ...] = ()
        if subject.calibrate is not None:
            poses = find_poses(opened, surface, frames=reads.frames)
            recording = Corrected.of(opened, poses)
        frames_read = recording
        if len(recording) and not is_known:
            frames_read = Part(recording, run.frames)
            if None not in sets:
                names = [name for names_of_set in sets for name in names_of_set or ()]
                frames_read = _Seen(frames_read, tuple(names))
        scenes = Scenes(ReadRecording(frames_read, reads) if is_known else frames_read)
        detect = open_detector(spec, frames_read, place, scenes)
        labels = rules.classes or known_labels(detect) or ("vehicle",)
        check_known(detect, labels)
        check_outputs(may_overwrite, labels)
        with progress_bar("frame", reads.count(recording), hidden=writing.json) as bar:
            evaluation = evaluate_recording(
                recording,
                detect,
                replace(comparison, classes=labels),
                place=place,
                reads=reads,
                scenes=scenes,
                run=replace(run, progress=bar.stage),
            )
        if not any(row.truths for row in evaluation):
            raise ValueError(
                f"there is no AP, since no {' and no '.join(labels)} is to be found in "
                f"{describe_count(reads.count(recording), 'frame')}: take more frames, other "
                "--classes or another area"
            )
        evaluation = replace(evaluation, poses=poses)
        save_evaluation(evaluation, out)
    text = f"{evaluation.text()}\nwritten to {out}/table.json, PR curves beside it"
    if not subject.detector:
        name = getattr(detect, "name", "general")
        text = f"detector {name}, as --detector is left out\n\n{text}"
    print_result(evaluation.as_dict(), text, as_json=writing.json)
    return OK


def _compare(rules: Rules, *, is_known: bool) -> "Comparison":
    from toolkit.detection.evaluation import Comparison
    from toolkit.detection.link.range_images import find_codec
    from toolkit.detection.schemes import PAPER_SCHEMES, schemes_in_steps

    link = rules.link
    schemes_by_name = schemes_in_steps(
        link.step, refers_to=link.refers_to, key_every=link.key_every
    )
    default_schemes: tuple[str, ...] = PAPER_SCHEMES if is_known else ()
    schemes = [schemes_by_name[name] for name in rules.schemes or default_schemes]
    return Comparison(
        schemes=schemes or (None,),
        sensor_sets=[arguments.sensor_set(sensor_names) for sensor_names in rules.sensors],
        iou_thresholds=rules.iou,
        protocol=rules.protocol,
        metric=rules.metric,
        codec=find_codec(link.codec, step=link.step),
        radius=rules.radius,
        rate=link.rate,
        breakdown=rules.breakdown,
    )


@dataclass(frozen=True, eq=False)
class _Seen(RecordingView):
    """A recording as seen by some of its sensors."""

    sensors: tuple[int | str, ...]

    def __getitem__(self, index: int) -> Frame:
        return self.recording[index].seen_by(list(dict.fromkeys(self.sensors)))
