"""`coview evaluate`: score schemes and sensor sets on a recording."""

from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from tyro.conf import Positional

from coview import arguments
from coview.commands.detection.evaluate_tracks import evaluate_track_file
from coview.commands.detection.evaluation_options import Rules, Subject
from coview.detector_spec import DetectorSpec
from coview.detectors import check_detector, open_detector
from coview.outputs import OK, Writing, check_folder, claim, print_result
from coview.progress_bar import progress_bar
from coview.recordings import Opening
from toolkit.calibration.place import Place
from toolkit.display import describe_count
from toolkit.frame import Frame, RecordingView
from toolkit.runtime.run import Run
from toolkit.sensors.error_profiles import find_profile

if TYPE_CHECKING:
    from toolkit.calibration.found_pose import FoundPose
    from toolkit.calibration.reference_surface import Surface
    from toolkit.detection.comparison import Comparison
    from toolkit.detection.evaluation_result import Evaluation
    from toolkit.frame import Recording
    from toolkit.objects import Detector


def evaluate_command(
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
    fused together.

    Example: coview evaluate tjunction.hdf5 --schemes early late --sensors 0,2,5 all --iou 0.7 0.8

    Example: coview evaluate my-log --layout argoverse --detector general

    Example: coview evaluate my-junction --schemes early late foreground --calibrate together
        --still

    Example: coview evaluate street.hdf5 --tracks tracks.json

    Args:
        dataset: Recording made by coview simulate, one of the authors' files, or clouds in any
            layout; with --tracks also KITTI's labels of tracks (.txt), or a folder of them.
        out: Folder for table.json and the PR curves."""
    score = _evaluate_detector if subject.tracks is None else evaluate_track_file
    return score(
        dataset,
        out=out,
        subject=subject,
        rules=rules,
        opening=opening,
        place=place,
        run=run,
        writing=writing,
    )


def _evaluate_detector(
    dataset: Path,
    *,
    out: Path,
    subject: Subject,
    rules: Rules,
    opening: Opening,
    place: Place,
    run: Run,
    writing: Writing,
) -> int:
    """Score a detector on a recording, and return the exit code.

    dataset: path of the recording; out: path of the results; subject: detector and poses; rules:
    schemes, classes and thresholds; opening: how the recording is read."""
    from toolkit.calibration.recording_scenes import Scenes
    from toolkit.datasets.recording_views import ReadRecording, Reads
    from toolkit.detection.evaluation import evaluate_recording
    from toolkit.detection.evaluation_files import save_evaluation
    from toolkit.objects import check_known, known_labels

    _check_options(rules, subject)
    sets = [arguments.sensor_set(names) for names in rules.sensors]
    spec = None if subject.detector is None else DetectorSpec.from_name(subject.detector)
    if spec is not None:
        check_detector(spec, place)
    surface = _read_reference(subject.calibrate)
    reads = Reads(subject.errors, run.seed, run.frames)
    inputs = [dataset, *opening.files]
    check_outputs = partial(_check_outputs, out, inputs, rules)
    with ExitStack() as stack:
        opened = stack.enter_context(opening.open(dataset))
        is_known = place.uses_site(opened.site)
        comparison = _compare(rules, is_known=is_known)
        _check_recording(opened, reads.count(opened), sets)
        settings = (inputs, subject, rules, place, run)
        claimed = claim(out, settings, check_outputs, overwrite=writing.overwrite)
        may_overwrite = stack.enter_context(claimed)
        recording, poses = _correct_poses(opened, subject.calibrate, surface, reads.frames)
        frames = recording if is_known else _select_frames(recording, sets, run.frames)
        scenes = Scenes(ReadRecording(frames, reads) if is_known else frames)
        detector = open_detector(spec, frames, place, scenes)
        labels = rules.classes or known_labels(detector) or ("vehicle",)
        check_known(detector, labels)
        check_outputs(may_overwrite, labels)
        count = reads.count(recording)
        comparison = replace(comparison, classes=labels)
        with progress_bar("frame", count, hidden=writing.json) as bar:
            run = replace(run, progress=bar.stage)
            evaluation = evaluate_recording(
                recording, detector, comparison, place=place, reads=reads, scenes=scenes, run=run
            )
        _check_truths(evaluation, labels, count)
        evaluation = replace(evaluation, poses=poses)
        save_evaluation(evaluation, out)
    text = _describe_evaluation(evaluation, out, default=None if subject.detector else detector)
    print_result(evaluation.as_dict(), text, as_json=writing.json)
    return OK


def _describe_evaluation(evaluation: "Evaluation", out: Path, *, default: "Detector | None") -> str:
    """Text of an evaluation and its files.

    out: folder of the files; default: detector that was chosen without --detector, which is named
    first, None with one."""
    text = f"{evaluation.text()}\nwritten to {out}/table.json, PR curves next to it"
    if default is None:
        return text
    name = getattr(default, "name", "general")
    return f"detector {name}, as --detector is left out\n\n{text}"


def _check_options(rules: Rules, subject: Subject) -> None:
    """Raise ValueError for options of the evaluation that do not fit.

    rules: how detections are scored; subject: what is scored, and under which sensor errors."""
    for name in ("schemes", "sensors", "classes", "iou"):
        arguments.check_each_once(f"--{name}", getattr(rules, name))
    arguments.check_ious(rules.iou or ())
    arguments.check_schemes(rules.schemes or ())
    arguments.check_least("--radius", rules.radius, 0.0)
    arguments.check_positive("--rate", rules.link.rate)
    arguments.check_share("--step", rules.link.step)
    if rules.similarity is not None:
        raise ValueError("--similarity is for --tracks: leave it out")
    find_profile(subject.errors)  # raises for an unknown name


def _read_reference(reference: str | None) -> "Surface | None":
    """Read the surface that poses are fitted to, None without one."""
    from toolkit.calibration.poses import TOGETHER
    from toolkit.calibration.reference_surface import read_surface

    return None if reference in (None, TOGETHER) else read_surface(reference)


def _check_outputs(
    out: Path,
    inputs: Sequence[Path],
    rules: Rules,
    overwrite: bool,
    labels: Sequence[str] | None = None,
) -> None:
    """Check that the table and the curves of some classes may be written.

    out: folder of the files; inputs: files that the command reads; rules: with classes and IoU
    thresholds, which name the files; overwrite: True to replace files; labels: the classes, None
    for the rules' ones. Raises ValueError or OSError otherwise."""
    from toolkit.detection.evaluation_files import curve_files

    labels = labels or rules.classes or ("vehicle",)
    for name in ("table.json", *curve_files(labels, rules.iou)):
        check_folder(out, holds=name, inputs=inputs, overwrite=overwrite)


def _check_recording(
    recording: "Recording", count: int, sets: Sequence[Sequence[int | str] | None]
) -> None:
    """Raise ValueError for labels that cannot be scored, and for unknown sensors.

    count: number of first frames that are evaluated; sets: sensors of each set, by number or name,
    None for all."""
    from toolkit.datasets.listing import check_labels
    from toolkit.frame import select_sensors

    check_labels(recording, count)
    if len(recording):
        for sensors in sets:
            select_sensors(recording[0].sensors, sensors)  # raises for an unknown sensor


def _correct_poses(
    recording: "Recording", reference: str | None, surface: "Surface | None", frames: int | None
) -> "tuple[Recording, tuple[FoundPose, ...]]":
    """Return a recording with corrected poses, and the poses that were found.

    reference: name of what the poses are fitted to, None to keep the recording as it is; surface:
    surface that they are fitted to, if any; frames: number of first frames to use, None for
    all."""
    from toolkit.calibration.corrected_recording import Corrected
    from toolkit.calibration.poses import find_poses

    if reference is None:
        return recording, ()
    poses = find_poses(recording, surface, frames=frames)
    return Corrected.from_poses(recording, poses), poses


def _select_frames(
    recording: "Recording", sets: Sequence[Sequence[int | str] | None], count: int | None
) -> "Recording":
    """Return the first frames, with the sensors of the sets only.

    sets: sensors of each set, by number or name, None for all; count: number of frames, None for
    all."""
    from toolkit.datasets.recording_views import Part

    if not len(recording):
        return recording
    frames = Part(recording, count)
    if None in sets:
        return frames
    names = [name for sensors in sets for name in sensors or ()]
    return _Seen(frames, tuple(names))


def _check_truths(evaluation: "Evaluation", labels: Sequence[str], count: int) -> None:
    """Raise ValueError if there is no object to find. count: number of frames, for the message."""
    if not any(row.truths for row in evaluation):
        raise ValueError(
            f"there is no AP, since no {' and no '.join(labels)} is to be found in "
            f"{describe_count(count, 'frame')}: take more frames, other --classes or another area"
        )


def _compare(rules: Rules, *, is_known: bool) -> "Comparison":
    """Return the comparison that the rules describe.

    is_known: the site is known, so that all schemes are compared if the rules name none."""
    from toolkit.detection.comparison import Comparison
    from toolkit.detection.link.range_images import find_codec
    from toolkit.detection.schemes import PAPER_SCHEMES, schemes_in_steps

    link = rules.link
    schemes_by_name = schemes_in_steps(link.step)
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
        timings=rules.timings,
    )


@dataclass(frozen=True, eq=False)
class _Seen(RecordingView):
    """Recording as some of its sensors see it."""

    sensors: tuple[int | str, ...]

    def __getitem__(self, index: int) -> Frame:
        return self.recording[index].seen_by(list(dict.fromkeys(self.sensors)))
