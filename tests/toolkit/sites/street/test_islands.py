"""Islands are kerbed and planted in many ways, never on a lane."""

import numpy as np
import shapely

from toolkit.sites.furniture import rectangle
from toolkit.sites.street.islands import plant_islands
from toolkit.sites.surroundings import LANE_CLEARANCE, Plot, Road

SIDES = [(-20.0, -20.0, 20.0, -14.0), (-20.0, 14.0, 20.0, 20.0), (-20.0, -20.0, -14.0, 20.0), (14.0, -20.0, 20.0, 20.0)]


def planted(seed, sides=SIDES):
    plot = Plot(Road([], [], [rectangle(*side) for side in sides], []), shapely.box(-60, -60, 60, 60), [])
    plant_islands(plot, np.random.default_rng(seed))
    return plot


def test_what_stands_on_an_island_keeps_off_the_lanes_and_differs_from_site_to_site():
    kinds, numbers, sizes = set(), [], []
    for seed in range(25):
        plot = planted(seed)
        ground, *rest = plot.solids
        assert ground.kind == "island"
        assert 27.0**2 < shapely.Polygon(ground.footprint).area < 28.0**2
        low = [shapely.Polygon(s.footprint) for s in rest if s.kind != "tree"]
        assert min((p.distance(plot.road.carriageway) for p in low), default=1) >= LANE_CLEARANCE
        kinds |= {s.kind for s in rest}
        numbers.append(len(rest))
        sizes += [np.ptp(s.footprint, axis=0).max() for s in rest if s.kind in ("hedge", "bush")]
        assert len(planted(seed).solids) == len(plot.solids)
    assert {"hedge", "bush", "tree", "sign", "container", "planter"} <= kinds
    assert min(numbers) < 25 < 50 < max(numbers)
    assert min(sizes) < 1.0 < 4.0 < max(sizes)


def test_slivers_between_lanes_stay_bare():
    narrow = [(-20.0, -8.0, 20.0, -2.0), (-20.0, 2.0, 20.0, 8.0), (-20.0, -8.0, -3.0, 8.0), (3.0, -8.0, 20.0, 8.0)]
    assert planted(0, narrow).solids == []
