"""Files of a plan: plan.json and all that is made of it, in one folder."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

from placement_env.report.content import Plan
from placement_env.report.planning.planning import Planned
from toolkit.runtime.files import write_text


def write_plan(planned: Planned, out: Path) -> list[Path]:
    """Write a plan's files into a folder, made if missing; their paths."""
    path = out / "plan.json"
    write_text(path, plan_json(planned.plan))
    return [path]


def plan_json(plan: Plan) -> str:
    """A plan as JSON: the same plan gives the same text; null for what is not finite."""
    return json.dumps(_finite(plan.as_dict()), indent=1, allow_nan=False, ensure_ascii=False) + "\n"


def _finite(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _finite(each) for key, each in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(each) for each in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
