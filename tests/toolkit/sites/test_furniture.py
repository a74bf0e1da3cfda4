"""Outlines and solids beside the road."""

import numpy as np
import pytest
import shapely

from toolkit.sites.furniture import block, kerbs, rectangle


def test_kerbs_lie_between_road_and_footway(union):
    lanes, footways = [rectangle(0.0, 0.0, 20.0, 4.0)], [rectangle(0.0, 4.0, 20.0, 6.0)]
    stones = union([kerb.footprint for kerb in kerbs(lanes, footways)])
    assert stones.area == pytest.approx(20 * 0.15, rel=0.15)
    assert not stones.intersects(union(lanes))


def test_a_block_lies_along_its_yaw():
    turned = shapely.Polygon(block((4.0, 1.0), (1.0, 2.0), np.pi / 2))
    assert turned.equals(shapely.box(0.5, 0.0, 1.5, 4.0))
