"""Counts and conflicts of simulated hours, by offline tracks of what a detector would find.

    python tests/benchmarks/toolkit/bench_counts.py [--sites tjunction roundabout] [--hours 1]
        [--seeds 1 2 3] [--busier 1]

No rays are cast: each road user is missed, hidden and displaced as measured on recordings with rays
(`SIGHTINGS`), and false alarms come and go. The road users are tracked, counted and searched for
conflicts as `coview count` and `coview conflicts` do, and compared with the truth. `--busier` is a
factor of the drawn demand. Times are of the processor.
"""

import argparse
from collections.abc import Sequence
from itertools import pairwise
from time import process_time
from typing import NamedTuple

import numpy as np
from scipy.signal import lfilter

from coview.commands.detection.street import StreetDemand, choose_flow, simulate_street
from tests.benchmarks.figures import SITE_TITLES, record
from toolkit.counting.arms import find_arms
from toolkit.counting.conflicts import ConflictMatches, find_conflicts, match_conflicts
from toolkit.counting.counts import (
    GROUPS,
    CountError,
    StreetCounts,
    compare_counts,
    count_street,
    match_trips,
)
from toolkit.counting.fragments import join_fragments
from toolkit.counting.trajectories import Trajectory, collect_trajectories
from toolkit.objects import CYCLIST, HEAVY, PEDESTRIAN, VEHICLE, Detections
from toolkit.points import has_centre_inside
from toolkit.sites.site import Site
from toolkit.tracking.smoothing import smooth_tracks
from toolkit.traffic.flow import Flow

MAX_PET_S = 1.5
PET_TOLERANCE_S = 0.3
MAX_VEHICLE_ERROR = 0.01  # share of all vehicles
MAX_MOVEMENT_ERROR = 0.03  # share of a movement, or `MAX_MOVEMENT_TRIPS`
MAX_MOVEMENT_TRIPS = 2
MAX_CYCLIST_ERROR = 0.05
MAX_SPEED_ERRORS_KM_H = {"tjunction": 0.3, "roundabout": 0.8}
MIN_CONFLICT_SHARE = 0.9
MAX_PET_ERROR_S = 0.4  # of 95 %
FALSE_ALARMS = 0.5  # a frame, of pedestrians
FALSE_FRAMES = 3.0  # mean number of frames that each lasts


class Sighting(NamedTuple):
    """How a class of road users is detected, frame by frame.

    Attributes:
        missed: share of frames missed at random.
        hidings: share of frames in which it begins to be hidden.
        hidden_frames: mean number of frames that it is hidden.
        along_m: standard deviation of the place along the heading.
        across_m: standard deviation across it.
        size: standard deviation of length and width, as shares.
        yaw_rad: standard deviation of the heading.
        memory: correlation of these errors from one frame to the next."""

    missed: float
    hidings: float
    hidden_frames: float
    along_m: float
    across_m: float
    size: float
    yaw_rad: float
    memory: float


# of tjunction+background on three minutes of the T-junction with rays, profile paper
SIGHTINGS = {
    VEHICLE: Sighting(0.001, 0.001, 4.0, 0.07, 0.03, 0.03, 0.02, 0.85),
    HEAVY: Sighting(0.001, 0.001, 4.0, 0.12, 0.03, 0.03, 0.02, 0.4),
    CYCLIST: Sighting(0.005, 0.008, 2.5, 0.08, 0.03, 0.1, 0.15, 0.6),
    PEDESTRIAN: Sighting(0.005, 0.012, 3.0, 0.05, 0.05, 0.1, 0.4, 0.5),
}


class Outcome(NamedTuple):
    """Counts and conflicts of one hour.

    Attributes:
        site: name of the site.
        seed: seed of traffic and errors.
        counts: counts by tracks.
        truth: true counts.
        matches: conflicts found and true.
        simulation_s: time that the traffic took.
        tracking_s: time that the tracks took."""

    site: str
    seed: int
    counts: StreetCounts
    truth: StreetCounts
    matches: ConflictMatches
    simulation_s: float
    tracking_s: float


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--sites", nargs="+", default=["tjunction", "roundabout"])
    parser.add_argument("--hours", type=float, default=1.0)
    parser.add_argument("--seeds", nargs="+", type=int, default=[1, 2, 3])
    parser.add_argument("--busier", type=float, default=1.0)
    options = parser.parse_args()
    print("| site, seed | figure | by tracks | true | error | must be |")
    print("|---|---|---|---|---|---|")
    for site in options.sites:
        outcomes = []
        for seed in options.seeds:
            outcome = count_hour(site, seed, options.hours, options.busier)
            outcomes.append(outcome)
            print_counts(outcome)
            record_hour(outcome)
        print_conflicts(site, [outcome.matches for outcome in outcomes])


def count_hour(name: str, seed: int, hours: float, busier: float) -> Outcome:
    """Simulate a site, and count it by tracks of erroneous detections. busier: factor of demand."""
    demand = StreetDemand(hours=hours, seed=seed)
    drawn = choose_flow(name, demand)
    movements = [
        movement._replace(per_hour=busier * movement.per_hour) for movement in drawn.movements
    ]
    began = process_time()
    street = simulate_street(name, demand, Flow(tuple(movements)), hidden=True)
    simulation_s = process_time() - began
    assert street.true is not None
    frames = detect(street.true, street.times, street.site, np.random.default_rng([seed, 9]))
    began = process_time()
    tracks = smooth_tracks(frames, street.times, street.site.area.tolist())
    tracking_s = process_time() - began
    measured = join_fragments(collect_trajectories(tracks, street.times))
    arms = find_arms(street.site)
    found, true = (
        find_conflicts(users, street.site.area, max_pet=MAX_PET_S + PET_TOLERANCE_S)
        for users in (measured, street.true)
    )
    return Outcome(
        name,
        seed,
        count_street(measured, street.site, arms, street.times),
        count_street(street.true, street.site, arms, street.times),
        match_conflicts(found, true, max_pet=MAX_PET_S, tolerance=PET_TOLERANCE_S),
        simulation_s=simulation_s,
        tracking_s=tracking_s,
    )


def detect(
    road_users: Sequence[Trajectory], times: Sequence[float], site: Site, rng: np.random.Generator
) -> list[Detections]:
    """Detections in each frame: true road users in the area with errors, and false alarms."""
    box_parts = []
    label_parts = []
    frame_parts = []
    for user in road_users:
        sighting = SIGHTINGS[user.label]
        frames = np.searchsorted(times, user.times - 0.01)
        is_seen = has_centre_inside(user.boxes, site.area) & see(len(frames), sighting, rng)
        boxes = displace(user.boxes, sighting, rng)[is_seen]
        box_parts.append(boxes)
        label_parts.append(np.full(len(boxes), user.label))
        frame_parts.append(frames[is_seen])
    alarms = draw_false_alarms(len(times), site, rng)
    true_count = sum(map(len, box_parts))
    scores = np.append(rng.uniform(0.6, 0.98, true_count), rng.uniform(0.2, 0.6, len(alarms.boxes)))
    boxes = np.concatenate([*box_parts, alarms.boxes])
    labels = np.concatenate([*label_parts, np.full(len(alarms.boxes), PEDESTRIAN)])
    frames = np.concatenate([*frame_parts, alarms.frames])
    order = np.argsort(frames, kind="stable")
    everything = Detections(boxes[order], scores[order], labels[order])
    begin = np.searchsorted(frames[order], np.arange(len(times) + 1))
    return [everything[first:last] for first, last in pairwise(begin.tolist())]


def see(count: int, sighting: Sighting, rng: np.random.Generator) -> np.ndarray:
    """Mask of the frames, of a count, in which a road user is seen."""
    is_seen = rng.random(count) >= sighting.missed
    for first in np.flatnonzero(rng.random(count) < sighting.hidings).tolist():
        is_seen[first : first + rng.geometric(1 / sighting.hidden_frames)] = False
    return is_seen


def displace(boxes: np.ndarray, sighting: Sighting, rng: np.random.Generator) -> np.ndarray:
    """Boxes of one road user, frame after frame, with the errors of detections."""
    noise = rng.standard_normal((len(boxes), 5))
    memory = sighting.memory
    noise[1:] *= np.sqrt(1 - memory**2)
    noise = lfilter([1.0], [1.0, -memory], noise, axis=0)
    along = sighting.along_m * noise[:, 0]
    across = sighting.across_m * noise[:, 1]
    cos = np.cos(boxes[:, 6])
    sin = np.sin(boxes[:, 6])
    moved = boxes.copy()
    moved[:, 0] += along * cos - across * sin
    moved[:, 1] += along * sin + across * cos
    moved[:, 3:5] *= np.exp(sighting.size * noise[:, 2:4])
    moved[:, 6] += sighting.yaw_rad * noise[:, 4]
    return moved


class FalseAlarms(NamedTuple):
    """False pedestrians: frame and box of each."""

    frames: np.ndarray
    boxes: np.ndarray


def draw_false_alarms(count: int, site: Site, rng: np.random.Generator) -> FalseAlarms:
    """False alarms in a count of frames, each for some frames at one place."""
    starts = np.flatnonzero(rng.random(count) < FALSE_ALARMS / FALSE_FRAMES)
    lengths = rng.geometric(1 / FALSE_FRAMES, len(starts))
    places = rng.uniform(site.area[:2], site.area[2:], (len(starts), 2))
    frames = np.concatenate(
        [np.zeros(0, np.int64), *map(np.arange, starts, np.minimum(starts + lengths, count))]
    )
    boxes = np.zeros((len(frames), 7))
    shown = np.minimum(starts + lengths, count) - starts
    boxes[:, :2] = np.repeat(places, shown, axis=0) + rng.normal(0, 0.1, (len(frames), 2))
    boxes[:, 2:6] = (0.85, 0.6, 0.6, 1.7)
    return FalseAlarms(frames, boxes)


def print_counts(outcome: Outcome) -> None:
    """Print totals, the worst movement, mean speeds and times of an hour."""
    name = f"{outcome.site}, {outcome.seed}"
    print_row(name, "traffic, s", "", f"{outcome.simulation_s:.0f}", "", "")
    print_row(name, "tracking, s", f"{outcome.tracking_s:.0f}", "", "", "")
    for group, labels in GROUPS.items():
        count = outcome.counts.total(*labels)
        true = outcome.truth.total(*labels)
        matches = match_trips(outcome.counts, outcome.truth, *labels)
        limit = {"vehicles": MAX_VEHICLE_ERROR, "cyclists": MAX_CYCLIST_ERROR}.get(group)
        error = (count - true) / max(1, true)
        must = "" if limit is None else f"{limit:.0%}"
        print_row(name, group, count, true, f"{error:+.1%}", must)
        shares = f"{matches.found_share:.3f} of the true, {matches.right_share:.3f} of the counted"
        print_row(name, f"{group} matched", shares, "", "", "")
        if group == "vehicles":
            speed = outcome.counts.mean_speed(*labels)
            true_speed = outcome.truth.mean_speed(*labels)
            must = f"{MAX_SPEED_ERRORS_KM_H[outcome.site]}"
            figures = f"{speed:.2f}", f"{true_speed:.2f}", f"{speed - true_speed:+.2f}"
            print_row(name, f"{group}, km/h", *figures, must)
    errors = compare_counts(outcome.counts, outcome.truth)
    wrong = [describe_movement(error) for error in errors if is_wrong(error)]
    must = f"{MAX_MOVEMENT_ERROR:.0%} or {MAX_MOVEMENT_TRIPS}"
    print_row(name, "movements", len(errors), "", f"{len(wrong)} wrong {wrong}", must)


def record_hour(outcome: Outcome) -> None:
    """Record the counts and conflicts of an hour for the documentation."""
    cells = []
    for labels in GROUPS.values():
        count = outcome.counts.total(*labels)
        cells.append(f"{count} of {outcome.truth.total(*labels)}")
    errors = compare_counts(outcome.counts, outcome.truth)
    wrong_count = sum(is_wrong(error) for error in errors)
    matches = outcome.matches
    vehicles = GROUPS["vehicles"]
    speed_error = outcome.counts.mean_speed(*vehicles) - outcome.truth.mean_speed(*vehicles)
    recall = matches.detected / max(1, matches.true)
    precision = matches.right / max(1, matches.found)
    pet_error_s = np.quantile(np.abs(matches.pet_errors_s), 0.95) if matches.detected else np.nan
    cells += [
        f"{wrong_count} of {len(errors)}",
        f"{speed_error:+.2f} km/h",
        f"{recall:.3f}, {precision:.3f} of {matches.true}",
        f"{pet_error_s:.2f} s",
    ]
    record("counts", f"{SITE_TITLES[outcome.site]}, seed {outcome.seed}", cells)


def is_wrong(error: CountError) -> bool:
    """True for a movement whose count is farther off than it may be."""
    limit = max(MAX_MOVEMENT_TRIPS, MAX_MOVEMENT_ERROR * error.true_count)
    return abs(error.count - error.true_count) > limit


def describe_movement(error: CountError) -> str:
    """Words for a movement."""
    return f"{error.label} {error.entry}-{error.exit} {error.count} of {error.true_count}"


def print_conflicts(site: str, hours: Sequence[ConflictMatches]) -> None:
    """Print recall, precision and error of PET over all hours of a site."""
    true = sum(matches.true for matches in hours)
    found = sum(matches.found for matches in hours)
    if not true or not found:
        return
    recalls = [matches.detected / max(1, matches.true) for matches in hours]
    precisions = [matches.right / max(1, matches.found) for matches in hours]
    recall = sum(matches.detected for matches in hours) / true
    precision = sum(matches.right for matches in hours) / found
    errors = np.abs(np.concatenate([matches.pet_errors_s for matches in hours]))
    span = f"{min(recalls):.3f} to {max(recalls):.3f}"
    print_row(site, "conflicts, recall", f"{recall:.3f}", true, span, f"{MIN_CONFLICT_SHARE}")
    span = f"{min(precisions):.3f} to {max(precisions):.3f}"
    print_row(site, "conflicts, precision", f"{precision:.3f}", "", span, f"{MIN_CONFLICT_SHARE}")
    error = f"{np.quantile(errors, 0.95):.2f}"
    print_row(site, "PET of 95 %, s", "", "", error, f"{MAX_PET_ERROR_S}")


def print_row(*cells: object) -> None:
    """Print a row of the table."""
    print(f"| {' | '.join(map(str, cells))} |", flush=True)


if __name__ == "__main__":
    main()
