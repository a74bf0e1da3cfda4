"""`coview count`: turning movements, speeds, dwell times and queues, with their errors."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from tyro.conf import Positional

from coview.arguments import check_ending
from coview.commands.detection.street import (
    Measuring,
    Street,
    StreetDemand,
    list_inputs,
    open_street,
)
from coview.commands.detection.street_tables import align_rows, write_rows
from coview.outputs import OK, Writing, check_file, print_result
from coview.recordings import Opening
from toolkit.calibration.place import Place
from toolkit.display import describe_count
from toolkit.plots.canvas import check_picture

if TYPE_CHECKING:
    from toolkit.counting.arms import Arm
    from toolkit.counting.counts import CountError, StreetCounts
    from toolkit.counting.trajectories import Trajectory

_Row = dict[str, object]


@dataclass(frozen=True, kw_only=True)
class CountFiles:
    """Files of counts."""

    out: Path | None = None
    """Table of movements to write (.csv)."""
    diagram: Path | None = None
    """Turning-movement diagram to write (.svg or .png)."""


def count_command(
    source: Positional[str],
    /,
    *,
    files: CountFiles = CountFiles(),
    measuring: Measuring = Measuring(),
    demand: StreetDemand = StreetDemand(),
    opening: Opening = Opening(),
    place: Place = Place(),
    writing: Writing = Writing(),
) -> int:
    """Count a street: turning movements by entry, exit and class, speeds, dwell times and queues.

    A recording is counted by its tracks, next to its truth if it has any. A site is counted by
    simulated traffic, and --stretch gives the errors of its sensors.

    Example: coview count street.hdf5 --detector tjunction+background --out counts.csv

    Example: coview count tjunction --hours 1 --flow flow.csv --diagram counts.svg

    Args:
        source: Recording in any layout with the time of each frame, or tjunction, roundabout, or a
            site file."""
    inputs = list_inputs(source, measuring, opening)
    for file in (files.out, files.diagram):
        check_file(file, inputs=inputs, overwrite=writing.overwrite)
    if files.out is not None:
        check_ending(files.out, (".csv",), "a table of counts")
    if files.diagram is not None:
        check_picture(files.diagram)
    street, stretch = open_street(
        source, measuring, demand, opening, place=place, hidden=writing.json
    )
    result = _count(street)
    if stretch is not None:
        result["stretch"] = _count(stretch)
    rows: list[_Row] = result["movements"]  # type: ignore[assignment]
    if files.out is not None:
        from toolkit.counting.counts import MovementCount

        write_rows(
            files.out,
            list(rows[0]) if rows else [field.name for field in fields(MovementCount)],
            rows,
        )
    if files.diagram is not None:
        _draw(street, files.diagram)
    print_result(result, _describe(result), as_json=writing.json)
    return OK


def _count(street: Street) -> _Row:
    """Counts of a street as a JSON object, with their errors if both tracks and truth are known."""
    from toolkit.counting.arms import find_arms
    from toolkit.counting.counts import compare_counts

    arms = find_arms(street.site)
    true = _count_trajectories(street, street.true, arms)
    measured = _count_trajectories(street, street.measured, arms)
    counts = measured or true
    assert counts is not None
    if measured is not None and true is not None:
        movements = [_list_error(error) for error in compare_counts(measured, true)]
    else:
        movements = [asdict(movement) for movement in counts.movements]
    queues = {queue.entry: queue._asdict() for queue in counts.queues}
    if measured is not None and true is not None:
        for queue in true.queues:
            row = queues.setdefault(queue.entry, {"entry": queue.entry, "mean": 0.0, "longest": 0})
            row |= {"true_mean": queue.mean, "true_longest": queue.longest}
    return {
        "site": street.site.name,
        "seconds": counts.seconds,
        "counted": "truth" if measured is None else "tracks",
        "totals": _list_totals(measured, true),
        "movements": movements,
        "queues": [queues[entry] for entry in sorted(queues)],
        "partial": counts.partial,
    }


def _count_trajectories(
    street: Street, trajectories: "list[Trajectory] | None", arms: "Sequence[Arm]"
) -> "StreetCounts | None":
    """Counts of trajectories; None without any."""
    from toolkit.counting.counts import count_street

    if trajectories is None:
        return None
    return count_street(trajectories, street.site, arms, street.times)


def _list_error(error: "CountError") -> _Row:
    """Row of a movement with its error."""
    return asdict(error) | {"error": error.count - error.true_count}


def _list_totals(measured: "StreetCounts | None", true: "StreetCounts | None") -> list[_Row]:
    """Totals by group of classes, with their errors if both are known."""
    from toolkit.counting.counts import GROUPS, match_trips, wilson_interval

    rows = []
    for group, labels in GROUPS.items():
        counts = measured or true
        assert counts is not None
        row: _Row = {
            "group": group,
            "count": counts.total(*labels),
            "speed_km_h": counts.mean_speed(*labels),
        }
        if measured is not None and true is not None:
            matches = match_trips(measured, true, *labels)
            row |= {
                "true_count": true.total(*labels),
                "error": measured.total(*labels) - true.total(*labels),
                "true_speed_km_h": true.mean_speed(*labels),
                "found_share": matches.right / matches.true if matches.true else float("nan"),
                "found_interval": wilson_interval(matches.right, matches.true),
                "right_share": matches.right / matches.counted if matches.counted else np.nan,
                "right_interval": wilson_interval(matches.right, matches.counted),
            }
        rows.append(row)
    return rows


def _draw(street: Street, out: Path) -> None:
    """Draw the turning movements of what was counted."""
    from toolkit.counting.arms import find_arms
    from toolkit.plots.turning_diagram import ArmBearing, draw_turning_diagram
    from toolkit.sites.georeference import bearing_deg

    arms = find_arms(street.site)
    trajectories = street.true if street.measured is None else street.measured
    counts = _count_trajectories(street, trajectories, arms)
    assert counts is not None
    bearings = [
        ArmBearing(arm.name, bearing_deg(street.site, float(np.arctan2(*arm.direction[::-1]))))
        for arm in arms
    ]
    source = "true road users" if street.measured is None else "tracks"
    draw_turning_diagram(
        counts.movements,
        bearings,
        out,
        title=f"Turning movements at {street.site.name}",
        subtitle=f"{describe_count(round(counts.seconds / 60), 'minute')}, {source}",
    )


def _describe(result: _Row) -> str:
    """Text of counts: totals, then movements."""
    totals: list[_Row] = result["totals"]  # type: ignore[assignment]
    movements: list[_Row] = result["movements"]  # type: ignore[assignment]
    seconds = result["seconds"]
    lines = [f"{result['site']}: {seconds:.0f} s, counted by {result['counted']}"]
    for row in totals:
        lines.append(_describe_total(row))
    if movements:
        names = list(movements[0])
        lines.append(align_rows(names, movements, texts=3))
    stretch: _Row | None = result.get("stretch")  # type: ignore[assignment]
    if stretch is not None:
        lines.append("errors of the sensors, in a stretch with rays:")
        lines.append(_describe(stretch))
    return "\n".join(lines)


def _describe_total(row: dict[str, Any]) -> str:
    """Line of a group of classes; figures without road users are left out."""
    group = str(row["group"]).removesuffix("s")
    parts = [_describe_number(describe_count(row["count"], group), row["speed_km_h"])]
    if "true_count" in row:
        parts.append(_describe_number(f"true {row['true_count']}", row["true_speed_km_h"]))
        if row["true_count"]:
            low, high = row["found_interval"]  # at 95 %
            parts.append(
                f"{row['found_share']:.1%} of the true ones found ({low:.1%} to {high:.1%})"
            )
        if row["count"]:
            parts.append(f"{row['right_share']:.1%} of the counted ones right")
    return "; ".join(parts)


def _describe_number(count: str, speed_km_h: float) -> str:
    """Text of a count with its mean speed (km/h), NaN if there is none."""
    return count if np.isnan(speed_km_h) else f"{count}, {speed_km_h:.1f} km/h"
