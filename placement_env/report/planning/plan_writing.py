"""`write_plan`: a plan's files, written into a folder all or none."""

import json
from pathlib import Path

from placement_env.handover.exchange import EXCHANGE_FILES, write_exchange
from placement_env.report import content
from placement_env.report.pages.report import REPORT_FILES, write_report
from placement_env.report.planning.plan_folder import PLAN_FILE
from toolkit.runtime.text_values import replace_infinite
from toolkit.runtime.writing import write_text, writing_together

PLAN_FILES = (*REPORT_FILES, *EXCHANGE_FILES, PLAN_FILE)


def write_plan(planned: content.Planned, out: Path) -> list[Path]:
    """Write a plan's files into a folder, all or none, and return their paths by name.

    The folder is made if missing. A plan without sensors has no files for other tools
    (`EXCHANGE_FILES`). Files of `PLAN_FILES` that an earlier plan left there and this one lacks are
    removed; other files stay.

    Raises ImportError without the packages of `coview[report]`, OSError if the folder cannot be
    written."""
    plan = planned.plan
    with writing_together(out) as folder:
        write_text(folder / PLAN_FILE, format_json(plan))
        write_report(planned, folder)
        if planned.ground is not None and planned.candidates is not None:
            mounts = planned.candidates.mounts
            unused_mounts = [mount for mount in mounts if mount.name in plan.poles_unused]
            write_exchange(
                folder,
                planned.site,
                plan.sensors,
                planned.ground,
                unused=unused_mounts,
                currency=plan.currency,
            )
        names = sorted(path.name for path in folder.iterdir())
    # files of an earlier plan
    for name in set(PLAN_FILES).difference(names):
        (out / name).unlink(missing_ok=True)
    return [out / name for name in names]


def format_json(plan: content.Plan) -> str:
    """Format a plan as JSON text, the same for the same plan.

    Infinite numbers and NaN, which JSON lacks, become null."""
    values = replace_infinite(plan.as_dict())
    return json.dumps(values, indent=1, allow_nan=False, ensure_ascii=False) + "\n"
