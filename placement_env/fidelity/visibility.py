"""`Visibility`: points of candidates on objects, and points sent.

Only scored objects count. Points on an object are noise-free: those that lie on it and in the crop.
`toolkit.boxes.count_points` counts the same in the cropped cloud, with two exceptions: ground that
relief lifts into the foot of a box, which is no part of the object, and points on the very faces of
the box, where rounding decides. Points sent are their expectation under noise, which lifts half of
the points on even ground above z = 0 and so into the crop."""

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from placement_env.fidelity.traffic import Traffic, scored
from toolkit.arrays import Bool, Float32, Float64, Int64
from toolkit.frozen import set_fields
from toolkit.objects import VEHICLE, Objects
from toolkit.points import count_on_ground, frame_points, is_beyond
from toolkit.runtime.array_files import read_arrays, write_arrays
from toolkit.sensors.sensor import Sensor

if TYPE_CHECKING:
    from toolkit.datasets.dataset import CoopDataset


@dataclass(frozen=True, eq=False)
class Visibility:
    """Points of candidates on the scored objects of some frames.

    Objects are scored if they have some classes and are centred in the site's area. They come frame
    after frame.

    Attributes:
        points: Noise-free points of each candidate on each object inside the crop.
        distance: Horizontal distance from sensor to centre of the object (m), seen or not.
        frame: Index of each object's frame, ascending.
        boxes: Box of each object (x, y, z, length, width, height, yaw; m, rad, world frame).
        sent: Expected points of each candidate in the crop of each frame.
        far: Sent points that are horizontally beyond the radius of hybrid fusion from the sensor.
        labels: Class (number) of each object; all are vehicles if not given."""

    points: Float32[np.ndarray, "candidates objects"]
    distance: Float32[np.ndarray, "candidates objects"]
    frame: Int64[np.ndarray, " objects"]
    boxes: Float64[np.ndarray, "objects 7"]
    sent: Float32[np.ndarray, "candidates frames"]
    far: Float32[np.ndarray, "candidates frames"]
    labels: Int64[np.ndarray, " objects"] = None  # type: ignore[assignment]  # None: all vehicles

    def __post_init__(self) -> None:
        if self.labels is None:
            set_fields(self, labels=np.full(len(self.boxes), VEHICLE))

    @property
    def frames(self) -> int:
        """Number of frames."""
        return self.sent.shape[1]

    @property
    def on_objects(self) -> Float32[np.ndarray, "candidates frames"]:
        """Points of each candidate on all scored objects of each frame together."""
        sums = np.zeros((self.frames, len(self.points)), np.float32)  # axes: frame, candidate
        np.add.at(sums, self.frame, self.points.T)
        return np.ascontiguousarray(sums.T)

    def __len__(self) -> int:
        return len(self.points)

    @staticmethod
    def unseen(traffic: Traffic, sensors: Sequence[Sensor], labels: Sequence[int]) -> "Visibility":
        """Visibility of sensors without a point: points, sent and far are 0, to be filled in.

        labels: Classes (numbers) of the scored objects."""
        objects = [
            snapshot.objects[scored(snapshot.objects, traffic.site, labels)]
            for snapshot in traffic.snapshots
        ]
        # two arrays, as the caller fills them separately
        sent, far = np.zeros((2, len(sensors), len(objects)), np.float32)
        return _join(
            sensors,
            objects,
            points=[np.zeros((len(sensors), len(frame_objects))) for frame_objects in objects],
            sent=sent,
            far=far,
        )

    def select(self, indices: Sequence[int] | Int64[np.ndarray, " n"]) -> "Visibility":
        """Visibility from some of the candidates (indices), in this order."""
        rows = np.asarray(indices, np.int64)
        per_candidate = ("points", "distance", "sent", "far")  # fields with a row per candidate
        return replace(self, **{name: getattr(self, name)[rows] for name in per_candidate})

    def of_classes(self, labels: Sequence[int]) -> "Visibility":
        """Visibility of the objects of some classes (numbers); points sent stay."""
        mask = np.isin(self.labels, labels)
        return self if mask.all() else self._with_objects(mask)

    def _with_objects(self, mask: Bool[np.ndarray, " objects"]) -> "Visibility":
        """Copy with only the objects of a mask; points sent stay."""
        per_pair = {name: getattr(self, name)[:, mask] for name in ("points", "distance")}
        per_object = {name: getattr(self, name)[mask] for name in ("frame", "boxes", "labels")}
        return replace(self, **per_pair, **per_object)

    def save(self, path: str | Path) -> None:
        """Write a file that `load` reads; it is replaced whole or not at all."""
        write_arrays(path, {field.name: getattr(self, field.name) for field in fields(self)})

    @staticmethod
    def load(path: str | Path) -> "Visibility":
        """Read a file that `save` wrote.

        Raises FileNotFoundError; ValueError for a damaged or foreign file."""
        arrays = read_arrays(path)
        names = {field.name for field in fields(Visibility)}
        # older files lack labels, as only vehicles counted
        if arrays.keys() not in (names, names - {"labels"}):
            raise ValueError(
                f"{path} must hold {', '.join(sorted(names))}, got {', '.join(sorted(arrays))}: "
                "see save"
            )
        return Visibility(**arrays)

    @staticmethod
    def from_recording(
        recording: "CoopDataset",
        frames: int | None = None,
        *,
        noise_seed: int | None = 0,
        labels: Sequence[int] = (VEHICLE,),
    ) -> "Visibility":
        """Visibility from a recording's sensors, counted in its clouds.

        Args:
            recording: The recording.
            frames: Number of frames from the first on, None for all.
            noise_seed: Seed of the noise with which points sent are counted, as
                `toolkit.detection.evaluation` adds it; None for no noise.
            labels: Classes (numbers) of the scored objects."""
        from toolkit.datasets.recording_views import with_errors

        site = recording.site
        count = min(len(recording), len(recording) if frames is None else frames)
        # by frame: scored objects, points on these, and each sensor's points sent and far ones
        objects = []
        points = []
        sent_counts = []
        far_counts = []
        for k in range(count):
            frame = recording[k]
            frame_objects = frame.objects[scored(frame.objects, site, labels)]
            objects.append(frame_objects)
            clouds = frame_points(frame, area=site)
            points.append(
                np.array([count_on_ground(cloud, frame_objects.boxes, site) for cloud in clouds])
            )
            noisy_frame = frame if noise_seed is None else with_errors(frame, "paper", noise_seed)
            sent_clouds = frame_points(noisy_frame, area=site)
            sent_counts.append([len(cloud) for cloud in sent_clouds])
            far_masks = (
                is_beyond(cloud, sensor, site.hybrid_radius)
                for cloud, sensor in zip(sent_clouds, recording.sensors, strict=True)
            )
            far_counts.append([mask.sum() for mask in far_masks])
        sent, far = (
            np.array(counts, np.float32).reshape(count, -1).T  # axes: sensor, frame
            for counts in (sent_counts, far_counts)
        )
        return _join(recording.sensors, objects, points, sent, far)


def of_frames(visibility: Visibility, frames: Int64[np.ndarray, " k"]) -> Visibility:
    """Visibility in some of the frames (indices, ascending), which are numbered from 0 then."""
    selected = visibility._with_objects(np.isin(visibility.frame, frames))
    return replace(
        selected,
        frame=np.searchsorted(frames, selected.frame),  # position of each frame in `frames`
        sent=visibility.sent[:, frames],
        far=visibility.far[:, frames],
    )


def _join(
    sensors: Sequence[Sensor],
    objects: list[Objects],
    points: list[np.ndarray],
    sent: np.ndarray,
    far: np.ndarray,
) -> Visibility:
    """Visibility from counts of single frames.

    Args:
        sensors: Sensors, the rows of the arrays below.
        objects: Scored objects of each frame.
        points: For each frame (sensors, objects) points on these.
        sent: (sensors, frames) points sent.
        far: (sensors, frames) far points sent."""
    # an empty array comes first, as there may be no frame
    on_objects = np.concatenate([np.zeros((len(sensors), 0)), *points], axis=1).astype(np.float32)
    boxes = np.concatenate([np.zeros((0, 7)), *(frame_objects.boxes for frame_objects in objects)])
    labels = np.concatenate(
        [np.zeros(0, np.int64), *(frame_objects.labels for frame_objects in objects)]
    )
    frame = np.repeat(np.arange(len(objects)), [len(frame_objects) for frame_objects in objects])
    return Visibility(
        points=on_objects,
        distance=distances(sensors, boxes),
        frame=frame,
        boxes=boxes,
        sent=sent,
        far=far,
        labels=labels,
    )


def distances(
    sensors: Sequence[Sensor], boxes: Float64[np.ndarray, "objects 7"]
) -> Float32[np.ndarray, "candidates objects"]:
    """Horizontal distance (m) from each sensor to the centre of each box."""
    positions = np.array([sensor.position[:2] for sensor in sensors]).reshape(-1, 1, 2)
    return np.linalg.norm(boxes[:, :2] - positions, axis=2).astype(np.float32)
