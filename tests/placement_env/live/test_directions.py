"""Directions as people type them: bearings and named headings, tilts, heights, and numbers as they
are printed."""

import csv
import io
import math
from dataclasses import replace

import numpy as np
import pytest

from placement_env.candidates.candidates import Candidates, aim_sensor, aims, pool
from placement_env.handover.exchange import schedule_csv
from placement_env.handover.mounted import format_sensors
from placement_env.live.directions import parse_heading, parse_height, parse_tilt, show_bearing
from placement_env.live.variant import LiveSensor, Yard
from toolkit.geometry import pose
from toolkit.sites.files import load_site
from toolkit.sites.georeference import bearing_deg, heading_from_bearing
from toolkit.sites.random import random_site
from toolkit.sites.site import Mount

SITE = load_site("roundabout")
TURNED = replace(SITE, map_SE3_site=pose(3.0, -2.0, 0.0, yaw=math.radians(33.3)))
POLE = Mount("post", np.array([0.0, 0.0, 0.0]), 3.0, 8.0)


@pytest.mark.parametrize("site", [SITE, TURNED])
@pytest.mark.parametrize("bearing", [0.0, 45.0, 123.4, 270.0, 359.9])
def test_a_bearing_is_clockwise_from_the_maps_north(site, bearing):
    heading = parse_heading(site, str(bearing))
    ahead = site.map_SE3_site[:2, :2] @ (math.cos(heading), math.sin(heading))
    east, north = math.sin(math.radians(bearing)), math.cos(math.radians(bearing))
    assert ahead == pytest.approx((east, north), abs=1e-9)
    assert bearing_deg(site, heading_from_bearing(site, bearing)) == pytest.approx(bearing)


def test_a_heading_is_counter_clockwise_from_x_whatever_the_map():
    assert parse_heading(TURNED, "heading=135") == pytest.approx(math.radians(135))
    assert parse_heading(TURNED, "heading=-90") == pytest.approx(-math.pi / 2)


@pytest.mark.parametrize("offset", [0.0, 0.049, -0.049])
def test_a_number_as_it_is_printed_is_the_present_one(offset):
    heading, tilt, height = (
        math.radians(77.0 + offset),
        math.radians(25.0 + offset),
        5.0 + offset / 10,
    )
    sensor = LiveSensor("d0", "camera", "post", 0.0, 0.0, height, heading, tilt)
    assert parse_heading(TURNED, str(show_bearing(TURNED, sensor)), heading) == heading
    assert parse_heading(TURNED, f"heading={math.degrees(heading):.1f}", heading) == heading
    assert parse_heading(TURNED, str(show_bearing(TURNED, sensor) - 360), heading) == heading
    assert parse_tilt(25.0, tilt) == tilt
    assert parse_height(POLE, 5.0, height) == height


def test_another_number_is_followed():
    heading = parse_heading(SITE, "90.2", 0.0)
    assert math.degrees(heading) == pytest.approx(-0.2)
    assert parse_tilt(25.2, math.radians(25.0)) == pytest.approx(math.radians(25.2))
    assert parse_height(POLE, 5.1, 5.0) == 5.1
    assert parse_height(POLE, 9.0, 9.0) == 9.0  # above the pole's heights, as it was found
    assert (parse_height(POLE, 3.0), parse_height(POLE, 8.0)) == (3.0, 8.0)
    assert (parse_tilt(-10.0), parse_tilt(89.0)) == pytest.approx(
        (math.radians(-10), math.radians(89))
    )


@pytest.mark.parametrize(
    "text", ["north", "", "361", "-361", "nan", "inf", "heading=", "heading=400", "bearing=3"]
)
def test_what_is_no_direction_is_refused_with_both_ways_to_write_one(text):
    with pytest.raises(
        ValueError, match=r"clockwise from north, from 0 to 360.*got '.*heading=135"
    ):
        parse_heading(SITE, text)


@pytest.mark.parametrize("tilt", [90.5, 95.0, 180.0, -10.5, math.nan, math.inf])
def test_a_tilt_that_no_sensor_has_is_refused(tilt):
    with pytest.raises(
        ValueError, match=rf"a tilt must be -10 to 89 degrees below the horizon, got {tilt:g}"
    ):
        parse_tilt(tilt)


@pytest.mark.parametrize("height", [2.9, 8.1, math.nan])
def test_a_height_beyond_the_pole_is_refused(height):
    with pytest.raises(
        ValueError, match=rf"post takes sensors at 3 to 8 m above its foot, got {height:g}"
    ):
        parse_height(POLE, height)


@pytest.mark.parametrize(
    "site", [load_site("tjunction"), TURNED, random_site(7)], ids=lambda site: site.name
)
def test_the_row_of_a_schedule_is_the_sensor_at_any_junction(site):
    rng, stock = np.random.default_rng(4), pool(site)
    chosen = rng.choice(len(stock), 40, replace=False)
    # in poses of the stock, and in poses between them
    sensors = [stock.sensors[k] for k in chosen[:20]]
    for k in chosen[20:]:
        height, heading, tilt = rng.uniform((3.0, -3.1, 0.0), (8.0, 3.1, 0.6))
        place = stock.mounts[stock.mount[k]].position + np.array([0.0, 0.0, height])
        sensors.append(aim_sensor(stock.sensors[k], place, heading, tilt))
    mount = stock.mount[chosen]
    heights = [
        sensor.position[2] - stock.mounts[m].position[2]
        for sensor, m in zip(sensors, mount, strict=True)
    ]
    poses = Candidates.from_poses(sensors, mount, np.column_stack([heights, *aims(sensors)]), stock)
    rows = format_sensors(site, poses, range(len(poses)), kbit=np.zeros((len(poses), 1)))
    table = list(csv.DictReader(io.StringIO(schedule_csv(rows))))
    yard = Yard.from_stock(site, stock, [], ())
    variant = yard.place(sensors)
    for row, sensor in zip(table, variant.sensors, strict=True):
        assert parse_heading(site, row["bearing_deg"], sensor.heading) == sensor.heading
        assert parse_tilt(float(row["tilt_deg"]), sensor.tilt) == sensor.tilt
        assert (
            parse_height(
                yard.find_mount(variant, sensor.mount), float(row["height_m"]), sensor.height
            )
            == sensor.height
        )
        written = parse_heading(site, row["bearing_deg"])
        assert math.degrees(math.remainder(written - sensor.heading, math.tau)) == pytest.approx(
            0.0, abs=0.051
        )
    for k, built in enumerate(yard.candidates(variant).sensors[:20]):
        np.testing.assert_array_equal(built.pose, stock.sensors[chosen[k]].pose)
