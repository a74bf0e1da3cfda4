from dataclasses import replace

from placement_env.report.content import BreakdownRow, ClassSeen, Judgement, SchemeFigures
from placement_env.report.pages.sections_detection import detection_section, schemes_section


def judged(ap, half=0.02):
    return Judgement(ap, ap - half, ap + half, ap, None, 40, 20)


def test_the_weakest_part_is_named_where_the_intervals_tell_it(example):
    rows = (BreakdownRow("west", judged(0.8)), BreakdownRow("east", judged(0.9)), BreakdownRow("far", None))
    plan = replace(example.plan, by_zone=rows, by_range=(), by_approach=())
    section = detection_section(plan)
    assert section.conclusion == (
        "Detection is weakest at “west”, AP 0.800 (0.780–0.820, 40 vehicles), and best at “east”, AP 0.900 "
        "(0.880–0.920, 40 vehicles)."
    )
    drawing, table = section.blocks[:2]
    assert (
        drawing.caption == "By zone, AP runs from 0.800 at “west” to 0.900 at “east”, which the intervals tell apart."
    )
    assert [cell.text for cell in table.rows[2]] == ["far", "–", "no vehicle", "–", "0", "–", "–"]


def test_no_part_is_blamed_where_intervals_overlap(example):
    rows = (BreakdownRow("west", judged(0.87)), BreakdownRow("east", judged(0.9)))
    section = detection_section(replace(example.plan, by_zone=rows, by_range=(), by_approach=()))
    assert section.conclusion.startswith(
        "No part of the site is clearly worse than another: the weakest, “west”, has AP"
    )
    assert section.blocks[0].caption.endswith("which the intervals do not tell apart.")


def test_parts_without_vehicles_are_sentences(example):
    only = (BreakdownRow("west", judged(0.87)), BreakdownRow("east", None))
    plan = replace(example.plan, by_zone=only, by_range=(BreakdownRow("far", None),), by_approach=())
    drawing, _, distance, *_ = detection_section(plan).blocks
    assert drawing.caption == "By zone, only “west” held vehicles: AP 0.870 (0.850–0.890, 40 vehicles)."
    assert distance.text == "AP by distance is not known: no vehicle was there to be detected."


def test_coverage_of_other_classes_is_never_called_ap(example):
    seen = (ClassSeen("vehicle", 40, 10, 0.99), ClassSeen("cyclist", 1, 1, 0.5), ClassSeen("heavy", 0, 10, None))
    *_, said, table = detection_section(replace(example.plan, by_class=seen)).blocks
    assert said.text == (
        "Of all classes, cyclist is covered least: 50% of 1 road user had at least 1 point on them. These are shares "
        "of coverage, not AP: the detector knows vehicles only."
    )
    assert "AP" not in [column.title for column in table.columns]
    assert [cell.text for cell in table.rows[2]] == ["heavy", "0", "10", "–"]


def test_schemes_are_compared_at_the_iou_of_the_plan(example):
    def scheme(name, ap, kbit, iou=0.7):
        return SchemeFigures(name, iou, judged(ap), kbit)

    mine = (scheme("early", 0.9, 1500.0), scheme("late", 0.8, 300.0), scheme("late", 0.99, 300.0, 0.5))
    section = schemes_section(replace(example.plan, schemes=mine))
    assert section.conclusion == (
        "Early fusion has the highest AP, 0.900 (0.880–0.920), against 0.800 (0.780–0.820) of late fusion as planned, "
        "and their intervals do not overlap; late fusion sends 300 kbit per sensor and frame, the least."
    )
    assert section.blocks[1].caption == "Early fusion sends 5.0 times as much as late fusion."
    best = schemes_section(replace(example.plan, schemes=mine[1:2]))
    assert best.conclusion.startswith("Late fusion, as planned, has the highest AP, 0.800")
    assert best.blocks[1].caption == "A sensor sends 300 kbit of a frame under late fusion."
    assert schemes_section(replace(example.plan, schemes=())).conclusion == "No other scheme of fusion was judged."


def test_levels_of_traffic_have_a_table_of_their_own(example):
    rows = (BreakdownRow("thin traffic", judged(0.97)), BreakdownRow("dense traffic", judged(0.9)))
    plain, section = detection_section(example.plan), detection_section(replace(example.plan, by_level=rows))
    assert plain.conclusion == section.conclusion
    assert len(section.blocks) > len(plain.blocks)
    said = [
        block.caption for block in section.blocks if getattr(block, "caption", "").startswith("By level of traffic")
    ]
    assert said[0].startswith("By level of traffic, AP runs from 0.900 at “dense traffic” to 0.970 at “thin traffic”")


def test_error_profiles_have_a_table_of_their_own(example):
    rows = (BreakdownRow("paper", judged(0.97), 80.0), BreakdownRow("poor", judged(0.9), 60.0))
    plain, section = detection_section(example.plan), detection_section(replace(example.plan, by_errors=rows))
    assert plain.conclusion == section.conclusion
    said = [each.caption for each in section.blocks if getattr(each, "caption", "").startswith("By error profile")]
    assert said[0].startswith("By error profile, AP runs from 0.900 at “poor” to 0.970 at “paper”")
