"""Scores of detections in continuous traffic: road users as they are followed and counted."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from placement_env.analysis.intervals import mean_interval
from placement_env.report.motion_content import CountedGroup, FollowedClass, RoadUserFigure
from toolkit.arrays import Float64, Mask
from toolkit.counting.arms import find_arms
from toolkit.counting.count_totals import CountedTotal, compare_totals
from toolkit.counting.counts import GROUPS, CountError, compare_counts, count_street, pair_trips
from toolkit.counting.fragments import join_fragments
from toolkit.counting.trajectories import collect_trajectories
from toolkit.detection.track_truth import find_motions
from toolkit.objects import Detections, Objects, label_index
from toolkit.points import has_centre_inside
from toolkit.share_intervals import quantile_interval, wilson_interval
from toolkit.sites.site import Site
from toolkit.tracking.frame_overlap import measure_overlap
from toolkit.tracking.object_errors import TrackedWay, collect_ways, find_quantile
from toolkit.tracking.scores import CLEAR_THRESHOLD, MOSTLY_TRACKED_SHARE, match_clear
from toolkit.tracking.smoothing import smooth_tracks
from toolkit.tracking.tracker import track_live

MIN_MOVE_M = 1.0  # between two places of a road user that moves
KM_H_PER_M_S = 3.6


class MovingStreet(NamedTuple):
    """Detections of a set in continuous traffic, next to the truth.

    Attributes:
        site: Site of the traffic.
        times: Time of each frame (s), ascending.
        detections: Detections of each frame, world frame.
        truths: All objects of each frame, with ids that last."""

    site: Site
    times: Sequence[float]
    detections: Sequence[Detections]
    truths: Sequence[Objects]


def follow_classes(
    street: MovingStreet, labels: Sequence[str], seed: int = 0
) -> tuple[FollowedClass, ...]:
    """Follow the road users by live tracks, and score each class that has road users that move.

    Road users that stay are not to be found; their tracks are no false alarms.

    labels: names of the classes; seed: for the intervals of means."""
    area = street.site.area
    tracks = track_live(street.detections, street.times, area.tolist())
    motions = find_motions(street.truths, street.times)
    counted = mask_moving(street.truths)
    for mask, objects in zip(counted, street.truths, strict=True):
        mask &= has_centre_inside(objects.boxes, area)
    rows = []
    for label in labels:
        overlaps = []
        for frame_tracks, objects, mask in zip(tracks, street.truths, counted, strict=True):
            overlap = measure_overlap(
                frame_tracks,
                objects,
                label_index(label),
                counted=mask,
                outside=~has_centre_inside(frame_tracks.boxes, area),
            )
            overlaps.append(overlap.scored(CLEAR_THRESHOLD))
        matches = match_clear([overlap.pairs for overlap in overlaps]).matches
        ways = collect_ways(overlaps, matches, tracks, motions)
        if ways:
            rows.append(_summarise_ways(label, ways, seed))
    return tuple(rows)


def mask_moving(truths: Sequence[Objects]) -> list[Mask]:
    """Mask of the objects of each frame that are `MIN_MOVE_M` or more from their first place once.

    truths: objects of each frame, with ids that last."""
    first_places: dict[int, np.ndarray] = {}
    moving: set[int] = set()
    for objects in truths:
        for number, xy in zip(objects.ids.tolist(), objects.boxes[:, :2], strict=True):
            offset = xy - first_places.setdefault(number, xy)
            if np.hypot(offset[0], offset[1]) >= MIN_MOVE_M:
                moving.add(number)
    return [np.isin(objects.ids, sorted(moving)) for objects in truths]


def _summarise_ways(label: str, ways: Sequence[TrackedWay], seed: int) -> FollowedClass:
    """Figures of the road users of a class, at least one.

    label: name of the class; ways: each road user's way, with its matches; seed: for the interval
    of the mean speed error."""
    is_tracked = [way.matched_frames > MOSTLY_TRACKED_SHARE * way.frames for way in ways]
    waits = np.array([way.wait_s for way in ways if way.comes_in], np.float64)
    speed_errors = [way.speed_error_mps for way in ways]
    return FollowedClass(
        label=label,
        road_users=len(ways),
        mostly_tracked=_find_share(sum(is_tracked), len(ways)),
        entering=len(waits),
        first_detection_s=_find_quantile_figure(waits, 0.5),
        first_detection_95_s=_find_quantile_figure(waits, 0.95),
        never_detected=_find_share(int(np.isinf(waits).sum()), len(waits)),
        speed_error_km_h=_find_mean([KM_H_PER_M_S * error for error in speed_errors], seed),
    )


class StreetErrors(NamedTuple):
    """Errors of counts.

    Attributes:
        groups: Counts of each group of classes.
        movements: Counts of each class by entry and exit."""

    groups: tuple[CountedGroup, ...]
    movements: tuple[CountError, ...]


def count_groups(street: MovingStreet, labels: Sequence[str], seed: int = 0) -> StreetErrors:
    """Count the trips of tracks that were smoothed over all frames, next to the true trips.

    labels: names of the classes; groups and movements of other classes are left out; seed: for
    the intervals of means."""
    site = street.site
    arms = find_arms(site)
    tracks = smooth_tracks(street.detections, street.times, site.area.tolist())
    trajectories = join_fragments(collect_trajectories(tracks, street.times))
    true_trajectories = collect_trajectories(street.truths, street.times)
    counts = count_street(trajectories, site, arms, street.times)
    truth = count_street(true_trajectories, site, arms, street.times)
    groups = []
    for total in compare_totals(counts, truth):
        group_labels = GROUPS[total.group]
        if not set(group_labels) & set(labels):
            continue
        errors = []
        for pair in pair_trips(counts, truth, *group_labels):
            errors.append(pair.counted.speed_km_h - pair.true.speed_km_h)
        groups.append(_summarise_total(total, errors, seed))
    movements = [error for error in compare_counts(counts, truth) if error.label in labels]
    return StreetErrors(tuple(groups), tuple(movements))


def _summarise_total(total: CountedTotal, speed_errors: Sequence[float], seed: int) -> CountedGroup:
    """Counts of a group, with intervals of its shares and of its mean speed error.

    total: counted and true trips; speed_errors: counted minus true mean speed of each trip (km/h);
    seed: for the interval of the mean."""
    return CountedGroup(
        group=total.group,
        count=total.count,
        true_count=total.true_count,
        error=total.error,
        found=RoadUserFigure(total.found_share, *total.found_interval),
        right=RoadUserFigure(total.right_share, *total.right_interval),
        speed_error_km_h=_find_mean(speed_errors, seed),
    )


def _find_share(count: int, total: int) -> RoadUserFigure:
    """Share that `count` is of `total` road users, with its interval; NaN without any."""
    share = count / total if total else float("nan")
    return RoadUserFigure(share, *wilson_interval(share, total))


def _find_quantile_figure(values: Float64[np.ndarray, " n"], share: float) -> RoadUserFigure:
    """Quantile of values of 0 or more, NaN without any.

    share: share of the values below it, 0.5 for the median."""
    if not len(values):
        return RoadUserFigure(float("nan"))
    low, high = quantile_interval(values.tolist(), share)
    return RoadUserFigure(find_quantile(values, share), low, high)


def _find_mean(values: Sequence[float], seed: int) -> RoadUserFigure:
    """Mean of the values that are finite, NaN without any."""
    finite = [value for value in values if np.isfinite(value)]
    if not finite:
        return RoadUserFigure(float("nan"))
    return RoadUserFigure(float(np.mean(finite)), *mean_interval(finite, seed=seed))
