"""A stress test as text, JSON and SVG."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from placement_env.report.drawings.charts import interval_bars
from placement_env.report.stress.stressing import StressRow
from toolkit.runtime.files import write_text, writing_together
from toolkit.runtime.text_tables import aligned

STRESS_FILES = ("stress.json", "stress.svg")


def format_stress(rows: Sequence[StressRow]) -> str:
    """A line for each scheme under each condition."""
    table = [["stress", "level", "scheme", "sent as", "AP", "95 % interval", "kbit/sensor", "age"]]
    for row in rows:
        judged = row.judged
        figures = [f"{judged.ap:.3f}", f"{judged.low:.3f} to {judged.high:.3f}", f"{row.kbit_per_sensor:.2f}"]
        table.append([row.kind, row.level, row.scheme, row.codec, *figures, f"{row.age:.2f} s"])
    return aligned(table, texts=4)


def stress_content(rows: Sequence[StressRow], provenance: Mapping[str, Any]) -> dict[str, Any]:
    """For JSON: figures that are undefined are None."""
    return {"provenance": dict(provenance), "rows": [_defined(row.as_dict()) for row in rows]}


def write_stress(rows: Sequence[StressRow], provenance: Mapping[str, Any], folder: str | Path) -> None:
    """Write `STRESS_FILES` into a folder made if missing: all, or where that fails (OSError) none."""
    named = [(f"{row.kind} {row.level}: {row.scheme}, {row.codec}", row.judged) for row in rows]
    with writing_together(folder) as unfinished:
        write_text(unfinished / "stress.json", json.dumps(stress_content(rows, provenance), indent=1, allow_nan=False))
        write_text(unfinished / "stress.svg", interval_bars(named, "AP under stress"))


def _defined(value: Any) -> Any:
    if isinstance(value, dict):
        return {name: _defined(each) for name, each in value.items()}
    return None if isinstance(value, float) and math.isnan(value) else value
