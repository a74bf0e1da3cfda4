"""Links, bill of materials and sensors in the words of a plan."""

import numpy as np
import pytest

from placement_env.candidates.sensor_catalogue import PricedModel, SensorCatalogue
from placement_env.fidelity.detector import Outcome
from placement_env.report.content import MaterialItem
from placement_env.report.planning.mounting import bill_of_materials, link_loads, mounted_sensors


@pytest.fixture
def sensors(street):
    nothing = (np.zeros(0), np.zeros((3, 0), np.int16))
    outcomes = [Outcome(*nothing, np.array(bits)) for bits in ([100_000, 200_000], [300_000, 600_000])]
    first, second = street.candidates.axes.models
    catalogue = SensorCatalogue((PricedModel("eye", first, 10.0), PricedModel("wide eye", second, 20.0)))
    return mounted_sensors(street.site, street.candidates, (2, 3), outcomes, catalogue)


def test_sensors_have_their_prices_and_kbit(sensors):
    assert [(s.model, s.model_price, s.pole, s.pole_price) for s in sensors] == [
        ("eye", 10.0, "post2", 0.5),
        ("wide eye", 20.0, "post3", 3.0),
    ]
    assert [(s.kbit, s.peak_kbit, s.capacity_kbit) for s in sensors] == [(200.0, 300.0, 500.0), (400.0, 600.0, 500.0)]


def test_links_at_ten_frames_a_second(sensors):
    first, second = link_loads(sensors, limited=True)
    assert (first.pole, first.mbit_s, first.peak_mbit_s, first.capacity_mbit_s) == ("post2", 2.0, 3.0, 5.0)
    assert (first.share, first.fits) == (0.6, True)
    assert (second.share, second.fits) == (1.2, False)
    assert all(load.fits for load in link_loads(sensors, limited=False))


def test_the_bill_adds_up(sensors):
    bill = bill_of_materials((*sensors, sensors[0]))
    assert bill == (
        MaterialItem("eye", 2, 10.0, 20.0),
        MaterialItem("wide eye", 1, 20.0, 20.0),
        MaterialItem("pole", 2, 0.5, 1.0),
        MaterialItem("pole", 1, 3.0, 3.0),
    )
