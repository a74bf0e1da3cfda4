from dataclasses import replace

from placement_env.report.content import Judgement, Verdict
from placement_env.report.pages.sections_answer import (
    alternatives_section,
    chosen_section,
    front_section,
    in_words,
    requirement_section,
)


def test_the_answer_comes_first_with_what_excludes_what(example):
    plan = replace(example.plan, verdict=Verdict(False, "No.", ("Links are too small.",)))
    section = requirement_section(plan)
    assert section.conclusion == "No."
    assert section.blocks[1].items == ("Links are too small.",)
    asked = section.blocks[-1]
    assert [tuple(cell.text for cell in row) for row in asked.rows][1:4] == [
        ("budget", "6.0"),
        ("min ap", "0.95"),
        ("max kbit", "not given"),
    ]


def test_ap_is_explained_once_with_the_iou_of_the_plan(example):
    (said,) = [block.text for block in requirement_section(example.plan).blocks if block.kind == "paragraph"]
    assert "AP (average precision)" in said
    assert "at least 0.7 of the space" in said
    assert "95% confidence" in said


def test_values_in_words():
    assert in_words({"a": [1, None], "b": True}) == "a: 1, not given, b: yes"
    assert [in_words(value) for value in ("", (), 0, False)] == ["not given", "not given", "0", "no"]


def test_the_chosen_set(example):
    section = chosen_section(example.plan, example.site, example.ground)
    assert section.conclusion == (
        "Build 4 sensors, d0, d1, d3 and d5, for 6 EUR: the detector reaches AP 0.962 (0.932–0.992, 412 vehicles); a "
        "sensor sends 312 kbit of a frame under late fusion."
    )
    bullets, view, scene = section.blocks
    assert bullets.items == example.plan.why
    assert view.caption == "4 sensors on 4 poles; 2 poles that could carry one stay free."
    assert scene.kind == "scene"


def test_poles_that_the_site_does_not_have_are_counted_and_not_drawn(example):
    plan = replace(example.plan, poles_unused=("no such pole",))
    view = chosen_section(plan, example.site, example.ground).blocks[1]
    assert "1 pole that could carry one stays free." in view.caption


def test_the_front(example):
    section = front_section(example.plan)
    assert section.conclusion == (
        "4 sets cannot be bettered in AP, sent data and price at once: prices run from 1.50 EUR up, and the highest "
        "AP, 0.962 (0.932–0.992, 412 vehicles), costs 6 EUR."
    )
    assert [row[0].text for row in section.blocks[1].rows][-1] == "d0, d1, d3 and d5 (chosen)"
    unjudged = tuple(replace(option, judged=None) for option in example.plan.front)
    assert front_section(replace(example.plan, front=unjudged)).conclusion.endswith(
        "the cheapest of them costs 1.50 EUR."
    )


def test_alternatives_stand_beside_the_chosen_set(example):
    section = alternatives_section(example.plan)
    assert section.conclusion == (
        "1 other set cannot be told from the chosen one by the traffic judged, because the intervals overlap; none of "
        "them is cheaper."
    )
    (sets,) = section.blocks
    assert [row[0].text for row in sets.rows] == ["d0, d1, d3 and d5 (chosen)", "d0, d2, d3 and d5"]
    (near,) = example.plan.near_optimal
    cheaper = replace(example.plan, near_optimal=(near, replace(near, price=1.0)))
    assert alternatives_section(cheaper).conclusion.endswith("; 1 of them would cost less.")
    assert alternatives_section(replace(example.plan, near_optimal=())).blocks == ()


def test_two_figures_of_the_chosen_set_are_explained(example):
    """Sets are compared on one part of the traffic, and the chosen one is judged on another."""
    lucky = Judgement(1.0, 0.99, 1.0, 1.0, 1.0, 103, 12)
    front = (*example.plan.front[:-1], replace(example.plan.chosen, judged=lucky))
    plan = replace(example.plan, front=front, considered=front)
    for section in (front_section(plan), alternatives_section(plan)):
        assert section.blocks[0].text == (
            "The AP of this section are from the traffic on which the sets were compared. There the chosen set has "
            "1.000 (0.990–1.000, 103 vehicles); its 0.962 (0.932–0.992, 412 vehicles) in the rest of the report is "
            "from other traffic, which had no say in the choice and is therefore the one to trust."
        )
        chosen = next(row for row in section.blocks[-1].rows if "(chosen)" in row[0].text)
        assert chosen[2].text == "1.000"


def test_without_a_requirement_the_answer_is_not_about_one(example):
    assert requirement_section(replace(example.plan, verdict=Verdict(None, "The best."))).title == "The answer"


def test_what_sets_are_compared_by_is_said(example):
    chosen = example.plan.chosen
    plain = chosen_section(example.plan, example.site, example.ground)
    assert "that the question asks for" not in plain.conclusion
    least, less = (replace(chosen.judged, ap=ap, low=ap, high=ap) for ap in (0.5, 0.7))
    over = replace(example.plan, chosen=replace(chosen, over_levels=less))
    said = chosen_section(over, example.site, example.ground).conclusion
    assert "AP 0.700 (0.700–0.700, 412 vehicles) over the levels of traffic that the question asks for" in said
    both = replace(example.plan, chosen=replace(chosen, over_levels=less, left=least))
    said = chosen_section(both, example.site, example.ground).conclusion
    assert "AP 0.500 (0.500–0.500, 412 vehicles) of what is left with the failures and over the levels" in said
    rough = replace(example.plan, chosen=replace(chosen, over_levels=less, over_errors=least))
    said = chosen_section(rough, example.site, example.ground).conclusion
    assert "AP 0.500 (0.500–0.500, 412 vehicles) over the levels of traffic and over the error profiles that" in said
