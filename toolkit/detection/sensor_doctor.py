"""Doctor of a recording's sensors, compared with each other: times, rates and missed boxes.

- Clouds of one frame should be of one instant. Their stamps show it, and so do moving objects:
  boxes moved along their tracks fit the points of a late sensor, and of no other.
- Sensors of two rates cannot be paired: steps between stamps differ, clouds repeat, or frames lack
  a sensor.
- Points far below the ground come from a sensor whose pose is wrong or missing.
- A box is missed if a sensor sees the ground just in front of the box, but no point on it. Every
  sensor misses a few. If one misses many that others see, its pose is wrong or its points were
  lost."""

from collections.abc import Iterator, Sequence
from itertools import combinations, pairwise
from typing import NamedTuple

import numpy as np

from toolkit.arrays import BoxRows, Float64, Mask, Points
from toolkit.boxes import count_points, iou_bev
from toolkit.calibration.ground import Ground
from toolkit.datasets.doctor import Finding
from toolkit.detection.label_fits import MIN_FITTED_BOXES, SHIFTS_S, Movers, Seen, find_movers, fits
from toolkit.frame import MAX_APART_S, Frame, SensorCloud, measure_spread

MAX_RATE_RATIO = 1.2
MAX_REPEATED_SHARE = 0.2  # in a sensor's clouds
MAX_MISSING_SHARE = 0.3  # in the frames from a sensor's first to its last cloud
MIN_LATE_GAIN = 0.05  # in mean fit, for a sensor to be late
MIN_LATE_OBJECTS = 5  # that must fit better, and hardly any worse
MIN_TIMELY_OBJECTS = 3
MIN_FIT_CHANGE = 0.01
MIN_STALE_POINTS = 20  # on the former place of an object that has left it
MIN_FRONT_POINTS = 5  # on the ground in front of a box, which show that a sensor sees it
FRONT_M = 2.0
MARGIN_M = 0.1  # that a point may be outside its box
GROUND_BAND_M = 0.2
MIN_MISSED_SHARE = 0.5
MAX_USUAL_MISSED_SHARE = 0.2
MIN_BURIED_M = 1.0  # below the ground that all sensors together show
MIN_BURIED_SHARE = 0.3  # share of a sensor's points, which no ramp or ditch explains
MAX_USUAL_BURIED_SHARE = 0.05


def diagnose_times(samples: Sequence[Frame]) -> list[Finding]:
    """Return faults in the stated times of consecutive frames' clouds."""
    return [*suspect_stamps(samples), *suspect_rates(samples), *suspect_twins(samples)]


def diagnose_sensors(seen: Sequence[Seen], *, timely: bool) -> list[Finding]:
    """Return faults of sensors, as the labels of consecutive frames show them if they are right.

    timely: whether `diagnose_times` found nothing; only then a late sensor can be recognised."""
    late = [*suspect_late_sensors(seen)] if timely else []
    return [*late, *suspect_missed_boxes(seen), *suspect_buried_points(seen)]


def _sensor_names(samples: Sequence[Frame]) -> list[str]:
    return sorted({cloud.name for sample in samples for cloud in sample.clouds})


def _list_clouds(samples: Sequence[Frame], name: str) -> list[SensorCloud | None]:
    """Cloud of one sensor in each frame, None if the frame lacks it."""
    return [_find_cloud(sample, name) for sample in samples]


def _find_cloud(sample: Frame, name: str) -> SensorCloud | None:
    return next((cloud for cloud in sample.clouds if cloud.name == name), None)


def suspect_stamps(samples: Sequence[Frame]) -> Iterator[Finding]:
    """Find clouds of one frame whose stamps are apart."""
    paired = [sample for sample in samples if len(sample.clouds) > 1]
    spreads_s = [measure_spread(sample.clouds) for sample in paired]
    if not spreads_s or np.median(spreads_s) <= MAX_APART_S:
        return
    evidence = f"{np.median(spreads_s):.3f} s from first to last, median of {len(spreads_s)} frames"
    remedy = "pair clouds by their times, or move them to one time"
    yield Finding("warning", "clouds", "clouds of one instant are apart in time", evidence, remedy)


def suspect_rates(samples: Sequence[Frame]) -> Iterator[Finding]:
    """Find sensors that measure at another rate than the fastest."""
    steps_s = {}
    repeated = {}
    missing = {}
    for name in _sensor_names(samples):
        clouds = _list_clouds(samples, name)
        stamps = np.unique(
            [cloud.stamp_s for cloud in clouds if cloud is not None and cloud.stamp_s is not None]
        )
        if len(stamps) > 2:
            steps_s[name] = float(np.median(np.diff(stamps)))
        repeated[name] = _share_repeated(clouds)
        missing[name] = _share_missing(clouds)
    remedy = "pair clouds by their times, and leave out those without a partner"
    if len(steps_s) > 1 and max(steps_s.values()) > MAX_RATE_RATIO * min(steps_s.values()):
        evidence = ", ".join(f"{name} every {step:.3f} s" for name, step in steps_s.items())
        yield Finding("warning", "clouds", "sensors of two rates", evidence, remedy)
        return
    fresh = [name for name in repeated if repeated[name] <= MAX_REPEATED_SHARE]
    for name, share in repeated.items():
        if share > MAX_REPEATED_SHARE and fresh and _shows_the_past(samples, name):
            evidence = (
                f"{share:.0%} of its clouds repeat the one before, those of {fresh[0]} do not"
            )
            yield Finding(
                "warning", f"sensor {name}", "it is slower than the frames", evidence, remedy
            )
    complete = [name for name in missing if missing[name] < 0.1]
    for name, share in missing.items():
        if share > MAX_MISSING_SHARE and complete:
            evidence = (
                f"{share:.0%} of the frames from its first to its last cloud lack it, "
                f"{complete[0]} has all"
            )
            yield Finding(
                "warning", f"sensor {name}", "it is slower than the frames", evidence, remedy
            )


def suspect_twins(samples: Sequence[Frame]) -> Iterator[Finding]:
    """Find two sensors that have the same points in every frame: one cloud under two names."""
    for first, second in combinations(_sensor_names(samples), 2):
        pairs = [(_find_cloud(sample, first), _find_cloud(sample, second)) for sample in samples]
        clouds = [
            (first_cloud, second_cloud)
            for first_cloud, second_cloud in pairs
            if first_cloud and second_cloud and len(first_cloud.points) > 0
        ]
        if clouds and all(
            np.array_equal(first_cloud.points, second_cloud.points)
            for first_cloud, second_cloud in clouds
        ):
            evidence = f"all points in {len(clouds)} frames"
            words = f"it has the same points as {second}"
            yield Finding(
                "warning",
                f"sensor {first}",
                words,
                evidence,
                "leave one out, its points count twice",
            )


def _share_repeated(clouds: Sequence[SensorCloud | None]) -> float:
    """Share of a sensor's clouds that have the points of the frame before."""
    pairs = [(former, latter) for former, latter in pairwise(clouds) if former and latter]
    same = [
        len(former.points) > 0 and np.array_equal(former.points, latter.points)
        for former, latter in pairs
    ]
    return float(np.mean(same)) if len(same) > 2 else 0.0


def _shows_the_past(samples: Sequence[Frame], name: str) -> bool:
    """Return True if a cloud that repeats the one before shows objects at their earlier positions.

    Also returns True if no object moves."""
    stale_count = 0
    changes = 0
    for former, latter in pairwise(samples):
        places = former.objects.boxes
        gone = places[~(iou_bev(places, latter.objects.boxes) > 0).any(axis=1)]
        before = _find_cloud(former, name)
        cloud = _find_cloud(latter, name)
        if before and cloud and len(gone) and np.array_equal(cloud.points, before.points):
            changes += 1
            stale_count += bool((count_points(cloud.in_world(), gone) >= MIN_STALE_POINTS).any())
    return changes == 0 or stale_count > 0.5 * changes


def _share_missing(clouds: Sequence[SensorCloud | None]) -> float:
    """Share of the frames from a sensor's first cloud to its last that lack it."""
    present = np.flatnonzero([cloud is not None for cloud in clouds])
    span = int(present[-1] - present[0]) + 1 if len(present) else 0
    return 1 - len(present) / span if span > 4 else 0.0


def suspect_late_sensors(seen: Sequence[Seen]) -> Iterator[Finding]:
    """Find sensors whose points show moving objects at another time than other sensors."""
    samples = [view.sample for view in seen]
    names = _sensor_names(samples)
    movers = [find_movers(samples, k) for k in range(len(samples))]
    if len(names) < 2 or sum(len(moving.boxes) for moving in movers) < MIN_FITTED_BOXES:
        return
    late: dict[str, tuple[float, np.ndarray, np.ndarray]] = {}
    timely = []
    for name in names:
        views = [_restrict_sensor(view, name) for view in seen]
        now = _measure_shift(views, movers, 0.0)
        shifts = [sign * seconds for seconds in SHIFTS_S for sign in (1, -1)]
        shifted = {shift_s: _measure_shift(views, movers, shift_s) for shift_s in shifts}
        best = max(shifts, key=lambda shift_s: float(shifted[shift_s].mean()))
        if _is_later(now, shifted[best]):
            late[name] = (best, now, shifted[best])
        elif (now > 0).sum() >= MIN_TIMELY_OBJECTS:
            timely.append(name)
    for name, (shift_s, before, after) in late.items() if timely else ():
        side = "ahead of" if shift_s > 0 else "behind"
        words = f"its clouds are about {abs(shift_s):g} s {side} the labels and {', '.join(timely)}"
        share = f"{before.mean():.0%} as they are, {after.mean():.0%} with that undone"
        evidence = f"mean fit of {len(before)} moving objects to its points: {share}"
        yield Finding(
            "warning",
            f"sensor {name}",
            words,
            evidence,
            "pair clouds by their times, or move its points",
        )


def _is_later(
    before: Float64[np.ndarray, " tracks"], after: Float64[np.ndarray, " tracks"]
) -> bool:
    """Return True if nearly all moving objects fit better with their boxes moved."""
    change = (after - before)[(before > 0) | (after > 0)]
    improved = int((change > MIN_FIT_CHANGE).sum())
    spoilt = int((change < -MIN_FIT_CHANGE).sum())
    return (
        improved >= MIN_LATE_OBJECTS
        and spoilt <= 0.1 * improved
        and float(change.mean()) >= MIN_LATE_GAIN
    )


def _measure_shift(
    views: Sequence[Seen], movers: Sequence[Movers], shift_s: float
) -> Float64[np.ndarray, " tracks"]:
    """Mean fit of each moving object's boxes, moved along its track by some time.

    All frames of one object count as one, as they show the same."""
    moved = []
    for moving in movers:
        path = np.column_stack([shift_s * moving.velocities, np.zeros((len(moving.boxes), 5))])
        moved.append(moving.boxes + path)
    ids = np.concatenate([moving.ids for moving in movers if len(moving.ids)])
    tracks, places = np.unique(ids, return_inverse=True)
    return np.bincount(places, fits(views, moved)) / np.bincount(places, minlength=len(tracks))


def _restrict_sensor(seen: Seen, name: str) -> Seen:
    """Points of one sensor above the ground."""
    points = [cloud.in_world() for cloud in seen.sample.clouds if cloud.name == name]
    sensor_points = np.concatenate([np.zeros((0, 3)), *points])
    return Seen(seen.sample, seen.above_ground(sensor_points), seen.ground)


def suspect_buried_points(seen: Sequence[Seen]) -> Iterator[Finding]:
    """Find sensors whose points are below the ground that other sensors see."""
    shares: dict[str, float] = {}
    for name in _sensor_names([view.sample for view in seen]):
        heights = [np.zeros(0)]
        for view in seen:
            cloud = _find_cloud(view.sample, name)
            if cloud is not None and view.ground is not None:
                points = cloud.in_world()
                heights.append(points[:, 2] - view.ground.height(points[:, :2]))
        sensor_heights = np.concatenate(heights)
        if len(sensor_heights):
            shares[name] = float((sensor_heights < -MIN_BURIED_M).mean())
    usual = [name for name, share in shares.items() if share <= MAX_USUAL_BURIED_SHARE]
    for name, share in shares.items():
        if share >= MIN_BURIED_SHARE and usual:
            evidence = (
                f"{share:.0%} of its points are more than {MIN_BURIED_M:g} m below it, of "
                f"{usual[0]}'s hardly any"
            )
            words = "its points are below the ground that others see"
            yield Finding(
                "error",
                f"sensor {name}",
                words,
                evidence,
                "check its pose: its height, and which way is up",
            )


class _Visibility(NamedTuple):
    """For each box of a frame: whether a sensor must see it, and whether a point is on it."""

    must_see: Mask
    hit: Mask


def suspect_missed_boxes(seen: Sequence[Seen]) -> Iterator[Finding]:
    """Find sensors without points on boxes that they must see and other sensors see."""
    names = _sensor_names([seen_frame.sample for seen_frame in seen])
    if len(names) < 2:
        return
    must_see = dict.fromkeys(names, 0)
    missed = dict.fromkeys(names, 0)
    for seen_frame in seen:
        sample = seen_frame.sample
        ground = seen_frame.ground
        if ground is None or not len(sample.objects):
            continue
        views = {cloud.name: _look(cloud, sample.objects.boxes, ground) for cloud in sample.clouds}
        for name, view in views.items():
            other_hits = [
                other_view.hit for other_name, other_view in views.items() if other_name != name
            ]
            is_expected = view.must_see & np.any(
                [np.zeros(len(view.hit), bool), *other_hits], axis=0
            )
            must_see[name] += int(is_expected.sum())
            missed[name] += int((is_expected & ~view.hit).sum())
    shares = {
        name: missed[name] / must_see[name] for name in names if must_see[name] >= MIN_FITTED_BOXES
    }
    usual = [name for name, share in shares.items() if share <= MAX_USUAL_MISSED_SHARE]
    for name, share in shares.items():
        if share >= MIN_MISSED_SHARE and usual:
            evidence = (
                f"{missed[name]} of {must_see[name]} boxes in front of which it sees the ground"
            )
            words = "boxes hold points of other sensors, and none of this one"
            remedy = "check its pose, its times, and whether its points are whole"
            yield Finding("error", f"sensor {name}", words, evidence, remedy)


def _look(cloud: SensorCloud, boxes: BoxRows, ground: Ground) -> _Visibility:
    """Return the boxes (world frame) that a sensor must see, and the boxes that it hits.

    It must see a box if it measured the ground between itself and the box, within `FRONT_M` of the
    box and within its inner half as seen from the sensor."""
    points = cloud.in_world()
    heights = points[:, 2] - ground.height(points[:, :2])
    grown = boxes + np.array([0, 0, 0, 2, 2, 2, 0]) * MARGIN_M
    above_ground = points[heights > GROUND_BAND_M]
    hit = count_points(above_ground, grown) > 0
    level_points = points[np.abs(heights) < GROUND_BAND_M]
    position = cloud.world_SE3_sensor[:2, 3]
    must_see = [_sees_front(level_points, position, box) for box in boxes]
    return _Visibility(np.array(must_see, bool), hit)


def _sees_front(
    level_points: Points, position: Float64[np.ndarray, "2"], box: Float64[np.ndarray, "7"]
) -> bool:
    """Return True if points on the ground are just in front of a box, as seen from a position."""
    to_box = box[:2] - position
    distance = float(np.hypot(*to_box))
    ahead = to_box / max(distance, 1e-9)
    aside = np.array([-ahead[1], ahead[0]])
    heading = np.array([np.cos(box[6]), np.sin(box[6])])
    across = np.array([-heading[1], heading[0]])
    depth = abs(heading @ ahead) * box[3] / 2 + abs(across @ ahead) * box[4] / 2
    width = abs(heading @ aside) * box[3] / 2 + abs(across @ aside) * box[4] / 2
    if distance <= depth + FRONT_M:
        return False
    offsets = level_points[:, :2] - position
    along = offsets @ ahead
    near = (along > distance - depth - FRONT_M) & (along < distance - depth)
    inner = np.abs(offsets @ aside) < width / 2
    return int((near & inner).sum()) >= MIN_FRONT_POINTS
