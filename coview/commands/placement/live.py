"""`coview live` and `coview what-if`: move sensors, in the browser or by options."""

import sys
from contextlib import closing
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import tyro
from tyro.conf import Positional, UseAppendAction

from coview.arguments import check_schemes
from coview.commands.placement.plan import DEFAULT_CLASSES, StockOptions
from coview.options import ClassOptions, load_own_detector
from coview.outputs import OK, Writing, check_writable, print_result
from placement_env.cases import Cases
from placement_env.defaults import USUAL_CASES
from toolkit.detection.link.range_images import find_codec
from toolkit.runtime.run import Run

if TYPE_CHECKING:
    from placement_env.live.figures import LiveAnswer
    from placement_env.live.planner import LivePlanner
    from placement_env.live.project import ProjectFile
    from placement_env.report.planning.plan_folder import PlanFolder, StatedFigure

DEFAULT_STOCK = StockOptions()
LIVE_RUN = Run(frames=60, seed=3, cache=Path("out/cache"))
FIRST_FRAMES = 4  # frames of a page's first figures


@dataclass(frozen=True, kw_only=True)
class Changes:
    """Changes, made in this order."""

    drop: UseAppendAction[tuple[str, ...]] = ()
    """Sensor to take away; may be repeated."""
    move: UseAppendAction[tuple[tuple[str, str, float], ...]] = ()
    """Sensor, its new compass bearing (degrees clockwise from north; heading=135 is
    counter-clockwise from +x) and tilt below the horizon, as in the schedule; may be repeated."""
    lift: UseAppendAction[tuple[tuple[str, float], ...]] = ()
    """Sensor and its new height above the foot of its pole (m); may be repeated."""
    carry: UseAppendAction[tuple[tuple[str, str], ...]] = ()
    """Sensor and the pole to carry it to; may be repeated."""
    add: UseAppendAction[tuple[tuple[str, str, float], ...]] = ()
    """Pole of one more sensor, its compass bearing and tilt, as for --move; may be repeated."""
    fail: UseAppendAction[tuple[str, ...]] = ()
    """Sensor that fails; may be repeated."""

    def apply(self, planner: "LivePlanner") -> None:
        """Make the changes of the command line in the planner's variant.

        Sensors are removed first, then turned, raised, carried to other poles and added; failures
        come last. Raises ValueError for an unknown sensor or pole, and for a pole without room."""
        from placement_env.live.directions import parse_heading, parse_height, parse_tilt

        yard = planner.yard
        for name in self.drop:
            planner.remove(name)
        for name, bearing, tilt in self.move:  # degrees
            sensor = planner.variant.find(name)
            planner.move(
                name,
                heading=parse_heading(yard.site, bearing, sensor.heading),
                tilt=parse_tilt(tilt, sensor.tilt),
            )
        for name, height in self.lift:
            sensor = planner.variant.find(name)
            pole = yard.find_mount(planner.variant, sensor.mount)
            planner.move(name, height=parse_height(pole, height, sensor.height))
        for name, pole_name in self.carry:
            planner.move(name, position=pole_name)
        for pole_name, bearing, tilt in self.add:
            planner.add(pole_name, heading=parse_heading(yard.site, bearing), tilt=parse_tilt(tilt))
        for name in self.fail:
            planner.fail(name)


@dataclass(frozen=True, kw_only=True)
class LiveConditions:
    """Conditions under which sensors are scored."""

    iou: float | None = None
    """IoU at which a detection counts; the plan's, or 0.7, when left out."""
    errors: str | None = None
    """Error profile of the sensors if the detector measures: paper, surveyed, typical, glare or
    poor; the plan's, or paper, when left out."""

    def apply(self, cases: Cases) -> Cases:
        """Return cases with these options. Raises ValueError for an unknown profile or IoU."""
        if self.iou is not None:
            cases = replace(cases, iou=self.iou)
        return cases if self.errors is None else replace(cases, errors=(self.errors,))


@dataclass(frozen=True, kw_only=True)
class Keeping:
    """Files that keep the work."""

    out: Path = Path("out/live")
    """Folder for the project, exports and reports."""
    project: Path | None = None
    """File that keeps the work; SITE.live.json in --out when left out."""
    last_good: bool = False
    """Go on from the state before the last save, where the project file is damaged."""


@dataclass(frozen=True, kw_only=True)
class Serving:
    """Address of the page, and the browser."""

    port: int = 8090
    """Port of the address in the browser; the next free one where it is taken."""
    browser: bool = True
    """Open the browser."""


def what_if_command(
    plan: Positional[str],
    /,
    *,
    changes: Annotated[Changes, tyro.conf.arg(name="")] = Changes(),
    stock: StockOptions = DEFAULT_STOCK,
    classes: ClassOptions = DEFAULT_CLASSES,
    conditions: LiveConditions = LiveConditions(),
    run: Run = LIVE_RUN,
    writing: Writing = Writing(),
) -> int:
    """Compare a plan before and after moving, adding, dropping or failing sensors, in seconds.

    Figures are predicted by the surrogate on the frames that the plan's searches saw, or --frames
    of --seed at a site.

    Example: coview what-if out/plan --move pole03 350 12

    Example: coview what-if tjunction --drop d2 --carry d0 pole05 --add pole07 200 15 --json

    Args:
        plan: Folder of a plan, or a site with sensors."""
    planner = open_planner(where=plan, stock=stock, classes=classes, conditions=conditions, run=run)
    before = planner.finish()
    stated = planner.stated
    changes.apply(planner)
    after = planner.finish().since(before, "before and after")
    figures = {"before": before.as_dict(), "after": after.as_dict()}
    if stated is not None:
        figures["before"]["stated"] = asdict(stated)
    print_result(figures, _describe(before, after, stated), as_json=writing.json)
    return OK


def live_command(
    site: Positional[str] = "",
    /,
    *,
    stock: StockOptions = DEFAULT_STOCK,
    classes: ClassOptions = DEFAULT_CLASSES,
    conditions: LiveConditions = LiveConditions(),
    run: Run = LIVE_RUN,
    keeping: Annotated[Keeping, tyro.conf.arg(name="")] = Keeping(),
    serving: Annotated[Serving, tyro.conf.arg(name="")] = Serving(),
    writing: Writing = Writing(),
) -> int:
    """Move sensors by hand in the browser, and see immediately what it does.

    Sensors are dragged by their handles; AP, intervals, approaches, data, price and the worst
    failure follow. Every change is kept in the project file, from which the next start goes on.
    Served to this machine only, until Ctrl-C.

    Example: coview live tjunction

    Example: coview live

    Example: coview live out/plan --project out/live/main-street.json

    Args:
        site: A site with or without sensors, or the folder of a plan; the page asks for a map or
            site when left out."""
    import webbrowser

    from coview.live_start import LiveSession, interrupted_by_sigterm
    from toolkit.viewing.scene import check_viser

    check_viser()

    def find_project(where: str) -> Path:
        return keeping.project or keeping.out / f"{Path(where).stem or 'site'}.live.json"

    def begin(where: str) -> "tuple[LivePlanner, ProjectFile]":
        """Open the planner of a site or plan (`where`), and the file that keeps its project."""
        from placement_env.live.project import ProjectFile

        planner = open_planner(where, stock, classes, conditions, run, first=FIRST_FRAMES)
        return planner, ProjectFile(find_project(where), planner, last_good=keeping.last_good)

    session = LiveSession(begin, port=serving.port, folder=keeping.out)
    with interrupted_by_sigterm(), closing(session):
        project = str(find_project(site) if site else keeping.out)
        serving_note = f"{session.url} (this machine only; Ctrl-C ends it; kept in {project})"
        print_result({"url": session.url, "project": project}, serving_note, as_json=writing.json)
        sys.stdout.flush()
        if serving.browser:
            webbrowser.open(session.url)
        if site:
            session.open(site)
        session.wait()
    return OK


def open_planner(
    where: str,
    stock: StockOptions,
    classes: ClassOptions,
    conditions: LiveConditions,
    run: Run,
    *,
    first: int | None = None,
) -> "LivePlanner":
    """Open a planner at a site, or with the sensors of a plan's folder.

    A plan decides its poles, models, prices and keep-out areas, and the frames and seed unless the
    options give others than the usual ones. where: name or file of a site, or folder of a plan;
    first: number of frames for the first results, None for all. Raises ValueError and OSError for
    a site or folder that cannot be read."""
    from placement_env.live.planner import LivePlanner
    from placement_env.report.planning.plan_folder import is_plan_folder

    if not is_plan_folder(where):
        cases = conditions.apply(USUAL_CASES)
        return LivePlanner(stock.setting(where, classes, cases, run), run=run, first_frames=first)
    plan = _open_plan(where, stock, classes, conditions, run)
    if run.frames == LIVE_RUN.frames:
        run = replace(run, frames=plan.frames)
    if run.seed == LIVE_RUN.seed:
        run = replace(run, seed=plan.seed)
    return LivePlanner(plan, run=run, first_frames=first)


def _open_plan(
    where: str, stock: StockOptions, classes: ClassOptions, conditions: LiveConditions, run: Run
) -> "PlanFolder":
    """Read a plan's folder, with the setting that the options ask for.

    Options that are left out keep what the plan was made with: scheme, link share, codec, classes,
    cases and detector. Raises ValueError for an option that only the plan decides (candidates,
    models, keep-out areas, kept poles, capacity), and for a folder that cannot be read."""
    from placement_env.report.planning.plan_folder import read_plan_folder

    for name in ("candidates", "sensors", "keep_out", "keep", "capacity"):
        if getattr(stock, name) != getattr(DEFAULT_STOCK, name):
            option = f"--{name.replace('_', '-')}"
            raise ValueError(
                f"{option} does not go with the folder of a plan, which brings its own: leave it "
                f"out, or take the site {where}/site.json"
            )
    plan = read_plan_folder(where)
    setting = plan.setting
    changes = dict[str, Any]()
    if stock.scheme != DEFAULT_STOCK.scheme:
        check_schemes([stock.scheme])
        changes["scheme"] = stock.scheme
    if stock.link_share != DEFAULT_STOCK.link_share:
        changes["link_share"] = stock.link_share
    if stock.codec != DEFAULT_STOCK.codec:
        changes["codec"] = find_codec(stock.codec)
    if classes != DEFAULT_CLASSES:
        changes["classes"] = classes.build()
    if run.cache is not None:
        check_writable(run.cache.resolve(), run.cache)
    changes["cases"] = conditions.apply(setting.cases)
    changes["detector"] = load_own_detector(stock.detector or plan.own_detector, setting.place, run)
    return plan.ask(replace(setting, **changes))


def _describe(before: "LiveAnswer", after: "LiveAnswer", stated: "StatedFigure | None") -> str:
    """Table of the figures before and after a change, the change of AP, and problems, as text.

    stated: AP that the plan states, None without a plan."""
    from placement_env.analysis.intervals import describe_interval
    from toolkit.display import figure_digits, format_share
    from toolkit.runtime.text_tables import align_columns

    digits = figure_digits(after.objects)
    rows = [["", "before", "after", "change"]]
    if stated is not None:
        errors = "" if stated.errors == "paper" else f", errors {stated.errors}"
        rows.append(
            [
                f"AP that the plan states, by its detector{errors}",
                format_share(stated.ap, stated.objects),
                "",
                "",
            ]
        )
    rows.append(_compare("AP, predicted", before.ap, after.ap, digits))
    if len(before.classes) > 1:
        rows += [
            _compare(f"AP of {old.name}", old.ap or 0.0, new.ap or 0.0, figure_digits(new.objects))
            for old, new in zip(before.classes, after.classes, strict=True)
        ]
    rows.append(_compare("share found", before.recall, after.recall, digits))
    rows += [
        _compare(f"found {old.name}", old.recall, new.recall, figure_digits(new.objects))
        for old, new in zip(before.approaches, after.approaches, strict=True)
    ]
    currency = f" in {after.currency}" if after.currency else ""
    rows += [
        _compare("AP after the worst failure", before.worst, after.worst, digits),
        _compare("kbit per frame", before.kbit, after.kbit, 1),
        _compare(f"price{currency}", before.price, after.price),
    ]
    interval = describe_interval(after.change_low, after.change_high, digits)
    summary = (
        f"change of AP {after.change:+.{digits}f} ({interval}), predicted by the surrogate, N = "
        f"{after.objects} road users in {after.frames} frames"
    )
    return "\n".join([align_columns(rows, texts=1), summary, *after.problems])


def _compare(name: str, old: float, new: float, digits: int | None = None) -> list[str]:
    """Return a row with a figure before and after, and its change. digits: None for all."""
    form = "g" if digits is None else f".{digits}f"
    return [name, f"{old:{form}}", f"{new:{form}}", f"{new - old:+{form}}"]
