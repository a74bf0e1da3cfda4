"""`coview calibrate`: where the sensors of a recording really are."""

from __future__ import annotations

from pathlib import Path

from tyro.conf import Positional

from coview.arguments import check_errors, sensor_set, site_file
from coview.detectors import recording_detector
from coview.exits import OK, SUSPECTED
from coview.outputs import check_file, check_new_folder
from coview.printing import print_result
from coview.progress_bar import progress_bar
from coview.recordings import Opening, frame_count


def calibrate(
    dataset: Positional[Path],
    /,
    *,
    reference: str | None = None,
    held: tuple[str, ...] = (),
    detector: str | None = None,
    out: Path | None = None,
    poses: Path | None = None,
    layout: str | None = None,
    frames: int | None = None,
    reference_frames: int | None = None,
    errors: str = "paper",
    seed: int = 0,
    site: str | None = None,
    overwrite: bool = False,
    json: bool = False,
) -> int:
    """Find again where the sensors of a recording are, by what stands still there. Exit code 1 if one cannot be found.

    Each sensor learns its empty scene from its own frames and is registered against the reference, from up to 5° and
    0.5 m off. What the scene cannot say, such as moves along a bare plane, is named and stays as it was believed.

    Example: coview calibrate monday.hdf5 --reference tjunction --out corrected.hdf5 --poses poses.json

    Example: coview calibrate my-junction --layout folder --reference survey.ply --poses poses.json

    Args:
        dataset: Recording, as in coview evaluate. Lidars known by their clouds are found by the range images of these,
            on a vehicle or in fewer than five frames by one sweep.
        reference: What stands there: a site (name or file), a cloud file of a survey in the site's frame, or a
            recording of the day the sensors were mounted. By default the sensors are fitted to each other, and keep
            their common pose.
        held: Without a reference: numbers or names of sensors that stay where they are.
        detector: Without a reference: as in coview evaluate; road users that two sensors see at the same time then say
            what the standing scene leaves open.
        out: Copy of the recording with corrected poses to write; of clouds, a plain folder.
        poses: JSON to write: pose, uncertainty and what is not observed of each sensor; coview fuse reads it.
        layout: As in coview evaluate.
        frames: Only the first frames.
        reference_frames: Of a recording as reference, only the first frames.
        errors: As in coview evaluate; the poses that are believed are off by those of the profile.
        seed: Of the sensors' noise and errors.
        site: As in coview evaluate.
        overwrite: Replace files that are there.
        json: Print as JSON.
    """
    from toolkit.calibration.corrected_recording import write_corrected
    from toolkit.calibration.poses import TOGETHER, find_poses, save_poses
    from toolkit.calibration.registration import read_surface
    from toolkit.datasets.readings import ReadRecording, Reads
    from toolkit.datasets.recordings import Part

    check_errors(errors)
    reference = None if reference == TOGETHER else reference
    if reference is not None and (held or detector is not None):
        raise ValueError("--held and --detector are for sensors fitted to each other: leave them or --reference out")
    inputs = [dataset, *site_file(reference), *site_file(site)]
    with Opening(layout, site=site).open(dataset) as recording:
        total = frame_count(recording, frames)
        if total and not recording[0].has_images:
            if out is not None:
                check_new_folder(out, inputs=inputs, overwrite=overwrite)
        else:
            check_file(out, inputs=inputs, overwrite=overwrite)
        check_file(poses, inputs=[*inputs, *([out] if out else [])], overwrite=overwrite)
        read = ReadRecording(recording, Reads(errors, seed))
        surface = None if reference is None else read_surface(reference, frames=reference_frames)
        with progress_bar("sensor", hidden=json) as bar:
            found = find_poses(
                read,
                surface,
                held=sensor_set(",".join(held)) or [] if held else [],
                detector=None if detector is None else recording_detector(detector, recording),
                frames=total,
                progress=bar.to,
            )
        if out is not None:
            write_corrected(recording if recording[0].has_images else Part(recording, total), found, out)
    if poses is not None:
        save_poses(poses, found)
    print_result({each.sensor.name: each.described() for each in found}, "\n".join(map(str, found)), as_json=json)
    return OK if all(each.registration is not None for each in found) else SUSPECTED
