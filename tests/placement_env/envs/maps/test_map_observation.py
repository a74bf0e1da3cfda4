import numpy as np
import pytest

from placement_env.candidates.outlook.ground_plan import CHANNELS, RASTER_CELLS
from placement_env.candidates.outlook.outlook import CANDIDATE_FEATURES, VIEW, outlook
from placement_env.envs.maps.map_observation import EPISODE, TERMS, map_space, observed, rasters
from placement_env.envs.maps.terms import Terms
from placement_env.objective import Weights


def test_rasters_hold_the_outlook_in_its_cells(made_up):
    junction = made_up()
    known = outlook(junction.site, junction.candidates)
    channels, view = rasters(known, 15)
    assert channels.shape == (len(CHANNELS), RASTER_CELLS, RASTER_CELLS)
    assert view.shape == (15, len(VIEW), RASTER_CELLS, RASTER_CELLS)
    row, column = np.divmod(known.plan.used, RASTER_CELLS)
    assert (view[: len(known.view), :, row, column] == known.view.transpose(0, 2, 1)).all()
    assert (channels[:, row, column] == known.plan.channels[known.plan.used].T).all()
    assert not view[len(known.view) :].any()
    unused = np.setdiff1d(np.arange(RASTER_CELLS**2), known.plan.used)
    assert not view.reshape(15, len(VIEW), -1)[..., unused].any()


def test_terms_are_observed(made_up):
    junction = made_up()
    known = outlook(junction.site, junction.candidates)
    count = len(junction.candidates)
    failed = np.zeros(count, np.bool_)
    failed[-1] = True
    terms = Terms(3, junction.candidates, failed, Weights(2e-4, 0.01), most_price=8.0)
    seen = observed(rasters(known, 15), known, terms, [0], steps_left=0.5)
    assert map_space(15).contains(seen)
    rows, own = seen["candidates"], len(CANDIDATE_FEATURES)
    assert (rows[:count, :own] == known.features).all()
    assert not rows[count:].any()
    price, link, chosen, allowed = rows[:count, own:].T
    assert len(TERMS) == 4
    assert price == pytest.approx(junction.candidates.prices / (junction.candidates.prices + 1))
    assert link == pytest.approx(junction.candidates.capacity / (junction.candidates.capacity + 1000))
    assert np.flatnonzero(chosen).tolist() == [0]
    assert allowed.tolist() == terms.allowed([0]).tolist()
    left = 8 - junction.candidates.prices[0]
    assert seen["whole"] == pytest.approx([2 / 3, 3 / 11, 0.5, left / (left + 8), 0.2, 0.01])
    assert len(EPISODE) == 6
    assert seen["map"] is not observed(rasters(known, 15), known, terms, [0], steps_left=0.5)["map"]
    full = observed(rasters(known, 15), known, Terms.plain(junction.candidates, 1), [0], steps_left=0.0)
    assert not full["candidates"][:, -1].any()
    assert full["whole"][3] == 1
