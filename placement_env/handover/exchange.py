"""Files for spreadsheets, GIS tools and coview itself.

The same set gives the same bytes.

schedule.csv has a line per sensor (RFC 4180, UTF-8); a text that a spreadsheet would read as a formula begins with an
apostrophe. plan.geojson is in longitude and latitude (RFC 7946), or in the site's metres if it has no geographic
reference. Its layers are area, sensor, visible, blind and mount: the unused poles, which coview reads back as poles.
site.json is the site with the sensors, in the format for `coview simulate`.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
import shapely

from placement_env.handover.ground import Ground, blind_polygons, visible_polygons
from placement_env.handover.mounted import PlannedSensor
from toolkit.runtime.files import write_text
from toolkit.sites.files import save_site
from toolkit.sites.georeference import feature, feature_collection, mount_feature
from toolkit.sites.site import Mount, Site

SCHEDULE, MAP, SITE = "schedule.csv", "plan.geojson", "site.json"
EXCHANGE_FILES = (SCHEDULE, MAP, SITE)
FORMULA = ("=", "+", "-", "@", "\t", "\r", "\n")  # first characters of a cell that a spreadsheet would compute
IN_METRES = "the site has no geographic reference: coordinates are metres of the site frame, not longitude and latitude"


def write_exchange(
    folder: str | Path,
    site: Site,
    sensors: Sequence[PlannedSensor],
    ground: Ground,
    *,
    unused: Sequence[Mount] = (),
    currency: str = "",
) -> None:
    """Write `EXCHANGE_FILES` into a folder.

    The folder may be that of `toolkit.runtime.files.writing_together`. site: with the sensors; ground: that they see,
    in their order; unused: poles without a sensor; currency: of prices, "" for units of one ordinary pole. Raises
    ValueError if site, sensors and ground do not belong to one set.
    """
    names = [sensor.name for sensor in sensors]
    mounted = [sensor.name for sensor in site.sensors]
    if names != mounted or len(ground.seen) != len(names):
        raise ValueError(
            f"the site must have the planned sensors and the ground a layer for each, got {mounted} at the site, "
            f"{names} planned and {len(ground.seen)} layers: use mounted_site and visible_ground"
        )
    folder = Path(folder)
    write_text(folder / SCHEDULE, schedule_csv(sensors, currency))
    write_text(folder / MAP, plan_geojson(site, sensors, ground, unused=unused))
    save_site(site, folder / SITE)


def schedule_csv(sensors: Sequence[PlannedSensor], currency: str = "") -> str:
    """Mounting schedule, one line per sensor. Lengths are in m (site frame), angles in degrees, kbit per frame."""
    rows = [_row(sensor, currency or "ordinary poles") for sensor in sensors]
    text = io.StringIO(newline="")
    writer = csv.writer(text, lineterminator="\r\n")
    writer.writerow(COLUMNS)
    writer.writerows(rows)
    return text.getvalue()


COLUMNS = (
    *("pole", "sensor", "x_m", "y_m", "z_m", "longitude", "latitude", "height_m", "bearing_deg", "tilt_deg"),
    *("model", "model_price", "pole_price", "price_unit"),
    *("kbit_per_frame", "peak_kbit_per_frame", "link_kbit_per_frame"),
)


def _row(sensor: PlannedSensor, unit: str) -> list[str]:
    degrees = ["" if angle is None else f"{angle:.8f}" for angle in (sensor.longitude, sensor.latitude)]
    return [
        safe_cell(sensor.pole),
        safe_cell(sensor.name),
        *(_fixed(length, 3) for length in (sensor.x, sensor.y, sensor.z)),
        *degrees,
        _fixed(sensor.height, 3),
        _fixed(_bearing(sensor), 1),
        _fixed(sensor.tilt_deg, 1),
        safe_cell(sensor.model),
        f"{sensor.model_price:.10g}",
        f"{sensor.pole_price:.10g}",
        safe_cell(unit),
        *(_fixed(kbit, 1) for kbit in (sensor.kbit, sensor.peak_kbit, sensor.capacity_kbit)),
    ]


def safe_cell(text: str) -> str:
    """Return a cell text that no program reads as formula."""
    return f"'{text}" if text.startswith(FORMULA) else text


def _fixed(value: float, decimals: int) -> str:
    return f"{round(value, decimals) + 0.0:.{decimals}f}"


def _bearing(sensor: PlannedSensor) -> float:
    return round(sensor.bearing_deg, 1) % 360.0


def plan_geojson(site: Site, sensors: Sequence[PlannedSensor], ground: Ground, *, unused: Sequence[Mount] = ()) -> str:
    """Sensors, their ground, blind spots and unused poles. The layers are for GIS tools."""
    note: dict[str, object] = {} if site.geo_reference is not None else {"coview_site": 1, "note": IN_METRES}
    return feature_collection(_layers(site, sensors, ground, unused), name=f"{site.name} plan", **note)


def _layers(
    site: Site, sensors: Sequence[PlannedSensor], ground: Ground, unused: Sequence[Mount]
) -> Iterator[dict[str, object]]:
    yield feature(site, shapely.box(*site.area), layer="area", name=site.name)
    for sensor in sensors:
        yield feature(site, shapely.Point(sensor.x, sensor.y), layer="sensor", **_properties(sensor))
    square = ground.cell**2
    for sensor, seen, polygons in zip(sensors, ground.seen, visible_polygons(ground), strict=True):
        size = round(float((seen & ground.open_ground).sum()) * square, 1)
        yield feature(site, shapely.MultiPolygon(polygons), layer="visible", name=sensor.name, m2=size)
    dark = ground.open_ground & ~np.any(ground.seen, axis=0)
    blind = shapely.MultiPolygon(blind_polygons(ground))
    yield feature(site, blind, layer="blind", name="seen by no sensor", m2=round(float(dark.sum()) * square, 1))
    yield from (mount_feature(site, mount, used=False) for mount in unused)


def _properties(sensor: PlannedSensor) -> dict[str, object]:
    return {
        "name": sensor.name,
        "pole": sensor.pole,
        "model": sensor.model,
        "height": round(sensor.height, 3),
        "z": round(sensor.z, 3),
        "bearing_deg": _bearing(sensor),
        "tilt_deg": round(sensor.tilt_deg, 1) + 0.0,
        "model_price": sensor.model_price,
        "pole_price": sensor.pole_price,
        "kbit": round(sensor.kbit, 1),
        "peak_kbit": round(sensor.peak_kbit, 1),
        "capacity_kbit": sensor.capacity_kbit,
    }
