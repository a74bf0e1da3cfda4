from dataclasses import replace

from placement_env.report.content import MaterialItem
from placement_env.report.pages.sections_building import links_section, materials_section, schedule_section


def test_links_that_are_too_small_are_named(example):
    section = links_section(example.plan)
    assert section.conclusion == "1 link of 4 cannot carry what is sent: post00."
    assert section.blocks[0].caption.startswith("All links together carry 12.48 Mbit/s")
    assert [cell.text for cell in section.blocks[1].rows[0]] == ["post00", "3.12", "4.02", "4.00", "78.0", "no"]
    fine = links_section(replace(example.plan, links=example.plan.links[1:]))
    assert fine.conclusion == (
        "Every link carries what is sent; the fullest, of post01, is used to 16%: 3.12 of 20.00 Mbit/s."
    )


def test_bill_of_materials(example):
    section = materials_section(example.plan)
    assert section.conclusion == (
        "All of it costs 6 EUR; most of that, 4 EUR, goes to “pole with power and link” (4 at 1 EUR)."
    )
    bare = materials_section(replace(example.plan, currency="", materials=(MaterialItem("pole", 1, 1.0, 1.0),)))
    assert bare.conclusion == "All of it costs 1 unit; most of that, 1 unit, goes to “pole” (1 at 1 unit)."
    assert bare.blocks[0].text == "Prices are in units of one ordinary pole."


def test_mounting_schedule(example):
    section = schedule_section(example.plan)
    assert section.conclusion == "Mount 4 sensors on 4 poles, 5.2 m above the foot of the pole."
    assert [cell.text for cell in section.blocks[1].rows[0]] == [
        *("d0", "post00", "depth camera", "40.90", "8.10", "5.20"),
        *("14.423500", "50.081200", "45.0", "20.0"),
    ]


def test_a_site_that_is_nowhere_on_earth(example):
    first, *others = example.plan.sensors
    plan = replace(example.plan, sensors=(replace(first, longitude=None, latitude=None, height=3.0), *others))
    section = schedule_section(plan)
    assert section.conclusion.endswith("3.0 to 5.2 m above the foot of the pole.")
    assert "does not say where on earth" in section.blocks[0].text
    assert len(section.blocks[1].columns) == 8
