"""Sections on what to build."""

import math
from dataclasses import replace
from inspect import signature

import numpy as np

from placement_env.handover.mounted import MaterialItem
from placement_env.report.content import (
    ClassAP,
    DrawingResult,
    DrawnErrors,
    Judgement,
    SchemeFigures,
    Verdict,
)
from placement_env.report.pages import (
    document,
    installation_sections,
    method_section,
    others_section,
)
from placement_env.report.pages.decision import decision_section
from placement_env.report.pages.method_section import value_text
from placement_env.report.pages.printable_names import use_pole_names
from placement_env.report.pages.report import build_document

CHOSEN = ("d0", "d1", "d3", "d5")


def read(section, plan, *others):
    """Section of a plan, with the chosen set where the section asks for it."""
    chosen = [plan.chosen] if "chosen_option" in signature(section).parameters else []
    return document.Section("key", "Title", *section(plan, *chosen, *others))


def facts(plan, example):
    """First page of a plan: its lines by their labels, red ones in capitals."""
    section = read(decision_section, plan, example.site, example.ground)
    (lines,) = [block.items for block in section.blocks if block.kind == "facts"]
    return section, {each.label.upper() if each.alarm else each.label: each.text for each in lines}


def test_the_decision_comes_first_in_the_words_of_an_operator(example):
    section, said = facts(example.plan, example)
    answer = "uild 4 depth cameras on poles post00, post01, post02 and post03. The price is 6 EUR."
    assert section.conclusion.startswith(
        "The link is too narrow for 95 % of the frames: post00 needs 3.90 of 3.00 Mbit/s"
    )
    assert section.conclusion.endswith(f" With wider links: b{answer}")
    wide, _ = facts(replace(example.plan, links=example.plan.links[1:]), example)
    assert wide.conclusion == f"B{answer}"
    assert said["Asked for"] == example.plan.verdict.sentence
    assert said["One failure"] == "At worst, if d3 fails, 325 of 412 are still found."
    sampled = tuple(
        replace(case, judged=replace(case.judged, vehicles=155, frames=24))
        for case in example.plan.failures
    )
    _, estimated = facts(replace(example.plan, failures=sampled), example)
    assert estimated["One failure"] == "At worst, if d3 fails, about 325 of 412 are still found."
    assert said["LINKS"] == (
        "Too narrow at post00; post00 needs 3.90 of 3.00 Mbit/s at 10 frames a second. By radio, "
        "all sensors send 40 packets a second, 5.0 % of the airtime of 802.11p."
    )
    assert said["How sure"].startswith("AP 0.962, 95% interval 0.932–0.992, from 60 frames")
    assert "d3 first" in said["Next"]


def test_the_decision_explains_its_words(example):
    section, _ = facts(example.plan, example)
    view, explained = section.blocks[1:]
    assert view.caption == "4 sensors on 4 poles; 2 poles that could carry one stay free."
    assert [
        word in explained.text for word in ("AP (average precision)", "a find needs 0.7", "kbit")
    ] == [True] * 3


def test_a_decision_that_misses_the_question_says_what_was_allowed(example):
    question = {"money": 9.0, "sensors": 4}
    asked = replace(
        example.plan, question=question, verdict=Verdict(False, "No.", ("Links are too small.",))
    )
    section, said = facts(
        replace(asked, poles_unused=("no such pole",), links=example.plan.links[1:]), example
    )
    assert section.conclusion.endswith("Allowed were at most 9 EUR and at most 4 sensors.")
    assert section.blocks[1].caption.endswith("; 1 pole that could carry one stays free.")
    assert said["ASKED FOR"] == "No. Links are too small."
    assert said["Links"].startswith(
        "Every link carries 95 % of the frames. The fullest, post01, needs 3.90 of 20.00"
    )


def test_what_is_found_missed_unseen_and_lost_is_said_in_road_users(example):
    judged = replace(example.plan.chosen.judged, recall=0.9, precision=0.95)
    class_ap = (ClassAP("vehicle", 1.0, 0.7, judged),)
    streets = {"Elm Street in the west": 60.0, "the junction": 12.4, "A": 5.0, "B": 3.0, "C": 1.0}
    drawn = {"drawn": {"tree": 164, "fence": 1}}
    plan = replace(
        example.plan, class_ap=class_ap, blind_streets=streets, failures=(), origins=drawn
    )
    _, said = facts(plan, example)
    assert said["NOT SURVEYED"].startswith("Drawn at random, in no map: ")
    assert "164 tree" in said["NOT SURVEYED"]
    titled = replace(plan, head={"title": "Elm Street", "client": "The city"})
    named = build_document(titled, example.site, example.ground)
    assert (named.title, named.subtitle.partition(";")[0]) == ("Elm Street", "The city")
    assert said["Finds"].startswith("371 of 412 vehicles; 41 are missed, and 20 reports are false.")
    assert said["DOES NOT COUNT"] == "The detector does not know 61 cyclists that crossed the area."
    known = (
        *class_ap,
        ClassAP("cyclist", 0.0, 0.5, replace(judged, recall=0.5, precision=None, vehicles=61)),
    )
    _, other = facts(replace(plan, class_ap=known), example)
    assert other["DOES NOT COUNT"] == (
        "Also found, but not counted in the choice: 30 of 61 cyclists; 31 are missed."
    )
    assert said["Blind"] == (
        "4% of the lanes is out of every sensor's sight: Elm Street in the west (60 m²), the "
        "junction (12 m²), A (5 m²) and elsewhere (4 m²). Of all open ground, 31% is unseen."
    )
    assert "no second sensor" in said["ONE FAILURE"]
    assert said["Next"].startswith("Plan again with --classes")


def test_sensors_beside_the_chosen_set_are_called_by_their_poles(example):
    first, *others = example.plan.sensors
    aside, elsewhere = "post00_5.2m_h90_t20_camera", "post07_5.2m_h90_t20_camera"
    chosen = replace(
        example.plan.chosen, sensors=("post00", *CHOSEN[1:]), poles=("post00", "p", "p", "p")
    )
    other = replace(chosen, sensors=(aside, elsewhere), poles=("post00", "post07"))
    why = (f"The set of {aside} and {elsewhere} is worse; x{aside} is another word.",)
    plan = replace(
        example.plan,
        sensors=(replace(first, name="post00", pole="post00"), *others),
        chosen=chosen,
        why=why,
    )
    plan = replace(plan, considered=(chosen, other))
    named = use_pole_names(plan)
    assert named.chosen.sensors == ("post00", *CHOSEN[1:])
    assert named.considered[1].sensors == ("post00 (other aim)", "post07")
    assert named.why == (
        f"The set of post00 (other aim) and post07 is worse; x{aside} is another word.",
    )
    assert use_pole_names(example.plan) == example.plan


def test_values_value_text():
    assert value_text({"a": [1, None], "b": True}) == "a: 1, not given, b: yes"
    assert [value_text(value) for value in ("", (), 0, False)] == [
        "not given",
        "not given",
        "0",
        "no",
    ]


def test_the_chosen_set_stands_beside_front_and_alternatives(example):
    section = read(others_section.others_section, example.plan)
    assert section.conclusion == (
        "On the same frames, 1 other set is surely within 0.01 of the best; none is cheaper than "
        "the chosen set."
    )
    assert [row[0].text for row in section.blocks[-1].rows] == [
        *("d3", "d0 and d3", "d0, d1 and d3", "d0, d1, d3 and d5 (chosen)", "d0, d2, d3 and d5")
    ]
    better = replace(example.plan.front[0], judged=Judgement(0.99, 0.98, 1.0, 0.99, 1.0, 9, 9))
    better = replace(
        example.plan, front=(better,), near_optimal=(), provenance={"search_fidelity": "coverage"}
    )
    section = read(others_section.others_section, better)
    assert section.conclusion == (
        "On the same frames, no other set is surely within 0.01 of the best. The highest AP, "
        "0.99 (0.98–1.00, 9 vehicles), costs 1.50 EUR."
    )
    assert [column.title for column in section.blocks[-1].columns][1] == "coverage"
    assert (
        read(others_section.others_section, replace(example.plan, near_optimal=(), front=())).blocks
        == ()
    )


def test_figures_of_sets_and_what_they_are_compared_by_are_explained(example):
    """Sets are compared on one part of the traffic, and the chosen one is judged on another."""
    lucky = Judgement(1.0, 0.99, 1.0, 1.0, 1.0, 103, 12)
    front = (*example.plan.front[:-1], replace(example.plan.chosen, judged=lucky))
    plan = replace(example.plan, front=front, considered=front)
    for section in (read(others_section.others_section, plan),):
        assert section.blocks[0].text == (
            "The AP of each set in this section is from the traffic on which the sets were "
            "compared. There the chosen set has 1.000 (0.990–1.000, 103 vehicles); its 0.962 "
            "(0.932–0.992, 412 vehicles) in the rest of the report is from other traffic, which "
            "had no say in the choice and is therefore the figure to trust."
        )
        chosen = next(row for row in section.blocks[-1].rows if "(chosen)" in row[0].text)
        assert chosen[2].text == "1.000"
    chosen = example.plan.chosen
    least, less = (replace(chosen.judged, ap=ap, low=ap, high=ap) for ap in (0.5, 0.7))
    for cases, words in (
        ({"over_levels": less}, "over the levels of traffic"),
        ({"over_levels": less, "left": least}, "after the failures and over the levels of traffic"),
        ({"over_errors": least}, "over the error profiles"),
    ):
        over = replace(example.plan, chosen=replace(chosen, **cases))
        said = read(others_section.others_section, over).blocks[0].text
        assert said == f"The AP of each set in this section is that {words}, as the question asks."


def test_links_that_are_too_narrow_are_named(example):
    section = read(installation_sections.links_section, example.plan)
    assert section.conclusion == "1 link of 4 cannot carry what is sent: post00."
    assert section.blocks[0].caption.startswith("All links together carry 12.48 Mbit/s")
    assert [cell.text for cell in section.blocks[1].rows[0]] == [
        *("post00", "3.12", "3.90", "4.02", "3.00", "130.0", "no")
    ]
    fine = read(
        installation_sections.links_section, replace(example.plan, links=example.plan.links[1:])
    )
    assert fine.conclusion == (
        "Every link carries what is sent; the fullest, at post01, is used to 20%: it needs 3.90 "
        "of 20.00 Mbit/s."
    )


def test_materials_are_billed_in_the_currency_or_in_units(example):
    section = read(installation_sections.materials_section, example.plan)
    assert section.conclusion == (
        "The total is 6 EUR; the largest part, 4 EUR, is “pole with power and link” (4 at 1 EUR)."
    )
    bare = read(
        installation_sections.materials_section,
        replace(example.plan, currency="", materials=(MaterialItem("pole", 1, 1.0, 1.0),)),
    )
    assert (
        bare.conclusion == "The total is 1 unit; the largest part, 1 unit, is “pole” (1 at 1 unit)."
    )
    assert bare.blocks[0].text == "Prices are in units of one ordinary pole."


def test_the_schedule_says_where_sensors_are_mounted(example):
    section = read(installation_sections.schedule_section, example.plan, example.site)
    assert section.conclusion == "Mount 4 sensors on 4 poles, 5.2 m above the foot of the pole."
    assert [cell.text for cell in section.blocks[1].rows[0]] == [
        *("d0", "post00", "depth camera", "40.90", "8.10", "5.20"),
        *("14.423500", "50.081200", "45.0", "20.0"),
    ]


def test_a_schedule_without_a_geographic_reference_has_metres(example):
    first, *others = example.plan.sensors
    plan = replace(
        example.plan, sensors=(replace(first, longitude=None, latitude=None, height=3.0), *others)
    )
    section = read(installation_sections.schedule_section, plan, example.site)
    assert section.conclusion.endswith("3.0 to 5.2 m above the foot of the pole.")
    assert "has no geographic reference" in section.blocks[0].text
    assert "x runs towards 0°, y towards 270°" in section.blocks[0].text
    assert [column.title for column in section.blocks[1].columns][3:5] == ["x", "y"]
    aligned = replace(example.site, map_SE3_site=np.eye(4))
    section = read(installation_sections.schedule_section, plan, aligned)
    assert [column.title for column in section.blocks[1].columns][3:5] == ["east x", "north y"]
    assert len(section.blocks[1].columns) == 8


def test_assumptions_unknowns_and_provenance(example):
    section = read(method_section.method_section, example.plan)
    assert section.conclusion == (
        "Every AP here is that of VoxelNet, trained at tjunction in simulated traffic, 412 "
        "vehicles in 60 frames: it ranks places for sensors, and does not replace a trial on the "
        "street."
    )
    assert section.blocks[0].text == example.plan.verdict.sentence
    assert section.blocks[2].text == (
        "5 sets of sensors reached the final comparison, found by the searches cpsat and greedy; "
        "the detector judged 5 of them on all of its traffic."
    )
    assert [block.items for block in section.blocks if block.kind == "bullets"] == [
        example.plan.why,
        example.plan.assumptions,
        example.plan.unknown,
    ]
    rows = [[cell.text for cell in row] for row in section.blocks[-1].rows]
    assert rows[:3] == [
        ["versions: coview", "0.1.0"],
        ["seeds: search", "0"],
        ["seeds: judgement", "7"],
    ]


def test_nothing_is_claimed_where_nothing_was_judged(nothing_chosen):
    (asked,) = read(method_section.method_section, nothing_chosen.plan).blocks
    assert [cell.text for cell in asked.rows[1]] == ["max kbit", "0.001"]


def test_how_sure_it_is_what_would_do_as_well_and_which_poles_survive(example):
    plan = example.plan
    schemes = (
        *(
            SchemeFigures("early", 0.7, plan.chosen.judged, 1500.0),
            SchemeFigures("late", 0.7, plan.chosen.judged, 300.0),
        ),
    )
    early = replace(plan, scheme="early", schemes=(schemes[0], replace(schemes[1], as_good=True)))
    _, said = facts(replace(early, links=plan.links[1:]), example)
    assert said["Links"].endswith(
        "Sending boxes alone would do as well: AP 0.962 instead of 0.962, for 300.0 instead of "
        "1,500.0 kbit per sensor and frame (--scheme late)."
    )
    assert "540 frames would narrow it to 0.02" in facts(plan, example)[1]["How sure"].replace(
        "544", "540"
    )
    assert "sure that no other set" not in facts(plan, example)[1]["How sure"]
    assert (
        "90% sure that no other set" in facts(replace(plan, confidence=0.9), example)[1]["How sure"]
    )
    few = replace(plan.chosen, judged=replace(plan.chosen.judged, low=math.nan, high=math.nan))
    assert (
        "An interval needs 80 --frames or more."
        in facts(replace(plan, chosen=few), example)[1]["How sure"]
    )
    drawn = (DrawnErrors("poor", (0.9, 0.96), 0.93, 0.906, 60),)
    assert facts(replace(plan, by_draw=drawn), example)[1]["Mounting"] == (
        "Mounted anew 2 times with errors of profile poor, the sensors reach AP 0.930 on "
        "average; one time in ten it falls below 0.906."
    )
    other = tuple(
        DrawingResult(judged, poles)
        for judged, poles in ((plan.chosen.judged, ("post00", "x")),) * 2
    )
    made = replace(plan, by_drawing=other, origins={"drawn": {"tree": 2}})
    assert (
        "Planned for each of 2 drawings alone, the answer would use post00 in 2, post01 in 0"
        in (facts(made, example)[1]["NOT SURVEYED"])
    )
    best = replace(plan.chosen, sensors=("a", "b", "c", "d", "e"), price=8.0)
    section, _ = facts(replace(plan, best=best), example)
    assert section.conclusion.endswith(
        "5 sensors for 2 EUR more would find hardly more: surely less than 0.01 of AP."
    )
