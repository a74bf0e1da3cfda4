"""Faults of a street's sensors: dead, fewer returns, shorter range, more noise, turned or moved."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace

import numpy as np

from placement_env.acceptance.sensor_figures import (
    MAX_RANGE_FRAMES,
    SensorFigures,
    find_distances,
    measure_figures,
    promise_figures,
    render_scenes,
)
from placement_env.analysis.intervals import Interval, ratio_interval
from toolkit.arrays import Float64
from toolkit.calibration.empty_scene import EmptyScene, learn_empty_scenes
from toolkit.calibration.found_pose import FoundPose, describe_motion
from toolkit.calibration.poses import MIN_FRAMES, find_poses
from toolkit.calibration.recording_scenes import learn_sample_scenes
from toolkit.calibration.reference_surface import Surface
from toolkit.frame import Frames
from toolkit.sites.site import Site

MIN_RETURN_SHARE = 0.85  # least number of returns, as a share of the promised one
MIN_RANGE_SHARE = 0.85  # least range, as a share of the promised one
MAX_NOISE_RATIO = 1.5  # measured noise by the catalogue's
MIN_WORKING_SHARE = 0.95  # share of the frames in which a sensor must return something
DEAD_SHARE = 0.05  # share of the promised returns; with fewer in a frame, a sensor is dead in it
MAX_POSE_TURN_DEG = 0.3  # by which a pose may differ
MAX_POSE_MOVE_M = 0.05
MIN_POSE_SIGMAS = 3.0  # least difference in its standard deviations


@dataclass(frozen=True)
class PoseError:
    """Difference of a sensor's pose from what it should be.

    Attributes:
        turn_deg: angle between both.
        move_m: distance between both.
        turn_deviation_deg: standard deviation of the angle, infinite if it is not observed.
        move_deviation_m: standard deviation of the distance."""

    turn_deg: float
    move_m: float
    turn_deviation_deg: float
    move_deviation_m: float

    @property
    def is_clear(self) -> bool:
        """True if the difference is above its tolerance and above chance."""
        has_turned = self.turn_deg > max(
            MAX_POSE_TURN_DEG, MIN_POSE_SIGMAS * self.turn_deviation_deg
        )
        has_moved = self.move_m > max(MAX_POSE_MOVE_M, MIN_POSE_SIGMAS * self.move_deviation_m)
        return has_turned or has_moved


@dataclass(frozen=True)
class SensorCheck:
    """Planned sensor, with its figures in the street.

    Attributes:
        name: name of the sensor.
        promised: figures by the plan.
        measured: figures by the recording, None if the recording lacks the sensor.
        working_share: share of the frames in which it returns something.
        returns_low: lower end of the interval of measured by promised returns, NaN if unknown.
        returns_high: upper end.
        pose_error: difference of the found pose from the pose that the recording states, None if
            no pose was found.
        mount_error: difference of the found pose from the planned one, None likewise.
        pose_note: why no pose was found, or which motions are not observed; else empty."""

    name: str
    promised: SensorFigures
    measured: SensorFigures | None
    working_share: float = 0.0
    returns_low: float = float("nan")
    returns_high: float = float("nan")
    pose_error: PoseError | None = None
    mount_error: PoseError | None = None
    pose_note: str = ""

    @property
    def returns_share(self) -> float:
        """Measured returns by promised ones; 1 if none is promised, 0 without the sensor."""
        if self.measured is None:
            return 0.0
        return self.measured.returns / self.promised.returns if self.promised.returns else 1.0

    @property
    def is_dead(self) -> bool:
        """True if the sensor is missing, or never returns anything."""
        return self.measured is None or self.working_share == 0

    def faults(self) -> tuple[str, ...]:
        """Return the faults of the sensor, each a sentence without its subject, the sensor.

        A sensor that is off its stated pose is not compared with its planned one."""
        if self.measured is None:
            return ("is not in the recording",)
        if self.is_dead:
            return ("returns nothing in any frame",)
        sentences = []
        if self.working_share < MIN_WORKING_SHARE:
            sentences.append(f"returns something in only {self.working_share:.0%} of the frames")
        if self.returns_share < MIN_RETURN_SHARE:
            sentences.append(f"returns {self.returns_share:.0%} of what the plan promises")
        if self.measured.range_m < MIN_RANGE_SHARE * self.promised.range_m:
            sentences.append(
                f"sees {self.measured.range_m:.0f} m far instead of {self.promised.range_m:.0f} m"
            )
        if self.measured.noise_m > MAX_NOISE_RATIO * self.promised.noise_m:
            sentences.append(
                f"has noise of {100 * self.measured.noise_m:.1f} cm instead of "
                f"{100 * self.promised.noise_m:.1f} cm"
            )
        if self.pose_error is not None and self.pose_error.is_clear:
            sentences.append(f"is {_describe_error(self.pose_error)} off its stated pose")
        elif self.mount_error is not None and self.mount_error.is_clear:
            sentences.append(f"is {_describe_error(self.mount_error)} off its planned pose")
        return tuple(sentences)

    def as_dict(self) -> dict[str, object]:
        """Return all figures and faults as plain values for JSON."""
        share = {"returns_share": self.returns_share}
        return {**asdict(self), **share, "faults": list(self.faults())}


def check_sensors(
    recording: Frames, site: Site, surface: Surface, frames: int
) -> tuple[SensorCheck, ...]:
    """Check every planned sensor in the first frames of a recording.

    Args:
        recording: Frames of the street, whose sensors have the plan's names.
        site: Planned site with its sensors.
        surface: Standing surfaces of the place, by which poses are found.
        frames: Number of frames to use, at least `MIN_FRAMES`.

    Raises ValueError for too few frames."""
    if frames < MIN_FRAMES:
        raise ValueError(
            f"{frames} frames do not show what stands still: record {MIN_FRAMES} or more"
        )
    promised_scenes = render_scenes(site)
    returns = count_returns(recording, list(promised_scenes), frames)
    present = {sensor.name for sensor in recording[0].sensors}
    scenes = _learn_scenes(recording, frames)
    poses = {pose.sensor.name: pose for pose in find_poses(recording, surface, frames=frames)}
    indices = np.unique(np.linspace(0, frames - 1, min(MAX_RANGE_FRAMES, frames)).astype(int))
    samples = [recording[index] for index in indices.tolist()]
    checks = []
    for sensor in site.sensors:
        promised = promise_figures(promised_scenes[sensor.name])
        check = SensorCheck(sensor.name, promised, measured=None)
        if sensor.name in present:
            counts = returns[sensor.name]
            measured = measure_figures(samples, sensor.name, counts, scenes.get(sensor.name))
            interval = _interval_of_returns(counts, promised.returns)
            check = replace(
                check,
                measured=measured,
                working_share=float((counts > DEAD_SHARE * promised.returns).mean()),
                returns_low=interval.low,
                returns_high=interval.high,
            )
        found_pose = poses.get(sensor.name)
        if found_pose is not None and not check.is_dead:
            check = _add_pose(check, found_pose, replace(found_pose, sensor=sensor))
        checks.append(check)
    return tuple(checks)


def count_returns(
    recording: Frames, names: Sequence[str], frames: int
) -> dict[str, Float64[np.ndarray, " frames"]]:
    """Count the returns of each sensor in each of the first frames, 0 if it is missing.

    names: names of the sensors; frames: number of first frames."""
    counts = {name: np.zeros(frames) for name in names}
    for number in range(frames):
        frame = recording[number]
        for name in names:
            counts[name][number] = len(find_distances(frame, name))
    return counts


def _learn_scenes(recording: Frames, frames: int) -> dict[str, EmptyScene]:
    """Learn the empty scene of each sensor, by name; empty for clouds that make no image.

    frames: number of first frames to learn from."""
    if recording[0].has_images:
        return {scene.name: scene for scene in learn_empty_scenes(recording, frames=frames)}
    try:
        learnt = learn_sample_scenes(recording[number] for number in range(frames))
    except ValueError:
        return {}
    return {name: scene.scene for name, scene in learnt.items()}


def _interval_of_returns(counts: Float64[np.ndarray, " n"], promised: float) -> Interval:
    """Interval of measured by promised returns, over blocks of frames; NaN if none is promised.

    counts: returns of the sensor in each of n frames; promised: returns per frame by the plan."""
    if not promised:
        return Interval(float("nan"), float("nan"))
    return ratio_interval(counts, np.full(len(counts), promised))


def _add_pose(check: SensorCheck, stated: FoundPose, planned: FoundPose) -> SensorCheck:
    """Return a check with the differences of the found pose from the stated and planned ones.

    stated: found pose, with the sensor as the recording states it; planned: the same pose, with the
    sensor as planned. Without a found pose the check gets the reason."""
    if stated.registration is None:
        return replace(check, pose_note=stated.refusal)
    hidden = "; ".join(map(describe_motion, stated.registration.unobserved))
    return replace(
        check,
        pose_error=_measure_error(stated),
        mount_error=_measure_error(planned),
        pose_note=f"not observed: {hidden}" if hidden else "",
    )


def _measure_error(found_pose: FoundPose) -> PoseError:
    """Return the difference of a found pose from the pose of its sensor."""
    turn_deviation, move_deviation = found_pose.deviation
    return PoseError(
        turn_deg=float(np.rad2deg(found_pose.turn)),
        move_m=found_pose.distance,
        turn_deviation_deg=float(np.rad2deg(turn_deviation)),
        move_deviation_m=move_deviation,
    )


def _describe_error(error: PoseError) -> str:
    """Write angle and distance, such as "0.52° and 3 cm"."""
    return f"{error.turn_deg:.2f}° and {100 * error.move_m:.0f} cm"
