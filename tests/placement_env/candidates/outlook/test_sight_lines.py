import numpy as np
import pytest

from placement_env.candidates.outlook.ground_plan import RASTER_CELLS, ground_plan
from placement_env.candidates.outlook.height_map import height_map
from placement_env.candidates.outlook.sight_lines import VEHICLE_TOP, sight_lines
from toolkit.sites.site import Site, Solid

AREA = np.array([0.0, 0.0, 48.0, 48.0])  # cells of 2 m
ROAD = np.array([[0.0, 22.0], [48.0, 22.0], [48.0, 26.0], [0.0, 26.0]])
WALL = np.array([[20.0, 20.0], [21.0, 20.0], [21.0, 28.0], [20.0, 28.0]])


def lines(solids=(), height: float = 4.0, parking=()):
    site = Site("road", AREA, lanes=(ROAD,), solids=tuple(solids), parking=np.array(parking).reshape(-1, 3))
    plan = ground_plan(site)
    places = np.array([[1.0, 24.0, height], [1.0, 24.0, height + 4], [1.0, 24.0, height]])
    return plan, sight_lines(plan, height_map(site), places)


def at(plan, figures, x: float) -> float:
    cell = plan.cells_at(np.array([[x, 23.0]]))[0]
    return float(figures[plan.used.tolist().index(cell)])


def test_an_empty_road_is_clear():
    plan, seen = lines()
    assert len(plan.used) == 2 * RASTER_CELLS
    assert (seen.clear == 1).all()
    assert seen.clear.shape == (3, 2 * RASTER_CELLS)


def test_a_wall_hides_what_its_shadow_covers():
    plan, seen = lines([Solid(WALL, 0.0, 2.0)])
    assert at(plan, seen.clear[0], 11) == 1  # before the wall
    assert at(plan, seen.clear[0], 25) == 0
    # beyond the wall's far edge at x = 21 the line over it, from 4 m at x = 1, falls by 2 m in 20 m
    assert at(plan, seen.clear[0], 31) == pytest.approx(1 - (4 - 2 * 30 / 20) / VEHICLE_TOP, abs=0.12)
    assert at(plan, seen.clear[0], 45) == 1
    assert (seen.clear[1] >= seen.clear[0]).all()
    assert seen.clear[1].sum() > seen.clear[0].sum()
    assert (seen.clear[2] == seen.clear[0]).all()


def test_what_hangs_hides_what_is_behind_it_and_not_beneath():
    crown = Solid(WALL, 1.4, 9.0, "tree")
    plan, seen = lines([crown])
    assert at(plan, seen.clear[0], 11) == 1
    assert at(plan, seen.clear[0], 45) == 0
    assert at(plan, seen.clear[0], 23) in (0.5, 1.0)  # close behind, seen beneath the crown


def test_traffic_in_between_counts_where_it_reaches_up_to_the_line():
    low_plan, low = lines(height=2.0)
    _, high = lines(height=8.0)
    far, near = at(low_plan, low.between[0], 45), at(low_plan, low.between[0], 5)
    assert 0 == near < far
    assert at(low_plan, high.between[0], 45) < far
    _, parked = lines(height=2.0, parking=[[31.0, 23.0, 0.0]])
    assert at(low_plan, parked.between[0], 45) > far
    assert at(low_plan, parked.between[0], 21) == pytest.approx(at(low_plan, low.between[0], 21))
