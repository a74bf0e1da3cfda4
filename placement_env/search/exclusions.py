"""Reasons in words why sensors may not be built, or why nothing pays."""

import math

import numpy as np

from placement_env.classes import join_names
from placement_env.links import describe_share
from placement_env.objective import Objective
from toolkit.arrays import Bool


def describe_empty(objective: Objective) -> str:
    """Likely reason for an empty answer, with its remedy, to follow a colon.

    Links are checked first, then whether any single sensor detects something, and whether its AP
    exceeds its costs."""
    fits_link = objective.linked  # for each candidate
    if not fits_link.any():
        frames_text = describe_share(objective.setting.link_share)  # such as "every frame"
        min_kbit = float(objective.loads.min())
        max_capacity = float(objective.candidates.capacity.max())
        return (
            f"none of the {len(fits_link)} candidates fits its link: in {frames_text} they send up "
            f"to {min_kbit:.0f} kbit or more, and no link carries more than {max_capacity:.0f}: "
            "give mounts more, or pass --scheme late, which sends boxes"
        )
    single_sensors = np.eye(len(fits_link), dtype=np.bool_)[fits_link]
    singles = objective.scores(single_sensors)
    if float(singles.ap.max()) <= 0:
        nouns = " or a ".join(objective.classes.names)
        return (
            f"no candidate that fits its link detects a {nouns} in these frames: more --frames, "
            "other --candidates?"
        )
    if float(singles.reward.max()) <= 0:
        return "no sensor is worth what it costs: lower --comm and --price"
    return (
        "the search stopped before it had scored a set that may be built: give it more --seconds "
        "or --evaluations"
    )


def check_present(objective: Objective) -> None:
    """Raise ValueError if a counted class has no objects in the objective's traffic."""
    classes = objective.classes
    visibility = objective.visibility
    if visibility is not None:
        is_present = [bool((visibility.labels == label).any()) for label in classes.labels]
    else:
        # without objects the AP of a class is NaN, for any set
        all_candidates = np.ones((1, len(objective.candidates)), np.bool_)
        is_present = (~np.isnan(objective.class_ap(all_candidates)[0])).tolist()
    rows = zip(classes.names, is_present, strict=True)
    missing_names = [name for name, present in rows if not present]
    if missing_names:
        problem = f"there is no {' and no '.join(missing_names)} to find in these frames"
        raise ValueError(f"{problem}: say more --frames or another --seed, or leave out the class")


def describe_exclusions(
    objective: Objective, max_kbit: float | None = None, currency: str = ""
) -> tuple[str, ...]:
    """Sentences on what excludes candidates: links, the limit of kbit, the price.

    Each has the number of excluded candidates and the one that is closest to fitting. Empty if
    nothing is excluded.

    max_kbit: most kbit per frame that one sensor may send, None for any number; currency: "" for
    prices of one ordinary pole."""
    candidates = objective.candidates
    loads = objective.loads  # kbit per frame of each candidate
    exceeds_link = ~objective.linked
    count = len(candidates)
    reasons = []
    frames_text = describe_share(objective.setting.link_share)  # such as "every frame"
    if exceeds_link.any():
        closest_candidate = int(np.flatnonzero(exceeds_link)[np.argmin(loads[exceeds_link])])
        excluded_count = int(exceeds_link.sum())
        reasons.append(
            f"The links exclude {excluded_count} of {count} candidates: the least that any "
            f"of these sends in {frames_text} is up to {loads[closest_candidate]:.1f} kbit, over a "
            f"link of {candidates.capacity[closest_candidate]:g} kbit."
        )
    if max_kbit is not None and (loads > max_kbit).any():
        reasons.append(
            f"The limit of {max_kbit:g} kbit per sensor and frame excludes "
            f"{int((loads > max_kbit).sum())} of {count} candidates: the least that any candidate "
            f"sends in {frames_text} is up to {loads.min():.1f} kbit."
        )
    is_affordable = objective.affordable(candidates.prices)
    if not is_affordable.all():
        money = describe_money(objective.most_price, currency)
        excluded_count = int((~is_affordable).sum())
        costs = f"the cheapest of all costs {describe_money(candidates.prices.min(), currency)}"
        reasons.append(
            f"The sum of {money} excludes {excluded_count} of {count} candidates: {costs}."
        )
    return tuple(reasons)


def explain_kept(
    objective: Objective,
    is_allowed: Bool[np.ndarray, " candidates"],
    max_kbit: float = math.inf,
    currency: str = "",
) -> tuple[str, ...]:
    """Sentences on why the poles that must carry a sensor cannot all have one; empty if they can.

    is_allowed: candidates that may be built; max_kbit: most kbit per frame that one sensor may
    send; currency: "" for prices of one ordinary pole.
    """
    candidates = objective.candidates
    min_price = 0.0  # one sensor on each such pole
    reasons = list[str]()

    def compare_costs(amount: float) -> str:
        """Words for the amount that is needed, and for the amount that may be spent."""
        available = describe_money(objective.most_price, currency)
        return f"{describe_money(amount, currency)} or more, and {available} may be spent"

    for mount in objective.kept.tolist():
        name = candidates.mounts[mount].name
        poses = np.flatnonzero(candidates.mount == mount)
        if not len(poses):
            cause = "no pose on it sees the detection area"
        elif not objective.linked[poses].any():
            cause = (
                f"each pose sends more than its link of {candidates.capacity[poses[0]]:g} kbit per "
                "frame carries"
            )
        elif (objective.loads[poses] > max_kbit).all():
            cause = (
                f"each pose sends {objective.loads[poses].min():.1f} kbit per frame or more; "
                f"{max_kbit:g} are allowed"
            )
        elif not objective.affordable(candidates.prices[poses]).any():
            cause = f"a sensor there costs {compare_costs(float(candidates.prices[poses].min()))}"
        elif not is_allowed[poses].any():
            cause = "links, money and drawings of the site leave no pose"
        else:
            min_price += float(candidates.prices[poses][is_allowed[poses]].min())
            continue
        reasons.append(f"Pole {name} must carry a sensor, but cannot: {cause}.")
    if not reasons and not objective.affordable(np.array([min_price]))[0]:
        names = join_names([candidates.mounts[mount].name for mount in objective.kept])
        reasons.append(f"Sensors on {names}, as asked, cost together {compare_costs(min_price)}.")
    return tuple(reasons)


def describe_money(amount: float, currency: str) -> str:
    """Amount of money in words. currency: "" for an amount in prices of one ordinary pole."""
    if currency:
        return f"{round(amount, 2):,.10g} {currency}"
    return f"the price of {round(amount, 2):g} ordinary {'pole' if amount == 1 else 'poles'}"
