"""Section of the report on continuous traffic: road users as they are followed and counted."""

import math
from collections.abc import Sequence

from placement_env.report import content
from placement_env.report.motion_content import (
    CountedGroup,
    FollowedClass,
    MotionFigures,
    RoadUserFigure,
)
from placement_env.report.pages.columns import text_columns
from placement_env.report.pages.decision import PLURALS
from placement_env.report.pages.document import (
    Bullets,
    Cell,
    Content,
    Paragraph,
    TableBlock,
    build_content,
    build_table,
)
from placement_env.report.pages.figure_texts import UNDEFINED_MARK, percent
from toolkit.display import describe_count


def motion_section(plan: content.Plan) -> Content:
    """Describe how the chosen set follows and counts road users in continuous traffic.

    The conclusion is about the class with the smallest share mostly tracked. Without
    figures it gives the reason."""
    motion = plan.motion
    if motion is None:
        return build_content("Road users were not followed.")
    if motion.refusal:
        return build_content(motion.refusal)
    if not motion.classes:
        return build_content(f"In {_describe_traffic(motion)}, nobody moved through the area.")
    return build_content(
        _conclude(motion),
        Paragraph(_explain_traffic(motion)),
        *_tabulate_classes(motion.classes),
        *_tabulate_counts(motion.counts),
        Bullets(tuple(content.TEXTS["motion"])),
    )


def describe_followed(row: FollowedClass) -> str:
    """Describe how many road users of a class are mostly tracked, with the interval of the share.

    Such as "5 of 6 moving vehicles are mostly tracked (44–97%)"."""
    count = round(row.mostly_tracked.value * row.road_users)
    are_tracked = "is mostly tracked" if row.road_users == 1 else "are mostly tracked"
    return (
        f"{count} of {row.road_users} moving {PLURALS[row.label]} {are_tracked} "
        f"({_share_interval_text(row.mostly_tracked)})"
    )


def describe_soonness(row: FollowedClass) -> str:
    """Describe how soon road users of a class are detected, "" if none comes in.

    It is the median time from coming in to the first detection."""
    if not row.entering:
        return ""
    if math.isinf(row.first_detection_s.value):
        return "most arrivals are never detected"
    if row.first_detection_s.value == 0:
        return "half the arrivals are detected in their first frame"
    return f"half the arrivals are detected within {row.first_detection_s.value:.1f} s"


def _conclude(motion: MotionFigures) -> str:
    """Return a sentence on the class that is followed worst."""
    worst = min(motion.classes, key=_share_tracked)
    text = f"In {_describe_traffic(motion)}, {describe_followed(worst)}"
    soonness = describe_soonness(worst)
    return f"{text}; {soonness}." if soonness else f"{text}."


def _share_tracked(row: FollowedClass) -> float:
    return row.mostly_tracked.value


def _describe_traffic(motion: MotionFigures) -> str:
    return f"{describe_count(round(motion.seconds), 'second')} of continuous traffic"


def _explain_traffic(motion: MotionFigures) -> str:
    """Describe the traffic, so that it can be made again."""
    return (
        f"The chosen sensors, mounted once with errors of profile {motion.errors}, saw "
        f"{motion.frames} frames at {1 / motion.interval_s:g} Hz that no search saw. The same "
        f"traffic is made by: coview simulate site.json --every {motion.interval_s:g} --frames "
        f"{motion.frames} --seed {motion.seed}."
    )


def _tabulate_classes(classes: Sequence[FollowedClass]) -> tuple[TableBlock, ...]:
    """Return a table with a row for each class."""
    columns = (
        *text_columns(
            "Class",
            "moving",
            "mostly tracked",
            "half within (s)",
            "95% within (s)",
            "never detected",
        ),
        *text_columns("speed error (km/h)"),
    )
    rows = []
    for row in classes:
        cells = (
            row.label,
            _count_cell(row.road_users),
            _share_cell(row.mostly_tracked),
            _number_cell(row.first_detection_s),
            _number_cell(row.first_detection_95_s),
            _share_cell(row.never_detected),
            _number_cell(row.speed_error_km_h),
        )
        rows.append(cells)
    return build_table(
        "Road users as live tracks follow them, and times from coming in to the first detection",
        columns,
        rows,
    )


def _tabulate_counts(counts: Sequence[CountedGroup]) -> tuple[TableBlock, ...]:
    """Return a table of trips, with a row for each group of classes that has true or counted trips.

    It is empty without such a group."""
    columns = text_columns("Group", "true trips", "counted", "found", "right", "speed error (km/h)")
    rows = []
    for row in counts:
        if row.true_count or row.count:
            cells = (
                row.group,
                _count_cell(row.true_count),
                _count_cell(row.count),
                _share_cell(row.found),
                _share_cell(row.right),
                _number_cell(row.speed_error_km_h),
            )
            rows.append(cells)
    return build_table("Trips from entry to exit, counted as by coview count", columns, rows)


def _count_cell(count: int) -> Cell:
    """Return a number of road users or trips, aligned as the texts next to it."""
    return Cell(str(count), count)


def _share_cell(figure: RoadUserFigure) -> Cell:
    """Return a share in percent with its interval."""
    if math.isnan(figure.value):
        return Cell(UNDEFINED_MARK)
    return Cell(f"{percent(figure.value)} ({_share_interval_text(figure)})", figure.value)


def _share_interval_text(figure: RoadUserFigure) -> str:
    """Format the interval of a share in percent, such as 44–97%."""
    return f"{100 * figure.low:.0f}–{100 * figure.high:.0f}%"


def _number_cell(figure: RoadUserFigure) -> Cell:
    """Return a number to one decimal with its interval; an infinite time reads "never"."""
    if math.isnan(figure.value):
        return Cell(UNDEFINED_MARK)
    value_text = _number_text(figure.value)
    if math.isnan(figure.low):
        return Cell(f"{value_text} (no interval)", figure.value)
    if math.isinf(figure.low):
        return Cell(value_text, figure.value)
    interval = f"{figure.low:.1f}–{figure.high:.1f}"
    if math.isinf(figure.high):
        interval = f"from {figure.low:.1f}"
    return Cell(f"{value_text} ({interval})", figure.value)


def _number_text(value: float) -> str:
    """Format a number to one decimal; an infinite time reads "never"."""
    return "never" if math.isinf(value) else f"{value:.1f}"
