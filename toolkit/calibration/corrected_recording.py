"""Copy of a recording with the sensor poses that calibration found, and measurements the same to the byte."""

from __future__ import annotations

import json
import shutil
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np

from toolkit.arrays import Float64
from toolkit.calibration.poses import Corrected, FoundPose
from toolkit.datasets import published_layout as published
from toolkit.datasets.dataset import CoopDataset, list_cameras
from toolkit.datasets.recordings import write_recording
from toolkit.frame import Recording
from toolkit.geometry import check_pose
from toolkit.runtime.files import parse_json, writing
from toolkit.runtime.hdf5 import hdf5_file
from toolkit.sensors.sensor import Sensor
from toolkit.sites.files import format_site


def write_corrected(recording: Recording, found: Sequence[FoundPose], out: Path) -> None:
    """Write a recording at its found poses: a copy of the file for images, a folder for clouds."""
    if not isinstance(recording, CoopDataset):
        write_recording(Corrected.of(recording, found), out, "folder")
        return
    note = {each.sensor.name: each.described() for each in found}
    copy_corrected(recording, {each.sensor.name: each.pose for each in found}, out, note=note)


def copy_corrected(
    recording: CoopDataset,
    poses: Mapping[str, Float64[np.ndarray, "4 4"]],
    out: str | Path,
    *,
    note: Mapping[str, object] | None = None,
) -> None:
    """Copy a recording, whole or not at all, with other poses site_SE3_sensor by sensor name.

    The extrinsics, the sensors of the site in the file and the plan it was made from change, nothing else. note: kept
    as JSON in the attribute `calibration` of the file. Raises ValueError for an unknown sensor and for a pose that is
    not rigid.
    """
    names = [sensor.name for sensor in recording.sensors]
    for name, pose in poses.items():
        if name not in names:
            raise ValueError(f"there is no sensor {name!r} in {recording.path}: choose among {', '.join(names)}")
        check_pose(pose, f"pose of sensor {name!r}")
    with writing(out) as unfinished:
        shutil.copyfile(recording.path, unfinished)
        unfinished.chmod(0o600)
        with hdf5_file(unfinished, "r+") as (file, _):
            cameras = list_cameras(file)
            for sensor, images, place, _ in recording.channels:
                if sensor.name in poses:
                    group = file[images if place is None else f"cameras/{cameras[place]}"]
                    pose = np.asarray(poses[sensor.name], np.float64)
                    if isinstance(group, h5py.Group):
                        group["extrinsic"][...] = published.extrinsic(pose, recording.site.map_SE3_site)
                    if "site_SE3_sensor" in group.attrs:
                        group.attrs["site_SE3_sensor"] = pose
            if "coview/site" in file:
                moved = (Sensor(s.name, s.model, poses.get(s.name, s.pose)) for s in recording.site.sensors)
                del file["coview/site"]
                text = format_site(replace(recording.site, sensors=tuple(moved)))
                file.create_dataset("coview/site", data=text, track_times=False)
            own = file.get("coview")
            if own is not None and "plan" in own.attrs:  # a few numbers tell one recording's plan from another's
                rounded = {name: np.asarray(poses[name])[:3].ravel().round(6).tolist() for name in sorted(poses)}
                own.attrs["plan"] = json.dumps({**parse_json(str(own.attrs["plan"])), "calibrated": rounded})
            if note is not None:
                file.attrs["calibration"] = json.dumps(note)
