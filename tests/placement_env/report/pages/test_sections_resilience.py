from dataclasses import replace

from placement_env.report.content import SensorWorth
from placement_env.report.pages.sections_resilience import failures_section, order_section, worth_section


def test_worth_and_synergy(example):
    mine = (
        SensorWorth("a", 0.6, {"b": 0.05, "c": -0.1}),
        SensorWorth("b", 0.3, {"a": 0.05, "c": 0.0}),
        SensorWorth("c", 0.1, {"a": -0.1, "b": 0.0}),
    )
    section = worth_section(replace(example.plan, worth=mine))
    assert section.conclusion == (
        "a is worth most, 0.600 AP, and c least, 0.100. a and b complement each other most (+0.050), a and c least "
        "(-0.100)."
    )
    assert section.blocks[1].caption == "a accounts for 60% of what all sensors add."
    assert [cell.text for cell in section.blocks[2].rows[0]] == ["a", "0.600", "–", "+0.050", "-0.100"]


def test_one_sensor_has_no_synergy(example):
    section = worth_section(replace(example.plan, worth=(SensorWorth("a", 0.6, {}),)))
    assert section.conclusion == "There is one sensor, a, and all of the AP is its own: 0.600."
    assert section.blocks == ()


def test_the_worst_failure_of_one_and_of_two(example):
    section = failures_section(example.plan)
    assert section.conclusion == (
        "All sensors together give AP 0.962 (0.932–0.992, 412 vehicles). When 1 sensor may fail, d3 hurts most: AP "
        "0.780 (0.750–0.810, 412 vehicles) is left. When 2 sensors may fail, d0 and d3 hurt most: AP 0.520 "
        "(0.490–0.550, 412 vehicles) is left."
    )
    assert section.blocks[0].caption == (
        "3 of 6 cases cost so little that the interval still overlaps that of the whole set."
    )
    assert [cell.text for cell in section.blocks[1].rows[0]][-1] == "0.052"


def test_the_order_of_building(example):
    section = order_section(example.plan)
    assert section.conclusion == (
        "Build d3 first: for 1.50 EUR it alone gives AP 0.710 (0.680–0.740, 412 vehicles); the last, d5, brings it to "
        "AP 0.962 (0.932–0.992, 412 vehicles)."
    )
    assert section.blocks[0].caption == (
        "From 3 sensors on, the interval overlaps that of all: what more adds is uncertain."
    )
    one = order_section(replace(example.plan, order=example.plan.order[:1]))
    assert one.conclusion.endswith("412 vehicles).")
    assert one.blocks[0].caption == "Every sensor adds more than the intervals leave open."
