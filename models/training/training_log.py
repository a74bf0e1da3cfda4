"""Log of a training: a CSV file in long format with step, epoch, name and value."""

import csv
from pathlib import Path

from toolkit.runtime.files import write_text

LOG = "log.csv"
_HEADER = "step,epoch,name,value"


def add_figures(path: Path, step: int, epoch: float, figures: dict[str, float]) -> None:
    """Append figures to the log."""
    rows = path.read_text().splitlines()[1:] if path.exists() else []
    rows += [f"{step},{epoch:.4f},{name},{value}" for name, value in figures.items()]
    write_text(path, "\n".join([_HEADER, *rows, ""]))


def cut_log(path: Path, step: int) -> None:
    """Drop log rows after `step`, the last checkpoint."""
    if path.exists():
        kept_rows = []
        for row in path.read_text().splitlines()[1:]:
            cells = row.split(",")
            is_whole = len(cells) == 4 and cells[0].isdigit()
            if is_whole and int(cells[0]) <= step:
                kept_rows.append(row)
        write_text(path, "\n".join([_HEADER, *kept_rows, ""]))


def read_curves(path: Path) -> dict[str, tuple[list[float], list[float]]]:
    """Return the epochs and values of each figure, in order."""
    curves: dict[str, tuple[list[float], list[float]]] = {}
    with path.open(newline="") as file:
        for row in csv.DictReader(file):
            epochs, values = curves.setdefault(row["name"], ([], []))
            epochs.append(float(row["epoch"]))
            values.append(float(row["value"]))
    return curves
