"""The section on continuous traffic, as a reader sees it."""

import json
from dataclasses import replace

import pytest

from placement_env.report.pages.motion_section import motion_section
from placement_env.report.planning.plan_writing import format_json


def tables(section):
    _, blocks = section
    return [block for block in blocks if block.kind == "table"]


def texts(table):
    headings = [column.heading for column in table.columns]
    return [dict(zip(headings, (cell.text for cell in row), strict=True)) for row in table.rows]


def test_the_class_that_is_followed_worst_comes_first_and_intervals_are_stated(example):
    section = motion_section(example.plan)
    assert section[0] == (
        "In 15 seconds of continuous traffic, 6 of 12 moving pedestrians are mostly tracked "
        "(25–75%); most arrivals are never detected."
    )
    followed, counted = tables(section)
    vehicles, pedestrians = texts(followed)
    assert vehicles == {
        "Class": "vehicle",
        "moving": "6",
        "mostly tracked": "83% (44–97%)",
        "half within (s)": "0.3 (from 0.0)",
        "95% within (s)": "1.2 (from 0.3)",
        "never detected": "0% (0–49%)",
        "speed error (km/h)": "0.8 (no interval)",
    }
    assert pedestrians["half within (s)"] == "never (from 0.4)"
    assert pedestrians["95% within (s)"] == "never"
    assert pedestrians["speed error (km/h)"] == "0.5 (0.4–0.6)"
    (vehicle_trips,) = texts(counted)  # nobody on foot went from entry to exit
    assert vehicle_trips["found"] == "75% (30–95%)"
    assert (vehicle_trips["true trips"], vehicle_trips["counted"]) == ("4", "3")


def test_the_traffic_can_be_made_again(example):
    _, blocks = motion_section(example.plan)
    command = "coview simulate site.json --every 0.1 --frames 150 --seed 3000009"
    assert command in blocks[0].text


def test_without_figures_the_section_is_one_sentence(example):
    motion = example.plan.motion
    refused = replace(motion, refusal="Road users are not followed: no road.", classes=())
    assert motion_section(replace(example.plan, motion=refused)) == (refused.refusal, ())
    empty = replace(motion, classes=())
    assert motion_section(replace(example.plan, motion=empty))[0] == (
        "In 15 seconds of continuous traffic, nobody moved through the area."
    )
    assert motion_section(replace(example.plan, motion=None))[1] == ()


def test_what_is_unknown_or_endless_is_null_in_the_file(example):
    values = json.loads(format_json(example.plan), parse_constant=pytest.fail)
    vehicles, pedestrians = values["motion"]["classes"]
    assert vehicles["mostly_tracked"] == {
        "value": pytest.approx(5 / 6),
        "low": 0.4365,
        "high": 0.9699,
    }
    assert vehicles["speed_error_km_h"] == {"value": 0.84, "low": None, "high": None}
    assert pedestrians["first_detection_s"]["value"] is None
    assert values["motion"]["movements"][0]["true_count"] == 4
