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
from toolkit.sites.site import Site


@dataclass(frozen=True, eq=False)
class Corrected(RecordingView):
    """Recording with its sensors at their found poses.

    corrections: believed_SE3_found by sensor name; each believed pose is multiplied by it from the
    right. Other sensors stay as they are."""

    corrections: Mapping[str, Pose]

    @staticmethod
    def from_poses(recording: Recording, found_poses: Iterable[FoundPose]) -> "Corrected":
        """Return a recording with its sensors at found poses, in all its frames.

        found_poses: result for each sensor that was looked for; other sensors stay."""
        corrections = {}  # believed_SE3_found by name of the sensor
        for found_pose in found_poses:
            sensor = found_pose.sensor
            corrections[sensor.name] = invert(sensor.pose) @ found_pose.pose
        return Corrected(recording, corrections)

    def __getitem__(self, index: int) -> Frame:
        """Frame of an index, with its sensors at their found poses."""
        frame = self.recording[index]
        sensors = []
        measurements = []
        for sensor, measurement in zip(frame.sensors, frame.measurements, strict=True):
            # believed_SE3_found: takes points from the found sensor frame to the believed one
            correction = self.corrections.get(sensor.name)
            if correction is None:
                sensors.append(sensor)
                measurements.append(measurement)
                continue
            sensors.append(Sensor(sensor.name, sensor.model, sensor.pose @ correction))
            if isinstance(measurement, SensorCloud):
                # with points in the sensor's frame, only the pose changes
                cloud = measurement.in_own_frame()
                corrected_pose = cloud.world_SE3_sensor @ correction
                measurements.append(replace(cloud, world_SE3_sensor=corrected_pose))
            else:  # an image, whose pixels are relative to the sensor
                measurements.append(measurement)
        return replace(frame, sensors=tuple(sensors), measurements=tuple(measurements))


def write_corrected(recording: Recording, found_poses: Sequence[FoundPose], out: Path) -> None:
    """Write a recording with its sensors at their found poses.

    out: path of the result. A recording of images becomes a copy of its file, with a note of how
    the poses were found; one of clouds becomes a folder."""
    if isinstance(recording, CoopDataset):
        note = {found_pose.sensor.name: found_pose.as_dict() for found_pose in found_poses}
        poses = {found_pose.sensor.name: found_pose.pose for found_pose in found_poses}
        copy_corrected(recording, poses, out, note=note)
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

    The extrinsics, the sensors of the site in the file and its plan change, nothing else. note:
    kept as JSON in the attribute `calibration` of the file. Raises ValueError for an unknown sensor
    and for a pose that is not rigid."""
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
            _move_cameras(file, recording, poses)
            if "coview/site" in file:
                _move_site_sensors(file, recording.site, poses)
            _note_plan(file, poses)
            if note is not None:
                file.attrs["calibration"] = json.dumps(note)


def _move_cameras(file: h5py.File, recording: CoopDataset, poses: Mapping[str, Pose]) -> None:
    """Replace the poses that are stored with the images of sensors, by writing into `file`.

    poses: site_SE3_sensor by name of the sensor; other sensors stay."""
    cameras = list_cameras(file)
    for channel in recording.channels:
        if channel.sensor.name not in poses:
            continue
        # depth images of all cameras share a dataset; their poses are in a group for each camera
        node_name = channel.name
        if channel.depth_index is not None:
            node_name = f"cameras/{cameras[channel.depth_index]}"
        node = file[node_name]
        pose = np.asarray(poses[channel.sensor.name], np.float64)
        if isinstance(node, h5py.Group):
            node["extrinsic"][...] = published.extrinsic(pose, recording.site.map_SE3_site)
        if "site_SE3_sensor" in node.attrs:
            node.attrs["site_SE3_sensor"] = pose


def _move_site_sensors(file: h5py.File, site: Site, poses: Mapping[str, Pose]) -> None:
    """Replace the poses of sensors in the site that is stored in `file`.

    poses: site_SE3_sensor by name of the sensor; other sensors stay."""
    sensors = []
    for sensor in site.sensors:
        pose = poses.get(sensor.name, sensor.pose)
        sensors.append(Sensor(sensor.name, sensor.model, pose))
    del file["coview/site"]
    text = format_site(replace(site, sensors=tuple(sensors)))
    file.create_dataset("coview/site", data=text, track_times=False)


def _note_plan(file: h5py.File, poses: Mapping[str, Pose]) -> None:
    """Add the poses, rounded, to the plan of a simulation, which identifies its recording.

    A file without a plan stays as it is. poses: site_SE3_sensor by name of the sensor."""
    group = file.get("coview")
    if group is None or "plan" not in group.attrs:
        return
    rounded_poses = {}
    for name in sorted(poses):
        # the last row of a pose is always 0, 0, 0, 1
        rounded_poses[name] = np.asarray(poses[name])[:3].ravel().round(6).tolist()
    plan = parse_json(str(group.attrs["plan"]))
    group.attrs["plan"] = json.dumps({**plan, "calibrated": rounded_poses})
