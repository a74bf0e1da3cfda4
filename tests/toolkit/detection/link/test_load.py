"""Rate, packets and shares of links."""

import numpy as np
import pytest

from toolkit.detection.link.load import CAPACITIES_MBIT_PER_S, SetLoad, format_loads, link_load
from toolkit.exchange.geonetworking import PACKET_BYTES


def test_loads_count_packets_and_shares_of_links():
    load = link_load(np.array([[8000, 12000], [4000, 16000]]), 10.0)
    assert load.mbit_per_s == pytest.approx(0.2)
    assert load.packets == pytest.approx(1.5)
    assert load.one_packet == 0.5
    assert load.shares == pytest.approx({"802.11p": 0.2 / 6, "LTE-V2X": 0.2 / 8, "Ethernet": 0.002})
    assert load.rate == 10.0
    assert link_load(np.array([[8000, 12000], [4000, 16000]]), 0.5).mbit_per_s == pytest.approx(
        0.01
    )
    none = SetLoad("late", (), load)
    assert format_loads([none]).splitlines()[1].split()[:2] == ["late", "none"]
    assert PACKET_BYTES == 1398
    assert list(CAPACITIES_MBIT_PER_S) == list(load.shares)


def test_packets_are_whole():
    assert link_load(np.array([[0, 1, 8 * 1398, 8 * 1398 + 1, 8 * 13980]]), 10.0).packets == 14 / 5
    for rate in (0.0, -1.0, float("nan"), float("inf")):
        with pytest.raises(ValueError, match="rate must be above 0"):
            link_load(np.ones((1, 1), np.int64), rate)
    with pytest.raises(ValueError, match="0 frames of 3 sensors"):
        link_load(np.zeros((0, 3), np.int64), 10.0)


def test_loads_are_formatted():
    each = SetLoad("late", (0, 2), link_load(np.array([[8000, 12000], [4000, 16000]]), 10.0))
    assert format_loads([each]).splitlines() == [
        "scheme  sensors  Mbit/s  packets/message  in one packet  packets/s  airtime ms/s  "
        "802.11p  LTE-V2X  Ethernet",
        "late    0,2       0.200             1.50          0.500       30.0          39.8  "
        " 3.33 %   2.50 %    0.20 %",
    ]
    assert each.as_dict() | {"shares": None} == {
        "scheme": "late",
        "sensors": (0, 2),
        "rate": 10.0,
        "mbit_per_s": 0.2,
        "packets": 1.5,
        "one_packet": 0.5,
        "packets_per_s": 30.0,
        "airtime_ms_per_s": 39.8,
        "shares": None,
    }
