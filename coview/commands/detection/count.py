"""`coview count`: turning movements, speeds, dwell times and queues, with their errors."""

from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

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
from coview.commands.detection.street_tables import (
    StreetRow,
    align_rows,
    describe_stretch,
    write_rows,
)
from coview.outputs import OK, Writing, check_file, print_result
from coview.recordings import Opening
from toolkit.calibration.place import Place
from toolkit.display import describe_count
from toolkit.plots.canvas import check_picture

if TYPE_CHECKING:
    from toolkit.counting.arms import Arm
    from toolkit.counting.counts import CountError, StreetCounts


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
    counted = _CountedStreet.from_street(street)
    result = counted.as_dict()
    if stretch is not None:
        result["stretch"] = _CountedStreet.from_street(stretch).as_dict()
    _write(files, counted, result["movements"])
    print_result(result, _describe(result), as_json=writing.json)
    return OK


def _write(files: CountFiles, counted: "_CountedStreet", movements: list[StreetRow]) -> None:
    """Write the table and the diagram, each if it is named.

    Both appear at the end, one right after the other, so that a killed run leaves neither."""
    from toolkit.counting.counts import MovementCount
    from toolkit.runtime.writing import writing

    with ExitStack() as unfinished_files:
        if files.out is not None:
            columns = [field.name for field in fields(MovementCount)]
            table = unfinished_files.enter_context(writing(files.out))
            write_rows(table, list(movements[0]) if movements else columns, movements)
        if files.diagram is not None:
            counted.draw(unfinished_files.enter_context(writing(files.diagram)))


class _CountedStreet(NamedTuple):
    """Counts of a street.

    Attributes:
        street: the street.
        arms: its arms.
        measured: counts of the tracks, None for simulated traffic without rays.
        true: true counts, None for a recording without truth."""

    street: Street
    arms: "Sequence[Arm]"
    measured: "StreetCounts | None"
    true: "StreetCounts | None"

    @classmethod
    def from_street(cls, street: Street) -> "_CountedStreet":
        """Count the road users of a street."""
        from toolkit.counting.arms import find_arms
        from toolkit.counting.counts import count_street

        arms = find_arms(street.site)
        # of tracks and of the truth, None if they are unknown
        counts = [
            None
            if road_users is None
            else count_street(road_users, street.site, arms, street.times)
            for road_users in (street.measured, street.true)
        ]
        return cls(street, arms, *counts)

    @property
    def counts(self) -> "StreetCounts":
        """Counts of the tracks, or the true ones without tracks."""
        counts = self.measured or self.true
        assert counts is not None
        return counts

    def as_dict(self) -> StreetRow:
        """Counts as a JSON object, with their errors if both tracks and truth are known."""
        from toolkit.counting.counts import compare_counts

        movements = [asdict(movement) for movement in self.counts.movements]
        queues = {queue.entry: queue._asdict() for queue in self.counts.queues}
        if self.measured is not None and self.true is not None:
            errors = compare_counts(self.measured, self.true)
            movements = [_list_error(error) for error in errors]
            for queue in self.true.queues:
                # an entry at which no queue was measured
                empty_queue = {"entry": queue.entry, "mean": 0.0, "longest": 0}
                row = queues.setdefault(queue.entry, empty_queue)
                row |= {"true_mean": queue.mean, "true_longest": queue.longest}
        return {
            "site": self.street.site.name,
            "seconds": self.counts.seconds,
            "counted": "truth" if self.measured is None else "tracks",
            "totals": _list_totals(self),
            "movements": movements,
            "queues": [queues[entry] for entry in sorted(queues)],
            "partial": self.counts.partial,
        }

    def draw(self, out: Path) -> None:
        """Draw the turning movements of what was counted."""
        from toolkit.plots.turning_diagram import ArmBearing, draw_turning_diagram
        from toolkit.sites.georeference import bearing_deg

        site = self.street.site
        bearings = []
        for arm in self.arms:
            # from the middle of the junction
            direction_x, direction_y = arm.direction
            bearing = bearing_deg(site, float(np.arctan2(direction_y, direction_x)))
            bearings.append(ArmBearing(arm.name, bearing))
        source = "true road users" if self.measured is None else "tracks"
        draw_turning_diagram(
            self.counts.movements,
            bearings,
            out,
            title=f"Turning movements at {site.name}",
            subtitle=f"{describe_count(round(self.counts.seconds / 60), 'minute')}, {source}",
        )


def _list_error(error: "CountError") -> StreetRow:
    """Row of a movement with its error."""
    return asdict(error) | {"error": error.count - error.true_count}


def _list_totals(counted: _CountedStreet) -> list[StreetRow]:
    """Totals by group of classes, with their errors if both tracks and truth are known."""
    from toolkit.counting.count_totals import compare_totals
    from toolkit.counting.counts import GROUPS

    if counted.measured is not None and counted.true is not None:
        return [asdict(total) for total in compare_totals(counted.measured, counted.true)]
    rows = []
    for group, labels in GROUPS.items():
        row: StreetRow = {
            "group": group,
            "count": counted.counts.total(*labels),
            "speed_km_h": counted.counts.mean_speed(*labels),
        }
        rows.append(row)
    return rows


def _describe(result: StreetRow) -> str:
    """Text of counts: totals, then movements, then the same of a stretch recorded with rays."""
    lines = [f"{result['site']}: {result['seconds']:.0f} s, counted by {result['counted']}"]
    for row in result["totals"]:
        lines.append(_describe_total(row))
    movements = result["movements"]
    if movements:
        lines.append(align_rows(list(movements[0]), movements, texts=3))
    return "\n".join(lines + describe_stretch(result, _describe))


def _describe_total(row: StreetRow) -> str:
    """Line of a group of classes; figures without road users are left out."""
    # `describe_count` adds the s of the plural
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
