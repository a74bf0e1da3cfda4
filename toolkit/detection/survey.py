"""What a recording holds, before any detector: objects, points on each of them, and what early fusion would send.

The figures stand beside the paper's: 516 and 674 kbit per sensor (its first table), and the share of vehicles without a
point for sensor sets of the T-junction (section IV-E: more than 60 % for 4, 30 % for 3 and 4, none for 0, 2 and 5).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from toolkit.arrays import Float64, Int64
from toolkit.boxes import count_points
from toolkit.datasets.readings import read_frame
from toolkit.datasets.records import add_problems
from toolkit.datasets.sample import Sample
from toolkit.detection.codec import PAPER, Codec, check_codec
from toolkit.detection.provenance import dataset_origin, settings_origin, with_file_digest
from toolkit.objects import LABELS, VEHICLE, label_index
from toolkit.points import count_on_ground, frame_points, has_centre_inside, select_sensors
from toolkit.sensors.error_profiles import PAPER_ERRORS, ErrorProfile, get_profile

if TYPE_CHECKING:
    from toolkit.detection.evaluation import Recording


@dataclass(frozen=True)
class Survey:
    """frames: how many; objects_per_frame: mean in the area, by class; kbit_per_sensor: of all points, sensor by
    sensor; counts: points of each sensor on each vehicle in the area; provenance: dataset, settings and version;
    by_class: as `counts`, of the objects of each class that was counted."""

    frames: int
    objects_per_frame: dict[str, float]
    kbit_per_sensor: Float64[np.ndarray, " sensors"]
    counts: Int64[np.ndarray, "vehicles sensors"]
    provenance: dict[str, Any] = field(default_factory=dict)
    by_class: dict[str, Int64[np.ndarray, "_ sensors"]] = field(default_factory=dict)

    def points_on_vehicles(self, sensors: Sequence[int]) -> Int64[np.ndarray, " vehicles"]:
        """The point density of each vehicle in the fused cloud of a sensor set (indices)."""
        return self.counts[:, list(sensors)].sum(axis=1)

    def points_on_objects(self, label: str, sensors: Sequence[int]) -> Int64[np.ndarray, " objects"]:
        """The same of each object of a class. Raises ValueError for one that was not counted."""
        if label not in self.by_class:
            raise ValueError(f"counted were {', '.join(self.by_class) or 'no classes'}, not {label!r}")
        return self.by_class[label][:, list(sensors)].sum(axis=1)

    def unseen(self, sensors: Sequence[int], label: str | None = None) -> float:
        """The share of vehicles, or objects of a class, on which a sensor set has no point; NaN where there is none."""
        points = self.points_on_vehicles(sensors) if label is None else self.points_on_objects(label, sensors)
        return float((points == 0).mean()) if len(points) else float("nan")

    def as_dict(self, sensor_sets: Sequence[Sequence[int]]) -> dict[str, Any]:
        """The figures for JSON, with the share of unseen vehicles of some sensor sets; None for the share of none."""
        return {
            "frames": self.frames,
            "objects_per_frame": self.objects_per_frame,
            "kbit_per_sensor": float(self.kbit_per_sensor.mean()),
            "vehicles": len(self.counts),
            "unseen": {",".join(map(str, chosen)): self.unseen(chosen) for chosen in sensor_sets},
            "classes": {label: self._of_class(label, sensor_sets) for label in self.by_class},
            "provenance": with_file_digest(self.provenance),
        }

    def _of_class(self, label: str, sensor_sets: Sequence[Sequence[int]]) -> dict[str, Any]:
        """How many objects there are, and of each sensor set mean and median points on them and the share unseen."""
        sets: dict[str, Any] = {}
        for chosen in sensor_sets:
            points = self.points_on_objects(label, chosen)
            figures = (points.mean(), np.median(points), (points == 0).mean()) if len(points) else (None,) * 3
            named = zip(("mean_points", "median_points", "unseen"), figures, strict=True)
            sets[",".join(map(str, chosen))] = {name: value if value is None else float(value) for name, value in named}
        return {"objects": len(self.by_class[label]), "sets": sets}


def survey(
    dataset: Recording,
    *,
    classes: Sequence[str | int] = LABELS,
    frames: int | None = None,
    noise_seed: int = 0,
    errors: ErrorProfile | str = PAPER_ERRORS,
    codec: Codec = PAPER,
    progress: Callable[[int], None] | None = None,
) -> Survey:
    """Count over the first `frames` frames of a recording, all if not given; classes: whose points are counted beside
    those of vehicles; codec: of the points; errors: of the sensors, a profile or its name, drawn from `noise_seed`;
    progress is told how many frames are done. Raises ValueError for a class or error profile that does not exist."""
    check_codec(codec)
    wanted = sorted({label_index(label) for label in classes})
    errors = get_profile(errors)
    total = min(len(dataset), len(dataset) if frames is None else frames)
    if total < 1 or isinstance(frames, float):
        raise ValueError(f"there must be a frame to survey, a whole number, got {frames} of {len(dataset)}")
    site, everyone = dataset.site, select_sensors(dataset.sensors)
    labels, sent = np.zeros(len(LABELS), np.int64), np.zeros(len(everyone))
    counts: dict[int, list[np.ndarray]] = {label: [] for label in {VEHICLE, *wanted}}
    for k in range(total):
        frame = read_frame(dataset, k, errors=errors, noise_seed=noise_seed)
        objects = frame.objects[has_centre_inside(frame.objects.boxes, site.area)]
        clouds = frame_points(frame, everyone, area=site)
        for label, so_far in counts.items():
            boxes = objects.boxes[objects.labels == label]
            so_far.append(np.stack([count_on_ground(points, boxes, site) for points in clouds], axis=1))
        labels += np.bincount(objects.labels, minlength=len(LABELS))
        sent += [codec.encode_points(points).bits / 1000 for points in clouds]
        if progress is not None:
            progress(k + 1)
    per_frame = {name: float(count) / total for name, count in zip(LABELS, labels, strict=True)}
    settings = settings_origin(codec, site=site.name, frames=total, noise_seed=noise_seed, errors=errors.origin)
    points = {label: np.concatenate(of_class) for label, of_class in counts.items()}
    return Survey(
        total,
        per_frame,
        sent / total,
        points[VEHICLE],
        dataset_origin(dataset) | settings,
        {LABELS[label]: points[label] for label in wanted},
    )


def survey_samples(samples: Iterable[Sample], *, classes: Sequence[str | int] = LABELS) -> dict[str, Any]:
    """Figures for JSON: samples, points per cloud of each sensor (mean), objects per sample by class, of each class the
    points on an object (mean, median, share without any), how many cuboids hold as many points as the set says, and
    what was met in reading. Raises ValueError where there is no sample.
    """
    wanted = [label_index(label) for label in classes]
    points: dict[str, list[int]] = {}
    on_objects: dict[int, list[np.ndarray]] = {label: [] for label in range(len(LABELS))}
    problems: dict[str, int] = {}
    agree = known = number = 0
    for sample in samples:
        number += 1
        for cloud in sample.clouds:
            points.setdefault(cloud.name, []).append(len(cloud.points))
        together = sample.points()
        counts = count_points(together, sample.objects.boxes)
        for label, so_far in on_objects.items():
            so_far.append(counts[sample.objects.labels == label])
        for boxes, own in ((sample.objects.boxes, sample.counts), (sample.others.boxes, sample.others.counts)):
            if own is not None:
                agree, known = agree + int((count_points(together, boxes) == own).sum()), known + len(own)
        add_problems(problems, sample.problems)
    if not number:
        raise ValueError("there is no sample to survey: check the path and the layout")
    every = {label: np.concatenate(parts) for label, parts in on_objects.items()}
    return {
        "samples": number,
        "points_per_cloud": {name: float(np.mean(counts)) for name, counts in points.items()},
        "objects_per_sample": {LABELS[label]: len(counts) / number for label, counts in every.items()},
        "classes": {LABELS[label]: _of(every[label]) for label in wanted},
        "counts_that_agree": [agree, known] if known else None,
        "problems": problems,
    }


def _of(counts: np.ndarray) -> dict[str, Any]:
    figures = (counts.mean(), np.median(counts), (counts == 0).mean()) if len(counts) else (None,) * 3
    named = zip(("mean_points", "median_points", "unseen"), figures, strict=True)
    return {"objects": len(counts)} | {name: None if value is None else float(value) for name, value in named}


def survey_text(figures: dict[str, Any]) -> str:
    """The figures in lines of text."""
    objects = "  ".join(f"{name} {count:.2f}" for name, count in figures["objects_per_sample"].items())
    clouds = ", ".join(f"{name} {count:.0f}" for name, count in figures["points_per_cloud"].items())
    lines = [f"{figures['samples']} samples; points per cloud: {clouds}", f"objects per sample: {objects}"]
    for label, each in figures["classes"].items():
        if each["objects"]:
            lines.append(
                f"{label}: {each['unseen']:.1%} of {each['objects']} without a point, mean {each['mean_points']:.1f}, "
                f"median {each['median_points']:g} points"
            )
    if figures["counts_that_agree"]:
        agree, known = figures["counts_that_agree"]
        lines.append(f"{agree} of {known} labelled cuboids hold as many points as the set says")
    lines += [f"{number} {kind}" for kind, number in figures["problems"].items()]
    return "\n".join(lines)
