"""`coview calibrate`: where the sensors of a recording really are."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from tyro.conf import Positional

from coview.arguments import check_errors, sensor_set, site_file
from coview.detectors import recording_detector
from coview.outputs import OK, SUSPECTED, Writing, check_file, check_new_folder, print_result
from coview.progress_bar import progress_bar
from coview.recordings import Opening, frame_count


@dataclass(frozen=True)
class Reading:
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
    """Site, survey cloud in its frame, or recording of the day of mounting; sensors fit each other when left out."""
    reference_frames: int | None = None
    """Number of first frames to use of a recording as reference."""
    held: tuple[str, ...] = ()
    """Numbers or names of sensors that stay in place, without a reference."""
    detector: str | None = None
    """Detector, as in coview evaluate, of road users that two sensors see at once, without a reference."""


def calibrate(
    dataset: Positional[Path],
    /,
    *,
    out: Path | None = None,
    poses: Path | None = None,
    fit: Fit = Fit(),
    reading: Reading = Reading(),
    writing: Writing = Writing(),
) -> int:
    """Find again where the sensors of a recording are, by what stands still there. Exit code 1 if one cannot be found.

    Each sensor learns its empty scene from its own frames and is registered against the reference, from up to 5° and
    half a metre off. What the scene cannot say, such as moves along a bare plane, is named and kept. Lidars
    known by their clouds are found by range images of these, on a vehicle or in fewer than five frames by one sweep.

    Example: coview calibrate monday.hdf5 --reference tjunction --out corrected.hdf5 --poses poses.json

    Example: coview calibrate my-junction --layout folder --reference survey.ply --poses poses.json

    Args:
        dataset: Recording in any layout.
        out: Copy of the recording to write with corrected poses; a plain folder for clouds.
        poses: JSON file to write, with each sensor's pose, uncertainty and unobserved motions; coview fuse reads it.
    """
    from toolkit.calibration.corrected_recording import write_corrected
    from toolkit.calibration.poses import TOGETHER, find_poses, save_poses
    from toolkit.calibration.registration import read_surface
    from toolkit.datasets.readings import ReadRecording, Reads
    from toolkit.datasets.recordings import Part

    check_errors(reading.errors)
    reference = None if fit.reference == TOGETHER else fit.reference
    if reference is not None and (fit.held or fit.detector is not None):
        raise ValueError("--held and --detector are for sensors fitted to each other: leave them or --reference out")
    inputs = [dataset, *site_file(reference), *site_file(reading.site)]
    with Opening(reading.layout, site=reading.site).open(dataset) as recording:
        total = frame_count(recording, reading.frames)
        clouds = total and not recording[0].has_images
        if out is not None:
            (check_new_folder if clouds else check_file)(out, inputs=inputs, overwrite=writing.overwrite)
        check_file(poses, inputs=[*inputs, *([out] if out else [])], overwrite=writing.overwrite)
        read = ReadRecording(recording, Reads(reading.errors, reading.seed))
        surface = None if reference is None else read_surface(reference, frames=fit.reference_frames)
        with progress_bar("sensor", hidden=writing.json) as bar:
            found = find_poses(
                read,
                surface,
                held=sensor_set(",".join(fit.held)) or [] if fit.held else [],
                detector=None if fit.detector is None else recording_detector(fit.detector, recording),
                frames=total,
                progress=bar.to,
            )
        if out is not None:
            write_corrected(Part(recording, total) if clouds else recording, found, out)
    if poses is not None:
        save_poses(poses, found)
    figures = {each.sensor.name: each.described() for each in found}
    print_result(figures, "\n".join(map(str, found)), as_json=writing.json)
    return OK if all(each.registration is not None for each in found) else SUSPECTED
