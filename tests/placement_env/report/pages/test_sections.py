from dataclasses import replace

import pytest

from placement_env.report.content import Plan, Verdict
from placement_env.report.pages.sections import report_of

ORDER = (
    *("requirement", "chosen", "ground", "detection", "schemes", "front", "worth", "failures"),
    *("links", "materials", "schedule", "order", "alternatives", "method"),
)


@pytest.fixture(scope="module")
def document(example):
    return report_of(example.plan, example.site, example.ground)


def test_the_sections_are_those_a_reader_needs_in_this_order(document):
    assert tuple(section.key for section in document.sections) == ORDER
    assert document.title == "Deployment plan for tjunction"


def test_every_section_opens_with_a_sentence_and_every_drawing_has_one(document):
    for section in document.sections:
        assert section.conclusion.endswith((".", "?"))
        for block in section.blocks:
            if block.kind == "drawing":
                assert block.caption.endswith(".")
                assert block.caption != section.conclusion
                assert len(block.alt) > 20
                assert block.svg.lstrip().startswith(("<svg", "<?xml"))
            if block.kind == "table":
                assert block.rows


def test_every_ap_in_a_table_stands_with_interval_and_vehicles(document):
    for section in document.sections:
        for block in section.blocks:
            if block.kind == "table" and any(column.title == "AP" for column in block.columns):
                titles = [column.title for column in block.columns]
                assert titles[titles.index("AP") + 1] == "95% interval"
                assert "vehicles" in titles


def test_a_plan_without_sensors_is_sentences_all_through(nothing_chosen):
    document = report_of(nothing_chosen.plan, nothing_chosen.site, nothing_chosen.ground)
    assert tuple(section.key for section in document.sections) == ORDER
    assert document.subtitle == "VoxelNet; AP at IoU 0.7; late fusion"
    assert [section.key for section in document.sections if section.blocks] == ["requirement"]
    assert all(section.conclusion.endswith(".") for section in document.sections)


def test_a_plan_where_nothing_was_judged(nothing_chosen):
    plan = replace(nothing_chosen.plan, detector="", verdict=Verdict(False, "No set can be planned."))
    document = report_of(plan, nothing_chosen.site, None)
    assert document.subtitle == "No set was judged"
    assert document.sections[0].conclusion == "No set can be planned."


def test_one_sensor_and_nothing_more_is_known_of_it(example):
    """All that a plan may leave out is left out."""
    full = example.plan
    one = replace(full.chosen, sensors=full.chosen.sensors[:1], judged=None)
    verdict = Verdict(None, "Best of all.")
    plan = Plan(full.question, full.site, full.detector, 0.7, "late", "", verdict, one, sensors=full.sensors[:1])
    document = report_of(plan, replace(example.site, sensors=example.site.sensors[:1]), None)
    said = {section.key: section.conclusion for section in document.sections}
    assert said["chosen"] == (
        "Build 1 sensor, d0, for 6 units: it was not judged by the detector; a sensor sends 312 kbit of a frame under "
        "late fusion."
    )
    assert said["worth"] == "The worth of the sensors was not worked out."
    assert said["failures"] == "No failure leaves a sensor that works."
    assert said["front"] == "No other set is better than the chosen one in AP, sent data or price."
