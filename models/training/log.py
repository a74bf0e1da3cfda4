"""The log of a training: a CSV file in long format, one figure per row (step, epoch, name, value)."""

from __future__ import annotations

import csv
from pathlib import Path

from toolkit.runtime.files import write_text

LOG = "log.csv"
HEADER = ("step", "epoch", "name", "value")


def add(path: Path, step: int, epoch: float, figures: dict[str, float]) -> None:
    """Append figures."""
    rows = _rows(path) + [f"{step},{epoch:.4f},{name},{value}" for name, value in figures.items()]
    write_text(path, "\n".join([",".join(HEADER), *rows, ""]))


def cut(path: Path, step: int) -> None:
    """Drop what a killed training logged after its last checkpoint, at `step`: those steps are done again."""
    if path.exists():
        kept = [row for row in _rows(path) if row.count(",") == 3 and _step(row) <= step]
        write_text(path, "\n".join([",".join(HEADER), *kept, ""]))


def curves(path: Path) -> dict[str, tuple[list[float], list[float]]]:
    """Epochs and values of each figure in a log, in the order they first appear."""
    found: dict[str, tuple[list[float], list[float]]] = {}
    with path.open(newline="") as file:
        for row in csv.DictReader(file):
            epochs, values = found.setdefault(row["name"], ([], []))
            epochs.append(float(row["epoch"]))
            values.append(float(row["value"]))
    return found


def _rows(path: Path) -> list[str]:
    return path.read_text().splitlines()[1:] if path.exists() else []


def _step(row: str) -> float:
    step = row.split(",", 1)[0]
    return float(step) if step.isdigit() else float("inf")
