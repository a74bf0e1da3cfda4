"""`PlanFolder`: a plan read from its folder. This is the only reader of plans.

plan.json holds the question, the chosen set with its figures, and the stock. Every member that is
used is checked. site.json in the same folder has the chosen sensors. A plan.json without
`coview_plan` is from before there were versions; it is refused with that reason, because it lacks
prices and poles."""

import math
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from placement_env.candidates.candidates import Candidates
from placement_env.cases import IoUs
from placement_env.handover.exchange import SITE
from placement_env.report.content import PLAN_VERSION, Judgement
from placement_env.report.planning.plan_cases import (
    PLAN_AGAIN,
    read_cases,
    read_classes,
    read_codec,
)
from placement_env.report.planning.plan_stock import (
    MAX_PRICE,
    MAX_STOCK_SENSORS,
    read_optional,
    read_stock,
)
from placement_env.setting import Setting
from toolkit.detection.schemes import SCHEMES
from toolkit.objects import LABELS
from toolkit.runtime.json_object import JsonObject
from toolkit.runtime.reading import name_errors
from toolkit.runtime.text_values import read_json
from toolkit.sites.files import load_site
from toolkit.sites.site import Site

PLAN_FILE = "plan.json"
MAX_FRAMES = 100_000
MAX_OBJECTS = 10**9
MAX_SEED = 2**63 - 1
MAX_POLE_GAP_M = 1.5  # between a sensor and its pole, horizontally


@dataclass(frozen=True)
class StatedFigure:
    """AP of a plan's whole set by its detector, on traffic that no search saw.

    Attributes:
        ap: AP while no sensor fails, in all traffic.
        low: Lower end of its 95 % interval, NaN without one.
        high: Upper end, NaN without one.
        frames: Number of frames.
        objects: Number of objects to find in them.
        errors: Name of the sensors' error profile.
        predicted: AP that the searches predicted."""

    ap: float
    low: float
    high: float
    frames: int
    objects: int
    errors: str
    predicted: float


@dataclass(frozen=True)
class StatedClass:
    """Result of a plan's whole set for one class, as `content.ClassAP`.

    Attributes:
        label: Name of the class.
        weight: 0 if the class does not count.
        iou: IoU from which a detection counts; several for their mean.
        judged: Result on traffic that no search saw, while no sensor fails."""

    label: str
    weight: float
    iou: IoUs
    judged: Judgement


@dataclass(frozen=True)
class StatedResults:
    """Results that a plan states.

    Attributes:
        detector: Name of the detector that they are by, as in commands.
        classes: Result of the whole set for each class."""

    detector: str
    classes: tuple[StatedClass, ...]


@dataclass(frozen=True, eq=False)
class PlanFolder:
    """A plan that is read again.

    Attributes:
        path: The folder.
        setting: Question by which sets are scored, at the site with the chosen sensors.
        frames: Number of frames that the searches saw.
        given_frames: Number of frames of each part of the traffic if it was given, None for the
            usual ones.
        seed: Seed of the traffic.
        sensors: Most sensors, infinite for any number.
        detector: Name of the plan's detector, "shipped" for a shipped one.
        stated: Figure that the plan states, None under another question."""

    path: Path
    setting: Setting
    frames: int
    given_frames: int | None
    seed: int
    sensors: float
    detector: str
    stated: StatedFigure | None

    @property
    def own_detector(self) -> str | None:
        """Name of the plan's detector, None for a shipped one."""
        return None if self.detector == "shipped" else self.detector

    def ask(self, setting: Setting) -> "PlanFolder":
        """Return the plan with another setting, by which its set is then scored.

        The stated figure stays only if scheme, codec, classes, cases and link share are the
        same."""
        names = ("fusion", "codec", "counted", "cases", "link_share")
        is_same = all(getattr(setting, name) == getattr(self.setting, name) for name in names)
        return replace(self, setting=setting, stated=self.stated if is_same else None)


def is_plan_folder(where: object) -> bool:
    """Return True for the path of a folder, False for any other value or path.

    The folder is not opened; callers take every folder for a plan's folder."""
    return isinstance(where, str | Path) and Path(where).is_dir()


def read_plan_folder(where: str | Path) -> PlanFolder:
    """Read and check plan.json and site.json in a plan's folder.

    Raises FileNotFoundError for a folder without a plan. Raises ValueError, in one line with file,
    member, rule and value, for a damaged plan, another version, and a plan without a set."""
    folder = Path(where)
    if not (folder / PLAN_FILE).is_file():
        raise FileNotFoundError(
            f"{where} is no folder of a plan: it needs {PLAN_FILE} and {SITE} of coview plan"
        )
    path = folder / PLAN_FILE
    content = read_json(path)
    with name_errors(path):
        plan = JsonObject(content)
        _check_version(plan)
        if plan.value.get("chosen", ...) is None:  # null; a missing member is an error later
            sentence = plan.node("verdict").get("sentence", str)
            raise ValueError(
                f"the plan has no set of sensors to go on from ({sentence[:80]}): {PLAN_AGAIN}"
            )
    if not (folder / SITE).is_file():
        raise FileNotFoundError(
            f"{where} is no whole folder of a plan: {SITE} is missing; {PLAN_AGAIN}"
        )
    site = load_site(folder / SITE)
    with name_errors(path):
        _check_sensors(plan, site)
        return _read(folder, plan, site)


def read_stated_results(where: str | Path) -> StatedResults:
    """Read the results that a plan in a folder states for each class.

    `read_plan_folder` checks the rest of the folder. Raises ValueError for a damaged result."""
    path = Path(where) / PLAN_FILE
    content = read_json(path)
    with name_errors(path):
        plan = JsonObject(content)
        classes = tuple(_read_class(row) for row in plan.nodes("class_ap", len(LABELS)))
        return StatedResults(plan.get("detector", str), classes)


def found_nothing(path: Path) -> bool:
    """Return True if a plan.json holds a plan without a set, which may be overwritten.

    The verdict of such a plan is that the requirement is not met. False if the file is missing,
    damaged or no plan. path: the file."""
    try:
        plan = JsonObject(read_json(path))
        return plan.node("verdict").value.get("met") is False
    except (OSError, ValueError):
        return False


def _check_version(plan: JsonObject) -> None:
    """Raise ValueError for every version except this coview's, with advice for each case.

    plan: content of a plan.json, whose member `coview_plan` is the version of its format."""
    if "coview_plan" not in plan.value:
        raise ValueError(
            "it has no coview_plan, so it is of an earlier coview, without poles and prices, or "
            f"no plan: {PLAN_AGAIN}"
        )
    version = plan.get("coview_plan", int)
    # only 20 characters of the version are quoted, however long the number is
    if version > PLAN_VERSION:
        raise ValueError(
            f"coview_plan is version {version!s:.20}, this coview reads up to {PLAN_VERSION}: "
            "install a newer one"
        )
    if version < PLAN_VERSION:
        raise ValueError(f"coview_plan must be {PLAN_VERSION}, got {version!s:.20}: {PLAN_AGAIN}")


def _check_poles(plan: JsonObject, site: Site, stock: Candidates) -> None:
    """Raise ValueError for a sensor whose pole is unknown or more than `MAX_POLE_GAP_M` away.

    The distance is horizontal.

    Args:
        plan: Content of a plan.json.
        site: Site with the chosen sensors, in the order of the plan.
        stock: Candidates on all poles."""
    poles = {mount.name: mount for mount in stock.mounts}
    for row, sensor in zip(plan.nodes("sensors", MAX_STOCK_SENSORS), site.sensors, strict=True):
        name = row.choice("pole", poles)
        dx, dy = (sensor.position - poles[name].position)[:2]
        distance = float(np.hypot(dx, dy))
        if distance > MAX_POLE_GAP_M:
            raise ValueError(
                f"{sensor.name} hangs {distance:.6g} m from its pole {name}, more than "
                f"{MAX_POLE_GAP_M:g} m: the file is damaged, or {SITE} was changed"
            )


def _check_sensors(plan: JsonObject, site: Site) -> None:
    """Raise ValueError unless plan.json and site.json have the same sensors in the same order.

    plan: content of the plan.json; site: site of the site.json, with the chosen sensors."""
    plan_names = [sensor.get("name", str) for sensor in plan.nodes("sensors", MAX_STOCK_SENSORS)]
    site_names = [sensor.name for sensor in site.sensors]
    if plan_names != site_names:
        plan_text = ", ".join(plan_names)[:80]
        site_text = ", ".join(site_names)[:80] or "none"
        raise ValueError(
            f"plan and site must have the same sensors, got {plan_text} here, {site_text} in "
            f"{SITE}: take both from one plan"
        )


def _read(folder: Path, plan: JsonObject, site: Site) -> PlanFolder:
    """Read question, stock and stated figures of a plan.json, and check them against the site.

    folder: folder of the plan; site: site with the chosen sensors. Raises ValueError for a wrong
    member."""
    question = plan.node("question")
    head = plan.node("head")
    texts = {key: head.get(key, str) for key in head.value}
    money = read_optional(
        question, "money", lambda key: question.number(key, low=0, high=MAX_PRICE)
    )
    sensors = read_optional(
        question, "sensors", lambda key: question.whole(key, low=0, high=MAX_STOCK_SENSORS)
    )
    cases = read_cases(question)
    setting = Setting(
        site,
        candidates=read_stock(plan.node("stock"), site, texts),
        scheme=question.choice("scheme", SCHEMES),
        codec=read_codec(question),
        classes=read_classes(question, cases),
        cases=cases,
        most_price=math.inf if money is None else money,
        keep=tuple(question.texts("keep")),
        link_share=question.number("link_share", low=0, high=1),
    )
    _check_poles(plan, site, setting.pool)
    frames = question.numbers("frames", 3)
    if not all(frame == int(frame) and 1 <= frame <= MAX_FRAMES for frame in frames):
        raise ValueError(
            f"question.frames must be three whole numbers from 1 to {MAX_FRAMES}, got {frames}"
        )
    search_frames = int(frames[0])
    # if search and comparison have as many frames, the number was given: the usual ones differ
    given_frames = search_frames if frames[0] == frames[1] else None
    return PlanFolder(
        path=folder,
        setting=setting,
        frames=search_frames,
        given_frames=given_frames,
        seed=question.whole("seed", low=0, high=MAX_SEED),
        sensors=math.inf if sensors is None else sensors,
        detector=question.get("detector", str),
        stated=_read_stated(plan.node("chosen"), cases.names[0]),
    )


def _read_class(row: JsonObject) -> StatedClass:
    """Read the result of one class. row: entry of `class_ap` of a plan.json."""
    judged = row.node("judged")
    low = read_optional(judged, "low", judged.number)
    high = read_optional(judged, "high", judged.number)
    judgement = Judgement(
        ap=judged.number("ap", low=0, high=1),
        low=math.nan if low is None else low,
        high=math.nan if high is None else high,
        recall=judged.number("recall", low=0, high=1),
        precision=read_optional(judged, "precision", judged.number),
        vehicles=judged.whole("vehicles", low=0, high=MAX_OBJECTS),
        frames=judged.whole("frames", low=1, high=MAX_FRAMES),
        kind=judged.get("kind", str),
    )
    iou: IoUs
    if isinstance(row.value.get("iou"), list):
        iou = tuple(row.numbers("iou"))
    else:
        iou = row.number("iou", low=0, high=1)
    weight = row.number("weight", low=0)
    return StatedClass(label=row.choice("label", LABELS), weight=weight, iou=iou, judged=judgement)


def _read_stated(chosen_set: JsonObject, errors: str) -> StatedFigure:
    """Read the AP of the intact set with its interval, whose ends are NaN if they are null.

    chosen_set: `chosen` of a plan.json; errors: name of the first error profile."""
    judgement = chosen_set.node("judged")
    low = read_optional(judgement, "low", judgement.number)
    high = read_optional(judgement, "high", judgement.number)
    return StatedFigure(
        frames=judgement.whole("frames", low=1, high=MAX_FRAMES),
        objects=judgement.whole("vehicles", low=0, high=MAX_OBJECTS),
        predicted=chosen_set.number("predicted"),
        ap=judgement.number("ap", low=0, high=1),
        low=math.nan if low is None else low,
        high=math.nan if high is None else high,
        errors=errors,
    )
