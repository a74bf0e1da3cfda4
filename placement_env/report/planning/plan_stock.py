"""Stock of a plan in plan.json, written and read: poles, sensor models and prices."""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import shapely

from placement_env.candidates.candidates import Axes, Candidates, aims, pool
from placement_env.candidates.sensor_catalogue import RATES, PricedModel, SensorCatalogue
from placement_env.report.planning.question import Question, Stock
from toolkit.geometry import MAX_COORDINATE_M
from toolkit.runtime.json_object import Json, JsonObject
from toolkit.runtime.reading import name_errors
from toolkit.sensors.models import name_in_words
from toolkit.sites.files import format_attitude, format_model, read_model, read_sensor
from toolkit.sites.site import MAX_BUILT_HEIGHT_M, ORIGINS, Mount, Site

MAX_STOCK_POLES = 5000
MAX_STOCK_MODELS = 100
MAX_AIM_STEPS = 360
MAX_STOCK_SENSORS = 10_000
MAX_KEEP_OUT_AREAS = 1000
MAX_STOCK_POSES = 400_000
MAX_PRICE = 1e15
MAX_KBIT = 1e12
MAX_YEARS = 1000  # over which yearly rates are added up


class StockModel(NamedTuple):
    """Sensor model of a stock, and whether plan.json gives it a price.

    A model without a price has the price 0."""

    priced_model: PricedModel
    is_priced: bool


def format_stock(question: Question, candidates: Candidates) -> Json:
    """Return the stock of a plan for plan.json, in the site's metres.

    The stock has poles, sensor models, prices and keep-out areas. If the candidates are all poses
    on some poles, each height with each heading and tilt (`is_product`), it has the heights, number
    of headings and tilts, and None for the sensors; otherwise it has each sensor, and None for
    these.

    question: question with the stock; candidates: sensors that the stock offers."""
    stock = question.stock
    axes = candidates.axes
    catalogue = stock.catalogue
    if catalogue is None:
        names = [name_in_words(type(model).__name__) for model in axes.models]
    else:
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
    """Return a pole for plan.json: foot x, y, z and heights of sensors above it in metres."""
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
    """Return the sensors for plan.json, each with the indices of its pole and model.

    The indices are for the lists of poles and models of the same stock; positions are x, y, z (m)
    in the site's frame."""
    poles = candidates.mount.tolist()
    # columns of factors: indices of mount, height, heading, tilt and model
    models = candidates.factors[:, 4].tolist()
    return [
        {
            "name": sensor.name,
            "pole": pole,
            "model": model,
            "position": sensor.position.tolist(),
            **format_attitude(sensor),
        }
        for sensor, pole, model in zip(candidates.sensors, poles, models, strict=True)
    ]


def _format_catalogue(catalogue: SensorCatalogue) -> Json:
    """Return a catalogue for plan.json without its models, which the stock lists."""
    return {
        "currency": catalogue.currency,
        "pole_price": catalogue.pole_price,
        "rates": catalogue.rates,
        "years": catalogue.years,
        "digest": catalogue.digest,
    }


def read_optional(node: JsonObject, key: str, read: Callable[[str], Any]) -> Any:
    """Read a member with `read`, or return None if it is null.

    A missing member is not None: `read`, a method of the node, gets its key and raises."""
    # `...` as default makes a missing member differ from null
    return None if node.value.get(key, ...) is None else read(key)


def read_stock(stock: JsonObject, site: Site, head: dict[str, str]) -> Stock:
    """Read poles, sensor models, prices and keep-out areas of a plan.json.

    The stock that comes back has finished candidates, not a name for them. Raises ValueError for a
    wrong member.

    Args:
        stock: `stock` of a plan.json.
        site: Site with the chosen sensors.
        head: Title, client, author and date of the catalogue."""
    poles = tuple(_read_pole(pole) for pole in stock.nodes("poles", MAX_STOCK_POLES))
    models = [_read_stock_model(model) for model in stock.nodes("models", MAX_STOCK_MODELS)]
    if not poles or not models:
        raise ValueError("stock must hold a pole and a model: the file is damaged")
    # one area too many is enough to refuse the file; thousands more are not parsed
    area_texts = stock.texts("keep_out_wkt")[: MAX_KEEP_OUT_AREAS + 1]
    areas = tuple(_read_area(text, i) for i, text in enumerate(area_texts))
    if len(areas) > MAX_KEEP_OUT_AREAS:
        raise ValueError(f"stock.keep_out_wkt must hold at most {MAX_KEEP_OUT_AREAS} areas")
    # null is allowed for both; `...` as default makes a missing member differ from null
    catalogue = None
    if stock.value.get("catalogue", ...) is not None:
        catalogue = _read_catalogue(stock.node("catalogue"), models, head)
    if stock.value.get("sensors", ...) is None:
        candidates = _read_pool(stock, site, poles, models)
    else:
        candidates = _read_mounted(stock, poles, models)
    return Stock(candidates=candidates, catalogue=catalogue, keep_out=areas)


def _read_pole(pole: JsonObject) -> Mount:
    """Read a pole of a plan.json: its foot, heights of sensors, price, link and room.

    Raises ValueError for a wrong member."""
    name = pole.get("name", str)
    origin = pole.choice("origin", ORIGINS)
    position = np.array([pole.number(axis, -MAX_COORDINATE_M, MAX_COORDINATE_M) for axis in "xyz"])
    min_height = pole.number("min_height", low=0, high=MAX_BUILT_HEIGHT_M)
    max_height = pole.number("max_height", low=0, high=MAX_BUILT_HEIGHT_M)
    price = pole.number("price", low=0, high=MAX_PRICE)
    capacity = pole.number("capacity_kbit", low=0, high=MAX_KBIT)
    max_sensors = pole.whole("max_sensors", low=1, high=MAX_STOCK_SENSORS)
    with name_errors(pole.path):
        return Mount(
            name=name,
            position=position,
            min_height=min_height,
            max_height=max_height,
            price=price,
            capacity=capacity,
            max_sensors=max_sensors,
            origin=origin,
        )


def _read_stock_model(row: JsonObject) -> StockModel:
    """Read a sensor model of a plan.json; one without a price gets 0."""
    price = read_optional(row, "price", lambda key: row.number(key, low=0, high=MAX_PRICE))
    model = read_model(row.node("model"))
    priced_model = PricedModel(row.get("name", str), model, price or 0.0)
    return StockModel(priced_model, is_priced=price is not None)


def _read_area(text: str, number: int) -> shapely.Geometry:
    """Read an area in which no sensor may stand.

    text: well-known text in the site's metres; number: index in the file, for error texts.
    Raises ValueError for damaged text or an unsound polygon."""
    member = f"stock.keep_out_wkt[{number}]"
    try:
        area = shapely.from_wkt(text)
    except shapely.errors.ShapelyError:
        raise ValueError(
            f"{member} must be a polygon as well-known text, got {text[:60]!r}"
        ) from None
    if not _is_sound(area):
        raise ValueError(
            f"{member} must be a sound polygon in the site's metres, got {text[:60]!r}"
        )
    return area


def _is_sound(area: shapely.Geometry | None) -> bool:
    """Return True if an area is a valid polygon, not empty, within `MAX_COORDINATE_M`."""
    if area is None or area.geom_type not in ("Polygon", "MultiPolygon"):
        return False
    if not area.is_valid or area.is_empty or not np.isfinite(area.bounds).all():
        return False
    return max(map(abs, area.bounds)) <= MAX_COORDINATE_M  # bounds: x and y, lowest and highest


def _read_catalogue(
    node: JsonObject, models: list[StockModel], head: dict[str, str]
) -> SensorCatalogue:
    """Read the catalogue of a stock; its models come from the stock's list.

    Raises ValueError for a wrong member or a model without a price.

    Args:
        node: `catalogue` of the stock.
        models: All models of the stock.
        head: Title, client, author and date of the report."""
    if not all(stock_model.is_priced for stock_model in models):
        raise ValueError(
            "stock.models must all have a price where there is a catalogue: the file is damaged"
        )
    rates = node.node("rates")
    rates.check_keys(RATES)
    return SensorCatalogue(
        models=tuple(stock_model.priced_model for stock_model in models),
        currency=node.get("currency", str),
        pole_price=read_optional(
            node, "pole_price", lambda key: node.number(key, low=0, high=MAX_PRICE)
        ),
        digest=node.get("digest", str),
        rates={key: rates.number(key, low=0, high=MAX_PRICE) for key in rates.value},
        years=node.number("years", low=0, high=MAX_YEARS),
        report=head,
    )


def _read_pool(
    stock: JsonObject, site: Site, poles: tuple[Mount, ...], models: list[StockModel]
) -> Candidates:
    """Return candidates in all poses: poles times heights, headings, tilts and models.

    Raises ValueError for a wrong member or too many poses.

    stock: `stock` of a plan.json with heights, headings and tilts; poles, models: its members,
    already read."""
    heights = stock.numbers("heights_m")
    tilts = stock.numbers("tilts_deg")
    headings = stock.whole("headings", low=1, high=MAX_AIM_STEPS)
    if max(len(heights), len(tilts)) > MAX_AIM_STEPS:
        raise ValueError(f"stock.heights_m and tilts_deg must hold at most {MAX_AIM_STEPS} numbers")
    poses = len(poles) * len(heights) * headings * len(tilts) * len(models)
    if poses > MAX_STOCK_POSES:
        raise ValueError(
            f"stock must have at most {MAX_STOCK_POSES} poses, got {poses}: leave out poles"
        )
    # `pool` takes a list of models without prices, or a dictionary from model to price
    models_offered: Any = [stock_model.priced_model.model for stock_model in models]
    if all(stock_model.is_priced for stock_model in models):
        priced_models = [stock_model.priced_model for stock_model in models]
        models_offered = {priced.model: priced.price for priced in priced_models}
    tilts_rad = np.deg2rad(tilts).tolist()
    with name_errors("stock"):
        return pool(
            site,
            heights=heights,
            headings=headings,
            tilts=tilts_rad,
            models=models_offered,
            mounts=poles,
        )


def _read_mounted(
    stock: JsonObject, poles: tuple[Mount, ...], models: list[StockModel]
) -> Candidates:
    """Return candidates in single poses, each on a pole of the stock.

    Raises ValueError for a wrong member or no sensor.

    stock: `stock` of a plan.json with a list of sensors; poles, models: its members, already
    read."""
    sensors = []
    pole_indices = []
    heights = []  # above the foot of the pole (m)
    for row in stock.nodes("sensors", MAX_STOCK_SENSORS):
        pole_index = row.whole("pole", low=0, high=len(poles) - 1)
        model_index = row.whole("model", low=0, high=len(models) - 1)
        model = models[model_index].priced_model.model
        sensor = read_sensor(row.numbers("position", 3), row, model)
        sensors.append(sensor)
        pole_indices.append(pole_index)
        foot = poles[pole_index].position
        heights.append(sensor.position[2] - foot[2])  # z of both
    if not sensors:
        raise ValueError("stock.sensors must hold one sensor or more, or be null")
    headings, tilts = aims(sensors)
    poses = np.column_stack([heights, headings, tilts])
    no_sensors = _offer_models(poles, models)
    with name_errors("stock"):
        return Candidates.from_poses(sensors, np.array(pole_indices, np.int64), poses, no_sensors)


def _offer_models(poles: tuple[Mount, ...], models: list[StockModel]) -> Candidates:
    """Return candidates without sensors, from which `from_poses` takes poles, models and prices.

    They have no prices unless all models have one."""
    prices: tuple[float, ...] = ()
    if all(stock_model.is_priced for stock_model in models):
        prices = tuple(stock_model.priced_model.price for stock_model in models)
    axes = Axes(
        heights=np.zeros(0),
        headings=np.zeros(0),
        tilts=np.zeros(0),
        models=tuple(stock_model.priced_model.model for stock_model in models),
        prices=prices,
    )
    no_factors = np.zeros((0, 5), np.int64)  # columns: mount, height, heading, tilt, model
    return Candidates(sensors=(), mounts=poles, factors=no_factors, axes=axes)
