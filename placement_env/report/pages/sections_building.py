"""Sections for those who build: links, bill of materials, mounting schedule."""

from __future__ import annotations

from placement_env.report.content import RATE, Plan
from placement_env.report.drawings.charts import link_chart
from placement_env.report.pages.document import Column, Drawing, Paragraph, ReportBlock, Section, table
from placement_env.report.pages.sections_answer import NOTHING_CHOSEN
from placement_env.report.pages.wording import (
    counted,
    figure_cell,
    listed,
    number,
    percent,
    price_column,
    price_text,
    share_cell,
    text_cell,
)


def links_section(plan: Plan) -> Section:
    """Whether the links carry what the sensors send."""
    key, title = "links", "What the links carry"
    if plan.chosen is None or not plan.links:
        return Section(key, title, NOTHING_CHOSEN if plan.chosen is None else "No link carries anything.")
    narrow = [each for each in plan.links if not each.fits]
    fullest = max(plan.links, key=lambda each: each.share)
    conclusion = (
        f"{counted(len(narrow), 'link')} of {len(plan.links)} cannot carry what is sent: "
        f"{listed([each.pole for each in narrow])}."
        if narrow
        else f"Every link carries what is sent; the fullest, of {fullest.pole}, is used to {percent(fullest.share)}: "
        f"{number(fullest.mbit_s, 2)} of {number(fullest.capacity_mbit_s, 2)} Mbit/s."
    )
    columns = (
        Column("Pole", number=False),
        *(Column(name, "Mbit/s") for name in ("mean", "greatest frame", "capacity")),
        Column("used", "%"),
        Column("fits", number=False),
    )
    rows = [
        (
            text_cell(each.pole),
            *(figure_cell(value, 2) for value in (each.mbit_s, each.peak_mbit_s, each.capacity_mbit_s)),
            share_cell(each.share),
            text_cell("yes" if each.fits else "no"),
        )
        for each in plan.links
    ]
    alt = "Mbit/s of each link against its capacity: " + "; ".join(
        f"{each.pole}: {number(each.mbit_s, 2)} of {number(each.capacity_mbit_s, 2)}" for each in plan.links
    )
    total = sum(each.mbit_s for each in plan.links)
    said = f"All links together carry {number(total, 2)} Mbit/s to the place where detections are fused."
    blocks: tuple[ReportBlock, ...] = (
        Drawing(link_chart(plan.links), said, alt),
        *table(f"Load at {RATE:g} frames a second", columns, rows),
    )
    return Section(key, title, conclusion, blocks)


def materials_section(plan: Plan) -> Section:
    """What to order."""
    key, title = "materials", "Bill of materials"
    if plan.chosen is None or not plan.materials:
        return Section(key, title, NOTHING_CHOSEN if plan.chosen is None else "There is nothing to order.")
    total, dearest = sum(each.price for each in plan.materials), max(plan.materials, key=lambda each: each.price)
    conclusion = (
        f"All of it costs {price_text(total, plan.currency)}; most of that, {price_text(dearest.price, plan.currency)}, goes to "
        f"“{dearest.item}” ({dearest.count} at {price_text(dearest.unit_price, plan.currency)})."
    )
    columns = (
        Column("Item", number=False),
        Column("count"),
        price_column("each", plan.currency),
        price_column("together", plan.currency),
    )
    rows = [
        (text_cell(e.item), figure_cell(float(e.count), 0), figure_cell(e.unit_price, 2), figure_cell(e.price, 2))
        for e in plan.materials
    ]
    units = () if plan.currency else (Paragraph("Prices are in units of one ordinary pole."),)
    return Section(key, title, conclusion, (*units, *table("What to order", columns, rows)))


def schedule_section(plan: Plan) -> Section:
    """Where and how each sensor is mounted."""
    key, title = "schedule", "Mounting schedule"
    if plan.chosen is None or not plan.sensors:
        return Section(key, title, NOTHING_CHOSEN if plan.chosen is None else "There is nothing to mount.")
    heights = [sensor.height for sensor in plan.sensors]
    poles = len({sensor.pole for sensor in plan.sensors})
    conclusion = (
        f"Mount {counted(len(plan.sensors), 'sensor')} on {counted(poles, 'pole')}, "
        + (f"{min(heights):.1f} to {max(heights):.1f}" if max(heights) - min(heights) >= 0.05 else f"{heights[0]:.1f}")
        + " m above the foot of the pole."
    )
    on_earth = all(s.longitude is not None and s.latitude is not None for s in plan.sensors)
    degrees = (Column("longitude", "°"), Column("latitude", "°")) if on_earth else ()
    columns = (
        *(Column(name, number=False) for name in ("Sensor", "Pole", "Model")),
        *(Column(name, "m") for name in ("east x", "north y", "height")),
        *degrees,
        *(Column(name, "°") for name in ("bearing", "tilt down")),
    )
    rows = [
        (
            *(text_cell(text) for text in (s.name, s.pole, s.model)),
            *(figure_cell(value, 2) for value in (s.x, s.y, s.height)),
            *(figure_cell(value, 6) for value in ((s.longitude, s.latitude) if on_earth else ())),
            *(figure_cell(value, 1) for value in (s.bearing_deg, s.tilt_deg)),
        )
        for s in plan.sensors
    ]
    note = "Bearings are compass bearings of the optical axis, clockwise from north; tilt is below the horizon; "
    note += "height is above the foot of the pole. x and y are metres in the frame of the site."
    if not on_earth:
        note += " The site does not say where on earth it is, so there are no longitudes and latitudes."
    return Section(key, title, conclusion, (Paragraph(note), *table("Sensor by sensor", columns, rows)))
