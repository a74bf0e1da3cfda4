"""Figures of a recording before any detector.

Objects, points on each of them, and the bits that early fusion would send. They stand beside the paper's: 516 and 674
kbit per sensor (its first table), and the share of vehicles without a point for sensor sets of the T-junction (section
IV-E: more than 60 % for 4, 30 % for 3 and 4, none for 0, 2 and 5).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from toolkit.arrays import Float64, Int64
from toolkit.boxes import count_points
from toolkit.datasets.readings import ReadRecording, Reads
from toolkit.datasets.records import add_problems
from toolkit.detection.codec import PAPER, Codec, check_codec
from toolkit.detection.provenance import dataset_origin, settings_origin, with_file_digest
from toolkit.frame import Frame, Recording
from toolkit.objects import LABELS, VEHICLE, label_index
from toolkit.points import count_on_ground, frame_points, has_centre_inside
from toolkit.sites.site import Site


@dataclass(frozen=True)
class Survey:
    """Figures of a recording, in its site's area if known.

    Otherwise they cover all that is there. objects_per_frame: mean by class; kbit_per_sensor: of all points, sensor by
    sensor; counts: points of each sensor on each vehicle; by_class: the same of the objects of each class that was
    counted; points_per_cloud: mean of each sensor, by name; agreeing: number of labelled cuboids that hold as many
    points as the set says, of those where it says so, None where it does not; problems: number of labels and points
    left out in reading, by kind.
    """

    frames: int
    objects_per_frame: dict[str, float]
    kbit_per_sensor: Float64[np.ndarray, " sensors"]
    counts: Int64[np.ndarray, "vehicles sensors"]
    provenance: dict[str, Any] = field(default_factory=dict)
    by_class: dict[str, Int64[np.ndarray, "_ sensors"]] = field(default_factory=dict)
    points_per_cloud: dict[str, float] = field(default_factory=dict)
    agreeing: tuple[int, int] | None = None
    problems: dict[str, int] = field(default_factory=dict)

    def points_on_vehicles(self, sensors: Sequence[int]) -> Int64[np.ndarray, " vehicles"]:
        """Points on each vehicle in a fused cloud. The cloud is that of a sensor set (indices)."""
        return self.counts[:, list(sensors)].sum(axis=1)

    def points_on_objects(self, label: str, sensors: Sequence[int]) -> Int64[np.ndarray, " objects"]:
        """Points on each object of a class. Raises ValueError for a class that was not counted."""
        if label not in self.by_class:
            raise ValueError(f"counted were {', '.join(self.by_class) or 'no classes'}, not {label!r}")
        return self.by_class[label][:, list(sensors)].sum(axis=1)

    def unseen(self, sensors: Sequence[int], label: str | None = None) -> float:
        """Share of objects without a point of a sensor set. Vehicles, or objects of a class; NaN without any."""
        points = self.points_on_vehicles(sensors) if label is None else self.points_on_objects(label, sensors)
        return float((points == 0).mean()) if len(points) else float("nan")

    def as_dict(self, sensor_sets: Sequence[Sequence[int]]) -> dict[str, Any]:
        """Return the figures for JSON.

        The share of unseen vehicles is given for some sensor sets; None if undefined.
        """
        return {
            "frames": self.frames,
            "objects_per_frame": self.objects_per_frame,
            "points_per_cloud": self.points_per_cloud,
            "kbit_per_sensor": float(self.kbit_per_sensor.mean()),
            "vehicles": len(self.counts),
            "unseen": {",".join(map(str, chosen)): self.unseen(chosen) for chosen in sensor_sets},
            "classes": {label: self._of_class(label, sensor_sets) for label in self.by_class},
            "counts_that_agree": self.agreeing and list(self.agreeing),
            "problems": self.problems,
            "provenance": with_file_digest(self.provenance),
        }

    def _of_class(self, label: str, sensor_sets: Sequence[Sequence[int]]) -> dict[str, Any]:
        sets: dict[str, Any] = {}
        for chosen in sensor_sets:
            points = self.points_on_objects(label, chosen)
            figures = (points.mean(), np.median(points), (points == 0).mean()) if len(points) else (None,) * 3
            named = zip(("mean_points", "median_points", "unseen"), figures, strict=True)
            sets[",".join(map(str, chosen))] = {name: value if value is None else float(value) for name, value in named}
        return {"objects": len(self.by_class[label]), "sets": sets}

    def text(self, sensor_sets: Sequence[Sequence[int]]) -> str:
        """Return the figures as lines of text."""
        figures = self.as_dict(sensor_sets)
        objects = "  ".join(f"{name} {number:.2f}" for name, number in self.objects_per_frame.items())
        clouds = ", ".join(f"{name} {count:.0f}" for name, count in self.points_per_cloud.items())
        lines = [
            f"{self.frames} frames; points per cloud: {clouds}",
            f"objects per frame{' in the area' if self.provenance.get('site') else ''}: {objects}",
            f"early fusion: {figures['kbit_per_sensor']:.0f} kbit/sensor",
        ]
        for label, of_class in figures["classes"].items():
            for chosen, each in of_class["sets"].items() if of_class["objects"] else ():
                lines.append(
                    f"{label} from {chosen}: {each['unseen']:.1%} of {of_class['objects']} without a point, "
                    f"mean {each['mean_points']:.1f}, median {each['median_points']:g} points"
                )
        if self.agreeing is not None:
            agree, known = self.agreeing
            lines.append(f"{agree} of {known} labelled cuboids hold as many points as the set says")
        return "\n".join([*lines, *(f"{number} {kind}" for kind, number in self.problems.items())])


def survey(
    recording: Recording,
    *,
    classes: Sequence[str | int] = LABELS,
    reads: Reads = Reads(),
    codec: Codec = PAPER,
    progress: Callable[[int], None] | None = None,
) -> Survey:
    """Count over the frames of a recording.

    classes: whose points are counted beside those of vehicles; reads: errors of the sensors and number of frames;
    codec: of the points; progress: called with the number of frames done. Raises ValueError for an unknown class or
    error profile, and without frames.
    """
    check_codec(codec)
    wanted = sorted({label_index(label) for label in classes})
    total, errors, site = reads.count(recording), reads.profile(), recording.site
    measured = ReadRecording(recording, reads)
    names: list[str] = []
    labels, sent = np.zeros(len(LABELS), np.int64), list[dict[str, tuple[int, float]]]()
    counts: dict[int, list[dict[str, np.ndarray]]] = {label: [] for label in {VEHICLE, *wanted}}
    agreeing, problems = np.zeros(2, np.int64), dict[str, int]()
    for k in range(total):
        frame = measured[k]
        objects = frame.objects if site is None else frame.objects[has_centre_inside(frame.objects.boxes, site.area)]
        clouds = _clouds(frame, site)
        names += [name for name in clouds if name not in names]
        for label, so_far in counts.items():
            boxes = objects.boxes[objects.labels == label]
            so_far.append(
                {name: _count(points, boxes, site) for name, points in clouds.items()} | {"": np.zeros(len(boxes))}
            )
        labels += np.bincount(objects.labels, minlength=len(LABELS))
        sent.append({name: (len(each), codec.encode_points(each).bits / 1000) for name, each in clouds.items()})
        agreeing += _agreement(frame)
        add_problems(problems, frame.problems)
        if progress is not None:
            progress(k + 1)
    points = {
        label: np.concatenate(
            [
                np.stack([each.get(name, 0 * each[""]) for name in names], axis=1)
                if names
                else np.zeros((len(each[""]), 0))
                for each in of_class
            ]
        ).astype(np.int64)
        for label, of_class in counts.items()
    }
    settings = settings_origin(
        codec, site=site and site.name, frames=total, noise_seed=reads.noise_seed, errors=errors.origin
    )
    return Survey(
        total,
        {name: float(count) / total for name, count in zip(LABELS, labels, strict=True)},
        np.array([np.sum([each[name][1] for each in sent if name in each]) / total for name in names]),
        points[VEHICLE],
        dataset_origin(recording) | settings,
        {LABELS[label]: points[label] for label in wanted},
        {name: float(np.mean([each[name][0] for each in sent if name in each])) for name in names},
        (int(agreeing[0]), int(agreeing[1])) if agreeing[1] else None,
        problems,
    )


def _clouds(frame: Frame, site: Site | None) -> dict[str, np.ndarray]:
    """Points of every sensor, world frame. In the area of a site, else all."""
    if site is None:
        return {cloud.name: cloud.in_world() for cloud in frame.clouds}
    return dict(zip((sensor.name for sensor in frame.sensors), frame_points(frame, area=site), strict=True))


def _count(points: np.ndarray, boxes: np.ndarray, site: Site | None) -> np.ndarray:
    return count_points(points, boxes) if site is None else count_on_ground(points, boxes, site)


def _agreement(frame: Frame) -> tuple[int, int]:
    """Count cuboids whose points agree with the set.

    The first number agrees with the points that the set says; the second counts cuboids where it says so.
    """
    agree = known = 0
    for boxes, own in ((frame.objects.boxes, frame.counts), (frame.others.boxes, frame.others.counts)):
        if own is not None:
            agree, known = agree + int((count_points(frame.points(), boxes) == own).sum()), known + len(own)
    return agree, known
