"""Files of a plan: plan.json and all that is made of it, in one folder."""

from __future__ import annotations

import json
from pathlib import Path

from placement_env.handover.exchange import EXCHANGE_FILES, write_exchange
from placement_env.report.content import Plan, Planned
from placement_env.report.pages.report import REPORT_FILES, write_report
from toolkit.runtime.files import replace_infinite, write_text, writing_together

CONTENT = "plan.json"
PLAN_FILES = (*REPORT_FILES, *EXCHANGE_FILES, CONTENT)


def write_plan(planned: Planned, out: Path) -> list[Path]:
    """Write a plan's files into a folder, made if missing, all of them or none; their paths.

    Where there is no set to build there is nothing to hand over: what an earlier plan left there of `PLAN_FILES` goes.
    Raises ImportError without the packages of `coview[report]`, OSError where the folder cannot be written.
    """
    plan = planned.plan
    with writing_together(out) as folder:
        write_text(folder / CONTENT, plan_json(plan))
        write_report(planned, folder)
        if planned.ground is not None and planned.candidates is not None:
            unused = [mount for mount in planned.candidates.mounts if mount.name in plan.poles_unused]
            write_exchange(folder, planned.site, plan.sensors, planned.ground, unused=unused, currency=plan.currency)
        names = sorted(path.name for path in folder.iterdir())
    for name in set(PLAN_FILES).difference(names):
        (out / name).unlink(missing_ok=True)
    return [out / name for name in names]


def plan_json(plan: Plan) -> str:
    """A plan as JSON: the same plan gives the same text; null for what is not finite."""
    return json.dumps(replace_infinite(plan.as_dict()), indent=1, allow_nan=False, ensure_ascii=False) + "\n"
