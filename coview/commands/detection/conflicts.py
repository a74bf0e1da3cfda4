"""`coview conflicts`: road users whose ways cross shortly after each other."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from tyro.conf import Positional

from coview.arguments import check_ending, check_positive
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

if TYPE_CHECKING:
    from toolkit.counting.conflicts import Conflict

PET_TOLERANCE_S = 0.3  # by which a conflict's PET may be longer than asked for, to match
MAX_LISTED_CONFLICTS = 20  # lines of text
_COLUMNS = (
    *("time", "first_label", "second_label", "first", "second"),
    *("pet_s", "ttc_s", "angle_deg", "x", "y"),
)


@dataclass(frozen=True, kw_only=True)
class Severity:
    """Conflicts that are listed."""

    out: Path | None = None
    """Table of conflicts to write (.csv)."""
    max_pet: float = 1.5
    """Longest post-encroachment time (s)."""


def conflicts_command(
    source: Positional[str],
    /,
    *,
    severity: Severity = Severity(),
    measuring: Measuring = Measuring(),
    demand: StreetDemand = StreetDemand(),
    opening: Opening = Opening(),
    place: Place = Place(),
    writing: Writing = Writing(),
) -> int:
    """List conflicts: pairs of road users whose ways cross, with post-encroachment time and time to
    collision.

    A recording is searched by its tracks; if it has truth, the shares of conflicts found and of
    false ones are stated. A site is searched by simulated traffic, and --stretch gives these shares
    for its sensors.

    Example: coview conflicts street.hdf5 --detector tjunction+background --out conflicts.csv

    Example: coview conflicts roundabout --hours 1 --max-pet 1.5

    Args:
        source: Recording in any layout with the time of each frame, or tjunction, roundabout, or a
            site file."""
    from toolkit.counting.conflicts import MAX_PET_S

    check_positive("--max-pet", severity.max_pet)
    if severity.max_pet > MAX_PET_S:
        raise ValueError(f"--max-pet must be at most {MAX_PET_S:g} s, got {severity.max_pet:g}")
    inputs = list_inputs(source, measuring, opening)
    check_file(severity.out, inputs=inputs, overwrite=writing.overwrite)
    if severity.out is not None:
        check_ending(severity.out, (".csv",), "a table of conflicts")
    street, stretch = open_street(
        source, measuring, demand, opening, place=place, hidden=writing.json
    )
    result = _search(street, severity.max_pet)
    if stretch is not None:
        result["stretch"] = _search(stretch, severity.max_pet)
    if severity.out is not None:
        write_rows(severity.out, _COLUMNS, result["conflicts"])
    print_result(result, _describe(result), as_json=writing.json)
    return OK


def _search(street: Street, max_pet: float) -> StreetRow:
    """Conflicts of a street as a JSON object, with shares if both tracks and truth are known.

    max_pet: longest post-encroachment time (s) of a conflict that counts."""
    from toolkit.counting.conflicts import find_conflicts, match_conflicts

    # longer ones too, which may match
    longest = max_pet + PET_TOLERANCE_S
    area = street.site.area
    true_conflicts = (
        None if street.true is None else find_conflicts(street.true, area, max_pet=longest)
    )
    track_conflicts = (
        None if street.measured is None else find_conflicts(street.measured, area, max_pet=longest)
    )
    listed_conflicts = true_conflicts if track_conflicts is None else track_conflicts
    assert listed_conflicts is not None
    result: StreetRow = {
        "site": street.site.name,
        "seconds": street.times[-1] - street.times[0] if len(street.times) else 0.0,
        "searched": "truth" if track_conflicts is None else "tracks",
        "max_pet_s": max_pet,
        "conflicts": [
            _list_row(conflict) for conflict in listed_conflicts if conflict.pet_s <= max_pet
        ],
    }
    if track_conflicts is not None and true_conflicts is not None:
        matches = match_conflicts(
            track_conflicts, true_conflicts, max_pet=max_pet, tolerance=PET_TOLERANCE_S
        )
        pet_errors_s = np.abs(matches.pet_errors_s)
        nan = float("nan")
        result |= {
            "true_conflicts": matches.true,
            "found_share": matches.detected / matches.true if matches.true else nan,
            "false_share": 1 - matches.right / matches.found if matches.found else nan,
            "pet_error_95_s": float(np.quantile(pet_errors_s, 0.95)) if len(pet_errors_s) else nan,
        }
    return result


def _list_row(conflict: "Conflict") -> StreetRow:
    """Row of a conflict, by the names of `_COLUMNS`."""
    values = conflict._asdict()
    values["first_label"], values["second_label"] = conflict.labels
    return {name: values[name] for name in _COLUMNS}


def _describe(result: StreetRow) -> str:
    """Text of conflicts: their number, shares found and false, and the shortest PETs."""
    rows = result["conflicts"]
    text = (
        f"{result['site']}: {len(rows)} conflicts with a PET of at most {result['max_pet_s']:g} s "
        f"in {result['seconds']:.0f} s, searched by {result['searched']}"
    )
    lines = [text]
    if "true_conflicts" in result:
        figures = [f"true {result['true_conflicts']}"]
        if np.isfinite(result["found_share"]):
            figures.append(f"{result['found_share']:.1%} of them found")
        if np.isfinite(result["false_share"]):
            figures.append(f"{result['false_share']:.1%} of the found ones false")
        if np.isfinite(result["pet_error_95_s"]):
            figures.append(f"error of PET at 95 %: {result['pet_error_95_s']:.2f} s")
        lines.append("; ".join(figures))
    shortest = sorted(rows, key=lambda row: float(row["pet_s"]))[:MAX_LISTED_CONFLICTS]
    if shortest:
        # the first three columns are texts
        lines.append(align_rows(_COLUMNS, shortest, texts=3))
    # results of a stretch with rays have the same keys, so this function describes them too
    return "\n".join(lines + describe_stretch(result, _describe))
