"""Objects of a map in a site: its frame, its window, its lanes."""

import numpy as np
import pytest
import shapely

from toolkit.geometry import pose
from toolkit.sites.furniture import post, rectangle
from toolkit.sites.opendrive.extract import roads_near
from toolkit.sites.opendrive.placed import in_frame, off_the_road, understood
from toolkit.sites.opendrive.standing import Standing

WINDOW = shapely.box(-40, -40, 40, 40)


def test_frame_of_the_site():
    there = Standing(groups=[[post(12.0, 5.0, 3.0)]], bays=[(12.0, 5.0, 1.0)], lamps=[(10.0, 6.0)])
    moved = in_frame(there, pose(10.0, 5.0, yaw=np.pi / 2))
    np.testing.assert_allclose(moved.groups[0][0].footprint.mean(axis=0), [0, -2], atol=1e-3)
    np.testing.assert_allclose(moved.bays, [[0, -2, 1.0 - np.pi / 2]], atol=1e-9)
    np.testing.assert_allclose(moved.lamps, [[1, 0]], atol=1e-9)


def test_what_would_stop_traffic_is_left_out_and_said():
    there = Standing(
        groups=[[post(0.0, 9.0, 3.0)], [post(0.0, 0.0, 3.0), post(0.0, 8.0, 3.0)], [post(90.0, 0.0, 3.0)], []]
    )
    there.unknown.update({"dragon": 2, "elf": 1})
    kept, notes = off_the_road(there, WINDOW, [rectangle(-40.0, -4.0, 40.0, 4.0)], shapely.Polygon())
    assert kept == there.groups[0]
    assert notes == [
        "1 objects or signals stand on the carriageway and were left out",
        "objects of types that are not known were left out: 2 'dragon', 1 'elf'",
    ]
    assert off_the_road(Standing(), WINDOW, [rectangle(-40.0, -4.0, 40.0, 4.0)], shapely.Polygon()) == ([], [])


def test_damage_names_the_file(street, tmp_path):
    path = street(tmp_path, objects='<object type="tree" s="5" t="x"/>')
    with pytest.raises(ValueError, match=r"street\.xodr: <object> needs a finite number as t, got 'x'"):
        understood(path, roads_near(path, WINDOW, 0.0, 3.5))
