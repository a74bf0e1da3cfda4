"""A first set of sensors by coverage: what it maximises, that it keeps the site, and what it
refuses."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from placement_env.candidates.candidates import aims
from placement_env.fidelity.visibility import Visibility
from placement_env.search import first_sensors
from placement_env.search.first_sensors import HalvedViews, with_first_sensors
from toolkit.sites.files import load_site
from toolkit.sites.maps.osm_site import import_osm
from toolkit.sites.maps.piece import MapPiece

MAP = Path(__file__).parents[3] / "docs" / "own-junction.osm"


def seeing(points: list[list[float]]) -> Visibility:
    on = np.array(points, np.float32)
    sent = np.zeros((len(on), 1), np.float32)
    return Visibility(
        on, on, np.zeros(on.shape[1], np.int64), np.zeros((on.shape[1], 7)), sent, sent
    )


def test_further_views_are_worth_half_of_the_one_before():
    score = HalvedViews(seeing([[20, 19, 0, 90], [30, 20, 0, 0], [25, 40, 0, 20]]))
    estimate = score(np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [1, 1, 1]], bool))
    # objects are seen with 20 points or more by: 1 0 0 1; 2 1 0 1; 3 2 0 2 sensors
    assert estimate.ap.tolist() == [0.0, 0.25, (0.75 + 0.5 + 0.5) / 4, (0.875 + 0.75 + 0.75) / 4]
    assert estimate.recall.tolist() == estimate.ap.tolist()
    assert estimate.kbit.tolist() == [0.0] * 4


@pytest.fixture(scope="module")
def imported():
    return import_osm(MapPiece(MAP, centre=(8.0, 49.5), size=(70, 50)))


def test_sensors_are_placed_on_mounts_of_their_own_and_spread(imported, limits):
    limits(first_sensors, FIRST_FRAMES=4)
    limits(first_sensors, FIRST_HEADINGS=4)
    placed = with_first_sensors(imported, 3)
    site = placed.site
    assert replace(site, sensors=()) == imported
    assert len({tuple(sensor.position[:2]) for sensor in site.sensors}) == 3
    feet = {tuple(mount.position[:2]) for mount in imported.mounts}
    assert {tuple(sensor.position[:2]) for sensor in site.sensors} <= feet
    assert [sensor.position[2] for sensor in site.sensors] == [6.0] * 3
    headings, tilts = aims(site.sensors)
    assert np.rad2deg(tilts) == pytest.approx([15.0] * 3)
    assert len(set(np.rad2deg(headings).round() % 360)) > 1
    assert placed.covered_share > 0.6
    assert str(placed).startswith(
        f"3 sensors placed by coverage: from {placed.pose_count} poses of the paper's camera"
    )
    assert with_first_sensors(imported, 3).site == site


@pytest.mark.parametrize("count", [0, -1])
def test_a_number_of_sensors_that_makes_no_sense(count, imported):
    with pytest.raises(ValueError, match="number of sensors must be"):
        with_first_sensors(imported, count)


def test_sites_where_nothing_can_be_placed(limits):
    site = load_site("tjunction")
    limits(first_sensors, FIRST_FRAMES=1)
    with pytest.raises(ValueError, match="has no mount"):
        with_first_sensors(replace(site, mounts=()), 2)
    with pytest.raises(ValueError, match="network"):
        with_first_sensors(replace(site, network=""), 2)
