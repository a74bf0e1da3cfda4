"""A simulated junction as an input."""

from dataclasses import replace
from importlib.util import find_spec
from threading import Event

import numpy as np
import pytest

from toolkit.centre.junction_input import JunctionInput
from toolkit.sites.files import load_site

pytestmark = pytest.mark.skipif(find_spec("libsumo") is None, reason="traffic needs SUMO")


def test_all_sensors_send_in_step_and_traffic_goes_on():
    site = load_site("tjunction")
    site = replace(site, sensors=site.sensors[:2])
    messages = list(JunctionInput(site, 0.1, 0.5, seed=3).messages(Event()))
    assert [message.sensor for message in messages] == ["d0", "d1"] * 5
    times = [message.time_s for message in messages[::2]]
    assert times == pytest.approx(0.1 * np.arange(5))
    first, last = messages[0].measurement, messages[-2].measurement
    assert not np.array_equal(first, last)  # noise, if nothing else
    stop = Event()
    stop.set()
    assert list(JunctionInput(site, 0.1, 0.5).messages(stop)) == []
