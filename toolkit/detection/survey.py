"""Figures of a recording before any detector: objects, points on each object, bits of early fusion.

They can be compared with the paper's: 516 and 674 kbit per sensor (its first table), and the share
of vehicles without a point for sensor sets of the T-junction (section IV-E: more than 60 % for 4,
30 % for 3 and 4, none for 0, 2 and 5)."""

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial
from itertools import chain
from typing import Any, NamedTuple

import numpy as np

from toolkit.arrays import Float64, Int64
from toolkit.boxes import count_points
from toolkit.datasets.recording_views import ReadRecording, Reads
from toolkit.detection.codec import PAPER, Codec, check_codec
from toolkit.detection.provenance import dataset_origin, settings_origin, with_file_digest
from toolkit.frame import Frame, Recording
from toolkit.objects import LABELS, VEHICLE, label_index
from toolkit.points import count_on_ground, frame_points, has_centre_inside
from toolkit.sites.site import Site


@dataclass(frozen=True)
class Survey:
    """Figures of a recording, in its site's area if known, else of the whole recording.

    Attributes:
        frames: number of frames.
        objects_per_frame: mean number of objects in a frame, by name of the class.
        kbit_per_sensor: kbit (1000 bits) in which each sensor sends all its points, mean over the
            frames that have the sensor.
        counts: number of points of each sensor on each vehicle of all frames.
        provenance: data, settings and version.
        by_class: number of points of each sensor on each object, by name of the counted class.
        points_per_cloud: number of points of each sensor, by name; mean over the frames that have
            the sensor.
        agreement: number of labelled cuboids that hold as many points as the data set states, and
            number of cuboids for which it states a number; None if it states none.
        problems: labels and points left out in reading, by kind.
    """

    frames: int
    objects_per_frame: dict[str, float]
    kbit_per_sensor: Float64[np.ndarray, " sensors"]
    counts: Int64[np.ndarray, "vehicles sensors"]
    provenance: dict[str, object] = field(default_factory=dict)
    by_class: dict[str, Int64[np.ndarray, "_ sensors"]] = field(default_factory=dict)
    points_per_cloud: dict[str, float] = field(default_factory=dict)
    agreement: tuple[int, int] | None = None
    problems: dict[str, int] = field(default_factory=dict)

    def points_on_vehicles(self, sensors: Sequence[int]) -> Int64[np.ndarray, " vehicles"]:
        """Number of points on each vehicle from all sensors of a set (indices)."""
        return self.counts[:, list(sensors)].sum(axis=1)

    def points_on_objects(
        self, label: str, sensors: Sequence[int]
    ) -> Int64[np.ndarray, " objects"]:
        """Number of points on each object of a class from all sensors of a set (indices).

        Raises ValueError for a class whose points were not counted."""
        if label not in self.by_class:
            raise ValueError(
                f"counted were {', '.join(self.by_class) or 'no classes'}, not {label!r}"
            )
        counts = self.by_class[label]  # points on each object from each sensor
        return counts[:, list(sensors)].sum(axis=1)

    def unseen(self, sensors: Sequence[int], label: str | None = None) -> float:
        """Share (0 to 1) of objects without a point from any sensor of a set (indices).

        label: name of a counted class, None for vehicles. NaN without objects."""
        if label is None:
            points = self.points_on_vehicles(sensors)
        else:
            points = self.points_on_objects(label, sensors)
        return float((points == 0).mean()) if len(points) else float("nan")

    def as_dict(self, sensor_sets: Sequence[Sequence[int]]) -> dict[str, Any]:
        """Return the figures for JSON.

        sensor_sets: sets of sensor indices for which points on objects are summed up. Figures of a
        class without objects are None, except `unseen` of vehicles, which is NaN."""
        sensors_by_name = {",".join(map(str, sensors)): sensors for sensors in sensor_sets}
        classes = {}
        for label, counts in self.by_class.items():
            sets: dict[str, dict[str, float | None]] = {}
            for name, sensors in sensors_by_name.items():
                points = self.points_on_objects(label, sensors)
                sets[name] = {"mean_points": None, "median_points": None, "unseen": None}
                if len(points):
                    sets[name] = {
                        "mean_points": float(points.mean()),
                        "median_points": float(np.median(points)),
                        "unseen": float((points == 0).mean()),
                    }
            classes[label] = {"objects": len(counts), "sets": sets}
        return {
            "frames": self.frames,
            "objects_per_frame": self.objects_per_frame,
            "points_per_cloud": self.points_per_cloud,
            "kbit_per_sensor": float(self.kbit_per_sensor.mean()),
            "vehicles": len(self.counts),
            "unseen": {name: self.unseen(sensors) for name, sensors in sensors_by_name.items()},
            "classes": classes,
            # None if the data set states no numbers of points
            "counts_that_agree": self.agreement and list(self.agreement),
            "problems": self.problems,
            "provenance": with_file_digest(self.provenance),
        }

    def text(self, sensor_sets: Sequence[Sequence[int]]) -> str:
        """Return the figures as lines of text.

        sensor_sets: sets of sensor indices for which points on objects are summed up."""
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
        for label, class_figures in figures["classes"].items():
            object_count = class_figures["objects"]
            sets = class_figures["sets"] if object_count else {}
            for sensors, set_figures in sets.items():
                unseen_text = f"{set_figures['unseen']:.1%} of {object_count} without a point"
                points = (
                    f"mean {set_figures['mean_points']:.1f}, median "
                    f"{set_figures['median_points']:g} points"
                )
                lines.append(f"{label} from {sensors}: {unseen_text}, {points}")
        if self.agreement is not None:
            # with the numbers that the data set states
            agree, compared_count = self.agreement
            lines.append(
                f"{agree} of {compared_count} labelled cuboids hold as many points as the set says"
            )
        lines += [f"{number} {kind}" for kind, number in self.problems.items()]
        return "\n".join(lines)


def survey(
    recording: Recording,
    *,
    classes: Sequence[str | int] = LABELS,
    reads: Reads = Reads(),
    codec: Codec = PAPER,
    progress: Callable[[int], None] | None = None,
) -> Survey:
    """Count objects, points and bits over the frames of a recording.

    classes: names or numbers of the classes for which points on objects are counted, in addition to
    vehicles; reads: errors of the sensors and number of frames; codec: codec that gives the bits of
    the points; progress: called with the number of frames done. Raises ValueError for an
    unknown class or error profile, and without frames."""
    check_codec(codec)
    class_numbers = sorted({label_index(label) for label in classes})
    frame_total = reads.count(recording)
    errors = reads.profile()
    site = recording.site
    measured = ReadRecording(recording, reads)
    frame_counts = list[_FrameCounts]()
    problems = Counter[str]()
    for k in range(frame_total):
        frame = measured[k]
        frame_counts.append(_count_frame(frame, site, codec))
        problems.update(frame.problems)
        if progress is not None:
            progress(k + 1)
    labels = np.concatenate([counts.labels for counts in frame_counts])  # objects of all frames
    names = list(dict.fromkeys(chain.from_iterable(counts.points for counts in frame_counts)))
    columns = [_join_column(frame_counts, name) for name in names]
    # number of points; axes: object, sensor
    points_on = np.array(columns, np.int64).reshape(len(names), len(labels)).T
    kbits = []
    points_per_cloud = {}
    for name in names:
        # means over its clouds: a sensor that is missing in a frame sends nothing there
        with_sensor = [counts for counts in frame_counts if name in counts.points]
        kbits.append(np.mean([counts.kbit[name] for counts in with_sensor]))
        points_per_cloud[name] = float(np.mean([counts.points[name] for counts in with_sensor]))
    agree_count = sum(counts.agree for counts in frame_counts)
    compared_count = sum(counts.compared for counts in frame_counts)
    settings = {
        "site": site and site.name,
        "frames": frame_total,
        "noise_seed": reads.noise_seed,
        "errors": errors.origin,
    }
    objects_per_frame = {
        name: float((labels == number).sum()) / frame_total for number, name in enumerate(LABELS)
    }
    return Survey(
        frames=frame_total,
        objects_per_frame=objects_per_frame,
        kbit_per_sensor=np.array(kbits),
        counts=points_on[labels == VEHICLE],
        provenance=dataset_origin(recording) | settings_origin(codec, **settings),
        by_class={LABELS[label]: points_on[labels == label] for label in class_numbers},
        points_per_cloud=points_per_cloud,
        agreement=(agree_count, compared_count) if compared_count else None,
        problems=dict(problems),
    )


class _FrameCounts(NamedTuple):
    """Counts of one frame.

    Attributes:
        labels: class number of each object (index in `toolkit.objects.LABELS`).
        points_on: number of points on each object, by name of the sensor.
        points: number of points of each sensor, by name.
        kbit: kbit (1000 bits) in which each sensor sends its points, by name.
        agree: labelled cuboids that hold as many points as the data set states.
        compared: labelled cuboids for which the data set states a number.
    """

    labels: Int64[np.ndarray, " objects"]
    points_on: dict[str, Int64[np.ndarray, " objects"]]
    points: dict[str, int]
    kbit: dict[str, float]
    agree: int
    compared: int


def _count_frame(frame: Frame, site: Site | None, codec: Codec) -> _FrameCounts:
    """Count the points, bits and agreeing cuboids of a frame.

    site: site whose area limits the objects and points that count, None for all; codec:
    gives the bits of the points."""
    objects = frame.objects
    # function of points and boxes
    count = count_points
    if site is None:
        clouds = {cloud.name: cloud.in_world() for cloud in frame.clouds}
    else:
        objects = objects[has_centre_inside(objects.boxes, site.area)]
        count = partial(count_on_ground, place=site)
        names = [sensor.name for sensor in frame.sensors]
        clouds = dict(zip(names, frame_points(frame, area=site), strict=True))
    agree_count = 0
    compared_count = 0
    # boxes, and the number of points in each that the data set states, None if it states none;
    # `others` are labelled objects of other classes
    cuboids = [(frame.objects.boxes, frame.counts), (frame.others.boxes, frame.others.counts)]
    for boxes, stated_counts in cuboids:
        if stated_counts is not None:
            agree_count += int((count_points(frame.points(), boxes) == stated_counts).sum())
            compared_count += len(stated_counts)
    return _FrameCounts(
        labels=objects.labels,
        points_on={name: count(points, objects.boxes) for name, points in clouds.items()},
        points={name: len(points) for name, points in clouds.items()},
        kbit={name: codec.encode_points(points).bits / 1000 for name, points in clouds.items()},
        agree=agree_count,
        compared=compared_count,
    )


def _join_column(frames: Sequence[_FrameCounts], name: str) -> Int64[np.ndarray, " objects"]:
    """Join the numbers of points on each object of all frames from one sensor.

    name: name of the sensor; objects of frames without the sensor have 0 points."""
    columns = [frame.points_on.get(name, np.zeros_like(frame.labels)) for frame in frames]
    return np.concatenate(columns)
