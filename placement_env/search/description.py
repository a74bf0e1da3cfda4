"""Sets of sensors, their scores and assessments in words."""

import math
from collections.abc import Mapping, Sequence

import numpy as np

from placement_env.analysis.intervals import describe_interval, describe_sureness
from placement_env.candidates.candidates import aims
from placement_env.handover.mounted import set_names
from placement_env.objective import Objective, Score
from placement_env.protocol import Doubting
from placement_env.search.portfolio.curve import CurvePoint
from placement_env.search.result import Assessment, Contender, ProfileAP
from toolkit.display import figure_digits, format_share
from toolkit.sensors.models import name_in_words
from toolkit.sensors.sensor import Sensor
from toolkit.sites.georeference import bearing_deg
from toolkit.sites.site import Site

MIN_LEVEL_OBJECTS = 100  # a level of traffic with fewer objects gets a warning


def describe_sensors(
    names: Sequence[str], moved_sensors: Sequence[Sensor] = (), site: Site | None = None
) -> list[str]:
    """Lines with the names of sensors, and any new positions (m) and directions (degrees).

    Directions are compass bearings at a site, otherwise headings from +x.

    names: names of the candidates; moved_sensors: the same sensors in new poses, empty if they
    stay; site: None for sensors without one.
    """
    if not moved_sensors:
        return list(names)
    headings, tilts = aims(moved_sensors)  # rad
    if site is None:
        directions = [
            f"heading {degrees:.1f} (from +x)" for degrees in np.rad2deg(headings).tolist()
        ]
    else:
        directions = [
            # the remainder after rounding, so that 359.99 becomes 0.0
            f"bearing {round(bearing_deg(site, heading), 1) % 360:.1f}"
            for heading in headings.tolist()
        ]
    text = "{} moved to x {:.2f} y {:.2f} z {:.2f} m, {} tilt {:.1f} degrees"
    rows = zip(names, moved_sensors, directions, np.rad2deg(tilts).tolist(), strict=True)
    return [
        text.format(name, *sensor.position, direction, tilt_deg)
        for name, sensor, direction, tilt_deg in rows
    ]


def describe_mounted(objective: Objective, subset: Sequence[int]) -> list[str]:
    """Lines on each sensor of a set: its name, model, height above the mount's foot, direction.

    subset: indices of the candidates."""
    candidates = objective.candidates
    site = objective.site
    sensors = [candidates.sensors[c] for c in subset]
    headings, tilts = aims(sensors)  # rad, from +x and below the horizon
    lines = []
    for k, name in enumerate(set_names(candidates, subset)):
        mount = candidates.mounts[candidates.mount[subset[k]]]
        z = sensors[k].position[2]
        foot_z = mount.position[2]
        height = f"{z - foot_z:.1f} m up"
        if site is None:
            facing = f"facing {np.rad2deg(headings[k]):.0f} degrees from +x"
        else:
            facing = f"facing {bearing_deg(site, float(headings[k])):.0f} degrees from north"
        down = f"{np.rad2deg(tilts[k]):.0f} degrees down"
        model_name = name_in_words(type(sensors[k].model).__name__)
        lines.append(f"{name}: {model_name}, {height}, {facing}, {down}")
    return lines


def describe_estimate(
    figure: Assessment | CurvePoint | Contender | ProfileAP, fidelity: str, object_count: int
) -> str:
    """AP or coverage of a set with its interval, in as many decimals as the objects support.

    figure: has `ap`, which is the coverage if the fidelity is "coverage", and the ends `low` and
    `high` of its interval; fidelity: name of the fidelity that measured them; object_count: number
    of objects that they were measured on.
    """
    interval = describe_interval(figure.low, figure.high, figure_digits(object_count))
    name = "coverage" if fidelity == "coverage" else "AP"
    return f"{name} {format_share(figure.ap, object_count)} ({interval})"


def describe_score(score: Score) -> str:
    """Figures of a set in one line: AP or coverage, also by class if several, recall and costs."""
    by_class = ""
    if len(score.class_ap) > 1:
        class_texts = [f"{name} {ap:.4f}" for name, ap in score.class_ap.items()]
        by_class = f" ({', '.join(class_texts)})"
    costs = (
        f"{score.kbit_per_sensor:.1f} kbit per sensor, {score.kbit:.1f} kbit, price {score.price:g}"
    )
    if score.fidelity == "coverage":
        return f"coverage {score.ap:.4f}{by_class}, {costs}"
    return f"AP {score.ap:.4f}{by_class}, recall {score.recall:.4f}, {costs} ({score.fidelity})"


def describe_assessment(assessment: Assessment) -> list[str]:
    """Lines on the assessment of the answer, and of each search's answer if it was assessed."""
    caveat = "" if assessment.by == "detector" else ", not a detector: it may err alike everywhere"
    object_count = assessment.objects
    rivals = f"{assessment.entrants} compared sets is better by more than {assessment.tolerance:g}"
    sureness = f"  {describe_sureness(assessment.confidence)} sure that none of the {rivals}"
    if math.isnan(assessment.confidence):
        sureness = f"  too few frames or objects to say how sure it is that none of the {rivals}"
    elif assessment.confidence < assessment.asked:
        sureness += f", short of the {assessment.asked:.0%} asked for"
    lines = [
        (
            f"judged by the {assessment.by} on {assessment.frames} frames that had no part in the "
            f"choice{caveat}:"
        ),
        f"  {describe_estimate(assessment, assessment.by, object_count)} on {object_count} "
        f"objects, {assessment.kbit:.1f} kbit a frame; estimated "
        f"{format_share(assessment.predicted, object_count)} by the search, "
        f"{format_share(assessment.expected, object_count)} after the race",
        sureness,
    ]
    if assessment.by_errors:
        lines.append(
            f"  the {assessment.errors_by} over error profiles: "
            f"{describe_profiles(assessment.by_errors, object_count)}"
        )
    for contender in assessment.contenders:
        searches = " and ".join(contender.searches)
        estimate = describe_estimate(contender, assessment.by, object_count)
        predicted = format_share(contender.predicted, object_count)
        excess = format_share(contender.curse, object_count, signed=True)
        lines.append(f"  {searches}: {estimate}, predicted {predicted}, {excess} too much")
    return lines


def describe_profiles(by_errors: Sequence[ProfileAP], object_count: int) -> str:
    """AP at each error profile separately, in words.

    object_count: number of objects in the frames."""
    return ", ".join(
        f"{profile.name} {describe_estimate(profile, 'detector', object_count)}"
        for profile in by_errors
    )


def describe_by_errors(by_errors: Mapping[str, float]) -> list[str]:
    """Line with the AP at each error profile; empty without error profiles."""
    figures = [f"{name} {ap:.4f}" for name, ap in by_errors.items()]
    return [f"AP at each error profile: {', '.join(figures)}"] if figures else []


def describe_doubts(objective: Objective, subset: Sequence[int]) -> list[str]:
    """Lines on a surrogate's standard error for a set, and warnings about extrapolation.

    Empty for other fidelities. subset: indices of the candidates, empty for the empty set."""
    surrogate = objective.scored_by
    if not isinstance(surrogate, Doubting):
        return []
    spread = np.nan
    if subset:
        (spread,) = surrogate.spread(objective.row(subset)[None]).tolist()
    error = "an unknown error" if np.isnan(spread) else f"a standard error of {spread:.3f}"
    model_names = {type(sensor.model).__name__ for sensor in objective.candidates.sensors}
    # `doubts`: warnings about sensor models that the surrogate was not fitted to
    warnings = [*surrogate.doubts(model_names), *_warn_of_few_objects(objective)]
    lines = [f"the surrogate predicts the detector's AP with {error}"]
    return lines + [f"warning: {warning}" for warning in warnings]


def _warn_of_few_objects(objective: Objective) -> list[str]:
    """Warning about levels of traffic with too few objects, as a list; empty if all have enough."""
    # number of objects at each level, by its name
    counts = {} if objective.preparation is None else objective.preparation.count_at_levels()
    low_counts = [
        f"{name} has {count}" for name, count in counts.items() if count < MIN_LEVEL_OBJECTS
    ]
    remedy = f"fewer than {MIN_LEVEL_OBJECTS} objects at a level say little: increase --frames"
    return [f"{' and '.join(low_counts)} objects to find; {remedy}"] if low_counts else []
