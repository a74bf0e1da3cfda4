"""The log of a training: a CSV file in long format, one figure per row (step, epoch, name, value)."""

from __future__ import annotations

import csv
import os
from pathlib import Path

HEADER = ("step", "epoch", "name", "value")


def add(path: Path, step: int, epoch: float, figures: dict[str, float]) -> None:
    """Append figures."""
    new = not path.exists() or path.stat().st_size == 0
    with path.open("a", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerows([HEADER] if new else [])
        writer.writerows((step, f"{epoch:.4f}", name, value) for name, value in figures.items())


def cut(path: Path, step: int) -> None:
    """Drop what a killed training logged after its last checkpoint, at `step`: those steps are done again."""
    if not path.exists():
        return
    kept = [row for row in path.read_text().splitlines()[1:] if row.count(",") == 3 and _step(row) <= step]
    unfinished = path.with_name(path.name + ".partial")
    unfinished.write_text("\n".join([",".join(HEADER), *kept]) + "\n")
    os.replace(unfinished, path)


def curves(path: Path) -> dict[str, tuple[list[float], list[float]]]:
    """Epochs and values of each figure in a log, in the order they first appear."""
    found: dict[str, tuple[list[float], list[float]]] = {}
    with path.open(newline="") as file:
        for row in csv.DictReader(file):
            epochs, values = found.setdefault(row["name"], ([], []))
            epochs.append(float(row["epoch"]))
            values.append(float(row["value"]))
    return found


def _step(row: str) -> float:
    step = row.split(",", 1)[0]
    return float(step) if step.isdigit() else float("inf")
