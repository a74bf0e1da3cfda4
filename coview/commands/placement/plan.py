"""`coview plan`: a deployment plan with a report."""

import math
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from tyro.conf import Positional

from coview.arguments import check_least, check_schemes, check_share, site_file
from coview.options import ClassOptions, Output, load_own_detector
from coview.outputs import NOT_MET, OK, PLAN_KIND, check_folder, check_writable, claim, print_result
from coview.progress_bar import progress_bar
from placement_env.candidates.candidates import NoCandidates
from placement_env.candidates.poles import load_keep_out
from placement_env.candidates.sensor_catalogue import load_sensor_catalogue
from placement_env.cases import Cases, iou_text
from placement_env.defaults import USUAL_CASES
from placement_env.links import LINK_SHARE
from placement_env.report.planning.plan_folder import PLAN_FILE, found_nothing
from placement_env.report.planning.question import DEFAULT_SENSORS, Question, Stock
from placement_env.setting import Setting
from toolkit.detection.link.range_images import find_codec
from toolkit.runtime.run import USUAL_WORKERS, Run
from toolkit.sites.files import load_site
from toolkit.sites.site import Site

if TYPE_CHECKING:
    from placement_env.report.content import Judgement, Plan

# shares of the time of a plan, as measured at imported crossings
PLAN_STEPS = {
    "poses rendered": 0.15,
    "searches": 0.25,
    "set sizes compared": 0.35,
    "frames of the closest sets": 0.15,
    "frames of the chosen set": 0.1,
    "frames of the fusion schemes": 0.1,
    "frames of the order of building": 0.05,
    "frames followed": 0.15,
}
# likewise, of a plan with --min-ap
PRICE_STEPS = {
    "poses rendered": 0.1,
    "searches": 0.28,
    "frames of the first look": 0.22,
    "sets judged by price": 0.1,
    "frames of the chosen set": 0.08,
    "frames of the fusion schemes": 0.18,
    "frames of the order of building": 0.04,
    "frames followed": 0.15,
}
DEFAULT_CLASSES = ClassOptions()
DEFAULT_OUTPUT = Output(out=Path("out/plan"))
DEFAULT_RUN = Run(cache=Path("out/cache"), workers=USUAL_WORKERS)


@dataclass(frozen=True, kw_only=True)
class Goal:
    """Budget and requirements."""

    budget: int | None = None
    """Maximum number of sensors; 4 without --money."""
    money: float | None = None
    """Maximum price of poles and sensors, in the catalogue's currency or in ordinary poles."""
    min_ap: float | None = None
    """Required AP; the answer is the cheapest set that reaches it."""
    max_kbit: float | None = None
    """Maximum data (kbit) that a sensor may send per frame, in --link-share of the frames."""
    confidence: float = 0.95
    """Confidence, at the end of a comparison, that no set of as many sensors is better by more than
    0.01."""
    width: float | None = None
    """Width of the 95 % interval of the stated AP: 0.02 takes as many frames as that needs, up to
    1,200."""
    drawings: int = 1
    """At an imported site, number of drawings of what its map does not show, over which sets are
    compared."""

    def __post_init__(self) -> None:
        """Raise ValueError for an option that is out of range."""
        check_least("--drawings", self.drawings, 1)
        limits = {
            "--budget": self.budget,
            "--money": self.money,
            "--min-ap": self.min_ap,
            "--max-kbit": self.max_kbit,
        }
        for option, value in limits.items():
            check_least(option, value, 0)
        check_share("--confidence", self.confidence)
        if self.width is not None:
            check_share("--width", self.width)


@dataclass(frozen=True, kw_only=True)
class StockOptions:
    """Sensors to choose from, links and fusion."""

    candidates: str = "pool"
    """Sensors to choose from: pool, paper for the site's own, or a GeoJSON file of poles."""
    sensors: Path | None = None
    """Catalogue of sensor models with prices (TOML); the paper's camera at no price when left
    out."""
    keep_out: Path | None = None
    """GeoJSON file of areas where no sensor may stand."""
    keep: tuple[str, ...] = ()
    """Names of poles that must carry a sensor."""
    capacity: float | None = None
    """Capacity of every link (kbit per frame), in place of the poles' own."""
    link_share: float = LINK_SHARE
    """Share of the frames in which every link must carry what is sent."""
    scheme: str = "early"
    """Fusion scheme: early, late, hybrid or foreground."""
    codec: str = "paper"
    """Coding: paper counts 96 bits a point and 256 a box, range-images sends bytes in steps of
    2 cm."""
    detector: str | None = None
    """Detector, as in coview evaluate except cluster; a shipped one when left out."""

    def build(self, site: Site) -> Stock:
        """Build the candidates' sensors, prices and keep-out areas from the files that are named.

        Raises ValueError and OSError for unusable files."""
        return Stock(
            candidates=self.candidates,
            catalogue=None if self.sensors is None else load_sensor_catalogue(self.sensors),
            keep_out=() if self.keep_out is None else load_keep_out(self.keep_out, site),
            capacity_kbit=self.capacity,
        )

    def setting(self, site: str, classes: ClassOptions, cases: Cases, run: Run) -> Setting:
        """Build the setting at a site (name or file).

        Raises ValueError and OSError for unusable options and files."""
        check_schemes([self.scheme])
        if run.cache is not None:
            check_writable(run.cache.resolve(), out=run.cache)
        loaded_site = load_site(site)
        return Setting(
            loaded_site,
            candidates=self.build(loaded_site),
            scheme=self.scheme,
            codec=find_codec(self.codec),
            classes=classes.build(),
            cases=cases,
            detector=load_own_detector(self.detector, loaded_site, run),
            link_share=self.link_share,
        )


def plan_command(
    site: Positional[str],
    /,
    *,
    goal: Goal = Goal(),
    stock: StockOptions = StockOptions(),
    classes: ClassOptions = DEFAULT_CLASSES,
    cases: Cases = USUAL_CASES,
    run: Run = DEFAULT_RUN,
    output: Output = DEFAULT_OUTPUT,
) -> int:
    """Plan which sensors to build, and write a report with the reasons.

    A fast estimate searches the sets, the detector compares the best ones on fresh traffic, and the
    answer is judged on other traffic again. Each part has --frames frames (60, 120 and 120 when
    left out). In as many frames of traffic that goes on at 10 Hz (300), the answer follows and
    counts road users. The cases are the conditions under which sets are compared and must reach
    --min-ap. An interrupted plan resumes.

    Example: coview plan tjunction --budget 4 --min-ap 0.9 --out out/plan

    Args:
        site: tjunction, roundabout, or a site file."""
    from placement_env.report.planning.plan_writing import PLAN_FILES, write_plan
    from placement_env.report.planning.planning import plan as answer_question

    out = output.out or Path("out/plan")
    files = [path for path in (stock.sensors, stock.keep_out) if path is not None]
    inputs = [*site_file(site), *site_file(stock.candidates), *files]
    check = partial(
        check_folder, out, holds=PLAN_FILE, inputs=inputs, writes=PLAN_FILES, kind=PLAN_KIND
    )
    settings = (site, goal, stock, classes, cases, run)
    most_price = math.inf if goal.money is None else goal.money
    setting = replace(
        stock.setting(site, classes, cases, run), most_price=most_price, keep=stock.keep
    )
    sensors = DEFAULT_SENSORS if goal.budget is None and goal.money is None else goal.budget
    question = Question(
        setting,
        run,
        sensors,
        goal.min_ap,
        goal.max_kbit,
        goal.confidence,
        goal.width,
        goal.drawings,
    )
    with suppress(NoCandidates):  # the plan gives the reason
        _ = setting.pool
    claimed = claim(
        out, settings, check, overwrite=output.overwrite or found_nothing(out / PLAN_FILE)
    )
    steps = PLAN_STEPS if goal.min_ap is None else PRICE_STEPS
    with claimed, progress_bar("", hidden=output.json, steps=steps) as bar:
        planned = answer_question(replace(question, run=replace(run, progress=bar.stage)))
        written = write_plan(planned, out)
    text = (
        f"{_describe(planned.plan)}\nwritten to {out}: {', '.join(path.name for path in written)}"
    )
    print_result(planned.plan.as_dict(), text, as_json=output.json)
    return NOT_MET if planned.plan.verdict.met is False else OK


def _describe(plan: "Plan") -> str:
    """Verdict, sensors and figures of a plan as lines of text."""
    from placement_env.analysis.intervals import AP_TOLERANCE, describe_sureness
    from placement_env.handover.mounted import is_named_by_pole

    verdict = plan.verdict
    lines = [verdict.sentence]
    if verdict.met is False:
        lines = [" ".join((verdict.sentence, *verdict.reasons))]
    for sensor in plan.sensors:
        pole = "" if is_named_by_pole(sensor.name, sensor.pole) else f"{sensor.pole}, "
        lines.append(
            f"  {sensor.name}: {pole}{sensor.model}, {sensor.height:.1f} m up, facing "
            f"{sensor.bearing_deg:.0f} degrees from north, {sensor.tilt_deg:.0f} degrees down"
        )
    if len(plan.class_ap) > 1:
        lines += [
            _describe_judgement(f"{row.label:<10}", row.judged, iou=f" at IoU {iou_text(row.iou)}")
            for row in plan.class_ap
        ]
    lines += [
        _describe_judgement(f"{row.name:<18}", row.judged, frames=f" in {row.judged.frames} frames")
        for row in (*plan.by_level, *plan.by_errors)
        if row.judged is not None
    ]
    for draws in plan.by_draw:
        mean = plan.format_drawn_ap(draws.mean, draws)
        tenth = plan.format_drawn_ap(draws.tenth, draws)
        lines.append(
            f"  {draws.profile}: mean AP {mean} of {len(draws.aps)} draws, a tenth below {tenth}"
        )
    lines += _describe_motion(plan)
    if plan.confidence is not None:
        lines.append(
            f"  {describe_sureness(plan.confidence)} sure that no other compared set of as many "
            f"sensors is better by more than {AP_TOLERANCE:g}"
        )
    return "\n".join(lines)


def _describe_motion(plan: "Plan") -> list[str]:
    """Return a line for each class in continuous traffic, or one with the reason for a refusal."""
    from placement_env.report.pages.motion_section import describe_followed, describe_soonness

    motion = plan.motion
    if motion is None:
        return []
    if motion.refusal:
        return [f"  {motion.refusal}"]
    lines = []
    for row in motion.classes:
        texts = (describe_followed(row), describe_soonness(row))
        lines.append(f"  {'; '.join(filter(None, texts))}, in {motion.seconds:.0f} s of traffic")
    return lines


def _describe_judgement(name: str, judged: "Judgement", *, iou: str = "", frames: str = "") -> str:
    interval = judged.describe_interval()
    return f"  {name} AP {judged.format_ap()} ({interval}){iou}, {judged.vehicles} to find{frames}"
