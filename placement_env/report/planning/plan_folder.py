"""`PlanFolder`: a plan read from its folder. This is the only reader of plans.

plan.json holds the question, the chosen set with its figures, and the stock: poles, sensor models
and prices that the plan chose from. Every member that is used is checked. site.json in the same
folder has the chosen sensors. A plan.json without `coview_plan` is from before there were versions;
it is refused with that reason, because it lacks prices and poles."""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import shapely

from placement_env.candidates.candidates import Axes, Candidates, aims, pool
from placement_env.candidates.sensor_catalogue import RATES, PricedModel, SensorCatalogue
from placement_env.cases import MAX_FAILING, MAX_LEVELS, Cases
from placement_env.classes import Classes
from placement_env.handover.exchange import SITE
from placement_env.report.content import PLAN_VERSION
from placement_env.report.planning.question import Question, Stock
from placement_env.setting import Setting
from toolkit.detection.codec import Codec
from toolkit.detection.link.range_images import CODECS, find_codec
from toolkit.detection.schemes import SCHEMES
from toolkit.geometry import MAX_COORDINATE_M
from toolkit.runtime.files import name_errors, read_json
from toolkit.runtime.json_object import Json, JsonObject
from toolkit.sensors.error_profiles import PROFILES
from toolkit.sensors.models import name_in_words
from toolkit.sites.files import format_attitude, format_model, load_site, read_model, read_sensor
from toolkit.sites.site import MAX_BUILT_HEIGHT_M, ORIGINS, Mount, Site

PLAN_FILE = "plan.json"
MAX_STOCK_POLES = 5000
MAX_STOCK_MODELS = 100
MAX_AIM_STEPS = 360
MAX_STOCK_SENSORS = 10_000
MAX_KEEP_OUT_AREAS = 1000
MAX_STOCK_POSES = 400_000
MAX_FRAMES = 100_000
MAX_OBJECTS = 10**9
MAX_SEED = 2**63 - 1
MAX_PRICE = 1e15
MAX_KBIT = 1e12
MAX_POLE_GAP_M = 1.5  # between a sensor and its pole
PLAN_AGAIN = "make the plan again with coview plan"


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
        """Return the plan under another question, for which it states no figure."""
        names = ("fusion", "codec", "counted", "cases", "link_share")
        same = all(getattr(setting, name) == getattr(self.setting, name) for name in names)
        return replace(self, setting=setting, stated=self.stated if same else None)


def is_plan_folder(where: object) -> bool:
    """Return whether this is the path of a folder, which must then be a plan's folder."""
    return isinstance(where, str | Path) and Path(where).is_dir()


def read_plan_folder(where: str | Path) -> PlanFolder:
    """Read the plan in a folder.

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
        if plan.value.get("chosen", ...) is None:
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


def found_nothing(path: Path) -> bool:
    """Return whether a plan.json holds a plan without a set, which may be overwritten."""
    try:
        plan = JsonObject(read_json(path))
        return plan.node("verdict").value.get("met") is False
    except (OSError, ValueError):
        return False


def format_stock(question: Question, candidates: Candidates) -> Json:
    """Return the stock of a plan for plan.json, in the site's metres.

    The stock has poles, sensor models, prices and keep-out areas."""
    stock = question.stock
    axes = candidates.axes
    catalogue = stock.catalogue
    names = [name_in_words(type(model).__name__) for model in axes.models]
    if catalogue is not None:
        names = [catalogue.get_name(model) for model in axes.models]
    prices = axes.prices or (None,) * len(axes.models)
    models = [
        {"name": names[i], "price": prices[i], "model": format_model(model)}
        for i, model in enumerate(axes.models)
    ]
    is_product = stock.is_product
    return {
        "poles": [_format_pole(mount) for mount in candidates.mounts],
        "models": models,
        "heights_m": axes.heights.tolist() if is_product else None,
        "headings": len(axes.headings) if is_product else None,
        "tilts_deg": np.rad2deg(axes.tilts).round(9).tolist() if is_product else None,
        "sensors": None if is_product else _format_mounted(candidates),
        "keep_out_wkt": [area.wkt for area in stock.keep_out],
        "catalogue": None if catalogue is None else _format_catalogue(catalogue),
    }


def _format_pole(mount: Mount) -> Json:
    x, y, z = mount.position.tolist()
    return {
        "name": mount.name,
        "x": x,
        "y": y,
        "z": z,
        "min_height": mount.min_height,
        "max_height": mount.max_height,
        "price": mount.price,
        "capacity_kbit": mount.capacity,
        "max_sensors": mount.max_sensors,
        "origin": mount.origin,
    }


def _format_mounted(candidates: Candidates) -> list[Json]:
    rows = zip(candidates.sensors, candidates.factors.tolist(), strict=True)
    return [
        {
            "name": sensor.name,
            "pole": factors[0],
            "model": factors[4],
            "position": sensor.position.tolist(),
            **format_attitude(sensor),
        }
        for sensor, factors in rows
    ]


def _format_catalogue(catalogue: SensorCatalogue) -> Json:
    return {
        "currency": catalogue.currency,
        "pole_price": catalogue.pole_price,
        "rates": catalogue.rates,
        "years": catalogue.years,
        "digest": catalogue.digest,
    }


def _check_version(plan: JsonObject) -> None:
    if "coview_plan" not in plan.value:
        raise ValueError(
            "it has no coview_plan, so it is of an earlier coview, without poles and prices, or "
            f"no plan: {PLAN_AGAIN}"
        )
    version = plan.get("coview_plan", int)
    if version > PLAN_VERSION:
        raise ValueError(
            f"coview_plan is version {version!s:.20}, this coview reads up to {PLAN_VERSION}: "
            "install a newer one"
        )
    if version < PLAN_VERSION:
        raise ValueError(f"coview_plan must be {PLAN_VERSION}, got {version!s:.20}: {PLAN_AGAIN}")


def _check_poles(plan: JsonObject, site: Site, stock: Candidates) -> None:
    """Refuse a sensor whose pole is unknown or too far away."""
    poles = {mount.name: mount for mount in stock.mounts}
    for row, sensor in zip(plan.nodes("sensors", MAX_STOCK_SENSORS), site.sensors, strict=True):
        name = row.choice("pole", poles)
        distance = float(np.hypot(*(sensor.position - poles[name].position)[:2]))
        if distance > MAX_POLE_GAP_M:
            raise ValueError(
                f"{sensor.name} hangs {distance:.6g} m from its pole {name}, more than "
                f"{MAX_POLE_GAP_M:g} m: the file is damaged, or {SITE} was changed"
            )


def _check_sensors(plan: JsonObject, site: Site) -> None:
    names = [sensor.get("name", str) for sensor in plan.nodes("sensors", MAX_STOCK_SENSORS)]
    mounted = [sensor.name for sensor in site.sensors]
    if names != mounted:
        plan_names = ", ".join(names)[:80]
        site_names = ", ".join(mounted)[:80] or "none"
        raise ValueError(
            f"plan and site must have the same sensors, got {plan_names} here, {site_names} in "
            f"{SITE}: take both from one plan"
        )


def _read(folder: Path, plan: JsonObject, site: Site) -> PlanFolder:
    question = plan.node("question")
    head = plan.node("head")
    texts = {key: head.get(key, str) for key in head.value}
    money = _read_optional(question, "money", lambda key: question.number(key, 0, MAX_PRICE))
    sensors = _read_optional(
        question, "sensors", lambda key: question.whole(key, 0, MAX_STOCK_SENSORS)
    )
    cases = _read_cases(question)
    setting = Setting(
        site,
        candidates=_read_stock(plan.node("stock"), site, texts),
        scheme=question.choice("scheme", SCHEMES),
        codec=_read_codec(question),
        classes=_read_classes(question, cases),
        cases=cases,
        most_price=math.inf if money is None else money,
        keep=tuple(question.texts("keep")),
        link_share=question.number("link_share", 0, 1),
    )
    _check_poles(plan, site, setting.pool)
    frames = question.numbers("frames", 3)
    if not all(frame == int(frame) and 1 <= frame <= MAX_FRAMES for frame in frames):
        raise ValueError(
            f"question.frames must be three whole numbers from 1 to {MAX_FRAMES}, got {frames}"
        )
    return PlanFolder(
        folder,
        setting,
        int(frames[0]),
        int(frames[0]) if frames[0] == frames[1] else None,
        question.whole("seed", 0, MAX_SEED),
        math.inf if sensors is None else sensors,
        question.get("detector", str),
        _read_stated(plan.node("chosen"), cases.names[0]),
    )


def _read_optional(node: JsonObject, key: str, read: Callable[[str], Any]) -> Any:
    """Read a member that may be null, but not missing."""
    return None if node.value.get(key, ...) is None else read(key)


def _read_cases(question: JsonObject) -> Cases:
    several = isinstance(question.value.get("iou"), list)
    ious = tuple(question.numbers("iou")) if several else (question.number("iou"),)
    errors = question.texts("errors")
    for name in errors:
        if name not in PROFILES:
            profile_names = ", ".join(PROFILES)
            raise ValueError(
                f"question.errors has a profile {name[:60]!r} that is not one of {profile_names}: "
                f"{PLAN_AGAIN}"
            )
    with name_errors("question"):
        return Cases(
            iou=ious,
            failing=question.whole("failing", 0, MAX_FAILING),
            failures=question.choice("failures", ("worst", "mean")),  # type: ignore[arg-type]
            levels=question.whole("levels", 1, MAX_LEVELS),
            levels_by=question.choice("levels_by", ("worst", "mean")),  # type: ignore[arg-type]
            errors=tuple(errors),
            errors_by=question.choice("errors_by", ("worst", "mean")),  # type: ignore[arg-type]
        )


def _read_classes(question: JsonObject, cases: Cases) -> Classes:
    names = question.texts("classes")
    weights = question.numbers("class_weights")
    stated_ious = question.get("class_ious", list)
    with name_errors("question"):
        combine = question.choice("combine", ("mean", "worst"))
        plain = Classes(tuple(names), tuple(weights), combine)  # type: ignore[arg-type]
        if len(stated_ious) != len(plain.names):
            raise ValueError(
                f"class_ious must hold one for each of {', '.join(plain.names)}, got "
                f"{len(stated_ious)}"
            )
        ious = [
            _find_class_iou(cases, plain, name, iou)
            for name, iou in zip(plain.names, stated_ious, strict=True)
        ]
        return replace(plain, ious=tuple(ious))


def _find_class_iou(cases: Cases, plain: Classes, name: str, stated: object) -> float | None:
    """Return the IoU of a class, None if it is the usual one."""
    usual = cases.class_ious(plain, name)
    if stated == usual or stated == list(np.atleast_1d(usual)):
        return None
    if isinstance(stated, bool) or not isinstance(stated, int | float):
        raise ValueError(
            f"class_ious of {name} must be one number, or the IoU of the question, got "
            f"{stated!r:.60}"
        )
    return float(stated)


def _read_codec(question: JsonObject) -> Codec:
    digest = question.get("codec", str)
    for name in CODECS:
        if find_codec(name).digest == digest:
            return find_codec(name)
    raise ValueError(
        f"question.codec must belong to {' or '.join(CODECS)}, got {digest[:60]!r}: {PLAN_AGAIN}"
    )


def _read_stated(chosen_set: JsonObject, errors: str) -> StatedFigure:
    judgement = chosen_set.node("judged")
    low = _read_optional(judgement, "low", judgement.number)
    high = _read_optional(judgement, "high", judgement.number)
    return StatedFigure(
        frames=judgement.whole("frames", 1, MAX_FRAMES),
        objects=judgement.whole("vehicles", 0, MAX_OBJECTS),
        predicted=chosen_set.number("predicted"),
        ap=judgement.number("ap", 0, 1),
        low=math.nan if low is None else low,
        high=math.nan if high is None else high,
        errors=errors,
    )


def _read_stock(stock: JsonObject, site: Site, head: dict[str, str]) -> Stock:
    poles = tuple(_read_pole(pole) for pole in stock.nodes("poles", MAX_STOCK_POLES))
    models = [_read_priced(model) for model in stock.nodes("models", MAX_STOCK_MODELS)]
    if not poles or not models:
        raise ValueError("stock must hold a pole and a model: the file is damaged")
    area_texts = stock.texts("keep_out_wkt")[: MAX_KEEP_OUT_AREAS + 1]
    areas = tuple(_read_area(text, i) for i, text in enumerate(area_texts))
    if len(areas) > MAX_KEEP_OUT_AREAS:
        raise ValueError(f"stock.keep_out_wkt must hold at most {MAX_KEEP_OUT_AREAS} areas")
    catalogue = None
    if stock.value.get("catalogue", ...) is not None:
        catalogue = _read_catalogue(stock.node("catalogue"), models, head)
    if stock.value.get("sensors", ...) is None:
        candidates = _read_pool(stock, site, poles, models)
    else:
        candidates = _read_mounted(stock, poles, models)
    return Stock(candidates=candidates, catalogue=catalogue, keep_out=areas)


def _read_pole(pole: JsonObject) -> Mount:
    name = pole.get("name", str)
    origin = pole.choice("origin", ORIGINS)
    position = np.array([pole.number(axis, -MAX_COORDINATE_M, MAX_COORDINATE_M) for axis in "xyz"])
    min_height = pole.number("min_height", 0, MAX_BUILT_HEIGHT_M)
    max_height = pole.number("max_height", 0, MAX_BUILT_HEIGHT_M)
    price = pole.number("price", 0, MAX_PRICE)
    capacity = pole.number("capacity_kbit", 0, MAX_KBIT)
    max_sensors = pole.whole("max_sensors", 1, MAX_STOCK_SENSORS)
    with name_errors(pole.path):
        return Mount(name, position, min_height, max_height, price, capacity, max_sensors, origin)


def _read_priced(row: JsonObject) -> tuple[PricedModel, bool]:
    """Read a model, and whether it has a price."""
    price = _read_optional(row, "price", lambda key: row.number(key, 0, MAX_PRICE))
    model = read_model(row.node("model"))
    return PricedModel(row.get("name", str), model, price or 0.0), price is not None


def _read_area(text: str, number: int) -> shapely.Geometry:
    where = f"stock.keep_out_wkt[{number}]"
    try:
        area = shapely.from_wkt(text)
    except shapely.errors.ShapelyError:
        raise ValueError(
            f"{where} must be a polygon as well-known text, got {text[:60]!r}"
        ) from None
    if not _is_sound(area):
        raise ValueError(f"{where} must be a sound polygon in the site's metres, got {text[:60]!r}")
    return area


def _is_sound(area: shapely.Geometry | None) -> bool:
    """Return whether an area is a valid polygon with coordinates within bounds."""
    if area is None or area.geom_type not in ("Polygon", "MultiPolygon"):
        return False
    if not area.is_valid or area.is_empty or not np.isfinite(area.bounds).all():
        return False
    return max(map(abs, area.bounds)) <= MAX_COORDINATE_M


def _read_catalogue(
    node: JsonObject, models: list[tuple[PricedModel, bool]], head: dict[str, str]
) -> SensorCatalogue:
    if not all(is_priced for _, is_priced in models):
        raise ValueError(
            "stock.models must all have a price where there is a catalogue: the file is damaged"
        )
    rates = node.node("rates")
    rates.check_keys(RATES)
    return SensorCatalogue(
        tuple(model for model, _ in models),
        node.get("currency", str),
        _read_optional(node, "pole_price", lambda key: node.number(key, 0, MAX_PRICE)),
        node.get("digest", str),
        {key: rates.number(key, 0, MAX_PRICE) for key in rates.value},
        node.number("years", 0, 1000),
        head,
    )


def _read_pool(
    stock: JsonObject, site: Site, poles: tuple[Mount, ...], models: list[tuple[PricedModel, bool]]
) -> Candidates:
    heights = stock.numbers("heights_m")
    tilts = stock.numbers("tilts_deg")
    headings = stock.whole("headings", 1, MAX_AIM_STEPS)
    if max(len(heights), len(tilts)) > MAX_AIM_STEPS:
        raise ValueError(f"stock.heights_m and tilts_deg must hold at most {MAX_AIM_STEPS} numbers")
    poses = len(poles) * len(heights) * headings * len(tilts) * len(models)
    if poses > MAX_STOCK_POSES:
        raise ValueError(
            f"stock must have at most {MAX_STOCK_POSES} poses, got {poses}: leave out poles"
        )
    models_offered: Any = [priced_model.model for priced_model, _ in models]
    if all(is_priced for _, is_priced in models):
        models_offered = {priced_model.model: priced_model.price for priced_model, _ in models}
    radians = np.deg2rad(tilts).tolist()
    with name_errors("stock"):
        return pool(
            site,
            heights=heights,
            headings=headings,
            tilts=radians,
            models=models_offered,
            mounts=poles,
        )


def _read_mounted(
    stock: JsonObject, poles: tuple[Mount, ...], models: list[tuple[PricedModel, bool]]
) -> Candidates:
    sensors = []
    factors = []
    for row in stock.nodes("sensors", MAX_STOCK_SENSORS):
        pole = row.whole("pole", 0, len(poles) - 1)
        model = row.whole("model", 0, len(models) - 1)
        sensor = read_sensor(row.numbers("position", 3), row, models[model][0].model)
        sensors.append(sensor)
        factors.append((pole, model))
    if not sensors:
        raise ValueError("stock.sensors must hold one sensor or more, or be null")
    mount = np.array([pole for pole, _ in factors], np.int64)
    headings, tilts = aims(sensors)
    heights = [
        sensor.position[2] - poles[pole].position[2]
        for sensor, pole in zip(sensors, mount.tolist(), strict=True)
    ]
    prices: tuple[float, ...] = ()
    if all(is_priced for _, is_priced in models):
        prices = tuple(priced_model.price for priced_model, _ in models)
    sensor_models = tuple(priced_model.model for priced_model, _ in models)
    axes = Axes(np.zeros(0), np.zeros(0), np.zeros(0), sensor_models, prices)
    empty = Candidates((), poles, np.zeros((0, 5), np.int64), axes)
    poses = np.column_stack([heights, headings, tilts])
    with name_errors("stock"):
        return Candidates.from_poses(sensors, mount, poses, empty)
