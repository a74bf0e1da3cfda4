"""Times of clouds: stamps that are apart, sensors of two rates, and clouds that repeat.

Clouds of one frame should be of one instant. Sensors of two rates cannot be paired: steps between
stamps differ, clouds repeat, or frames lack a sensor."""

from collections.abc import Iterator, Sequence
from itertools import combinations, pairwise

import numpy as np

from toolkit.boxes import count_points, iou_bev
from toolkit.doctor.findings import Finding
from toolkit.doctor.sensor_clouds import find_cloud, list_clouds, sensor_names
from toolkit.frame import MAX_APART_S, Frame, SensorCloud, measure_spread

MAX_RATE_RATIO = 1.2  # largest ratio of two sensors' steps in time, for one rate
MAX_REPEATED_SHARE = 0.2  # largest share of a sensor's clouds that may repeat the one before
# largest share of the frames from a sensor's first to its last cloud that may lack it
MAX_MISSING_SHARE = 0.3
MAX_COMPLETE_MISSING_SHARE = 0.1  # share of such frames below which a sensor counts as complete
MIN_STALE_POINTS = 20  # points on the former place of an object that show it there still


def diagnose_times(samples: Sequence[Frame]) -> list[Finding]:
    """Return faults in the stated times of consecutive frames' clouds."""
    return [*suspect_stamps(samples), *suspect_rates(samples), *suspect_twins(samples)]


def suspect_stamps(samples: Sequence[Frame]) -> Iterator[Finding]:
    """Find clouds of one frame whose stamps are usually more than `MAX_APART_S` apart."""
    spreads_s = [measure_spread(sample.clouds) for sample in samples if len(sample.clouds) > 1]
    if not spreads_s or np.median(spreads_s) <= MAX_APART_S:
        return
    evidence = f"{np.median(spreads_s):.3f} s from first to last, median of {len(spreads_s)} frames"
    remedy = "pair clouds by their times, or move them to one time"
    yield Finding(
        severity="warning",
        where="clouds",
        suspected="clouds of one instant are apart in time",
        evidence=evidence,
        remedy=remedy,
    )


def suspect_rates(samples: Sequence[Frame]) -> Iterator[Finding]:
    """Find sensors of two rates.

    They show by steps between stamps, or without stamps by clouds that repeat the one before, or by
    frames without a cloud of the sensor."""
    # by name of the sensor: usual time (s) from cloud to cloud, share of its clouds that repeat
    # the one before, and share of the frames that lack it
    steps_s = {}
    repeated_shares = {}
    missing_shares = {}
    for name in sensor_names(samples):
        clouds = list_clouds(samples, name)
        stamps = np.unique(
            [cloud.stamp_s for cloud in clouds if cloud is not None and cloud.stamp_s is not None]
        )
        if len(stamps) > 2:
            steps_s[name] = float(np.median(np.diff(stamps)))
        repeated_shares[name] = _measure_repeated_share(clouds)
        missing_shares[name] = _measure_missing_share(clouds)
    remedy = "pair clouds by their times, and leave out those without a partner"
    if len(steps_s) > 1 and max(steps_s.values()) > MAX_RATE_RATIO * min(steps_s.values()):
        evidence = ", ".join(f"{name} every {step:.3f} s" for name, step in steps_s.items())
        yield Finding(
            severity="warning",
            where="clouds",
            suspected="sensors of two rates",
            evidence=evidence,
            remedy=remedy,
        )
        return
    fresh_names = [name for name, share in repeated_shares.items() if share <= MAX_REPEATED_SHARE]
    for name, share in repeated_shares.items():
        if share > MAX_REPEATED_SHARE and fresh_names and _is_cloud_stale(samples, name):
            evidence = (
                f"{share:.0%} of its clouds repeat the one before, those of {fresh_names[0]} do not"
            )
            yield Finding(
                severity="warning",
                where=f"sensor {name}",
                suspected="it is slower than the frames",
                evidence=evidence,
                remedy=remedy,
            )
    complete_names = [
        name for name, share in missing_shares.items() if share < MAX_COMPLETE_MISSING_SHARE
    ]
    for name, share in missing_shares.items():
        if share > MAX_MISSING_SHARE and complete_names:
            evidence = (
                f"{share:.0%} of the frames from its first to its last cloud lack it, "
                f"{complete_names[0]} has all"
            )
            yield Finding(
                severity="warning",
                where=f"sensor {name}",
                suspected="it is slower than the frames",
                evidence=evidence,
                remedy=remedy,
            )


def suspect_twins(samples: Sequence[Frame]) -> Iterator[Finding]:
    """Find two sensors that have the same points in every frame: one cloud under two names."""
    for first, second in combinations(sensor_names(samples), 2):
        point_pairs = []  # points of both sensors in each frame with points of the first
        for sample in samples:
            first_cloud = find_cloud(sample, first)
            second_cloud = find_cloud(sample, second)
            if first_cloud and second_cloud and len(first_cloud.points) > 0:
                point_pairs.append((first_cloud.points, second_cloud.points))
        if point_pairs and all(
            np.array_equal(points, other_points) for points, other_points in point_pairs
        ):
            yield Finding(
                severity="warning",
                where=f"sensor {first}",
                suspected=f"it has the same points as {second}",
                evidence=f"all points in {len(point_pairs)} frames",
                remedy="leave one out, its points count twice",
            )


def _measure_repeated_share(clouds: Sequence[SensorCloud | None]) -> float:
    """Share of a sensor's clouds that have the points of the frame before, 0 to 1.

    It is 0 for fewer than three pairs of clouds. clouds: cloud in each frame, None if the frame
    lacks it."""
    is_repeated = [
        len(former.points) > 0 and np.array_equal(former.points, latter.points)
        for former, latter in pairwise(clouds)
        if former and latter
    ]
    return float(np.mean(is_repeated)) if len(is_repeated) > 2 else 0.0


def _is_cloud_stale(samples: Sequence[Frame], name: str) -> bool:
    """Return True if the clouds of a sensor that repeat mostly show objects at former places.

    Then the repeated clouds are old, rather than the labels. Also returns True if no object has
    left its place when a cloud repeats. name: name of the sensor."""
    stale_count = 0  # repeated clouds that show an object at a place that it has left
    repeated_count = 0  # repeated clouds of frames in which objects have left their places
    for former, latter in pairwise(samples):
        former_boxes = former.objects.boxes
        # boxes of the frame before whose places no box of this frame overlaps
        left_boxes = former_boxes[~(iou_bev(former_boxes, latter.objects.boxes) > 0).any(axis=1)]
        former_cloud = find_cloud(former, name)
        cloud = find_cloud(latter, name)
        if not former_cloud or not cloud or not len(left_boxes):
            continue
        if np.array_equal(cloud.points, former_cloud.points):
            repeated_count += 1
            point_counts = count_points(cloud.in_world(), left_boxes)
            stale_count += bool((point_counts >= MIN_STALE_POINTS).any())
    return repeated_count == 0 or stale_count > repeated_count / 2


def _measure_missing_share(clouds: Sequence[SensorCloud | None]) -> float:
    """Share of the frames from a sensor's first cloud to its last that lack it, 0 to 1.

    clouds: cloud in each frame, None if the frame lacks it. Returns 0 for fewer than five frames
    from the first to the last."""
    cloud_frames = np.flatnonzero([cloud is not None for cloud in clouds])
    span = int(cloud_frames[-1] - cloud_frames[0]) + 1 if len(cloud_frames) else 0  # in frames
    return 1 - len(cloud_frames) / span if span > 4 else 0.0
