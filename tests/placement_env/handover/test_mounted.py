"""A chosen set as it is mounted: names, poles, degrees, and sensors that a search moved."""

import math
from dataclasses import replace
from string import ascii_lowercase

import numpy as np
import pytest

from placement_env.candidates.candidates import Axes, Candidates, aim_sensor, paper_candidates, pool
from placement_env.candidates.sensor_catalogue import PricedModel, SensorCatalogue
from placement_env.handover import mounted
from toolkit.geometry import pose
from toolkit.sensors.models import DepthCamera, SpinningLidar
from toolkit.sites.files import load_site
from toolkit.sites.georeference import inverse_project, projection
from toolkit.sites.site import Mount, Site

CENTRE = (13.4, 52.505)
NORTH, EAST = (
    Mount("north", np.array([0.0, 12.0, 0.5]), 3.0, 9.0, 0.5, 800.0),
    Mount("e/1", np.array([20.0, 0.0, 0.0])),
)
SITE = Site(
    "berlin",
    np.array([-20.0, -20.0, 20.0, 20.0]),
    mounts=(NORTH, EAST),
    map_SE3_site=pose(3.0, 4.0, yaw=np.pi / 2),
    geo_reference=projection(*CENTRE),
)
KBIT = {"kbit": np.array([[200.0, 400.0], [10.5, 30.5]])}


@pytest.fixture
def candidates() -> Candidates:
    tilts = [math.radians(15)]
    return pool(
        SITE, heights=[4.0], headings=4, tilts=tilts, models=(DepthCamera(), SpinningLidar())
    )


@pytest.fixture
def chosen(candidates) -> list[int]:
    names = [sensor.name for sensor in candidates.sensors]
    return [names.index("north_4.0m_h270_t15_camera"), names.index("e-1_4.0m_h180_t15_lidar")]


def test_sensors_of_a_set_are_named_placed_and_aimed(candidates, chosen):
    north, east = mounted.format_sensors(SITE, candidates, chosen, **KBIT)
    assert (north.name, north.pole, north.model) == ("north", "north", "depth-camera")
    assert (east.name, east.pole, east.model) == ("e-1", "e/1", "spinning-lidar")
    assert (north.x, north.y, north.z, north.height) == (0.0, 12.0, 4.5, 4.0)
    # y of the site points to the map's west: 12 m along it from (3, 4) is 9 m west and 4 m north of
    # the map's zero
    (degrees,) = inverse_project(np.array([[-9.0, 4.0]]), CENTRE)
    assert (north.longitude, north.latitude) == pytest.approx(tuple(degrees), abs=1e-9)
    assert north.bearing_deg == pytest.approx(90.0)  # against y of the site: to the map's east
    assert east.bearing_deg == pytest.approx(180.0)
    assert (north.tilt_deg, east.tilt_deg) == (15.0, 15.0)


def test_sensors_of_a_set_have_prices_and_loads(candidates, chosen):
    north, east = mounted.format_sensors(SITE, candidates, chosen, **KBIT)
    assert (north.pole_price, north.capacity_kbit, north.kbit, north.peak_kbit) == (
        0.5,
        800.0,
        300.0,
        400.0,
    )
    assert (east.pole_price, east.capacity_kbit, east.kbit, east.peak_kbit) == (
        1.0,
        2000.0,
        20.5,
        30.5,
    )
    assert (north.model_price, east.model_price) == (0.0, 0.0)


def test_without_a_map_there_is_no_longitude(candidates, chosen):
    north, _ = mounted.format_sensors(replace(SITE, geo_reference=None), candidates, chosen, **KBIT)
    assert (north.longitude, north.latitude) == (None, None)
    assert north.bearing_deg == pytest.approx(90.0)


def test_moved_sensors_keep_their_poles_or_get_the_nearest(candidates, chosen):
    first, second = (candidates.sensors[c] for c in chosen)
    moved = (
        aim_sensor(first, np.array([0.0, 12.0, 6.75]), math.radians(-84.5), math.radians(7.0)),
        second,
    )
    north, east = mounted.format_sensors(SITE, candidates, chosen, moved, **KBIT)
    assert (north.name, north.pole, north.height) == ("north", "north", 6.25)
    assert (north.bearing_deg, north.tilt_deg) == pytest.approx((84.5, 7.0))
    assert (east.name, east.height) == ("e-1", 4.0)  # it stayed where it was
    site = mounted.mounted_site(SITE, candidates, chosen, moved)
    assert [s.name for s in site.sensors] == [north.name, east.name]
    assert np.array_equal(site.sensors[0].pose, moved[0].pose)
    away = (aim_sensor(candidates.sensors[chosen[0]], np.array([20.0, 0.0, 5.0]), 0.0, 0.0),)
    (there,) = mounted.format_sensors(SITE, candidates, chosen[:1], away, kbit=np.ones((1, 1)))
    assert (there.pole, there.name) == ("e/1", "e-1")
    assert [mount.name for mount in mounted.unused_mounts(candidates, chosen[:1], away)] == [
        "north"
    ]


def test_a_site_has_only_the_chosen_sensors(candidates, chosen):
    site = mounted.mounted_site(SITE, candidates, np.array(chosen))
    assert [sensor.name for sensor in site.sensors] == ["north", "e-1"]
    assert site == replace(SITE, sensors=site.sensors)
    assert mounted.unused_mounts(candidates, chosen) == ()
    assert mounted.unused_mounts(candidates, []) == (NORTH, EAST)
    assert mounted.mounted_site(site, candidates, []).sensors == ()


def test_poles_of_a_file_become_mounts_of_the_site(candidates):
    own = [
        Mount("new", np.array([-15.0, 9.0, 0.0])),
        Mount("north", np.array([9.0, 9.0, 0.0]), price=3.0),
    ]
    own += [Mount("again", np.array([20.05, 0.0, 0.0]))]
    found = pool(SITE, mounts=own)
    site = mounted.mounted_site(
        SITE, found, [0, int(np.flatnonzero(found.mount == 1)[0]), len(found) - 1]
    )
    assert [(m.name, *m.position, m.price) for m in site.mounts] == [
        *(
            ("e/1", 20.0, 0.0, 0.0, 1.0),
            ("new", -15.0, 9.0, 0.0, 1.0),
            ("north", 9.0, 9.0, 0.0, 3.0),
        )
    ]


def test_mounts_of_sites_come_once_and_of_no_set_none():
    site = load_site("tjunction")
    assert mounted.mounted_site(site, paper_candidates(site), range(6)).sensors == site.sensors
    assert {m.name for m in mounted.mounted_site(site, paper_candidates(site), [0, 3]).mounts} >= {
        m.name for m in site.mounts
    }
    none = Axes(np.zeros(0), np.zeros(0), np.zeros(0), ())
    empty = Candidates((), (NORTH,), np.zeros((0, 5), np.int64), none)
    assert mounted.format_sensors(SITE, empty, [], kbit=np.zeros((0, 1))) == ()


def test_mounts_are_paid_once_and_numbers_may_differ(candidates, chosen):
    with pytest.raises(ValueError, match="kbit must hold a row for each of 2 sensors, got 1"):
        mounted.format_sensors(SITE, candidates, chosen, kbit=np.ones((1, 3)))
    with pytest.raises(ValueError, match="moved must hold the 2 chosen sensors, got 1"):
        mounted.format_sensors(SITE, candidates, chosen, candidates.sensors[:1], **KBIT)
    names = [sensor.name for sensor in candidates.sensors]
    both = [chosen[0], names.index("north_4.0m_h180_t15_camera")]
    sensors = mounted.format_sensors(SITE, candidates, both, **KBIT)
    assert [(each.pole, each.pole_price) for each in sensors] == [("north", 0.5), ("north", 0.0)]
    poles = [item for item in mounted.bill_of_materials(sensors) if item.item == "pole"]
    assert [(item.count, item.price) for item in poles] == [(1, 0.5)]
    (load,) = mounted.link_loads(sensors, limited=True)
    assert (load.pole, load.mbit_s, load.peak_mbit_s, load.capacity_mbit_s) == pytest.approx(
        ("north", 3.205, 4.305, 8.0)
    )


@pytest.fixture
def sensors(street):
    kbit = np.array([[100.0, 300.0], [200.0, 600.0]])
    first, second = street.candidates.axes.models
    catalogue = SensorCatalogue(
        (PricedModel("eye", first, 10.0), PricedModel("wide eye", second, 20.0))
    )
    return mounted.format_sensors(
        street.site, street.candidates, (2, 3), kbit=kbit, catalogue=catalogue
    )


def test_bills_of_prices_and_links_add_up(sensors):
    assert [(s.model, s.model_price, s.pole, s.pole_price) for s in sensors] == [
        ("eye", 10.0, "post2", 0.5),
        ("wide eye", 20.0, "post3", 3.0),
    ]
    assert [(s.kbit, s.peak_kbit, s.capacity_kbit) for s in sensors] == [
        (200.0, 300.0, 500.0),
        (400.0, 600.0, 500.0),
    ]
    first, second = mounted.link_loads(sensors, limited=True)
    assert (first.pole, first.mbit_s, first.peak_mbit_s, first.capacity_mbit_s) == (
        "post2",
        2.0,
        3.0,
        5.0,
    )
    assert (first.share, first.fits) == (0.6, True)
    # 12500 and 37500 bytes: 9 and 27 packets of 1398 bytes; all but the last are full
    last_us = [40 + 8 * math.ceil((22 + 8 * (126 + rest)) / 48) for rest in (1316, 1152)]
    assert (first.packets_s, first.airtime_ms_s) == pytest.approx(
        (180.0, (8 * 2080 + 26 * 2080 + sum(last_us)) / 2 / 100)
    )
    assert mounted.describe_radio([first]).startswith("180 packets a second, 37.2 % of the")
    assert mounted.describe_radio([first] * 3).endswith("802.11p, more than a channel has")
    assert (second.share, second.fits) == (1.2, False)
    assert all(load.fits for load in mounted.link_loads(sensors, limited=False))
    bill = mounted.bill_of_materials((*sensors, sensors[0]))
    assert bill == (
        *(
            mounted.MaterialItem("eye", 2, 10.0, 20.0),
            mounted.MaterialItem("wide eye", 1, 20.0, 20.0),
        ),
        *(mounted.MaterialItem("pole", 2, 0.5, 1.0), mounted.MaterialItem("pole", 1, 3.0, 3.0)),
    )


LETTERS = (*ascii_lowercase, "aa", "ab")


@pytest.mark.parametrize(
    ("names", "poles", "expected"),
    [
        (["L/1_6.0m_h0_t5_camera", "L2_4.5m_h22.5_t-5_lidar0"], ["L/1", "L2"], ("L-1", "L2")),
        (
            ["L_6.0m_h0_t5_camera", "M_6.0m_h0_t5_camera", "L_6.0m_h9_t5_camera"],
            ["L", "M", "L"],
            ("L a", "M", "L b"),
        ),
        (["d0", "d1"], ["L", "L"], ("d0", "d1")),
        (["L b", "d1"], ["M", "L"], ("M", "d1")),  # carried from L to M
        (
            ["L a_6.0m_h0_t5_camera", "L_6.0m_h0_t5_camera", "L_6.0m_h9_t5_camera"],
            ["L a", "L", "L"],
            None,
        ),
        (
            [f"L_6.0m_h{k}_t5_camera" for k in range(28)],
            ["L"] * 28,
            tuple(f"L {c}" for c in LETTERS),
        ),
        (["Ecke_6.0m", "L_h0_t5_camera"], ["Ecke", "L"], ("Ecke_6.0m", "L_h0_t5_camera")),
    ],
)
def test_sensors_are_named_by_their_poles(names, poles, expected):
    assert mounted.name_by_poles(names, poles, ["L", "M"]) == (expected or tuple(names))
