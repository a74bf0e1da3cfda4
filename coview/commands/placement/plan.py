"""`coview plan`: a deployment plan, judged on traffic that its search never saw, with a report."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from tyro.conf import Positional

from coview.arguments import check_least, check_schemes, check_share, site_file
from coview.exits import NOT_MET, OK
from coview.options import ClassOptions, Output, load_own_detector
from coview.outputs import check_folder, check_writable
from coview.printing import print_result
from coview.progress_bar import progress_bar
from placement_env.cases import USUAL_CASES, Cases, iou_text
from toolkit.runtime.run import Run

if TYPE_CHECKING:
    from placement_env.report.content import Plan
    from placement_env.report.planning.question import Question, Stock
    from toolkit.sites.site import Site


@dataclass(frozen=True, kw_only=True)
class Goal:
    """Budget, and what must be reached."""

    budget: int | None = None
    """Most sensors; 4 if no --money is given either."""
    money: float | None = None
    """Most that poles and sensors may cost together, in the catalogue's currency, or in ordinary poles."""
    min_ap: float | None = None
    """AP that must be reached; the answer is the cheapest set that does."""
    max_kbit: float | None = None
    """Most that a sensor may send per frame."""
    confidence: float = 0.95
    """Confidence at which a comparison ends: that no set of as many sensors is better by more than 0.01."""

    def __post_init__(self) -> None:
        named = {"--budget": self.budget, "--money": self.money, "--min-ap": self.min_ap, "--max-kbit": self.max_kbit}
        for option, value in named.items():
            check_least(option, value, 0)
        check_share("--confidence", self.confidence)


@dataclass(frozen=True, kw_only=True)
class StockOptions:
    """Sensors that may be mounted, and how they fuse."""

    candidates: str = "pool"
    """pool, paper for the site's own sensors, or a GeoJSON file of poles."""
    sensors: Path | None = None
    """Catalogue of sensor models and their prices, TOML; by default the paper's camera at no price."""
    keep_out: Path | None = None
    """GeoJSON file with areas where no sensor may stand."""
    capacity: float | None = None
    """Capacity of every pole's link (kbit per frame), in place of the poles' own."""
    scheme: str = "early"
    """Fusion of measurements: early, late, hybrid or foreground."""
    codec: str = "paper"
    """Coding of what is sent: paper counts 96 bits a point and 256 a box, range-images sends bytes in steps of 2 cm."""
    detector: str | None = None
    """Detector as in coview evaluate, except cluster; by default a shipped one."""

    def build(self, site: Site) -> Stock:
        """Build the stock. Raises ValueError and OSError for files that cannot be used."""
        from placement_env.candidates.poles import load_keep_out
        from placement_env.candidates.sensor_catalogue import load_sensor_catalogue
        from placement_env.report.planning.question import Stock

        return Stock(
            candidates=self.candidates,
            catalogue=None if self.sensors is None else load_sensor_catalogue(self.sensors),
            keep_out=() if self.keep_out is None else load_keep_out(self.keep_out, site),
            capacity_kbit=self.capacity,
        )


USUAL_GOAL, USUAL_STOCK, USUAL_CLASSES = Goal(), StockOptions(), ClassOptions()
USUAL_OUTPUT = Output(out=Path("out/plan"))
USUAL_RUN = Run(cache=Path("out/cache"), workers=2)


def plan(
    site: Positional[str],
    /,
    *,
    goal: Goal = USUAL_GOAL,
    stock: StockOptions = USUAL_STOCK,
    classes: ClassOptions = USUAL_CLASSES,
    cases: Cases = USUAL_CASES,
    run: Run = USUAL_RUN,
    output: Output = USUAL_OUTPUT,
) -> int:
    """Plan which sensors to build, and write a report that says which, why, and what it cannot say.

    Sets are searched by a fast fidelity, compared by the detector on fresh traffic, and the answer is judged on traffic
    of its own. An interrupted plan resumes.

    Example: coview plan tjunction --budget 4 --min-ap 0.9 --out out/plan

    Args:
        site: tjunction, roundabout, or a site file.
        cases: Sets are compared, and required to reach --min-ap, by the AP over these cases.
        run: --frames are those of each of three parts of traffic: search, comparison, judgement (60, 60 and 120).
        output: plan.json, report.html, report.pdf and files for installers and GIS.
    """
    from placement_env.report.planning.planning import plan as answer
    from placement_env.report.planning.planning import write_plan

    out = output.out or Path("out/plan")
    check_schemes([stock.scheme])
    files = [path for path in (stock.sensors, stock.keep_out) if path is not None]
    inputs = [*site_file(site), *site_file(stock.candidates), *files]
    check_folder(out, holds="plan.json", inputs=inputs, overwrite=output.overwrite)
    if run.cache is not None:
        check_writable(run.cache.resolve(), run.cache)
    with progress_bar("", hidden=output.json) as bar:
        question = _build_question(site, goal, stock, classes, cases, replace(run, progress=bar.stage))
        planned = answer(question)
        written = write_plan(planned, out)
    text = f"{_describe(planned.plan)}\nwritten to {out}: {', '.join(path.name for path in written)}"
    print_result(planned.plan.as_dict(), text, as_json=output.json)
    return NOT_MET if planned.plan.verdict.met is False else OK


def _build_question(
    site: str, goal: Goal, stock: StockOptions, classes: ClassOptions, cases: Cases, run: Run
) -> Question:
    from placement_env.report.planning.question import USUAL_SENSORS, Question
    from placement_env.setting import Setting
    from toolkit.detection.link.range_images import find_codec
    from toolkit.sites.files import load_site

    place = load_site(site)
    setting = Setting(
        place,
        candidates=stock.build(place),
        scheme=stock.scheme,
        codec=find_codec(stock.codec),
        classes=classes.build(),
        cases=cases,
        detector=load_own_detector(stock.detector, place, run),
        most_price=math.inf if goal.money is None else goal.money,
    )
    sensors = USUAL_SENSORS if goal.budget is None and goal.money is None else goal.budget
    return Question(setting, run, sensors, goal.min_ap, goal.max_kbit, goal.confidence)


def _describe(plan: Plan) -> str:
    """Answer in a few lines."""
    verdict = plan.verdict
    lines = [" ".join((verdict.sentence, *verdict.reasons)) if verdict.met is False else verdict.sentence]
    lines += [f"  {s.name}: {s.pole}, {s.height:.1f} m, bearing {s.bearing_deg:.0f}" for s in plan.sensors]
    if len(plan.class_ap) > 1:
        lines += [
            f"  {row.label:<10} AP {row.judged.ap:.3f} ({row.judged.low:.3f} to {row.judged.high:.3f}) at IoU "
            f"{iou_text(row.iou)}, {row.judged.vehicles} to find"
            for row in plan.class_ap
        ]
    lines += [
        f"  {row.name:<18} AP {row.judged.ap:.3f} ({row.judged.low:.3f} to {row.judged.high:.3f}), "
        f"{row.judged.vehicles} to find in {row.judged.frames} frames"
        for row in (*plan.by_level, *plan.by_errors)
        if row.judged is not None
    ]
    return "\n".join(lines)
