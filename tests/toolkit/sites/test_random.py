import libsumo
import numpy as np
import pytest
import shapely

from toolkit.sensors.models import DepthCamera, SpinningLidar
from toolkit.sites.files import document, format_site, parse
from toolkit.sites.network import shoulders
from toolkit.sites.random import (
    MAX_MOUNT_HEIGHT_M,
    MAX_STREET_SLOPE,
    MIN_MOUNT_HEIGHT_M,
    random_sensors,
    random_site,
    sloping,
)
from toolkit.sites.site import Relief, Site


def union(polygons):
    return shapely.union_all([shapely.Polygon(p) for p in polygons])


def check(site: Site, tmp_path) -> None:
    width, depth = site.area[2:] - site.area[:2]
    assert 59.9 <= width <= 110.1
    assert 39.9 <= depth <= 110.1
    lanes = union(site.lanes)
    footways = union(site.footways).difference(lanes.buffer(0.02))
    assert lanes.intersection(shapely.box(*site.area)).area > 200
    assert footways.intersection(shapely.box(*site.area)).area > 50
    unused = shoulders(site.network).values()
    strips = [
        shapely.LineString(line).buffer(width / 2, cap_style="flat") for line, width in unused
    ]
    driven = lanes.difference(shapely.union_all(strips).buffer(0.02))
    low = [s for s in site.solids if s.base - site.ground(s.footprint.mean(axis=0)) < 2]
    for solid in low:
        assert shapely.Polygon(solid.footprint).intersection(driven).area < 1e-3, solid
    crowns = [
        s
        for s in site.solids
        if s.kind == "tree" and shapely.Polygon(s.footprint).intersects(lanes)
    ]
    below = site.plane(np.array([s.footprint.mean(axis=0) for s in crowns]).reshape(-1, 2))
    assert all(1.0 < s.base - z < s.top - z < 12.0 for s, z in zip(crowns, below, strict=True))
    standing = union(s.footprint for s in low if s.top - s.base > 0.5 and s.kind != "kerb")
    assert standing.intersection(footways).area < 0.06 * footways.area
    assert len(site.mounts) >= 12
    assert 1 <= len(site.sensors) <= 10
    for sensor in site.sensors:
        x, y, z = sensor.position
        assert (
            MIN_MOUNT_HEIGHT_M - 0.1
            <= z - site.ground(np.array([[x, y]]))[0]
            <= MAX_MOUNT_HEIGHT_M + 0.1
        )
        around = [
            s
            for s in site.solids
            if shapely.Polygon(s.footprint).distance(shapely.Point(x, y)) < 0.1
        ]
        assert not [s for s in around if s.base <= z <= s.top], sensor.name
    bays = [shapely.Point(x, y).buffer(1.0) for x, y, _ in site.parking]
    assert standing.intersection(shapely.union_all(bays)).area < 1e-3
    assert parse(document(site)) == site
    check_traffic(site, tmp_path)


def check_traffic(site: Site, tmp_path) -> None:
    """SUMO loads the network; a car and a pedestrian get onto it and move."""
    network = tmp_path / "net.xml"
    network.write_text(site.network)
    quiet = ["--no-warnings", "--no-step-log", "--duration-log.disable"]
    libsumo.start(["sumo", "-n", str(network), *quiet])
    try:
        incoming = [e for e in libsumo.edge.getIDList() if e.startswith("in")]
        outgoing = [e for e in libsumo.edge.getIDList() if e.startswith("out")]
        found = [
            libsumo.simulation.findRoute(a, b, "DEFAULT_VEHTYPE").edges
            for a in incoming
            for b in outgoing
        ]
        routes = [route for route in found if route]
        assert len(routes) >= len(incoming)
        libsumo.route.add("drive", routes[0])
        libsumo.vehicle.add("car", "drive", departPos="5")
        libsumo.person.add("walker", incoming[0], 10.0)
        libsumo.person.appendWalkingStage("walker", [incoming[0]], 60.0)
        for _ in range(5):
            libsumo.simulationStep()
        assert "car" in libsumo.vehicle.getIDList()
        assert libsumo.vehicle.getDistance("car") > 1
        assert "walker" in libsumo.person.getIDList()
    finally:
        libsumo.close()


@pytest.mark.one_in(3)
@pytest.mark.parametrize("seed", range(5))
def test_site_is_valid(seed, tmp_path):
    check(random_site(seed), tmp_path)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(100))
def test_many_sites_are_valid(seed, tmp_path):
    check(random_site(np.random.default_rng(1000 + seed)), tmp_path)


@pytest.mark.slow
def test_random_sites_repeat_with_the_seed():
    assert format_site(random_site(3)) == format_site(random_site(np.random.default_rng(3)))
    assert format_site(random_site(3)) != format_site(random_site(4))


def test_random_sensors_are_of_both_sorts():
    site = random_site(1)
    rng = np.random.default_rng(0)
    drawn = [random_sensors(site, rng) for _ in range(60)]
    assert {len(sensors) for sensors in drawn} == set(range(1, 11))
    models = [sensor.model for sensors in drawn for sensor in sensors]
    assert {type(model) for model in models} == {DepthCamera, SpinningLidar}
    assert all(
        np.deg2rad(60) <= m.fov <= np.deg2rad(100) for m in models if isinstance(m, DepthCamera)
    )
    assert {m.channels for m in models if isinstance(m, SpinningLidar)} == {16, 32, 64, 128}
    for sensors in drawn:
        names = [sensor.name for sensor in sensors]
        assert names == sorted(names)


def test_random_cameras_look_to_the_middle():
    site = random_site(2)
    rng = np.random.default_rng(0)
    middle = (site.area[:2] + site.area[2:]) / 2
    cameras = [
        s for _ in range(40) for s in random_sensors(site, rng) if isinstance(s.model, DepthCamera)
    ]
    towards = np.array([middle - s.position[:2] for s in cameras])
    ahead = np.array([s.pose[:2, 2] for s in cameras])
    cosine = (
        (towards * ahead).sum(1) / np.linalg.norm(towards, axis=1) / np.linalg.norm(ahead, axis=1)
    )
    assert np.mean(cosine > np.cos(np.pi / 4)) > 0.6


def test_so_many_sensors_are_drawn_as_asked():
    site = random_site(0)
    assert len(random_sensors(site, 5, 7)) == 7
    assert len(random_sensors(site, 5, len(site.mounts) + 3)) == len(site.mounts) + 3
    with pytest.raises(ValueError, match="count must be at least 1, got 0"):
        random_sensors(site, 5, 0)
    with pytest.raises(ValueError, match="no mounts"):
        random_sensors(Site("bare", np.array([0.0, 0, 1, 1])), 5)


def drawn(count):
    return [random_site(seed) for seed in range(count)]


@pytest.mark.slow
def test_streets_hold_what_detectors_must_tell_from_vehicles():
    """Over a dozen sites: crowns over the road, bays in it, works, and many things as big as
    cars."""
    sites = drawn(12)
    over_road, bays_in_road = [], []
    for site in sites:
        road = union(site.lanes)
        crowns = [shapely.Polygon(solid.footprint) for solid in site.solids if solid.kind == "tree"]
        over_road.append(sum(road.intersects(crown) for crown in crowns))
        bays_in_road.append(sum(road.contains(shapely.Point(bay[:2])) for bay in site.parking))
    assert 5 <= sum(number > 10 for number in over_road) <= 11
    assert sum(number > 5 for number in bays_in_road) >= 5
    kinds = [{solid.kind for solid in site.solids} for site in sites]
    assert sum("cone" in there or "barrier" in there for there in kinds) >= 5
    bulky = {
        "container",
        "hedge",
        "bush",
        "cabinet",
        "planter",
        "heap",
        "machine",
        "shelter",
        "bin",
    }
    assert np.mean([sum(s.kind in bulky for s in site.solids) for site in sites]) > 20


@pytest.mark.slow
def test_sensors_hang_at_heights_and_tilts_of_streets():
    rows = []
    for site in drawn(6):
        rng = np.random.default_rng(0)
        for sensor in (
            s
            for _ in range(20)
            for s in random_sensors(site, rng)
            if isinstance(s.model, DepthCamera)
        ):
            height = sensor.position[2] - site.ground(sensor.position[None, :2])[0]
            rows.append((height, np.rad2deg(-np.arcsin(sensor.pose[2, 2]))))
    table = np.array(rows)
    heights, tilts = table[:, 0], table[:, 1]
    assert MIN_MOUNT_HEIGHT_M - 0.01 < heights.min() < 1.8
    assert 8.5 < heights.max() < MAX_MOUNT_HEIGHT_M + 0.01
    assert 0.1 < np.mean(heights < 2.8) < 0.5
    assert tilts.min() > -1e-6
    assert tilts.max() < 35.1
    assert np.median(tilts[heights < 2.2]) < 7
    assert np.median(tilts[heights > 6]) > 12


@pytest.mark.slow
def test_slopes_are_drawn_for_some_streets():
    steep = [np.hypot(*sloping(Relief(0.1, seed)).slope) for seed in range(400)]
    assert 0.33 < np.mean(np.array(steep) > 0) < 0.47
    assert max(steep) <= MAX_STREET_SLOPE + 1e-3
    assert min(s for s in steep if s) >= 0.01 - 1e-3


@pytest.mark.slow
def test_mounts_stand_on_the_sloping_ground():
    sites = drawn(4)
    assert max(np.hypot(*site.relief.slope) for site in sites) > 0.01
    for site in sites:
        feet = np.array([mount.position for mount in site.mounts])
        np.testing.assert_allclose(feet[:, 2], site.ground(feet[:, :2]), atol=6e-4)
