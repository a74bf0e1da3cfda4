"""Log of a training: a CSV file in long format with step, epoch, name and value."""

import csv
from pathlib import Path

from toolkit.runtime.writing import write_text

LOG = "log.csv"
_COLUMNS = ("step", "epoch", "name", "value")
_HEADER = ",".join(_COLUMNS)


def add_figures(path: Path, step: int, epoch: float, figures: dict[str, float]) -> None:
    """Append figures, by name, to the log; epoch: the step as a number of epochs."""
    rows = path.read_text().splitlines()[1:] if path.exists() else []
    rows += [f"{step},{epoch:.4f},{name},{value}" for name, value in figures.items()]
    write_text(path, "\n".join([_HEADER, *rows, ""]))


def cut_log(path: Path, step: int) -> None:
    """Drop log rows after `step`, the last checkpoint, and a last row that was cut off."""
    if path.exists():
        kept_rows = []
        for row in path.read_text().splitlines()[1:]:
            cells = row.split(",")
            is_whole = len(cells) == len(_COLUMNS) and cells[0].isdigit()
            if is_whole and int(cells[0]) <= step:
                kept_rows.append(row)
        write_text(path, "\n".join([_HEADER, *kept_rows, ""]))


def read_curves(path: Path) -> dict[str, tuple[list[float], list[float]]]:
    """Return the epochs and values of each figure by name, in the order of a log.

    path: CSV file with the columns name, epoch and value."""
    curves: dict[str, tuple[list[float], list[float]]] = {}
    with path.open(newline="") as file:
        for row in csv.DictReader(file):
            epochs, values = curves.setdefault(row["name"], ([], []))
            epochs.append(float(row["epoch"]))
            values.append(float(row["value"]))
    return curves
