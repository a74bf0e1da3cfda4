"""Demand of continuous traffic: how many road users an hour go from which gate to which.

A gate is a place at the border of a site's network at which road users come in or leave. Its name
is the compass direction in which it lies from the middle of the detection area, such as "north" or
"south-east 2" for the second of two."""

import csv
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from toolkit.arrays import Float64, Rng
from toolkit.runtime.reading import read_text

ROAD_USER_KINDS = ("vehicle", "cyclist", "pedestrian")
KINDS_BY_EARLIER_NAME = {"walker": "pedestrian"}  # in tables of earlier versions
# road users an hour that come in at a gate, lowest and highest draw by kind
DRAWN_PER_HOUR = {"vehicle": (160.0, 320.0), "cyclist": (20.0, 80.0), "pedestrian": (60.0, 160.0)}
MAX_PER_HOUR = 3600.0  # at one gate, of one kind
_COLUMNS = ("kind", "entry", "exit", "per_hour")


class Movement(NamedTuple):
    """Road users of a kind that go from one gate to another.

    Attributes:
        kind: one of `ROAD_USER_KINDS`.
        entry: name of the gate at which they come in.
        exit: name of the gate at which they leave.
        per_hour: mean number of them in an hour."""

    kind: str
    entry: str
    exit: str
    per_hour: float


@dataclass(frozen=True)
class Flow:
    """Movements of an hour of traffic; those that are not listed do not take place.

    Raises ValueError for an unknown kind, a number below 0 or above `MAX_PER_HOUR`, and a movement
    that is listed twice."""

    movements: tuple[Movement, ...]

    def __post_init__(self) -> None:
        """Raise ValueError for a movement of an unknown kind, a wrong number, or listed twice."""
        listed = set()
        for movement in self.movements:
            if movement.kind not in ROAD_USER_KINDS:
                raise ValueError(
                    f"a movement is of {', '.join(ROAD_USER_KINDS)}, got {movement.kind!r}"
                )
            if not 0 <= movement.per_hour <= MAX_PER_HOUR:
                raise ValueError(
                    f"per_hour must be 0 to {MAX_PER_HOUR:g}, got {movement.per_hour:g} for "
                    f"{movement.kind}s from {movement.entry} to {movement.exit}"
                )
            if movement[:3] in listed:
                raise ValueError(
                    f"{movement.kind}s from {movement.entry} to {movement.exit} are listed twice"
                )
            listed.add(movement[:3])

    @cached_property
    def per_hour(self) -> Float64[np.ndarray, " movements"]:
        """Mean number of road users in an hour, for each movement."""
        return np.array([movement.per_hour for movement in self.movements], np.float64)

    @staticmethod
    def draw(possible: Mapping[str, Mapping[str, Sequence[str]]], rng: Rng) -> "Flow":
        """Draw the demand of each kind at each gate, and the shares of its exits.

        possible: by kind and entry, the exits that can be reached."""
        movements = []
        for kind in ROAD_USER_KINDS:
            for entry, exits in possible.get(kind, {}).items():
                per_hour = rng.uniform(*DRAWN_PER_HOUR[kind])
                shares = rng.dirichlet(np.full(len(exits), 2.0))
                for exit_name, share in zip(exits, shares.tolist(), strict=True):
                    movements.append(
                        Movement(kind, entry, exit=exit_name, per_hour=float(per_hour * share))
                    )
        return Flow(tuple(movements))

    @staticmethod
    def read(path: str | Path) -> "Flow":
        """Read a table (CSV) with the columns kind, entry, exit, per_hour.

        Kinds may have the names of earlier versions, such as walker for pedestrian.
        Raises ValueError, with the line, for another table or a number that is none."""
        path = Path(path)
        lines = read_text(path).splitlines()
        rows = csv.reader(lines)
        header = tuple(name.strip() for name in next(_read_rows(path, rows), []))
        if header != _COLUMNS:
            raise ValueError(
                f"{path} must begin with the columns {','.join(_COLUMNS)}, got {','.join(header)}"
            )
        movements = []
        for row in _read_rows(path, rows):
            if not any(cell.strip() for cell in row):
                continue
            where = f"{path}, line {rows.line_num}"
            if len(row) != len(_COLUMNS):
                raise ValueError(f"{where}: {len(_COLUMNS)} cells are needed, got {len(row)}")
            kind, entry, exit_name, number = (cell.strip() for cell in row)
            try:
                per_hour = float(number)
            except ValueError:
                raise ValueError(f"{where}: per_hour must be a number, got {number!r}") from None
            kind = KINDS_BY_EARLIER_NAME.get(kind, kind)
            movements.append(Movement(kind, entry, exit=exit_name, per_hour=per_hour))
        try:
            return Flow(tuple(movements))
        except ValueError as error:
            raise ValueError(f"{path}: {error}") from None

    def text(self) -> str:
        """Table (CSV) that `read` takes."""
        lines = [",".join(_COLUMNS)]
        lines += [
            f"{movement.kind},{movement.entry},{movement.exit},{movement.per_hour:.6g}"
            for movement in self.movements
        ]
        return "\n".join(lines) + "\n"

    def check(self, possible: Mapping[str, Mapping[str, Sequence[str]]]) -> None:
        """Raise ValueError, with what is possible, for a movement that the network has no way for.

        possible: by kind and entry, the exits that can be reached."""
        for kind, entry, exit_name, _ in self.movements:
            exits_by_entry = possible.get(kind, {})
            if entry not in exits_by_entry:
                gates = ", ".join(exits_by_entry) or "none"
                raise ValueError(f"no {kind} can come in at {entry!r}: its gates are {gates}")
            if exit_name not in exits_by_entry[entry]:
                exits = ", ".join(exits_by_entry[entry]) or "none"
                raise ValueError(
                    f"no {kind} can go from {entry!r} to {exit_name!r}: exits there are {exits}"
                )


def _read_rows(path: Path, rows: Any) -> Iterator[list[str]]:
    """Yield the cells of each row of a table.

    rows: a `csv.reader`. Raises ValueError, with the line, for a row that it cannot split, such as
    one with a cell of more than 131,072 characters."""
    try:
        yield from rows
    except csv.Error as error:
        raise ValueError(f"{path}, line {rows.line_num}: {error}") from None
