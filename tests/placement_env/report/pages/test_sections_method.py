from placement_env.report.pages.sections_method import method_section


def test_assumptions_unknowns_and_provenance(example):
    section = method_section(example.plan)
    assert section.conclusion == (
        "Every AP here is that of VoxelNet, trained at tjunction in simulated traffic, 412 vehicles in 60 frames: it "
        "ranks places for sensors, and does not replace a trial on the street."
    )
    assert section.blocks[0].text == (
        "5 sets of sensors came to the final comparison by the detector, found by the searches cpsat and greedy."
    )
    assert [block.items for block in section.blocks if block.kind == "bullets"] == [
        example.plan.assumptions,
        example.plan.unknown,
    ]
    rows = [[cell.text for cell in row] for row in section.blocks[-1].rows]
    assert rows[:3] == [["versions: coview", "0.1.0"], ["seeds: search", "0"], ["seeds: judgement", "7"]]


def test_nothing_is_claimed_where_nothing_was_judged(nothing_chosen):
    assert method(nothing_chosen.plan).blocks == ()
