"""`coview calibrate`: where the sensors of a recording really are."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from tyro.conf import Positional

from coview.arguments import check_errors, refuse_given, sensor_set, site_file
from coview.clouds import TOGETHER, found_poses, opened_clouds, write_corrected_clouds
from coview.detectors import recording_detector
from coview.exits import OK, SUSPECTED
from coview.outputs import check_file, check_new_folder
from coview.printing import print_result
from coview.progress_bar import progress_bar
from coview.recordings import frame_count, open_recording

if TYPE_CHECKING:
    from toolkit.calibration.poses import FoundPose


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
        dataset: Recording, as in coview evaluate.
        reference: What stands there: a site (name or file), a cloud file of a survey in the site's frame, or a
            recording of the day the sensors were mounted. Left out: the sensors are fitted to each other, and
            keep their common pose.
        held: Without a reference: numbers or names of sensors that stay where they are.
        detector: Without a reference: as in coview evaluate; road users that two sensors see at the same time then say
            what the standing scene leaves open.
        out: Copy of the recording with corrected poses to write; of clouds, a plain folder.
        poses: JSON to write: pose, uncertainty and what is not observed of each sensor; coview fuse reads it.
        layout: Of a recording of clouds, as in coview detect; its lidars are found by the range images of their clouds,
            on a vehicle or in fewer than five samples by one sweep.
        frames: Only the first so many frames.
        reference_frames: Of a recording as reference, only the first so many.
        errors: As in coview evaluate; the poses that are believed are off by those of the profile.
        seed: Of the sensors' noise and errors.
        site: As in coview evaluate.
        overwrite: Replace files that are there.
        json: Print as JSON.
    """
    from toolkit.calibration.corrected_recording import write_corrected
    from toolkit.calibration.poses import find_poses, find_poses_together
    from toolkit.calibration.registration import read_surface

    check_errors(errors)
    if reference is not None and (held or detector is not None):
        raise ValueError("--held and --detector are for sensors fitted to each other: leave them or --reference out")
    inputs = [dataset, *site_file(reference), *site_file(site)]
    if layout is not None:
        others = {"--detector": detector is not None, "--errors": errors != "paper", "--site": site is not None}
        refuse_given(others, "is not for --layout")
        if out is not None:
            check_new_folder(out, inputs=inputs, overwrite=overwrite)
        check_file(poses, inputs=inputs, overwrite=overwrite)
        opened = opened_clouds(dataset, layout, frames)
        found = found_poses(
            opened,
            reference or TOGETHER,
            held=sensor_set(",".join(held)) or [] if held else [],
            frames=reference_frames,
        )
        if out is not None:
            write_corrected_clouds(opened, found, out)
        return _said(found, poses, json)
    check_file(out, inputs=inputs, overwrite=overwrite)
    check_file(poses, inputs=[*inputs, *([out] if out else [])], overwrite=overwrite)
    with open_recording(dataset, site) as recording:
        total = frame_count(recording, frames)
        with progress_bar("sensor", len(recording.sensors), hidden=json) as bar:
            if reference is None:
                stay, detect = sensor_set(",".join(held)) if held else [], None
                if detector is not None:
                    detect = recording_detector(detector, recording)
                found = find_poses_together(
                    recording, held=stay or [], detector=detect, frames=total, errors=errors, noise_seed=seed
                )
            else:
                surface = read_surface(reference, frames=reference_frames)
                found = find_poses(recording, surface, frames=total, errors=errors, noise_seed=seed, progress=bar.to)
        if out is not None:
            described = {each.sensor.name: each.described() for each in found}
            write_corrected(recording, {each.sensor.name: each.pose for each in found}, out, note=described)
    return _said(found, poses, json)


def _said(found: Sequence[FoundPose], poses: Path | None, json: bool) -> int:
    """Write and print what was found."""
    from toolkit.calibration.poses import save_poses

    if poses is not None:
        save_poses(poses, found)
    print_result({each.sensor.name: each.described() for each in found}, "\n".join(map(str, found)), as_json=json)
    return OK if all(each.registration is not None for each in found) else SUSPECTED
