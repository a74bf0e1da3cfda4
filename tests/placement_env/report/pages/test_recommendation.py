"""Sections on what to build."""

from dataclasses import replace
from inspect import signature

from placement_env.handover.mounted import MaterialItem
from placement_env.report.content import Judgement, Verdict
from placement_env.report.pages import document, report
from placement_env.report.pages.report import build_document, value_text


def read(section, plan, *others):
    """Section of a plan, with the chosen set where the section asks for it."""
    chosen = [plan.chosen] if "chosen" in signature(section).parameters else []
    return document.Section("key", "Title", *section(plan, *chosen, *others))


def test_the_answer_comes_first_and_explains_its_ap(example):
    plan = replace(example.plan, verdict=Verdict(False, "No.", ("Links are too small.",)))
    section = read(report.requirement_section, plan)
    assert section.conclusion == "No."
    assert section.blocks[1].items == ("Links are too small.",)
    asked = section.blocks[-1]
    assert [tuple(cell.text for cell in row) for row in asked.rows][1:4] == [
        *(("budget", "6.0"), ("min ap", "0.95"), ("max kbit", "not given"))
    ]
    (said,) = [each.text for each in read(report.requirement_section, example.plan).blocks if each.kind == "paragraph"]
    assert "AP (average precision)" in said
    assert "at least 0.7 of their union" in said
    assert "95% confidence" in said
    plan = replace(example.plan, verdict=Verdict(None, "The best."))
    assert build_document(plan, example.site, None).sections[0].title == "The answer"


def test_values_value_text():
    assert value_text({"a": [1, None], "b": True}) == "a: 1, not given, b: yes"
    assert [value_text(value) for value in ("", (), 0, False)] == ["not given", "not given", "0", "no"]


def test_the_chosen_set_stands_beside_front_and_alternatives(example):
    section = read(report.chosen_section, example.plan, example.site, example.ground)
    assert section.conclusion == (
        "Build 4 sensors, d0, d1, d3 and d5, for 6 EUR: the detector reaches AP 0.962 (0.932–0.992, 412 vehicles); "
        "each sensor sends 312 kbit per frame with late fusion."
    )
    bullets, view, scene = section.blocks
    assert bullets.items == example.plan.why
    assert view.caption == "4 sensors on 4 poles; 2 poles that could carry one stay free."
    assert scene.kind == "scene"
    plan = replace(example.plan, poles_unused=("no such pole",))
    view = read(report.chosen_section, plan, example.site, example.ground).blocks[1]
    assert "1 pole that could carry one stays free." in view.caption
    section = read(report.front_section, example.plan)
    assert section.conclusion == (
        "No set beats these 4 in AP, data sent and price at once: prices start at 1.50 EUR, and the highest "
        "AP, 0.962 (0.932–0.992, 412 vehicles), costs 6 EUR."
    )
    assert [row[0].text for row in section.blocks[1].rows][-1] == "d0, d1, d3 and d5 (chosen)"
    unjudged = tuple(replace(option, judged=None) for option in example.plan.front)
    assert read(report.front_section, replace(example.plan, front=unjudged)).conclusion.endswith(
        "the cheapest costs 1.50 EUR."
    )
    section = read(report.alternatives_section, example.plan)
    assert section.conclusion == (
        "The judged traffic cannot tell 1 other set from the chosen one, because the intervals overlap; none of them "
        "is cheaper."
    )
    (sets,) = section.blocks
    assert [row[0].text for row in sets.rows] == ["d0, d1, d3 and d5 (chosen)", "d0, d2, d3 and d5"]
    (near,) = example.plan.near_optimal
    cheaper = replace(example.plan, near_optimal=(near, replace(near, price=1.0)))
    assert read(report.alternatives_section, cheaper).conclusion.endswith("; 1 of them is cheaper.")
    assert read(report.alternatives_section, replace(example.plan, near_optimal=())).blocks == ()


def test_figures_of_sets_and_what_they_are_compared_by_are_explained(example):
    """Sets are compared on one part of the traffic, and the chosen one is judged on another."""
    lucky = Judgement(1.0, 0.99, 1.0, 1.0, 1.0, 103, 12)
    front = (*example.plan.front[:-1], replace(example.plan.chosen, judged=lucky))
    plan = replace(example.plan, front=front, considered=front)
    for section in (read(report.front_section, plan), read(report.alternatives_section, plan)):
        assert section.blocks[0].text == (
            "The AP of each set in this section is from the traffic on which the sets were compared. There the chosen "
            "set has 1.000 (0.990–1.000, 103 vehicles); its 0.962 (0.932–0.992, 412 vehicles) in the rest of the "
            "report is from other traffic, which had no say in the choice and is therefore the figure to trust."
        )
        chosen = next(row for row in section.blocks[-1].rows if "(chosen)" in row[0].text)
        assert chosen[2].text == "1.000"
    chosen = example.plan.chosen
    plain = read(report.chosen_section, example.plan, example.site, example.ground)
    assert "as the question asks" not in plain.conclusion
    least, less = (replace(chosen.judged, ap=ap, low=ap, high=ap) for ap in (0.5, 0.7))
    over = replace(example.plan, chosen=replace(chosen, over_levels=less))
    said = read(report.chosen_section, over, example.site, example.ground).conclusion
    assert "AP 0.700 (0.700–0.700, 412 vehicles) over the levels of traffic, as the question asks" in said
    both = replace(example.plan, chosen=replace(chosen, over_levels=less, left=least))
    said = read(report.chosen_section, both, example.site, example.ground).conclusion
    assert "AP 0.500 (0.500–0.500, 412 vehicles) after the failures and over the levels" in said
    rough = replace(example.plan, chosen=replace(chosen, over_levels=less, over_errors=least))
    said = read(report.chosen_section, rough, example.site, example.ground).conclusion
    assert "AP 0.500 (0.500–0.500, 412 vehicles) over the levels of traffic and over the error profiles, as" in said


def test_bills_schedules_and_links_are_listed(example):
    section = read(report.links_section, example.plan)
    assert section.conclusion == "1 link of 4 cannot carry what is sent: post00."
    assert section.blocks[0].caption.startswith("All links together carry 12.48 Mbit/s")
    assert [cell.text for cell in section.blocks[1].rows[0]] == ["post00", "3.12", "4.02", "4.00", "78.0", "no"]
    fine = read(report.links_section, replace(example.plan, links=example.plan.links[1:]))
    assert fine.conclusion == (
        "Every link carries what is sent; the fullest, at post01, is used to 16%: its largest frames need 4.02 of "
        "20.00 Mbit/s."
    )
    section = read(report.materials_section, example.plan)
    assert section.conclusion == (
        "The total is 6 EUR; the largest part, 4 EUR, is “pole with power and link” (4 at 1 EUR)."
    )
    bare = read(
        report.materials_section, replace(example.plan, currency="", materials=(MaterialItem("pole", 1, 1.0, 1.0),))
    )
    assert bare.conclusion == "The total is 1 unit; the largest part, 1 unit, is “pole” (1 at 1 unit)."
    assert bare.blocks[0].text == "Prices are in units of one ordinary pole."
    section = read(report.schedule_section, example.plan)
    assert section.conclusion == "Mount 4 sensors on 4 poles, 5.2 m above the foot of the pole."
    assert [cell.text for cell in section.blocks[1].rows[0]] == [
        *("d0", "post00", "depth camera", "40.90", "8.10", "5.20"),
        *("14.423500", "50.081200", "45.0", "20.0"),
    ]
    first, *others = example.plan.sensors
    plan = replace(example.plan, sensors=(replace(first, longitude=None, latitude=None, height=3.0), *others))
    section = read(report.schedule_section, plan)
    assert section.conclusion.endswith("3.0 to 5.2 m above the foot of the pole.")
    assert "has no geographic reference" in section.blocks[0].text
    assert len(section.blocks[1].columns) == 8


def test_assumptions_unknowns_and_provenance(example):
    section = read(report.method_section, example.plan)
    assert section.conclusion == (
        "Every AP here is that of VoxelNet, trained at tjunction in simulated traffic, 412 vehicles in 60 frames: it "
        "ranks places for sensors, and does not replace a trial on the street."
    )
    assert section.blocks[0].text == (
        "5 sets of sensors reached the final comparison, found by the searches cpsat and greedy; the detector judged 5 "
        "of them on all of its traffic."
    )
    assert [block.items for block in section.blocks if block.kind == "bullets"] == [
        example.plan.assumptions,
        example.plan.unknown,
    ]
    rows = [[cell.text for cell in row] for row in section.blocks[-1].rows]
    assert rows[:3] == [["versions: coview", "0.1.0"], ["seeds: search", "0"], ["seeds: judgement", "7"]]


def test_nothing_is_claimed_where_nothing_was_judged(nothing_chosen):
    assert read(report.method_section, nothing_chosen.plan).blocks == ()
