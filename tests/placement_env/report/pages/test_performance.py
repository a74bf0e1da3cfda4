"""Sections on what the set does."""

from dataclasses import replace
from inspect import signature

import numpy as np

from placement_env.handover.ground import GroundShares
from placement_env.report.content import (
    BreakdownRow,
    ClassSeen,
    Judgement,
    SchemeFigures,
    SensorWorth,
)
from placement_env.report.pages import (
    detection_section,
    document,
    ground_section,
    schemes_section,
    sensors_sections,
)


def read(section, plan, *others):
    """Section of a plan, with the chosen set where the section asks for it."""
    chosen = [plan.chosen] if "chosen_option" in signature(section).parameters else []
    return document.Section("key", "Title", *section(plan, *chosen, *others))


def judged(ap, half=0.02):
    return Judgement(ap, ap - half, ap + half, ap, None, 40, 20)


def test_the_weakest_part_is_named_where_intervals_tell_it(example):
    rows = (
        BreakdownRow("west", judged(0.8)),
        BreakdownRow("east", judged(0.9)),
        BreakdownRow("far", None),
    )
    plan = replace(example.plan, by_zone=rows, by_range=(), by_approach=())
    section = read(detection_section.detection_section, plan)
    assert section.conclusion == (
        "Detection is weakest at “west”, AP 0.80 (0.78–0.82, 40 vehicles), and best at “east”, "
        "AP 0.90 (0.88–0.92, 40 vehicles)."
    )
    drawing, table = section.blocks[:2]
    assert (
        drawing.caption
        == "By zone, AP ranges from 0.80 at “west” to 0.90 at “east”; the intervals do not overlap."
    )
    assert [cell.text for cell in table.rows[2]] == ["far", "–", "no vehicle", "–", "0", "–", "–"]


def test_overlapping_intervals_name_no_weakest_part(example):
    near = (BreakdownRow("west", judged(0.87)), BreakdownRow("east", judged(0.9)))
    section = read(
        detection_section.detection_section,
        replace(example.plan, by_zone=near, by_range=(), by_approach=()),
    )
    assert section.conclusion.startswith(
        "No part of the site is clearly worse than another: the weakest, “west”, has AP"
    )
    assert section.blocks[0].caption.endswith("; the intervals overlap.")


def test_parts_without_vehicles_have_no_ap(example):
    only = (BreakdownRow("west", judged(0.87)), BreakdownRow("east", None))
    plan = replace(
        example.plan, by_zone=only, by_range=(BreakdownRow("far", None),), by_approach=()
    )
    drawing, _, distance, *_ = read(detection_section.detection_section, plan).blocks
    assert drawing.caption == "By zone, only “west” had vehicles: AP 0.87 (0.85–0.89, 40 vehicles)."
    assert distance.text == "AP by distance is unknown: there was no vehicle to detect."


def test_the_class_covered_least_is_named(example):
    seen = (
        ClassSeen("vehicle", 40, 10, 0.99),
        ClassSeen("cyclist", 1, 1, 0.5),
        ClassSeen("heavy", 0, 10, None),
    )
    *_, said, table = read(
        detection_section.detection_section, replace(example.plan, by_class=seen)
    ).blocks
    assert said.text == (
        "The class covered least is cyclist: 50% of 1 road user had at least 1 point on them. "
        "These are shares of coverage, not AP."
    )
    assert "AP" not in [column.title for column in table.columns]
    assert [cell.text for cell in table.rows[2]] == ["heavy", "0", "10", "–"]


def test_schemes_are_compared_at_the_iou_of_the_plan(example):
    def scheme(name, ap, kbit, iou=0.7):
        return SchemeFigures(name, iou, judged(ap), kbit)

    mine = (
        scheme("early", 0.9, 1500.0),
        scheme("late", 0.8, 300.0),
        scheme("late", 0.99, 300.0, 0.5),
    )
    section = read(schemes_section.schemes_section, replace(example.plan, schemes=mine))
    assert section.conclusion == (
        "Early fusion has the highest AP, 0.90 (0.88–0.92), against 0.80 (0.78–0.82) with late "
        "fusion as planned, and the difference is not due to chance; late fusion sends 300 kbit "
        "per sensor and frame, the least."
    )
    alike = (replace(mine[0], as_good=True), *mine[1:])
    said = read(schemes_section.schemes_section, replace(example.plan, schemes=alike)).conclusion
    assert "and on the same frames they cannot be told apart" in said
    assert section.blocks[1].caption == "Early fusion sends 5.0 times as much as late fusion."
    best = read(schemes_section.schemes_section, replace(example.plan, schemes=mine[1:2]))
    assert best.conclusion.startswith("Late fusion, as planned, has the highest AP, 0.80 (")
    assert best.blocks[1].caption == "A sensor sends 300 kbit per frame with late fusion."
    assert (
        read(schemes_section.schemes_section, replace(example.plan, schemes=())).conclusion
        == "No other fusion scheme was judged."
    )


def test_levels_and_error_profiles_have_tables(example):
    rows = (BreakdownRow("thin traffic", judged(0.97)), BreakdownRow("dense traffic", judged(0.9)))
    plain, section = (
        read(detection_section.detection_section, example.plan),
        read(detection_section.detection_section, replace(example.plan, by_level=rows)),
    )
    assert plain.conclusion == section.conclusion
    assert len(section.blocks) > len(plain.blocks)
    said = [
        each.caption
        for each in section.blocks
        if getattr(each, "caption", "").startswith("By level of traffic")
    ]
    assert said[0].startswith(
        "By level of traffic, AP ranges from 0.90 at “dense traffic” to 0.97 at “thin traffic”"
    )
    rows = (BreakdownRow("paper", judged(0.97), 80.0), BreakdownRow("poor", judged(0.9), 60.0))
    plain, section = (
        read(detection_section.detection_section, example.plan),
        read(detection_section.detection_section, replace(example.plan, by_errors=rows)),
    )
    assert plain.conclusion == section.conclusion
    said = [
        each.caption
        for each in section.blocks
        if getattr(each, "caption", "").startswith("By error profile")
    ]
    assert said[0].startswith("By error profile, AP ranges from 0.90 at “poor” to 0.97 at “paper”")


SHARES = GroundShares((0.8, 0.5, 0.25), 0.2, 0.05, {"d0": 400.0, "d1": 1000.0}, 2000.0, 400.0)


def test_shares_and_density_are_those_of_lanes(example):
    section = read(
        ground_section.ground_section,
        replace(example.plan, ground=SHARES),
        example.site,
        example.ground,
    )
    assert section.conclusion == (
        "At least one sensor sees 80% of the open ground, and two or more see 50%; no sensor "
        "sees 400 m², or 5% of the lanes."
    )
    *maps, areas, scene = section.blocks
    assert scene.kind == "scene"
    assert [block.kind for block in maps] == ["drawing"] * 3
    assert "50% of the open ground" in maps[0].caption
    assert maps[2].caption.startswith("400 m², 20% of the open ground,")
    assert [[cell.text for cell in row] for row in areas.rows] == [
        ["d0", "400", "20.0"],
        ["d1", "1,000", "50.0"],
    ]
    ground = example.ground
    density = np.zeros_like(ground.density)
    density[0][ground.lanes], density[1][ground.lanes] = 1.5, 1.0
    sparse = np.argwhere(ground.lanes)[: int(ground.lanes.sum()) // 4]
    density[:, sparse[:, 0], sparse[:, 1]] = 0.2
    section = read(
        ground_section.ground_section,
        replace(example.plan, ground=SHARES),
        example.site,
        replace(ground, density=density),
    )
    assert section.blocks[1].caption == (
        "25% of the lanes' ground gets fewer than 1 point per m² in a frame, too few to tell "
        "what is there; the other lanes get 2 per m² in the middle case."
    )
    bare = replace(example.ground, lanes=np.zeros_like(example.ground.lanes))
    section = read(ground_section.ground_section, example.plan, example.site, bare)
    assert section.blocks[1].caption.startswith("No lane lies in the area")
    assert read(ground_section.ground_section, example.plan, example.site, None).blocks == ()


def test_worth_and_synergy_of_one_two_and_many(example):
    mine = (
        *(
            SensorWorth("a", 0.6, {"b": 0.05, "c": -0.1}),
            SensorWorth("b", 0.3, {"a": 0.05, "c": 0.0}),
        ),
        SensorWorth("c", 0.1, {"a": -0.1, "b": 0.0}),
    )
    section = read(sensors_sections.worth_section, replace(example.plan, worth=mine))
    assert section.conclusion == (
        "a is worth most, 0.600 AP, and c least, 0.100. a and b complement each other best "
        "(+0.050). a and c duplicate each other most (-0.100)."
    )
    assert section.blocks[1].caption == "a accounts for 60% of what all sensors add."
    assert [cell.text for cell in section.blocks[2].rows[0]] == [
        "a",
        "0.600",
        "–",
        "+0.050",
        "-0.100",
    ]
    two = (SensorWorth("a", 0.7, {"b": -0.09}), SensorWorth("b", 0.2, {"a": -0.09}))
    assert read(sensors_sections.worth_section, replace(example.plan, worth=two)).conclusion == (
        "a is worth most, 0.700 AP, and b least, 0.200. a and b duplicate each other most (-0.090)."
    )
    section = read(
        sensors_sections.worth_section, replace(example.plan, worth=(SensorWorth("a", 0.6, {}),))
    )
    assert section.conclusion == "There is one sensor, a, and all of the AP is its own: 0.600."
    assert section.blocks == ()


def test_failures_and_the_order_of_building(example):
    section = read(sensors_sections.failures_section, example.plan)
    assert section.conclusion == (
        "All sensors together give AP 0.962 (0.932–0.992, 412 vehicles). If 1 sensor fails, the "
        "worst loss is that of d3: AP 0.780 (0.750–0.810, 412 vehicles) is left. If 2 sensors "
        "fail, the worst loss is that of d0 and d3: AP 0.520 (0.490–0.550, 412 vehicles) is "
        "left."
    )
    assert section.blocks[0].caption == ("In 0 of 6 cases no more than 0.01 of the AP is lost.")
    assert [cell.text for cell in section.blocks[1].rows[0]][-1] == "0.052"
    section = read(sensors_sections.order_section, example.plan)
    assert section.conclusion == (
        "Build d3 first: for 1.50 EUR it alone gives AP 0.710 (0.680–0.740, 412 vehicles); the "
        "last, d5, brings it to AP 0.962 (0.932–0.992, 412 vehicles)."
    )
    assert section.blocks[0].caption == ("Every sensor adds more than 0.01 of AP.")
    *others, last = example.plan.order
    level = replace(example.plan, order=(*others, replace(last, judged=others[-1].judged)))
    caption = read(sensors_sections.order_section, level).blocks[0].caption
    assert caption == "From 3 sensors on, more sensors add no more than 0.01 of AP."
    one = read(sensors_sections.order_section, replace(example.plan, order=example.plan.order[:1]))
    assert one.conclusion.endswith("412 vehicles).")
    assert one.blocks[0].caption == "Every sensor adds more than 0.01 of AP."
