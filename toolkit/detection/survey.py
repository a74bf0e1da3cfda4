"""Figures of a recording before any detector: objects, points on each of them, and the bits of
early fusion.

They stand beside the paper's: 516 and 674 kbit per sensor (its first table), and the share of
vehicles without a point for sensor sets of the T-junction (section IV-E: more than 60 % for 4, 30 %
for 3 and 4, none for 0, 2 and 5)."""

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial
from itertools import chain
from typing import Any

import numpy as np

from toolkit.arrays import Float64, Int64
from toolkit.boxes import count_points
from toolkit.datasets.recordings import ReadRecording, Reads
from toolkit.detection.codec import PAPER, Codec, check_codec
from toolkit.detection.provenance import dataset_origin, settings_origin, with_file_digest
from toolkit.frame import Recording
from toolkit.objects import LABELS, VEHICLE, label_index
from toolkit.points import count_on_ground, frame_points, has_centre_inside


@dataclass(frozen=True)
class Survey:
    """Figures of a recording, in its site's area if known, else of all that is there.

    objects_per_frame: mean by class; kbit_per_sensor: of all points; counts: points of each sensor
    on each vehicle; by_class: the same of each class that was counted; points_per_cloud: mean of
    each sensor, by name; agreeing: number of labelled cuboids that hold as many points as the set
    says, of those where it says so, None where it does not; problems: labels and points left out in
    reading, by kind."""

    frames: int
    objects_per_frame: dict[str, float]
    kbit_per_sensor: Float64[np.ndarray, " sensors"]
    counts: Int64[np.ndarray, "vehicles sensors"]
    provenance: dict[str, object] = field(default_factory=dict)
    by_class: dict[str, Int64[np.ndarray, "_ sensors"]] = field(default_factory=dict)
    points_per_cloud: dict[str, float] = field(default_factory=dict)
    agreeing: tuple[int, int] | None = None
    problems: dict[str, int] = field(default_factory=dict)

    def points_on_vehicles(self, sensors: Sequence[int]) -> Int64[np.ndarray, " vehicles"]:
        """Points of a sensor set (indices) on each vehicle."""
        return self.counts[:, list(sensors)].sum(axis=1)

    def points_on_objects(
        self, label: str, sensors: Sequence[int]
    ) -> Int64[np.ndarray, " objects"]:
        """Points on each object of a counted class, or ValueError."""
        if label not in self.by_class:
            raise ValueError(
                f"counted were {', '.join(self.by_class) or 'no classes'}, not {label!r}"
            )
        return self.by_class[label][:, list(sensors)].sum(axis=1)

    def unseen(self, sensors: Sequence[int], label: str | None = None) -> float:
        """Share of objects, or vehicles, without a point, or NaN."""
        points = (
            self.points_on_vehicles(sensors)
            if label is None
            else self.points_on_objects(label, sensors)
        )
        return float((points == 0).mean()) if len(points) else float("nan")

    def as_dict(self, sensor_sets: Sequence[Sequence[int]]) -> dict[str, Any]:
        """Return the figures for JSON, undefined as None."""
        named = {",".join(map(str, chosen)): chosen for chosen in sensor_sets}
        classes = {}
        for label, counts in self.by_class.items():
            sets: dict[str, dict[str, float | None]] = {}
            for name, chosen in named.items():
                points = self.points_on_objects(label, chosen)
                shares = (
                    [points.mean(), np.median(points), (points == 0).mean()]
                    if len(points)
                    else [None] * 3
                )
                figures = [None if share is None else float(share) for share in shares]
                sets[name] = dict(
                    zip(("mean_points", "median_points", "unseen"), figures, strict=True)
                )
            classes[label] = {"objects": len(counts), "sets": sets}
        means = {
            name: getattr(self, name)
            for name in ("frames", "objects_per_frame", "points_per_cloud")
        }
        means |= {
            "kbit_per_sensor": float(self.kbit_per_sensor.mean()),
            "vehicles": len(self.counts),
        }
        unseen = {name: self.unseen(chosen) for name, chosen in named.items()}
        agree = {
            "counts_that_agree": self.agreeing and list(self.agreeing),
            "problems": self.problems,
        }
        provenance = with_file_digest(self.provenance)
        return {**means, "unseen": unseen, "classes": classes, **agree, "provenance": provenance}

    def text(self, sensor_sets: Sequence[Sequence[int]]) -> str:
        """Return the figures as lines of text."""
        figures = self.as_dict(sensor_sets)
        objects = "  ".join(
            f"{name} {number:.2f}" for name, number in self.objects_per_frame.items()
        )
        clouds = ", ".join(f"{name} {count:.0f}" for name, count in self.points_per_cloud.items())
        lines = [
            f"{self.frames} frames; points per cloud: {clouds}",
            f"objects per frame{' in the area' if self.provenance.get('site') else ''}: {objects}",
            f"early fusion: {figures['kbit_per_sensor']:.0f} kbit/sensor",
        ]
        for label, of_class in figures["classes"].items():
            for chosen, each in of_class["sets"].items() if of_class["objects"] else ():
                unseen = f"{each['unseen']:.1%} of {of_class['objects']} without a point"
                points = f"mean {each['mean_points']:.1f}, median {each['median_points']:g} points"
                lines.append(f"{label} from {chosen}: {unseen}, {points}")
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

    classes: whose points are counted beside those of vehicles; reads: errors of the sensors and
    number of frames; codec: of the points; progress: called with the number of frames done. Raises
    ValueError for an unknown class or error profile, and without frames."""
    check_codec(codec)
    wanted = sorted({label_index(label) for label in classes})
    total = reads.count(recording)
    errors = reads.profile()
    site = recording.site
    measured = ReadRecording(recording, reads)
    agreeing = [0, 0]
    problems = Counter[str]()
    sent: list[dict[str, tuple[int, float]]] = []
    # labels of a frame's objects, points of each cloud
    counted: list[tuple[np.ndarray, dict[str, np.ndarray]]] = []
    for k in range(total):
        frame = measured[k]
        if site is None:
            objects = frame.objects
            clouds = {cloud.name: cloud.in_world() for cloud in frame.clouds}
        else:
            objects = frame.objects[has_centre_inside(frame.objects.boxes, site.area)]
            points = frame_points(frame, area=site)
            clouds = {
                sensor.name: cloud for sensor, cloud in zip(frame.sensors, points, strict=True)
            }
        count = count_points if site is None else partial(count_on_ground, place=site)
        counted.append(
            (
                objects.labels,
                {name: count(points, objects.boxes) for name, points in clouds.items()},
            )
        )
        sent.append(
            {
                name: (len(each), codec.encode_points(each).bits / 1000)
                for name, each in clouds.items()
            }
        )
        for boxes, own in (
            (frame.objects.boxes, frame.counts),
            (frame.others.boxes, frame.others.counts),
        ):
            if own is not None:
                agreeing[0] += int((count_points(frame.points(), boxes) == own).sum())
                agreeing[1] += len(own)
        problems.update(frame.problems)
        if progress is not None:
            progress(k + 1)
    every = np.concatenate([own for own, _ in counted])
    names = list(dict.fromkeys(chain.from_iterable(sent)))
    columns = [
        np.concatenate([each.get(name, np.zeros_like(own)) for own, each in counted])
        for name in names
    ]
    points_on = np.array(columns, np.int64).reshape(len(names), len(every)).T
    settings = {
        "site": site and site.name,
        "frames": total,
        "noise_seed": reads.noise_seed,
        "errors": errors.origin,
    }
    return Survey(
        total,
        {name: float((every == number).sum()) / total for number, name in enumerate(LABELS)},
        np.array(
            [np.sum([each[name][1] for each in sent if name in each]) / total for name in names]
        ),
        points_on[every == VEHICLE],
        dataset_origin(recording) | settings_origin(codec, **settings),
        {LABELS[label]: points_on[every == label] for label in wanted},
        {name: float(np.mean([each[name][0] for each in sent if name in each])) for name in names},
        (agreeing[0], agreeing[1]) if agreeing[1] else None,
        dict(problems),
    )
