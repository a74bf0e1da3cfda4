"""`coview survey`, `doctor` and `calibrate`: checks of a recording."""

from dataclasses import asdict, dataclass
from pathlib import Path

from tyro.conf import Positional

from coview.arguments import Label, check_least, sensor_set, site_file
from coview.detector_spec import DetectorSpec
from coview.detectors import open_detector
from coview.outputs import OK, SUSPECTED, Writing, check_empty_folder, check_file, print_result
from coview.progress_bar import progress_bar
from coview.recordings import Opening, frame_count
from toolkit.sensors.error_profiles import find_profile


def survey_command(
    dataset: Positional[Path],
    /,
    *,
    sensors: tuple[str, ...] = ("all",),
    classes: tuple[Label, ...] = ("vehicle", "cyclist", "pedestrian", "heavy"),
    frames: int | None = None,
    errors: str = "paper",
    seed: int = 0,
    json: bool = False,
    opening: Opening = Opening(),
) -> int:
    """Count what a recording holds: objects per frame, kbit of early fusion, points on the objects
    of each class.

    Objects in the site's area are counted, or all objects if the site is unknown.

    Example: coview survey tjunction.hdf5 --sensors 4 3,4 0,2,5 all

    Example: coview survey my-log --layout argoverse

    Args:
        dataset: Recording in any layout.
        sensors: Sensor sets, as in coview evaluate.
        classes: Classes whose points are counted.
        frames: Number of first frames to use; all when left out.
        errors: Error profile, as in coview evaluate.
        seed: Seed of the sensors' noise and errors.
        json: Print as JSON."""
    from toolkit.datasets.recording_views import Reads
    from toolkit.detection.survey import survey
    from toolkit.frame import select_sensors

    find_profile(errors)  # raises for an unknown name, before any work
    with opening.open(dataset) as recording:
        total = frame_count(recording, frames)
        if not total:
            raise ValueError("there is no frame to survey: check the path and the layout")
        # indices of the sensors of each set
        selections = [select_sensors(recording[0].sensors, sensor_set(names)) for names in sensors]
        with progress_bar("frame", total, hidden=json) as bar:
            result = survey(
                recording, classes=classes, reads=Reads(errors, seed, total), progress=bar.to
            )
    print_result(result.as_dict(selections), result.text(selections), as_json=json)
    return OK


def doctor_command(
    dataset: Positional[Path],
    /,
    *,
    site: str | None = None,
    reference: str | None = None,
    layout: str | None = None,
    frames: int = 20,
    json: bool = False,
) -> int:
    """Check a recording for the classic mistakes, and name those suspected and why. Exit code 1 if
    any is.

    Example: coview doctor my-recording.hdf5

    Example: coview doctor my-log --layout argoverse

    Args:
        dataset: Recording in any layout.
        site: Name or file of the site, for hdf5, as in coview evaluate.
        reference: Reference, as in coview calibrate, against which the sensors' poses are checked
            too.
        layout: Layout, as in coview evaluate.
        frames: Number of first frames whose labels are checked; all for hdf5.
        json: Print as JSON."""
    from toolkit.doctor.diagnosis import diagnose
    from toolkit.doctor.drift import check_drift
    from toolkit.sites.files import load_site

    check_least("--frames", frames, 1)
    loaded_site = load_site(site) if site else None
    diagnosis = diagnose(dataset, layout, site=loaded_site, frames=frames)
    findings = diagnosis.findings
    if reference:
        findings = findings + check_drift(dataset, reference, loaded_site)
    text = "\n".join(map(str, findings)) or diagnosis.healthy
    print_result([asdict(finding) for finding in findings], text, as_json=json)
    return SUSPECTED if findings else OK


@dataclass(frozen=True)
class RecordingOptions:
    """Recording, and errors of its simulated sensors."""

    layout: str | None = None
    """Layout of the recording, as in coview evaluate."""
    site: str | None = None
    """Name or file of the site, as in coview evaluate."""
    frames: int | None = None
    """Number of first frames to use; all when left out."""
    errors: str = "paper"
    """Error profile, as in coview evaluate; believed poses have the profile's errors."""
    seed: int = 0
    """Seed of the sensors' noise and errors."""


@dataclass(frozen=True)
class Fit:
    """Surfaces or sensors that poses are fitted to."""

    reference: str | None = None
    """Site, survey cloud in its frame, or recording of the day of mounting; sensors fit each other
    when left out."""
    reference_frames: int | None = None
    """Number of first frames to use of a recording as reference."""
    held: tuple[str, ...] = ()
    """Numbers or names of sensors that stay in place, without a reference."""
    detector: str | None = None
    """Detector, as in coview evaluate, of road users that two sensors see at once, without a
    reference."""


def calibrate_command(
    dataset: Positional[Path],
    /,
    *,
    out: Path | None = None,
    poses: Path | None = None,
    fit: Fit = Fit(),
    reading: RecordingOptions = RecordingOptions(),
    writing: Writing = Writing(),
) -> int:
    """Find the poses of a recording's sensors again, by what stands still there. Exit code 1 if one
    cannot be found.

    Each sensor learns its empty scene from its frames and is registered against the reference,
    from up to 5° and half a metre off. Moves that the scene does not show, such as those along a
    bare plane, are named and kept. Lidars known by their clouds are found by range images made from
    them, on a vehicle or in fewer than five frames by one sweep.

    Example: coview calibrate monday.hdf5 --reference tjunction --out corrected.hdf5
        --poses poses.json

    Example: coview calibrate my-junction --layout folder --reference survey.ply --poses poses.json

    Args:
        dataset: Recording in any layout.
        out: Copy of the recording to write with corrected poses; a plain folder for clouds.
        poses: JSON file to write, with each sensor's pose, uncertainty and unobserved motions;
            coview fuse reads it."""
    from toolkit.calibration.corrected_recording import write_corrected
    from toolkit.calibration.found_pose import save_poses
    from toolkit.calibration.poses import TOGETHER, find_poses
    from toolkit.calibration.reference_surface import read_surface
    from toolkit.datasets.recording_views import Part, ReadRecording, Reads

    find_profile(reading.errors)  # raises for an unknown name, before any work
    reference = None if fit.reference == TOGETHER else fit.reference
    if reference is not None and (fit.held or fit.detector is not None):
        raise ValueError(
            "--held and --detector are for sensors fitted to each other: leave them or "
            "--reference out"
        )
    inputs = [dataset, *site_file(reference), *site_file(reading.site)]
    with Opening(reading.layout, site=reading.site).open(dataset) as recording:
        total = frame_count(recording, reading.frames)
        has_clouds = total and not recording[0].has_images
        if out is not None:
            check_out = check_empty_folder if has_clouds else check_file  # clouds: a plain folder
            check_out(out, inputs=inputs, overwrite=writing.overwrite)
        pose_inputs = [*inputs, out] if out else inputs
        check_file(poses, inputs=pose_inputs, overwrite=writing.overwrite)
        measured = ReadRecording(recording, Reads(reading.errors, reading.seed))
        surface = None
        if reference is not None:
            surface = read_surface(reference, frames=fit.reference_frames)
        held = (sensor_set(",".join(fit.held)) if fit.held else None) or []
        detector = None
        if fit.detector is not None:
            detector = open_detector(DetectorSpec.from_name(fit.detector), recording)
        with progress_bar("sensor", hidden=writing.json) as bar:
            found_poses = find_poses(
                measured, surface, held=held, detector=detector, frames=total, progress=bar.to
            )
        if out is not None:
            write_corrected(Part(recording, total) if has_clouds else recording, found_poses, out)
    if poses is not None:
        save_poses(poses, found_poses)
    figures = {pose.sensor.name: pose.as_dict() for pose in found_poses}
    print_result(figures, "\n".join(map(str, found_poses)), as_json=writing.json)
    return OK if all(pose.registration is not None for pose in found_poses) else SUSPECTED
