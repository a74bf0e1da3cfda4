"""Cases, classes and codec of the question in plan.json."""

from dataclasses import replace

import numpy as np

from placement_env.cases import MAX_FAILING, MAX_LEVELS, Cases
from placement_env.classes import Classes
from toolkit.detection.codec import Codec
from toolkit.detection.link.range_images import CODECS, find_codec
from toolkit.runtime.json_object import JsonObject
from toolkit.runtime.reading import name_errors
from toolkit.sensors.error_profiles import PROFILES

PLAN_AGAIN = "make the plan again with coview plan"


def read_cases(question: JsonObject) -> Cases:
    """Read the conditions under which sets are scored: IoU, failures, traffic levels and errors.

    Raises ValueError for a wrong member and for an unknown error profile.

    question: `question` of a plan.json."""
    has_several_ious = isinstance(question.value.get("iou"), list)
    ious = tuple(question.numbers("iou")) if has_several_ious else (question.number("iou"),)
    errors = question.texts("errors")
    for name in errors:
        if name not in PROFILES:
            profile_names = ", ".join(PROFILES)
            raise ValueError(
                f"question.errors has a profile {name[:60]!r} that is not one of {profile_names}: "
                f"{PLAN_AGAIN}"
            )
    with name_errors("question"):
        return Cases(
            iou=ious,
            failing=question.whole("failing", low=0, high=MAX_FAILING),
            failures=question.choice("failures", ("worst", "mean")),  # type: ignore[arg-type]
            levels=question.whole("levels", low=1, high=MAX_LEVELS),
            levels_by=question.choice("levels_by", ("worst", "mean")),  # type: ignore[arg-type]
            errors=tuple(errors),
            errors_by=question.choice("errors_by", ("worst", "mean")),  # type: ignore[arg-type]
        )


def read_classes(question: JsonObject, cases: Cases) -> Classes:
    """Read the classes that count, with their weights and IoU thresholds.

    A class has a threshold only if it differs from the one that the cases give it.
    Raises ValueError for a wrong member.

    question: `question` of a plan.json; cases: its cases, already read."""
    names = question.texts("classes")
    weights = question.numbers("class_weights")
    stated_ious = question.get("class_ious", list)
    with name_errors("question"):
        combine = question.choice("combine", ("mean", "worst"))
        # classes without thresholds that differ from the thresholds of the cases
        classes = Classes(tuple(names), tuple(weights), combine)  # type: ignore[arg-type]
        if len(stated_ious) != len(classes.names):
            raise ValueError(
                f"class_ious must hold one for each of {', '.join(classes.names)}, got "
                f"{len(stated_ious)}"
            )
        ious = [
            _find_class_iou(cases, classes, name, stated_iou)
            for name, stated_iou in zip(classes.names, stated_ious, strict=True)
        ]
        return replace(classes, ious=tuple(ious))


def _find_class_iou(cases: Cases, classes: Classes, name: str, stated: object) -> float | None:
    """Return the IoU threshold of a class, None if the cases give it the same one.

    Args:
        cases: Cases of the question.
        classes: The classes without thresholds that differ from the thresholds of the cases.
        name: Name of the class.
        stated: JSON value for this class: a number, or the list of the question's thresholds.

    Raises ValueError for another value."""
    usual_ious = cases.class_ious(classes, name)
    if stated == usual_ious or stated == list(np.atleast_1d(usual_ious)):
        return None
    if isinstance(stated, bool) or not isinstance(stated, int | float):
        raise ValueError(
            f"class_ious of {name} must be one number, or the IoU of the question, got "
            f"{stated!r:.60}"
        )
    return float(stated)


def read_codec(question: JsonObject) -> Codec:
    """Return the codec whose digest a question states. Raises ValueError for an unknown one."""
    digest = question.get("codec", str)
    for name in CODECS:
        if find_codec(name).digest == digest:
            return find_codec(name)
    raise ValueError(
        f"question.codec must belong to {' or '.join(CODECS)}, got {digest[:60]!r}: {PLAN_AGAIN}"
    )
