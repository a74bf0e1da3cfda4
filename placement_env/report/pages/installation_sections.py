"""Sections of the report on mounting: links, items to order, schedule and views."""

from collections.abc import Sequence

import numpy as np

from placement_env.classes import join_names
from placement_env.handover.mounted import FRAME_RATE_HZ, MaterialItem
from placement_env.links import describe_share
from placement_env.report import charts, content
from placement_env.report.pages.columns import price_column, text_columns
from placement_env.report.pages.document import (
    Column,
    Content,
    PageDrawing,
    Paragraph,
    ReportBlock,
    build_content,
    build_table,
)
from placement_env.report.pages.figure_texts import number_text, percent, price_text
from placement_env.report.sensor_views import draw_sensor_views
from toolkit.display import describe_count
from toolkit.sites.georeference import bearing_deg
from toolkit.sites.site import Site

MAX_EAST_TURN_DEG = 0.5  # an axis of the site that is turned by less counts as east


def links_section(plan: content.Plan) -> Content:
    """Compare the load of the poles' links with their capacity, and name those too narrow."""
    if not plan.links:
        return build_content("No link carries anything.")
    narrow_poles = [link.pole for link in plan.links if not link.fits]
    fullest = max(plan.links, key=lambda link: link.share)
    total = sum(link.mbit_s for link in plan.links)
    conclusion = (
        f"Every link carries what is sent; the fullest, at {fullest.pole}, is used to "
        f"{percent(fullest.share)}: it needs {number_text(fullest.load_mbit_s, 2)} of "
        f"{number_text(fullest.capacity_mbit_s, 2)} Mbit/s."
    )
    if narrow_poles:
        conclusion = (
            f"{describe_count(len(narrow_poles), 'link')} of {len(plan.links)} cannot carry what "
            f"is sent: {join_names(narrow_poles)}."
        )
    loads = [Column(name, "Mbit/s", 2) for name in ("mean", "load", "largest frame", "capacity")]
    columns = (*text_columns("Pole"), *loads, Column("used", "%"), *text_columns("fits"))
    load_rule = f"what is sent does not exceed in {describe_share(plan.link_share)}"
    rows = [
        (
            link.pole,
            link.mbit_s,
            link.load_mbit_s,
            link.peak_mbit_s,
            link.capacity_mbit_s,
            link.share,
            "yes" if link.fits else "no",
        )
        for link in plan.links
    ]
    load_texts = "; ".join(
        f"{link.pole}: {number_text(link.mbit_s, 2)} of {number_text(link.capacity_mbit_s, 2)}"
        for link in plan.links
    )
    drawing = PageDrawing(
        charts.link_chart(plan.links),
        f"All links together carry {number_text(total, 2)} Mbit/s to the fusion centre.",
        f"Mbit/s of each link against its capacity: {load_texts}",
    )
    caption = (
        f"Load at {FRAME_RATE_HZ:g} frames a second. A link must carry its load, which {load_rule}"
    )
    return build_content(conclusion, drawing, *build_table(caption, columns, rows))


def materials_section(plan: content.Plan) -> Content:
    """List the items to order and what the catalogue's rates add, with prices."""
    if not plan.materials:
        return build_content("There is nothing to order.")
    dearest_item = max(plan.materials, key=lambda item: item.price)
    total = price_text(sum(item.price for item in plan.materials), plan.currency)
    dearest_price = price_text(dearest_item.price, plan.currency)
    unit_price = price_text(dearest_item.unit_price, plan.currency)
    conclusion = (
        f"The total is {total}; the largest part, {dearest_price}, is "
        f"“{dearest_item.item}” ({dearest_item.count} at {unit_price})."
    )
    columns = (
        *text_columns("Item"),
        Column("count", digits=0),
        price_column("each", plan.currency),
        price_column("total", plan.currency),
    )
    blocks: list[ReportBlock] = []
    if not plan.currency:
        blocks.append(Paragraph("Prices are in units of one ordinary pole."))
    blocks += build_table("What to order", columns, _item_rows(plan.materials))
    # `running`: yearly and other costs by the catalogue's rates
    blocks += build_table("What the rates add to the price", columns, _item_rows(plan.running))
    return build_content(conclusion, *blocks)


def _item_rows(items: Sequence[MaterialItem]) -> list[tuple[str, int, float, float]]:
    # columns: name, number, price of one, price of all
    return [(item.item, item.count, item.unit_price, item.price) for item in items]


def schedule_section(plan: content.Plan, site: Site) -> Content:
    """List the position and aim of each sensor, for mounting.

    Longitudes and latitudes are listed if the site has a geographic reference; sensors' names only
    if they differ from those on their poles.

    site: gives the compass directions of the axes x and y."""
    if not plan.sensors:
        return build_content("There is nothing to mount.")
    min_height = min(sensor.height for sensor in plan.sensors)
    max_height = max(sensor.height for sensor in plan.sensors)
    heights = f"{plan.sensors[0].height:.1f}"
    if max_height - min_height >= 0.05:
        heights = f"{min_height:.1f} to {max_height:.1f}"
    poles = describe_count(len({sensor.pole for sensor in plan.sensors}), "pole")
    on_earth = all(
        sensor.longitude is not None and sensor.latitude is not None for sensor in plan.sensors
    )
    along_x = bearing_deg(site, 0.0)
    along_y = bearing_deg(site, np.pi / 2)
    x, y = ("east x", "north y") if abs(along_x - 90.0) < MAX_EAST_TURN_DEG else ("x", "y")
    has_names = any(sensor.name != sensor.pole for sensor in plan.sensors)
    titles = ("Sensor", "Pole", "Model") if has_names else ("Pole", "Model")
    columns = list(text_columns(*titles))
    columns += [Column(name, "m", 2) for name in (x, y, "height")]
    if on_earth:
        columns += [Column("longitude", "°", 6), Column("latitude", "°", 6)]
    columns += [Column("bearing", "°"), Column("tilt down", "°")]
    rows = []
    for sensor in plan.sensors:
        row: list[str | float | None] = [sensor.name] if has_names else []
        row += [sensor.pole, sensor.model, sensor.x, sensor.y, sensor.height]
        if on_earth:
            row += [sensor.longitude, sensor.latitude]
        row += [sensor.bearing_deg, sensor.tilt_deg]
        rows.append(row)
    note = (
        "Bearings are compass bearings of the optical axis, clockwise from north; tilt is below "
        "the horizon; height is above the foot of the pole. x and y are metres from the site's "
        f"origin: x runs towards {along_x:.0f}°, y towards {along_y:.0f}°."
    )
    if not on_earth:
        note += " The site has no geographic reference, so there are no longitudes and latitudes."
    return build_content(
        (
            f"Mount {describe_count(len(plan.sensors), 'sensor')} on {poles}, {heights} m above "
            "the foot of the pole."
        ),
        Paragraph(note),
        *build_table("Sensor by sensor", columns, rows),
    )


def views_section(
    plan: content.Plan, site: Site, moments: Sequence[content.SceneMoment]
) -> Content:
    """Show pictures of what each sensor sees, with its points on vehicles of the first moment.

    site: site with the chosen sensors; moments: frames with their clouds, empty for no points.
    There are pictures of the first sensors only if there are many."""
    pictures = draw_sensor_views(site, site.sensors, moments)
    marks_note = (
        " Its points on vehicles of one moment are green where all sensors together find the "
        "vehicle, else red."
    )
    if not moments:
        marks_note = ""
    views = []
    # further sensors have no picture
    for sensor, svg in zip(site.sensors, pictures, strict=False):
        caption = f"{sensor.name}: the empty site, lighter where nearer.{marks_note}"
        alt = f"Distances that sensor {sensor.name} measures at the empty site"
        views.append(PageDrawing(svg, caption, alt))
    drawn_sensors = "Each sensor"
    if len(pictures) != len(plan.sensors):
        drawn_sensors = f"Each of the first {len(pictures)} of {len(plan.sensors)} sensors"
    return build_content(
        f"{drawn_sensors} looks at the junction from its pole as drawn here.", *views
    )
