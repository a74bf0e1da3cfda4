"""Poses of a recording's sensors, by their empty scenes: against a reference, or against each
other.

Joint alignment of sensors by the parts of a standing scene that several of them see, without a
reference.

The pairs of all pairs of sensors make one linear system with six numbers per sensor (see
`toolkit.calibration.registration`): a point of one sensor lies on the plane that another measured
there. The common pose of all sensors is not observed, so steps are the smallest possible ones.
Motions of a sensor that shares too little with the others are not observed either; objects that
both see at the same time can determine them (`object_pairs`). The usual errors of mounting,
`USUAL_TURN` and `USUAL_MOVE`, are weighed against what few pairs say."""

import json
import shutil
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from itertools import combinations
from pathlib import Path

import h5py
import numpy as np

from toolkit.arrays import Bool, BoxRows, Float64, Int64, Points, Pose
from toolkit.calibration import registration as reference_fit
from toolkit.calibration.empty_scene import (
    GRID_SAMPLES,
    SAMPLE,
    STANDS_STILL,
    learn_empty_scenes,
    learn_sample_scenes,
)
from toolkit.calibration.registration import (
    LEVER,
    Registration,
    Surface,
    motion_between,
    resistance,
    scene_points,
)
from toolkit.datasets import published_layout as published
from toolkit.datasets.dataset import CoopDataset, list_cameras
from toolkit.datasets.doctor import Finding
from toolkit.datasets.recordings import write_recording
from toolkit.frame import Frame, Frames, Recording, RecordingView, SensorCloud, select_sensors
from toolkit.geometry import check_pose, invert, transform
from toolkit.objects import Detector
from toolkit.points import detect_on_ground, frame_points
from toolkit.runtime.files import parse_json, replace_infinite, write_text, writing
from toolkit.runtime.hdf5 import hdf5_file
from toolkit.sensors.models import RowLidar
from toolkit.sensors.sensor import Sensor
from toolkit.sites.files import format_site
from toolkit.sites.site import Site

LEAST_FRAMES = 5  # of an empty scene that sensors are registered by
LEAST_OVERLAP = 0.3  # fraction of a sensor's points that must have a counterpart
# a pose farther off than this has drifted
WORTH_TURN = float(np.deg2rad(0.1))
WORTH_MOVE = 0.02
_SURE = 3.0  # standard deviations


@dataclass(frozen=True, eq=False)
class FoundPose:
    """A sensor's believed mounting and its registration."""

    sensor: Sensor
    registration: Registration | None  # None if no pose was found
    refusal: str = ""  # the reason then

    @property
    def pose(self) -> Pose:
        """Pose that was found, else the believed one."""
        return self.sensor.pose if self.registration is None else self.registration.pose

    @property
    def turn(self) -> float:
        """Angle (rad) between the believed pose and this one."""
        return float(np.linalg.norm(motion_between(self.sensor.pose, self.pose)[:3])) / LEVER

    @property
    def distance(self) -> float:
        """Distance (m) between the believed position and this one."""
        return float(np.linalg.norm(self.pose[:3, 3] - self.sensor.pose[:3, 3]))

    @property
    def deviation(self) -> tuple[float, float]:
        """Standard deviations of turn (rad) and distance (m)."""
        if self.registration is None:
            return np.inf, np.inf
        turn, move = np.split(np.sqrt(np.diag(self.registration.covariance)), 2)
        return float(np.linalg.norm(turn)), float(np.linalg.norm(move))

    @property
    def drifted(self) -> bool:
        """True if the pose is off by more than 0.1° or 2 cm, and by more than three standard
        deviations."""
        turn, move = self.deviation
        return self.turn > max(WORTH_TURN, _SURE * turn) or self.distance > max(
            WORTH_MOVE, _SURE * move
        )

    def __str__(self) -> str:
        if self.registration is None:
            return f"{self.sensor.name}: not found: {self.refusal}"
        turn, move = self.deviation
        unseen = "; ".join(map(describe_motion, self.registration.unobserved))
        turned = f"turned by {np.rad2deg(self.turn):.2f}° (± {np.rad2deg(turn):.2f}°)"
        moved = f"moved by {self.distance * 100:.1f} cm (± {move * 100:.1f} cm)"
        return (
            f"{self.sensor.name}: {turned}, "
            f"{moved}{unseen and f'; not observed, so left as believed: {unseen}'}"
        )

    def described(self) -> dict[str, object]:
        """Return figures for files (degrees, metres, world axes); deviations are infinite where not
        observed."""
        poses: dict[str, object] = {"world_SE3_sensor": self.pose.tolist()}
        poses["believed_world_SE3_sensor"] = self.sensor.pose.tolist()
        if self.registration is None:
            return {**poses, "found": False, "why": self.refusal}
        turn, move = np.split(self.registration.deviations, 2)
        figures = poses | {
            "found": True,
            "turned_deg": float(np.rad2deg(self.turn)),
            "moved_m": self.distance,
        }
        figures["drifted"] = self.drifted
        figures["standard_deviation"] = {
            "turn_deg": np.rad2deg(turn).tolist(),
            "move_m": move.tolist(),
        }
        figures["covariance_rad_m"] = self.registration.covariance.tolist()
        figures["unobserved"] = [describe_motion(motion) for motion in self.registration.unobserved]
        return figures | {
            "overlap": self.registration.overlap,
            "scatter_m": self.registration.scatter,
        }


def describe_motion(motion: Float64[np.ndarray, "6"]) -> str:
    """Describe a motion, turns times `LEVER`, in words."""
    motion = motion * (-1 if motion[np.argmax(np.abs(motion))] < 0 else 1)
    parts = [
        f"{name} {share:.2f}"
        for name, share in zip(reference_fit.NAMES, motion, strict=True)
        if abs(share) > 0.1
    ]
    return ", ".join(parts)


def save_poses(path: str | Path, found_poses: Sequence[FoundPose]) -> None:
    """Write `FoundPose.described` of each sensor as JSON by name, for
    `toolkit.datasets.cloud_files.read_poses`."""
    write_text(
        path,
        json.dumps(
            replace_infinite(
                {found_pose.sensor.name: found_pose.described() for found_pose in found_poses}
            ),
            indent=1,
        ),
    )


def find_poses(
    recording: Frames,
    surface: Surface | None = None,
    *,
    held: Sequence[int | str] = (),
    detector: Detector | None = None,
    frames: int | None = None,
    sample: int = SAMPLE,
    progress: Callable[[int], None] | None = None,
) -> tuple[FoundPose, ...]:
    """Find the pose of every sensor of a recording in the first frame.

    It is found from the sensor's empty scene over the first `frames` frames, which a lidar known by
    its clouds learns from their range images; if frames are fewer than five, or it moves, from its
    points in the first frame with any.

    surface: what stands there; None to fit the sensors to each other. Then held: numbers or names
    of sensors that stay at their believed poses (without any, all move as little as they can, and
    their common pose stays), and detector: of road users in the cloud of one sensor, which say what
    the scene leaves open. sample: images kept of each sensor. progress: called with the number of
    sensors done.

    Raises ValueError for too few frames of images, clouds without points, fewer than two sensors
    without a surface, and unknown sensors."""
    count = min(len(recording), len(recording) if frames is None else frames)
    more = None
    if len(recording) and not recording[0].has_images:
        sensors, seen = _seen_in_clouds(recording, count)
        stay = select_sensors(sensors, held)
    else:
        if count < LEAST_FRAMES:
            problem = f"{count} frames are too few to tell what stands still from who passes"
            raise ValueError(f"{problem}: give {LEAST_FRAMES} or more")
        sensors = recording[0].sensors
        if surface is None:
            _check_several(sensors)
        seen = [
            scene_points(scene) for scene in learn_empty_scenes(recording, sample, frames=count)
        ]
        stay = select_sensors(sensors, held)
        if detector is not None:
            numbers = np.unique(
                np.linspace(0, count - 1, min(OBJECT_FRAMES, count)).astype(int)
            ).tolist()
            site = getattr(recording, "site", None)
            if site is None:
                raise ValueError("a detector is for a recording of a known site: leave it out")
            more = partial(
                object_pairs, seen_objects([recording[k] for k in numbers], detector, site)
            )
    if surface is None:
        return align_clouds([points for points, _ in seen], sensors, held=stay, more=more)
    found_poses: list[FoundPose] = []
    for (points, deviation), sensor in zip(seen, sensors, strict=True):
        found_poses.append(find_pose(points, sensor, surface, deviation=deviation))
        if progress is not None:
            progress(len(found_poses))
    return tuple(found_poses)


def _check_several(sensors: Sequence[Sensor]) -> None:
    """Refuse to fit a single sensor to others."""
    if len(sensors) < 2:
        names = ", ".join(sensor.name for sensor in sensors) or "none"
        raise ValueError(
            f"sensors are fitted to each other, for which two or more are needed, got {names}: "
            "give a reference"
        )


def find_pose(
    points: Points,
    sensor: Sensor,
    surface: Surface,
    *,
    deviation: Float64[np.ndarray, " n"] | None = None,
) -> FoundPose:
    """Find the pose of one sensor, near the believed one, from points in its own frame and their
    deviations (m)."""
    try:
        registration = reference_fit.register(points, surface, sensor.pose, deviation=deviation)
    except ValueError as error:
        return FoundPose(sensor, None, str(error))
    if registration.overlap >= LEAST_OVERLAP:
        return FoundPose(sensor, registration)
    few = f"only {registration.overlap:.0%} of its points have a counterpart in the reference"
    remedy = "is it of the same place, and does it show what this sensor sees?"
    return FoundPose(sensor, None, f"{few}, {LEAST_OVERLAP:.0%} are needed: {remedy}")


TOGETHER = "together"  # in place of a reference: sensors are fitted to each other
LEAST_SHARED = 50  # rows that a sensor must share with the others
OBJECT_FRAMES = 40  # searched for road users


def align_clouds(
    clouds: list[np.ndarray],
    sensors: Sequence[Sensor],
    *,
    held: Sequence[int] = (),
    more: "MorePairs | None" = None,
) -> tuple[FoundPose, ...]:
    """Fit the poses of sensors to each other by clouds of the same standing scene, each in its
    sensor's frame. held: numbers of sensors that stay; more: see
    `toolkit.calibration.poses.align`. Raises ValueError for fewer than two sensors."""
    _check_several(sensors)
    surfaces = [face_sensor(reference_fit.cloud_surface(points)) for points in clouds]
    alignment = align(surfaces, [sensor.pose for sensor in sensors], held=held, more=more)
    found_poses = []
    for k, sensor in enumerate(sensors):
        shared = int(alignment.shared[k].sum())
        if shared < LEAST_SHARED and k not in held:
            problem = (
                f"it shares {shared} points with the other sensors, {LEAST_SHARED} are needed: "
                "give a reference"
            )
            found_poses.append(FoundPose(sensor, None, problem))
            continue
        of_sensor = slice(6 * k, 6 * k + 6)
        covariance = np.ascontiguousarray(alignment.covariance[of_sensor, of_sensor])
        overlap = min(1.0, shared / max(1, int(alignment.shared.max())))
        figures = covariance, alignment.hidden_motions(k), overlap, float(alignment.scatter[k])
        found_poses.append(FoundPose(sensor, Registration(alignment.poses[k], *figures)))
    return tuple(found_poses)


@dataclass(frozen=True, eq=False)
class Corrected(RecordingView):
    """Recording with its sensors at their found poses."""

    # believed_SE3_found by name: each believed pose is multiplied by it
    corrections: Mapping[str, Pose]

    @staticmethod
    def of(recording: Recording, found_poses: Iterable[FoundPose]) -> "Corrected":
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


_Seen = tuple[Points, Float64[np.ndarray, " n"] | None]  # points and their deviations (m)


def _seen_in_clouds(recording: Frames, count: int) -> tuple[tuple[Sensor, ...], list[_Seen]]:
    """Sensors of clouds, and their points of the standing scene, each in its own frame."""
    first = [recording[k] for k in range(min(count, GRID_SAMPLES))]
    places = dict[str, np.ndarray]()
    moves = False
    for frame in first:
        for cloud in frame.clouds:
            position = (frame.map_SE3_world @ cloud.world_SE3_sensor)[:3, 3]
            moves |= bool(
                np.linalg.norm(position - places.setdefault(cloud.name, position)) > STANDS_STILL
            )
    if len(first) >= LEAST_FRAMES and not moves:
        learnt = learn_sample_scenes(recording[k] for k in range(count))
        points = {name: scene_points(first_frame.scene)[0] for name, first_frame in learnt.items()}
    else:
        points = dict[str, np.ndarray]()
        for frame in first:
            points = {cloud.name: cloud.in_sensor() for cloud in frame.clouds if len(cloud.points)}
            if points:
                break
        if not points:
            raise ValueError("no frame has a point to find a pose by")
    placed = {
        cloud.name: cloud.world_SE3_sensor for frame in reversed(first) for cloud in frame.clouds
    }
    return tuple(Sensor(name, RowLidar(), placed[name]) for name in points), [
        (sensor_points, None) for sensor_points in points.values()
    ]


def check_drift(path: str | Path, reference: str | Path, site: Site | None = None) -> list[Finding]:
    """Warn of each sensor that disagrees with the reference (see `read_surface`), or of a recording
    without poses. Raises ValueError and OSError if the reference cannot be read."""
    surface = reference_fit.read_surface(reference)
    try:
        with CoopDataset(path, site) as recording:
            return drift_findings(find_poses(recording, surface), str(reference))
    except (ValueError, OSError) as error:
        return [
            Finding(
                "warning",
                str(path),
                "its sensors' poses cannot be checked",
                str(error),
                "check them by hand",
            )
        ]


def drift_findings(found_poses: Sequence[FoundPose], reference: str) -> list[Finding]:
    """Warn of sensors that clearly drifted or have no pose."""
    findings = []
    for found_pose in found_poses:
        subject, (turn, move) = f"sensor {found_pose.sensor.name}", found_pose.deviation
        if found_pose.registration is None:
            suspected = f"its pose cannot be checked against {reference}"
            findings.append(
                Finding("warning", subject, suspected, found_pose.refusal, "check by hand")
            )
        elif found_pose.drifted:
            off = (
                f"turned by {np.rad2deg(found_pose.turn):.2f}° and moved by "
                f"{found_pose.distance * 100:.1f} cm"
            )
            within = f"to within {np.rad2deg(turn):.2f}° and {move * 100:.1f} cm"
            evidence = f"{off} against {reference}, {within}"
            suspicion = (
                "it hangs crooked or has drifted",
                evidence,
                "write its pose by coview calibrate",
            )
            findings.append(Finding("warning", subject, *suspicion))
    return findings


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
        write_recording(Corrected.of(recording, found_poses), out, "folder")


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


# Each level: radius (m) of the search for counterparts, voxel (m), least limit (m) of Tukey's
# weights.
_LEVELS = ((1.5, 0.8, 0.75), (0.7, 0.5, 0.35), (0.35, 0.4, 0.15), (0.2, 0.4, 0.08))
_STEPS = 15  # limit for each level
_SAME_SIDE = 0.7  # cosine of the angle between the normals of a pair: a hedge has two sides
_RESISTS = 0.1  # fraction of a motion across the plane: less is the noise of normals
_LEAST_POINTS = 5.0  # that must resist a motion for it to be observed
# standard deviations of the believed poses, per axis
USUAL_TURN = float(np.deg2rad(1.5))
USUAL_MOVE = 0.15

Poses = Sequence[Pose]


@dataclass(frozen=True, eq=False)
class Pairs:
    """Rows of the linear system, each pulling sensors `one` and `other` together along a
    direction."""

    one: int
    other: int
    one_row: Float64[np.ndarray, "n 6"]  # growth of the residual with the motion of each sensor
    other_row: Float64[np.ndarray, "n 6"]
    residual: Float64[np.ndarray, " n"]  # m, or rad
    deviation: Float64[np.ndarray, " n"]  # its standard deviation, larger where rows err alike
    limit: Float64[np.ndarray, " n"]  # residual beyond which a row does not count

    @property
    def system_rows(self) -> tuple[Float64[np.ndarray, "n 12"], Int64[np.ndarray, "12"]]:
        """Rows of both sensors, and their columns in the system."""
        where = np.concatenate([6 * self.one + np.arange(6), 6 * self.other + np.arange(6)])
        return np.concatenate([self.one_row, self.other_row], axis=1), where

    @cached_property
    def weight(self) -> Float64[np.ndarray, " n"]:
        """Tukey's weight over the variance."""
        return reference_fit.tukey_weight(self.residual / self.limit, 1.0) / self.deviation**2


# further pairs for poses and a search radius (m)
MorePairs = Callable[[Poses, float], Sequence[Pairs]]


@dataclass(frozen=True, eq=False)
class Alignment:
    """Poses that fit each other.

    covariance: of the motions of all sensors, six numbers each (rad and m), that of the usual
    errors where nothing is observed; unobserved: unit motions of all sensors, turns times `LEVER`,
    other than the common ones; shared: number of rows that each two sensors share; scatter: robust
    standard deviation (m) of each sensor's rows."""

    poses: tuple[Pose, ...]
    covariance: Float64[np.ndarray, "m m"]
    unobserved: Float64[np.ndarray, "k m"]
    shared: Int64[np.ndarray, "n n"]
    scatter: Float64[np.ndarray, " n"]

    def hidden_motions(self, sensor: int) -> Float64[np.ndarray, "_ 6"]:
        """Unit motions of one sensor that nothing determines."""
        of_sensor = self.unobserved[:, 6 * sensor : 6 * sensor + 6]
        _, size, motions = np.linalg.svd(of_sensor, full_matrices=False)
        return motions[size > 0.3]


def align(
    surfaces: Sequence[Surface],
    believed: Poses,
    *,
    held: Sequence[int] = (),
    more: MorePairs | None = None,
) -> Alignment:
    """Fit sensor poses, near the believed ones, to each other by their surfaces.

    surfaces: each sensor's empty scene in its own frame, normals towards the sensor; held: numbers
    of sensors that stay; more: returns further pairs for poses and a search radius. Raises
    ValueError for fewer than two sensors, and for an unknown held one."""
    count = len(surfaces)
    if count != len(believed) or count < 2:
        got = f"got {count} surfaces and {len(believed)} poses"
        raise ValueError(
            f"alignment needs two or more sensors, each with a surface and a pose: {got}"
        )
    if any(not 0 <= sensor < count for sensor in held):
        raise ValueError(f"held must be sensor numbers from 0 to {count - 1}, got {list(held)}")
    free = np.repeat([sensor not in held for sensor in range(count)], 6)
    poses = [np.array(pose, np.float64) for pose in believed]
    for radius, voxel, min_limit in _LEVELS:
        thinned = [reference_fit.thin_rows(surface.points, voxel) for surface in surfaces]
        for _ in range(_STEPS):
            pairs = _surface_pairs(surfaces, thinned, poses, (radius, min_limit))
            pairs += list(more(poses, radius)) if more is not None else []
            motions_off = [
                motion_between(*pose_pair) for pose_pair in zip(believed, poses, strict=True)
            ]
            system = _Joint(pairs, free, np.concatenate(motions_off))
            step = system.step()
            poses = list(map(reference_fit.apply_motion, poses, step.reshape(-1, 6)))
            if np.abs(step).max() < reference_fit.CONVERGED * radius:
                break
    middle = np.mean([pose[:3, 3] for pose in poses], axis=0)
    motions = np.zeros((6, count, 6))  # of all sensors together, as if they hung on one frame
    for axis, direction in enumerate(np.eye(3)):
        for sensor, pose in enumerate(poses):
            motions[axis, sensor] = [
                *(direction * LEVER),
                *np.cross(direction, pose[:3, 3] - middle),
            ]
            motions[3 + axis, sensor, 3:] = direction
    hidden = system.hidden_motions(np.linalg.qr(motions.reshape(6, -1).T)[0].T)
    shared = np.zeros((count, count), np.int64)
    rows = [[np.empty(0)] for _ in poses]
    for pair in pairs:
        counts = pair.weight > 0
        shared[pair.one, pair.other] += int(counts.sum())
        for sensor in (pair.one, pair.other):
            rows[sensor].append(np.abs(pair.residual[counts]))
    residuals_of = [np.concatenate(residuals) for residuals in rows]
    scatter = np.array(
        [
            1.4826 * float(np.median(residuals)) if len(residuals) else 0.0
            for residuals in residuals_of
        ]
    )
    return Alignment(tuple(poses), system.covariance(), hidden, shared + shared.T, scatter)


def face_sensor(surface: Surface) -> Surface:
    """Turn a surface's normals towards its sensor, the origin."""
    away = (surface.points * surface.normals).sum(axis=1) > 0
    return Surface(
        surface.points,
        np.where(away[:, None], -surface.normals, surface.normals),
        surface.roughness,
    )


@dataclass(frozen=True, eq=False)
class _Joint:
    """Linear system of one step."""

    pairs: Sequence[Pairs]
    free: Bool[np.ndarray, " m"]  # which of the 6 n numbers may change
    off: Float64[np.ndarray, " m"]  # difference of each from its believed value

    @cached_property
    def _modes(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Eigenvalues and eigenvectors (columns), and mask of observed ones."""
        information = np.zeros((len(self.free), len(self.free)))
        for pair in self.pairs:
            rows, where = pair.system_rows
            information[np.ix_(where, where)] += rows.T @ (rows * pair.weight[:, None])
        information[~self.free] = 0.0
        information[:, ~self.free] = 0.0
        values, vectors = np.linalg.eigh(information)
        largest = np.linalg.norm(vectors.reshape(-1, 6, len(values)), axis=1).max(axis=0)
        resists = np.zeros(len(values))
        for pair in self.pairs:
            rows, where = pair.system_rows
            along = (rows[pair.weight > 0] @ (vectors[where] / largest)) ** 2
            resists += np.where(along > _RESISTS**2, along, 0.0).sum(axis=0)
        return values, vectors, (resists > _LEAST_POINTS) & (values > 0)

    @cached_property
    def _posterior(self) -> Float64[np.ndarray, "m m"]:
        """Information of the observed motions and of the usual errors."""
        values, vectors, observed = self._modes
        return (vectors * np.where(observed, values, 0.0)) @ vectors.T + np.diag(self._usual)

    @property
    def _usual(self) -> Float64[np.ndarray, " m"]:
        return np.tile(
            np.repeat([(LEVER * USUAL_TURN) ** -2, USUAL_MOVE**-2], 3), len(self.free) // 6
        )

    def step(self) -> Float64[np.ndarray, " m"]:
        """Motion of all sensors that brings the pairs together, and moves back what they do not
        determine."""
        _, vectors, observed = self._modes
        gradient = np.zeros(len(self.free))
        for pair in self.pairs:
            rows, where = pair.system_rows
            gradient[where] += rows.T @ (pair.weight * pair.residual)
        determined = vectors @ np.where(
            observed, vectors.T @ np.where(self.free, gradient, 0.0), 0.0
        )
        motion = np.zeros(len(self.free))
        free = np.ix_(self.free, self.free)
        motion[self.free] = -np.linalg.solve(
            self._posterior[free], (determined + self._usual * self.off)[self.free]
        )
        return motion

    def covariance(self) -> Float64[np.ndarray, "m m"]:
        """Covariance in rad and m, zero for held sensors."""
        covariance = np.zeros((len(self.free),) * 2)
        free = np.ix_(self.free, self.free)
        covariance[free] = np.linalg.inv(self._posterior[free])
        unit = np.tile(np.repeat([1 / LEVER, 1.0], 3), len(self.free) // 6)
        return unit[:, None] * covariance * unit

    def hidden_motions(self, common: Float64[np.ndarray, "6 m"]) -> Float64[np.ndarray, "k m"]:
        """Orthonormal motions that hardly any pair resists, without the common ones if no sensor is
        held."""
        _, vectors, observed = self._modes
        hidden = np.where(self.free[:, None], vectors[:, ~observed], 0.0).T
        if self.free.all():
            hidden = hidden - hidden @ common.T @ common
        _, size, motions = np.linalg.svd(hidden, full_matrices=False)
        return motions[size > 0.5]


def _surface_pairs(
    surfaces: Sequence[Surface],
    thinned: Sequence[np.ndarray],
    poses: Poses,
    limits: tuple[float, float],
) -> list[Pairs]:
    """Pair each thinned point with other sensors' nearest points, if they face the same way."""
    (radius, min_limit), pairs = limits, []
    for one, (surface, rows) in enumerate(zip(surfaces, thinned, strict=True)):
        world = transform(poses[one], surface.points[rows])
        facing = surface.normals[rows] @ poses[one][:3, :3].T
        for other, seen in enumerate(surfaces):
            if other == one:
                continue
            distance, row = seen.tree.query(
                transform(invert(poses[other]), world), distance_upper_bound=radius
            )
            near = np.flatnonzero(np.isfinite(distance))
            normals = seen.normals[row[near]] @ poses[other][:3, :3].T
            alike = (facing[near] * normals).sum(axis=1) > _SAME_SIDE
            near = near[alike]
            normals = normals[alike]
            counterparts = transform(poses[other], seen.points[row[near]])
            rough = np.hypot(surface.roughness[rows[near]], seen.roughness[row[near]])
            residual = ((world[near] - counterparts) * normals).sum(axis=1)
            deviation = np.hypot(rough, reference_fit.LEAST_SCALE)
            mine, theirs = (
                resistance(world[near], poses[sensor][:3, 3], normals) for sensor in (one, other)
            )
            spread = deviation * np.sqrt(reference_fit.CORRELATED)
            limit = np.maximum(reference_fit.TUKEY * deviation, min_limit)
            pairs.append(Pairs(one, other, mine, -theirs, residual, spread, limit))
    return pairs


PAIR_GATE = 1.5  # m: greatest distance between the centres that two sensors give one road user
_LEAST_GATE = 0.8  # m
_CENTRE = 0.25  # m, standard deviation of a centre along each axis
_HEADING = float(np.deg2rad(4.0))  # standard deviation of a heading
# greatest difference of the headings of one road user, up to a half turn
_WORST_HEADING = float(np.deg2rad(20.0))
_NO_MATCH = (np.empty((0, 3)), np.empty((0, 3)), np.empty(0))


@dataclass(frozen=True, eq=False)
class SeenBoxes:
    """Objects of one sensor and frame, in its axes."""

    centres: Float64[np.ndarray, "n 3"]
    ahead: Float64[np.ndarray, "n 3"]

    @classmethod
    def of(cls, boxes: BoxRows, believed: Pose) -> "SeenBoxes":
        """Return boxes of the world in the sensor's axes."""
        ahead = np.column_stack([np.cos(boxes[:, 6]), np.sin(boxes[:, 6]), np.zeros(len(boxes))])
        return cls(transform(invert(believed), boxes[:, :3]), ahead @ believed[:3, :3])


def seen_objects(frames: Sequence[Frame], detector: Detector, site: Site) -> list[list[SeenBoxes]]:
    """Detect objects in each sensor's cloud alone, per frame."""
    seen: list[list[SeenBoxes]] = []
    for frame in frames:
        clouds = zip(frame_points(frame, area=site), frame.sensors, strict=True)
        per_sensor = (
            (detect_on_ground(detector, cloud, site).boxes, sensor.pose) for cloud, sensor in clouds
        )
        seen.append([SeenBoxes.of(*detected) for detected in per_sensor])
    return seen


def object_pairs(seen: Sequence[Sequence[SeenBoxes]], poses: Poses, radius: float) -> list[Pairs]:
    """Rows of all road users that two sensors at `poses` see: three for the centre, one for the
    heading."""
    gate = float(np.clip(radius, _LEAST_GATE, PAIR_GATE))
    pairs = []
    for first, second in combinations(range(len(poses)), 2):
        matches = [
            _match_boxes(frame[first], frame[second], poses[first], poses[second], gate)
            for frame in seen
        ]
        first_centres, second_centres, turn = (
            np.concatenate(parts) for parts in zip(_NO_MATCH, *matches, strict=True)
        )
        if count := len(first_centres):
            axes = np.repeat(np.eye(3), count, axis=0)
            about_z = np.tile([0.0, 0.0, 1 / LEVER, 0.0, 0.0, 0.0], (count, 1))
            places = (
                (np.tile(first_centres, (3, 1)), poses[first][:3, 3]),
                (np.tile(second_centres, (3, 1)), poses[second][:3, 3]),
            )
            mine, theirs = (
                np.concatenate([resistance(*position, axes), about_z]) for position in places
            )
            residual = np.concatenate([(first_centres - second_centres).T.ravel(), turn])
            deviation = np.repeat([np.sqrt(2) * _CENTRE, np.sqrt(2) * _HEADING], [3 * count, count])
            limit = np.repeat([gate, _WORST_HEADING], [3 * count, count])
            pairs.append(Pairs(first, second, mine, -theirs, residual, deviation, limit))
    return pairs


def _match_boxes(
    mine: SeenBoxes, theirs: SeenBoxes, pose: Pose, other_pose: Pose, gate: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Centres matched by two sensors, and the first one's headings less the other's (rad)."""
    first_centres = transform(pose, mine.centres)
    second_centres = transform(other_pose, theirs.centres)
    if not (len(first_centres) and len(second_centres)):
        return _NO_MATCH
    distance = np.hypot(
        *(first_centres[:, None, :2] - second_centres[None, :, :2]).transpose(2, 0, 1)
    )
    nearest = distance.argmin(axis=1)
    row = np.arange(len(first_centres))
    mutual = (distance[:, nearest].argmin(axis=0) == row) & (distance[row, nearest] < gate)
    headings_ahead = (
        boxes.ahead @ at[:3, :3].T for boxes, at in ((mine, pose), (theirs, other_pose))
    )
    heading, other_heading = (np.arctan2(ahead[:, 1], ahead[:, 0]) for ahead in headings_ahead)
    turn = (heading - other_heading[nearest] + np.pi / 2) % np.pi - np.pi / 2
    matched = mutual & (np.abs(turn) < _WORST_HEADING)
    return first_centres[matched], second_centres[nearest[matched]], turn[matched]
