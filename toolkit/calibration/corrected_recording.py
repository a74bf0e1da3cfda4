"""Copy of a recording with corrected sensor poses.

The poses are those that calibration found. Measurements are the same to the byte.
"""

from __future__ import annotations

import json
import shutil
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

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
from toolkit.sites.site import Site


def write_corrected(recording: Recording, found: Sequence[FoundPose], out: Path) -> None:
    """Write a recording whose sensors stand at their found poses.

    A recording of images becomes a copy of the file, one of clouds a folder.
    """
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
    note: Mapping[str, Any] | None = None,
) -> None:
    """Copy a recording with other sensor poses.

    poses: site_SE3_sensor by sensor name. The file is written whole or not at all. The extrinsics, the sensors of the
    site in the file and the plan it was made from change, nothing else. note: kept as JSON in the attribute
    `calibration` of the file. Raises ValueError for an unknown sensor and for a pose that is not rigid.
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
                    where = images if place is None else f"cameras/{cameras[place]}"
                    _place(file[where], np.asarray(poses[sensor.name], np.float64), recording.site)
            if "coview/site" in file:
                _replace_text(file, "coview/site", format_site(_moved(recording.site, poses)))
            own = file.get("coview")
            if own is not None and "plan" in own.attrs:
                own.attrs["plan"] = json.dumps({**parse_json(str(own.attrs["plan"])), "calibrated": _rounded(poses)})
            if note is not None:
                file.attrs["calibration"] = json.dumps(note)


def _place(group: h5py.Group | h5py.Dataset, pose: Float64[np.ndarray, "4 4"], site: Site) -> None:
    """Write a pose wherever a sensor has one."""
    if isinstance(group, h5py.Group):
        group["extrinsic"][...] = published.extrinsic(pose, site.map_SE3_site)
    if "site_SE3_sensor" in group.attrs:
        group.attrs["site_SE3_sensor"] = pose


def _moved(site: Site, poses: Mapping[str, Float64[np.ndarray, "4 4"]]) -> Site:
    return replace(site, sensors=tuple(Sensor(s.name, s.model, poses.get(s.name, s.pose)) for s in site.sensors))


def _replace_text(file: h5py.File, name: str, text: str) -> None:
    del file[name]
    file.create_dataset(name, data=text, track_times=False)


def _rounded(poses: Mapping[str, Float64[np.ndarray, "4 4"]]) -> dict[str, list[float]]:
    """Round each pose to a few numbers. They tell one recording's plan from another's."""
    return {name: np.asarray(pose)[:3].ravel().round(6).tolist() for name, pose in sorted(poses.items())}
