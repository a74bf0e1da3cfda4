from dataclasses import replace

import numpy as np

from placement_env.report.content import GroundShares
from placement_env.report.pages.sections_ground import ground_section

SHARES = GroundShares((0.8, 0.5, 0.25), 0.2, 0.05, {"d0": 400.0, "d1": 1000.0}, 2000.0, 400.0)


def test_shares_are_said_in_words(example):
    section = ground_section(replace(example.plan, ground=SHARES), example.site, example.ground)
    assert section.conclusion == (
        "80% of the open ground is seen by at least one sensor and 50% by two or more; 400 m² are seen by none, and of "
        "the lanes alone 5%."
    )
    *maps, areas = section.blocks
    assert [block.kind for block in maps] == ["drawing"] * 3
    assert "50% of the open ground" in maps[0].caption
    assert maps[2].caption.startswith("400 m², 20% of the open ground,")
    assert [[cell.text for cell in row] for row in areas.rows] == [["d0", "400", "20.0"], ["d1", "1,000", "50.0"]]


def test_density_is_that_of_the_lanes_by_all_sensors(example):
    ground = example.ground
    density = np.zeros_like(ground.density)
    density[0][ground.lanes], density[1][ground.lanes] = 1.5, 1.0
    sparse = np.argwhere(ground.lanes)[: int(ground.lanes.sum()) // 4]
    density[:, sparse[:, 0], sparse[:, 1]] = 0.2
    section = ground_section(replace(example.plan, ground=SHARES), example.site, replace(ground, density=density))
    assert section.blocks[1].caption.startswith("Half of the lanes' ground gets 2.5 points per m² or more")
    assert "25% of it gets fewer than 1" in section.blocks[1].caption


def test_without_lanes_or_ground(example):
    bare = replace(example.ground, lanes=np.zeros_like(example.ground.lanes))
    section = ground_section(example.plan, example.site, bare)
    assert section.blocks[1].caption.startswith("No lane lies in the area")
    assert ground_section(example.plan, example.site, None).blocks == ()
