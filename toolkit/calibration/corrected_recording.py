"""Recordings with their sensors at their found poses."""

import json
import shutil
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import h5py
import numpy as np

from toolkit.arrays import Pose
from toolkit.calibration.found_pose import FoundPose
from toolkit.datasets import published_layout as published
from toolkit.datasets.dataset import CoopDataset
from toolkit.datasets.image_file import list_cameras
from toolkit.datasets.recordings import write_recording
from toolkit.frame import Frame, Recording, RecordingView, SensorCloud
from toolkit.geometry import check_pose, invert
from toolkit.runtime.hdf5 import hdf5_file
from toolkit.runtime.text_values import parse_json
from toolkit.runtime.writing import writing
from toolkit.sensors.sensor import Sensor
from toolkit.sites.files import format_site


@dataclass(frozen=True, eq=False)
class Corrected(RecordingView):
    """Recording with its sensors at their found poses."""

    # believed_SE3_found by name: each believed pose is multiplied by it
    corrections: Mapping[str, Pose]

    @staticmethod
    def from_poses(recording: Recording, found_poses: Iterable[FoundPose]) -> "Corrected":
        """Return a recording with found poses applied."""
        return Corrected(
            recording,
            {
                found_pose.sensor.name: invert(found_pose.sensor.pose) @ found_pose.pose
                for found_pose in found_poses
            },
        )

    def __getitem__(self, index: int) -> Frame:
        frame = self.recording[index]
        sensors = []
        measurements = []
        for sensor, measurement in zip(frame.sensors, frame.measurements, strict=True):
            correction = self.corrections.get(sensor.name)
            if correction is not None:
                if isinstance(measurement, SensorCloud):
                    in_sensor = measurement.in_own_frame()
                    measurement = replace(
                        in_sensor, world_SE3_sensor=in_sensor.world_SE3_sensor @ correction
                    )
                sensor = Sensor(sensor.name, sensor.model, sensor.pose @ correction)
            sensors.append(sensor)
            measurements.append(measurement)
        return replace(frame, sensors=tuple(sensors), measurements=tuple(measurements))


def write_corrected(recording: Recording, found_poses: Sequence[FoundPose], out: Path) -> None:
    """Write a recording at its found poses: a copy of the file for images, a folder for clouds."""
    if isinstance(recording, CoopDataset):
        note = {found_pose.sensor.name: found_pose.described() for found_pose in found_poses}
        copy_corrected(
            recording,
            {found_pose.sensor.name: found_pose.pose for found_pose in found_poses},
            out,
            note=note,
        )
    else:
        write_recording(Corrected.from_poses(recording, found_poses), out, "folder")


def copy_corrected(
    recording: CoopDataset,
    poses: Mapping[str, Pose],
    out: str | Path,
    *,
    note: Mapping[str, object] | None = None,
) -> None:
    """Copy a recording, whole or not at all, with other poses site_SE3_sensor by sensor name.

    The extrinsics, the sensors of the site in the file and the plan it was made from change,
    nothing else. note: kept as JSON in the attribute `calibration` of the file. Raises ValueError
    for an unknown sensor and for a pose that is not rigid."""
    names = [sensor.name for sensor in recording.sensors]
    for name, pose in poses.items():
        if name not in names:
            raise ValueError(
                f"there is no sensor {name!r} in {recording.path}: choose among {', '.join(names)}"
            )
        check_pose(pose, f"pose of sensor {name!r}")
    with writing(out) as unfinished:
        shutil.copyfile(recording.path, unfinished)
        unfinished.chmod(0o600)
        with hdf5_file(unfinished, "r+") as (file, _):
            cameras = list_cameras(file)
            for sensor, images, stream_index, _ in recording.channels:
                if sensor.name in poses:
                    group = file[
                        images if stream_index is None else f"cameras/{cameras[stream_index]}"
                    ]
                    pose = np.asarray(poses[sensor.name], np.float64)
                    if isinstance(group, h5py.Group):
                        group["extrinsic"][...] = published.extrinsic(
                            pose, recording.site.map_SE3_site
                        )
                    if "site_SE3_sensor" in group.attrs:
                        group.attrs["site_SE3_sensor"] = pose
            if "coview/site" in file:
                moved = (
                    Sensor(s.name, s.model, poses.get(s.name, s.pose))
                    for s in recording.site.sensors
                )
                del file["coview/site"]
                text = format_site(replace(recording.site, sensors=tuple(moved)))
                file.create_dataset("coview/site", data=text, track_times=False)
            coview_group = file.get("coview")
            if (
                coview_group is not None and "plan" in coview_group.attrs
            ):  # a few numbers tell one recording's plan from another's
                rounded = {
                    name: np.asarray(poses[name])[:3].ravel().round(6).tolist()
                    for name in sorted(poses)
                }
                coview_group.attrs["plan"] = json.dumps(
                    {**parse_json(str(coview_group.attrs["plan"])), "calibrated": rounded}
                )
            if note is not None:
                file.attrs["calibration"] = json.dumps(note)
