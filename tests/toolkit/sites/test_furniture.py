import numpy as np
import pytest
import shapely

from toolkit.sites.furniture import block, digger, hedge_block, kerbs, move_solids, rectangle
from toolkit.sites.site import KINDS, Solid
from toolkit.sites.surroundings.street_furniture import BUILT, PLANTED


def test_kerbs_blocks_and_hedges_have_place_and_size(union):
    lanes, footways = [rectangle(0.0, 0.0, 20.0, 4.0)], [rectangle(0.0, 4.0, 20.0, 6.0)]
    stones = union([kerb.footprint for kerb in kerbs(lanes, footways)])
    assert stones.area == pytest.approx(20 * 0.15, rel=0.15)
    assert not stones.intersects(union(lanes))
    assert shapely.Polygon(block((4.0, 1.0), (1.0, 2.0), np.pi / 2)).equals(
        shapely.box(0.5, 0.0, 1.5, 4.0)
    )
    sizes = [
        np.ptp(s.footprint, axis=0)
        for seed in range(200)
        for s in hedge_block(np.random.default_rng(seed))
    ]
    assert len([1 for length, width in sizes if 3.5 < length < 5.2 and 1.5 < width < 2.1]) > 10
    (one,) = move_solids([Solid(block((4.0, 2.0)), 0.5, 1.5, "bin")], 10.0, -3.0, np.pi / 2)
    assert shapely.Polygon(one.footprint).equals(shapely.box(9.0, -5.0, 11.0, -1.0))
    assert (one.base, one.top, one.kind) == (0.5, 1.5, "bin")


@pytest.mark.parametrize("make", [*dict.fromkeys((*PLANTED, *BUILT, digger))])
def test_everything_stands_on_the_ground_and_is_at_most_as_big_as_a_van(make):
    for seed in range(10):
        solids = make(np.random.default_rng(seed))
        again = make(np.random.default_rng(seed))
        assert [(s.base, s.top) for s in solids] == [(s.base, s.top) for s in again]
        corners = np.concatenate([s.footprint for s in solids])
        length, width = np.ptp(corners, axis=0)
        assert 0.5 < max(length, width) < 9.0
        assert min(length, width) < 4.1
        assert min(s.base for s in solids) == 0
        assert 0.3 < max(s.top for s in solids) < 3.7
        assert np.abs(corners.mean(axis=0)).max() < 2.0
        assert all(s.kind in KINDS for s in solids)
