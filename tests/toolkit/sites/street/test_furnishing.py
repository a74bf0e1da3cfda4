"""What is furnished keeps off the lanes, the mounts and the bays; what hangs over them hangs high."""

import numpy as np
import pytest
import shapely

from toolkit.sites.furniture import rectangle
from toolkit.sites.street.furnishing import FOOT_AIR, furnish
from toolkit.sites.surroundings import MOUNT_CLEARANCE, Road, place_mounts

AREA = np.array([-40.0, -20.0, 40.0, 20.0])
SHOULDER = rectangle(-80.0, -8.7, 80.0, -3.5)
LINE = np.array([[-80.0, -6.1], [80.0, -6.1]])  # middle of the shoulder, as its traffic goes
ROAD = Road(
    paths=[np.array([[-80.0, 0.0], [80.0, 0.0]])],
    half_widths=[(5.5, 10.7)],
    lanes=[rectangle(-80.0, -3.5, 80.0, 0.0), rectangle(-80.0, 0.0, 80.0, 3.5), SHOULDER],
    footways=[rectangle(-80.0, 3.5, 80.0, 5.5), rectangle(-80.0, -10.7, 80.0, -8.7)],
    shoulders=[SHOULDER],
)
DRIVEN = shapely.box(-80.0, -3.5, 80.0, 3.5)


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("angles", [{"in0": 90}, {}])
def test_what_is_built_keeps_off_the_lanes_the_mounts_and_the_bays(seed, angles):
    rng = np.random.default_rng(seed)
    mounts = place_mounts(ROAD, AREA, rng)
    solids, bays = furnish(ROAD, AREA, mounts, rng, strips={"in0": (LINE, 5.2)}, angles=angles)
    low = [(shapely.Polygon(s.footprint), s.kind) for s in solids if s.base < 2]
    assert {"building", "post"} <= {kind for _, kind in low}
    assert max(shape.intersection(DRIVEN).area for shape, _ in low) < 1e-3
    standing = [shape for shape, kind in low if kind not in ("post", "kerb")]
    spots = [shapely.Point(mount.position[:2]) for mount in mounts]
    assert min(shape.distance(spot) for shape in standing for spot in spots) >= MOUNT_CLEARANCE - 0.02
    parked = shapely.union_all([shapely.Point(x, y).buffer(1.0) for x, y, _ in bays])
    assert parked.intersection(shapely.union_all(standing)).area < 1e-6
    on_shoulder = [shapely.Polygon(SHOULDER).contains(shapely.Point(x, y)) for x, y, _ in bays]
    assert any(on_shoulder) == bool(angles)
    works = [shapely.Polygon(s.footprint) for s in solids if s.kind in ("cone", "barrier", "fence")]
    works = [shape.intersects(shapely.Polygon(SHOULDER).buffer(-0.3)) for shape in works]
    assert any(works) == (not angles)


def test_posts_end_below_the_lowest_sensor():
    rng = np.random.default_rng(0)
    mounts = place_mounts(ROAD, AREA, rng)
    solids, _ = furnish(ROAD, AREA, mounts, rng)
    assert [s.top for s in solids[: len(mounts)]] == [round(m.min_height - FOOT_AIR, 2) for m in mounts]
