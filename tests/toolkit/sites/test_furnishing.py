from dataclasses import replace

import numpy as np
import pytest
import shapely

from toolkit.sites import furniture, site
from toolkit.sites.surroundings.furnish import POST_AIR_M, furnish
from toolkit.sites.surroundings.islands import plant_islands
from toolkit.sites.surroundings.mount_places import place_mounts
from toolkit.sites.surroundings.places import points_along
from toolkit.sites.surroundings.plot import LANE_CLEARANCE_M, MOUNT_CLEARANCE_M, Plot, Road
from toolkit.sites.surroundings.road_works import lane_works, verge_works
from toolkit.sites.surroundings.street_trees import (
    CROWN_WIDTH_M,
    UNDERSIDE_M,
    draw_crown,
    plant_avenues,
    plant_tree,
)
from toolkit.sites.surroundings.works_closings import barrier, beacon, concrete, cone, fence

AREA = np.array([-40.0, -20.0, 40.0, 20.0])
SHOULDER = furniture.rectangle(-80.0, -8.7, 80.0, -3.5)
LINE = np.array([[-80.0, -6.1], [80.0, -6.1]])  # middle of the shoulder, as its traffic goes
ROAD = Road(
    paths=[np.array([[-80.0, 0.0], [80.0, 0.0]])],
    half_widths=[(5.5, 10.7)],
    lanes=[
        furniture.rectangle(-80.0, -3.5, 80.0, 0.0),
        furniture.rectangle(-80.0, 0.0, 80.0, 3.5),
        SHOULDER,
    ],
    footways=[
        furniture.rectangle(-80.0, 3.5, 80.0, 5.5),
        furniture.rectangle(-80.0, -10.7, 80.0, -8.7),
    ],
    strips={"in0": (LINE, 5.2)},
)
DRIVEN = shapely.box(-80.0, -3.5, 80.0, 3.5)


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("angles", [{"in0": 90}, {}])
def test_what_is_built_keeps_off_the_lanes_the_mounts_and_the_bays(seed, angles):
    rng = np.random.default_rng(seed)
    mounts = place_mounts(ROAD, AREA, rng)
    solids, bays = furnish(replace(ROAD, angles=angles), AREA, mounts, rng)
    low = [(shapely.Polygon(s.footprint), s.kind) for s in solids if s.base < 2]
    assert {"building", "post"} <= {kind for _, kind in low}
    assert max(shape.intersection(DRIVEN).area for shape, _ in low) < 1e-3
    standing = [shape for shape, kind in low if kind not in ("post", "kerb")]
    spots = [shapely.Point(mount.position[:2]) for mount in mounts]
    assert (
        min(shape.distance(spot) for shape in standing for spot in spots)
        >= MOUNT_CLEARANCE_M - 0.02
    )
    parked = shapely.union_all([shapely.Point(x, y).buffer(1.0) for x, y, _ in bays])
    assert parked.intersection(shapely.union_all(standing)).area < 1e-6
    assert any(shapely.Polygon(SHOULDER).contains(shapely.Point(x, y)) for x, y, _ in bays) == bool(
        angles
    )
    works = [shapely.Polygon(s.footprint) for s in solids if s.kind in ("cone", "barrier", "fence")]
    works = [shape.intersects(shapely.Polygon(SHOULDER).buffer(-0.3)) for shape in works]
    assert any(works) == (not angles)


def test_posts_are_as_high_as_their_mounts_leave():
    rng = np.random.default_rng(0)
    mounts = place_mounts(ROAD, AREA, rng)
    solids, _ = furnish(replace(ROAD, strips={}), AREA, mounts, rng)
    assert [s.top for s in solids[: len(mounts)]] == [
        round(m.min_height - POST_AIR_M, 2) for m in mounts
    ]


def test_works_stand_beside_the_road():
    assert works(0, line=np.array([[0.0, -6.1], [12.0, -6.1]])) == []
    number = 0
    for seed in range(8):
        plot = Plot(ROAD, WINDOW, [])
        verge_works(plot, np.random.default_rng(seed))
        assert not any(shapely.Polygon(s.footprint).intersects(ROAD.surface) for s in plot.solids)
        number += len(plot.solids) > 0
    assert number >= 4


def test_a_barrier_is_as_long_as_asked_and_about_a_metre_high():
    solids = barrier(2.5, np.random.default_rng(0))
    assert np.ptp(np.concatenate([s.footprint for s in solids])[:, 0]) == pytest.approx(2.5)
    assert min(s.base for s in solids) == 0
    assert 0.9 <= max(s.top for s in solids) <= 1.2
    plot = Plot(ROAD, WINDOW, [])
    plant_avenues(plot, np.zeros((0, 3)), np.random.default_rng(0))
    assert plot.solids == []


def test_crowns_are_as_wide_and_high_as_drawn():
    for seed in range(10):
        made = draw_crown(5.0, -2.0, CROWN_WIDTH_M[1] / 2, (3.0, 7.0), np.random.default_rng(seed))
        assert 3 <= len(made) <= 8
        reach = max(np.hypot(*(s.footprint - [5.0, -2.0]).T).max() for s in made)
        assert 3.0 < reach < 4.51
        assert min(s.base for s in made) == 3.0
        assert max(s.top for s in made) == 7.0


def test_trees_keep_off_walls_lanes_and_each_other():
    rng, plot = np.random.default_rng(0), Plot(ROAD, WINDOW, [])
    plot.solids.append(site.Solid(furniture.rectangle(0.0, 8.0, 10.0, 18.0), 0.0, 6.0, "building"))
    assert plant_tree(plot, np.array([5.0, 6.2]), 4.0, (3.0, 6.0), rng)
    crowns = [shapely.Polygon(s.footprint) for s in plot.solids if s.kind == "tree"]
    assert max(crown.bounds[3] for crown in crowns) <= 8.01
    assert not plant_tree(plot, np.array([5.0, 7.5]), 4.0, (3.0, 6.0), rng), "too close to the wall"
    assert not plant_tree(plot, np.array([20.0, 0.0]), 4.0, (3.0, 6.0), rng), "on the lane"
    assert not plant_tree(plot, np.array([5.0, 6.2]), 4.0, (3.0, 6.0), rng), "taken"


WINDOW = shapely.box(*AREA).buffer(25.0, join_style="mitre")
KERB = points_along(ROAD.carriageway.buffer(0.8).boundary.intersection(WINDOW), 0.5)


def avenue(seed):
    plot = Plot(ROAD, WINDOW, [site.Mount("pole", np.array([3.0, 4.3, 0.0]))])
    plant_avenues(plot, KERB, np.random.default_rng(seed))
    return plot.solids


def test_avenues_hang_over_the_road_and_stand_beside_it():
    seen = 0
    for seed in range(12):
        solids = avenue(seed)
        crowns = [s for s in solids if s.kind == "tree"]
        trunks = [shapely.Polygon(s.footprint) for s in solids if s.kind == "trunk"]
        assert not any(trunk.intersects(ROAD.carriageway) for trunk in trunks)
        assert all(UNDERSIDE_M[0] - 0.01 <= s.base < s.top <= UNDERSIDE_M[1] + 7.3 for s in crowns)
        hung = [s for s in crowns if shapely.Polygon(s.footprint).intersects(DRIVEN)]
        seen += len(hung) > 10
        near = [shapely.Polygon(s.footprint).distance(shapely.Point(3.0, 4.3)) for s in crowns]
        assert min(near, default=1.0) > 0.99
        assert [len(s.footprint) for s in solids] == [len(s.footprint) for s in avenue(seed)]
    assert 4 <= seen <= 11


def test_islands_are_planted_with_all_kinds():
    kinds, numbers, sizes = set(), [], []
    for seed in range(25):
        plot = planted(seed)
        ground, *rest = plot.solids
        assert ground.kind == "island"
        assert 27.0**2 < shapely.Polygon(ground.footprint).area < 28.0**2
        low = [shapely.Polygon(s.footprint) for s in rest if s.kind != "tree"]
        assert min((p.distance(plot.road.carriageway) for p in low), default=1) >= LANE_CLEARANCE_M
        kinds |= {s.kind for s in rest}
        numbers.append(len(rest))
        sizes += [np.ptp(s.footprint, axis=0).max() for s in rest if s.kind in ("hedge", "bush")]
        assert len(planted(seed).solids) == len(plot.solids)
    assert {"hedge", "bush", "tree", "sign", "container", "planter"} <= kinds
    assert min(numbers) < 25 < 50 < max(numbers)
    assert min(sizes) < 1.0 < 4.0 < max(sizes)


def test_slivers_stay_bare():
    narrow = [
        (-20.0, -8.0, 20.0, -2.0),
        (-20.0, 2.0, 20.0, 8.0),
        (-20.0, -8.0, -3.0, 8.0),
        (3.0, -8.0, 20.0, 8.0),
    ]
    assert planted(0, narrow).solids == []


@pytest.mark.parametrize("footway", [True, False])
def test_a_footway_is_planted_only_where_it_may_be(footway):
    plot = Plot(ROAD, WINDOW, [])
    assert (
        plant_tree(
            plot,
            np.array([0.0, 4.5]),
            2.0,
            (3.0, 6.0),
            np.random.default_rng(0),
            on_footways=footway,
        )
        == footway
    )


@pytest.mark.parametrize(("underside", "reaches"), [(2.4, False), (2.5, True)])
def test_crowns_too_low_to_drive_below_keep_off_the_road(underside, reaches):
    plot = Plot(ROAD, WINDOW, [])
    assert plant_tree(plot, np.array([0.0, 5.2]), 4.0, (underside, 6.0), np.random.default_rng(0))
    crowns = [shapely.Polygon(s.footprint) for s in plot.solids if s.kind == "tree"]
    assert any(crown.intersects(ROAD.carriageway) for crown in crowns) == reaches


SIDES = [
    (-20.0, -20.0, 20.0, -14.0),
    (-20.0, 14.0, 20.0, 20.0),
    (-20.0, -20.0, -14.0, 20.0),
    (14.0, -20.0, 20.0, 20.0),
]


def planted(seed, sides=SIDES):
    plot = Plot(
        Road([], [], [furniture.rectangle(*side) for side in sides], []),
        shapely.box(-60, -60, 60, 60),
        [],
    )
    plant_islands(plot, np.random.default_rng(seed))
    return plot


def works(seed, line=LINE, edge="in0"):
    plot = Plot(ROAD, WINDOW, [])
    lane_works(plot, {edge: (line, 3.4)}, np.random.default_rng(seed))
    return plot.solids


@pytest.mark.parametrize("edge", ["in0", "out0"])
def test_a_closed_lane_is_fenced_off_and_nothing_of_it_is_in_the_way(edge):
    found = set()
    for seed in range(15):
        solids = works(seed, edge=edge)
        shapes = [shapely.Polygon(s.footprint) for s in solids]
        assert min(shape.distance(DRIVEN) for shape in shapes) >= LANE_CLEARANCE_M
        x = np.concatenate([s.footprint[:, 0] for s in solids])
        assert (x.min() > 80 - 56) if edge == "in0" else (x.max() < -80 + 56), "near the junction"
        assert sum(s.kind in ("cone", "barrier", "fence") for s in solids) > 5
        found |= {s.kind for s in solids}
        assert [s.top for s in solids] == [s.top for s in works(seed, edge=edge)]
    assert {"cone", "barrier", "fence", "container", "machine", "heap"} <= found


@pytest.mark.parametrize(
    ("make", "kind", "top"),
    [
        *((cone, "cone", (0.5, 1.0)), (beacon, "cone", (1.0, 1.3))),
        *((concrete, "barrier", (0.75, 0.95)), (fence, "fence", (1.2, 2.0))),
    ],
)
def test_what_closes_a_lane_has_its_usual_size(make, kind, top):
    for seed in range(5):
        solids = make(np.random.default_rng(seed))
        assert {s.kind for s in solids} == {kind}
        assert min(s.base for s in solids) == 0
        assert top[0] - 0.01 <= max(s.top for s in solids) <= top[1] + 0.01
