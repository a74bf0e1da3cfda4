"""Files for spreadsheets, GIS tools and coview itself. The same set gives the same bytes.

schedule.csv has a line per sensor (RFC 4180, UTF-8). An apostrophe precedes any text that a
spreadsheet would read as a formula, also if it separates cells by semicolons. plan.geojson is in
longitude and latitude (RFC 7946), or in the site's metres if it has no geographic reference. Its
layers are area, sensor, visible, blind and mount: the unused poles, which coview reads back as
poles. site.json is the site with the sensors, in the format for `coview simulate`.
"""

import csv
import io
import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import shapely

from placement_env.handover.ground import GroundGrid, blind_polygons, visible_polygons
from placement_env.handover.mounted import PlannedSensor
from toolkit.runtime.writing import write_text
from toolkit.sites.files import save_site
from toolkit.sites.georeference import feature, feature_collection, mount_feature
from toolkit.sites.site import Mount, Site

SCHEDULE = "schedule.csv"
MAP = "plan.geojson"
SITE = "site.json"
EXCHANGE_FILES = (SCHEDULE, MAP, SITE)
FORMULA_START = re.compile(  # start of a cell that a spreadsheet may compute
    r"""(^|;|(?<!^)[\t\r\n])(?=["'\s]*[=+\-@\uff1d\uff0b\uff0d\uff20]|^[\t\r\n])"""
)
SCHEDULE_COLUMNS = (
    "pole",
    "sensor",
    "x_m",
    "y_m",
    "z_m",
    "longitude",
    "latitude",
    "height_m",
    "bearing_deg",
    "tilt_deg",
    "model",
    "model_price",
    "pole_price",
    "price_unit",
    "kbit_per_frame",
    "peak_kbit_per_frame",
    "link_kbit_per_frame",
)
SENSOR_PROPERTIES = (  # on the map
    "name",
    "pole",
    "model",
    "height",
    "z",
    "bearing_deg",
    "tilt_deg",
    "model_price",
    "pole_price",
    "kbit",
    "peak_kbit",
    "capacity_kbit",
)
ROUNDED_DIGITS = {"height": 3, "z": 3, "tilt_deg": 1, "kbit": 1, "peak_kbit": 1}  # decimals
METRES_NOTE = (
    "the site has no geographic reference: coordinates are metres of the site frame, not "
    "longitude and latitude"
)


def write_exchange(
    folder: str | Path,
    site: Site,
    sensors: Sequence[PlannedSensor],
    ground: GroundGrid,
    *,
    unused: Sequence[Mount] = (),
    currency: str = "",
) -> None:
    """Write `EXCHANGE_FILES` into a folder, which `toolkit.runtime.writing.writing_together` may
    yield.

    site: with the sensors; ground: visible to the sensors, in their order; unused: poles without a
    sensor; currency: unit of prices, "" for units of one ordinary pole. Raises ValueError if site,
    sensors and ground do not belong to one set.
    """
    names = [sensor.name for sensor in sensors]
    mounted_names = [sensor.name for sensor in site.sensors]
    if names != mounted_names or len(ground.seen) != len(names):
        rule = (
            "the site must have the planned sensors and the ground a layer for each, got "
            f"{mounted_names} at the site"
        )
        raise ValueError(
            f"{rule}, {names} planned and {len(ground.seen)} layers: use mounted_site and "
            "visible_ground"
        )
    folder = Path(folder)
    write_text(folder / SCHEDULE, schedule_csv(sensors, currency))
    write_text(folder / MAP, plan_geojson(site, sensors, ground, unused=unused))
    save_site(site, folder / SITE)


def schedule_csv(sensors: Sequence[PlannedSensor], currency: str = "") -> str:
    """Mounting schedule as CSV text, a line for each sensor under a line of headings.

    Lengths are in m (site frame), angles in degrees, data in kbit per frame. currency: unit of the
    prices, "" if they are multiples of an ordinary pole's price.
    """
    text = io.StringIO(newline="")
    writer = csv.writer(text, lineterminator="\r\n")
    writer.writerow(SCHEDULE_COLUMNS)
    for sensor in sensors:
        # in the order of `SCHEDULE_COLUMNS`
        row = [
            safe_cell(sensor.pole),
            safe_cell(sensor.name),
            _fixed(sensor.x, 3),
            _fixed(sensor.y, 3),
            _fixed(sensor.z, 3),
            "" if sensor.longitude is None else f"{sensor.longitude:.8f}",
            "" if sensor.latitude is None else f"{sensor.latitude:.8f}",
            _fixed(sensor.height, 3),
            _fixed(_bearing(sensor), 1),
            _fixed(sensor.tilt_deg, 1),
            safe_cell(sensor.model),
            f"{sensor.model_price:.10g}",
            f"{sensor.pole_price:.10g}",
            safe_cell(currency or "ordinary poles"),
            _fixed(sensor.kbit, 1),
            _fixed(sensor.peak_kbit, 1),
            _fixed(sensor.capacity_kbit, 1),
        ]
        writer.writerow(row)
    return text.getvalue()


def safe_cell(text: str) -> str:
    """Text of a cell that no program reads as a formula."""
    return FORMULA_START.sub(r"\1'", text)


def _fixed(value: float, decimals: int) -> str:
    """Number with so many decimals; + 0.0 makes a rounded -0.0 a 0.0."""
    return f"{round(value, decimals) + 0.0:.{decimals}f}"


def _bearing(sensor: PlannedSensor) -> float:
    """Bearing of a sensor with one decimal, in [0, 360) degrees also after rounding."""
    return round(sensor.bearing_deg, 1) % 360.0


def plan_geojson(
    site: Site,
    sensors: Sequence[PlannedSensor],
    ground: GroundGrid,
    *,
    unused: Sequence[Mount] = (),
) -> str:
    """GeoJSON text of sensors, the ground they see, blind spots and unused poles, for GIS tools.

    ground: cells that each sensor sees, in the order of `sensors`; unused: mounts without a sensor.
    Coordinates are metres, with a note, if the site has no geo reference."""
    note: dict[str, object] = {}
    if site.geo_reference is None:
        note = {"coview_site": 1, "note": METRES_NOTE}
    layers = [feature(site, shapely.box(*site.area), layer="area", name=site.name)]
    for sensor in sensors:
        properties = {name: getattr(sensor, name) for name in SENSOR_PROPERTIES}
        for name, digits in ROUNDED_DIGITS.items():
            properties[name] = round(properties[name], digits) + 0.0  # no -0.0
        properties["bearing_deg"] = _bearing(sensor)
        layers.append(
            feature(site, shapely.Point(sensor.x, sensor.y), layer="sensor", **properties)
        )
    cell_m2 = ground.cell**2
    visible_cells = ground.seen & ground.open_ground  # (sensors, ny, nx)
    sensor_polygons = visible_polygons(ground)
    for sensor, cells, polygons in zip(sensors, visible_cells, sensor_polygons, strict=True):
        shape = shapely.MultiPolygon(polygons)
        area_m2 = round(float(cells.sum()) * cell_m2, 1)
        layers.append(feature(site, shape, layer="visible", name=sensor.name, m2=area_m2))
    is_blind = ground.open_ground & ~np.any(ground.seen, axis=0)
    shape = shapely.MultiPolygon(blind_polygons(ground))
    area_m2 = round(float(is_blind.sum()) * cell_m2, 1)
    layers.append(feature(site, shape, layer="blind", name="seen by no sensor", m2=area_m2))
    layers += [mount_feature(site, mount, used=False) for mount in unused]
    return feature_collection(layers, name=f"{site.name} plan", **note)
