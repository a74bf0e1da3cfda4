"""OpenStreetMap extracts written by hand, what every imported site promises, and a small site with
all that sites have.

The fixtures are functions, called as often as a test likes.
"""

import json
import warnings
from pathlib import Path

import numpy as np
import pytest
import shapely

from toolkit.geometry import look, pose
from toolkit.sensors.models import DepthCamera, SpinningLidar
from toolkit.sensors.sensor import Sensor
from toolkit.sites.files import load_site, save_site
from toolkit.sites.georeference import inverse_project
from toolkit.sites.maps.osm_site import import_osm
from toolkit.sites.maps.piece import MapPiece
from toolkit.sites.site import Mount, Relief, Site, Solid

CENTRE = (13.4, 52.505)
SQUARE = np.array([[0.0, 0], [4, 0], [4, 4], [0, 4]])
NET = '<net version="1.20">\n    <edge id="a"/>\n</net>\n'


class Draft:
    """An OSM file in the making, its nodes given in metres around CENTRE."""

    def __init__(self) -> None:
        self.text: list[str] = []
        self.nodes: dict[tuple[float, float], int] = {}
        self.count = 1000

    def node(self, xy, **tags) -> int:
        if xy not in self.nodes:
            self.count += 1
            self.nodes[xy] = self.count
            ((longitude, latitude),) = inverse_project(np.array([xy], float), CENTRE)
            self.text.append(
                f'<node id="{self.count}" lat="{latitude:.7f}" '
                f'lon="{longitude:.7f}">{_tags(tags)}</node>'
            )
        return self.nodes[xy]

    def way(self, *corners, missing=(), **tags) -> int:
        references = [*missing, *(self.node(xy) for xy in corners)]
        self.count += 1
        inside = "".join(f'<nd ref="{i}"/>' for i in references)
        self.text.append(f'<way id="{self.count}" version="3">{inside}{_tags(tags)}</way>')
        return self.count

    def relation(self, members, **tags) -> None:
        inside = "".join(f'<member type="way" ref="{i}" role="{role}"/>' for i, role in members)
        self.count += 1
        self.text.append(f'<relation id="{self.count}">{inside}{_tags(tags)}</relation>')

    def __str__(self) -> str:
        return (
            '<?xml version="1.0" encoding="UTF-8"?>\n<osm version="0.6">\n'
            + "\n".join(self.text)
            + "\n</osm>\n"
        )


def _tags(tags) -> str:
    written = {key.replace("__", ":").rstrip("_"): value for key, value in tags.items()}
    return "".join(f'<tag k="{key}" v="{value}"/>' for key, value in written.items())


def _crossroads() -> Draft:
    """A main road and a side street that cross at (0, 0), 300 m long each."""
    draft = Draft()
    draft.node((0, 0), highway="traffic_signals")
    draft.way(
        (-300, 0),
        (0, 0),
        (300, 0),
        highway="secondary",
        lanes="2",
        maxspeed="50",
        name="Hauptstraße &amp; Co",
    )
    draft.way((0, -300), (0, 0), (10, 300), highway="residential")
    return draft


def _box(xmin, ymin, xmax, ymax):
    return (xmin, ymin), (xmax, ymin), (xmax, ymax), (xmin, ymax), (xmin, ymin)


def _put(draft, tmp_path, name="town.osm") -> Path:
    path = tmp_path / name
    path.write_text(str(draft), encoding="utf-8")
    return path


def _imported(draft, tmp_path, lefthand=False, **more) -> Site:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        site = import_osm(
            MapPiece(_put(draft, tmp_path), CENTRE, (80, 60), **more), lefthand=lefthand
        )
    _check(site, tmp_path)
    return site


def _union(polygons):
    return shapely.union_all([shapely.Polygon(p) for p in polygons])


def _on_lanes(site, x, y) -> bool:
    spot = shapely.Point(x, y)
    return bool(
        _union(p for p in site.lanes if shapely.Polygon(p).distance(spot) < 1)
        .buffer(0.01)
        .contains(spot)
    )


def _check(site: Site, tmp_path) -> None:
    """What every imported site promises: clear lanes, usable mounts of one price, no sensor that
    nobody asked for, a round trip, traffic that moves."""
    lanes = _union(site.lanes)
    for solid in site.solids:
        assert shapely.Polygon(solid.footprint).intersection(lanes).area < 1e-3, solid
    assert _union(site.footways).intersection(lanes).area < 0.1
    assert len(site.mounts) >= 6
    assert site.sensors == ()
    for mount in site.mounts:
        assert mount.price == 1.0
        spot, z = shapely.Point(mount.position[:2]), mount.position[2] + 6.0
        inside = [
            s
            for s in site.solids
            if shapely.Polygon(s.footprint).contains(spot) and s.base < z < s.top
        ]
        assert not inside, mount.name
    save_site(site, tmp_path / "saved.json")
    assert load_site(tmp_path / "saved.json") == site
    assert _drives(site, tmp_path) > 1.0


def _drives(site: Site, tmp_path) -> float:
    """How far (m) a car gets in 5 s that SUMO lets onto an edge in the area."""
    import libsumo

    (tmp_path / "net.xml").write_text(site.network)
    libsumo.start(
        [
            "sumo",
            "-n",
            str(tmp_path / "net.xml"),
            "--no-warnings",
            "--no-step-log",
            "--duration-log.disable",
        ]
    )
    try:
        lanes = [lane for lane in libsumo.lane.getIDList() if lane[0] != ":"]
        allowed = [lane for lane in lanes if "passenger" not in libsumo.lane.getDisallowed(lane)]
        edge = libsumo.lane.getEdgeID(max(allowed, key=libsumo.lane.getLength))
        libsumo.route.add("drive", [edge])
        libsumo.vehicle.add("car", "drive")
        for _ in range(5):
            libsumo.simulationStep()
        return libsumo.vehicle.getDistance("car")
    finally:
        libsumo.close()


def _of_kind(site, kind):
    return [solid for solid in site.solids if solid.kind == kind]


def _top(site, x, y) -> list[float]:
    spot = shapely.Point(x, y)
    return sorted(
        round(s.top, 3)
        for s in _of_kind(site, "building")
        if shapely.Polygon(s.footprint).contains(spot)
    )


def _small_site() -> Site:
    return Site(
        name="small",
        area=np.array([-10.0, -5, 10, 5]),
        height=3.5,
        lanes=(SQUARE, SQUARE + 0.1),
        footways=(SQUARE + 5,),
        solids=(
            Solid(SQUARE - 9, -0.3, 6.25, "building"),
            Solid(SQUARE + 1, -1.0, -0.5, "pond", "surveyed"),
        ),
        mounts=(
            Mount("a", np.array([1.0, 2, 0.01])),
            Mount("b", np.array([1.0, 3, 0]), 2.0, 9.0, 0.5, 800.0, 1, "drawn"),
        ),
        sensors=(
            Sensor("d0", DepthCamera(), look((1.0, 2.0, 5.2), 0.3, 0.1)),
            Sensor(
                "d1", DepthCamera(centre=(190.5, 151.0)), look((1.0, 2.0, 5.2), np.pi, np.pi / 2)
            ),
            Sensor(
                "l0",
                SpinningLidar(channels=32),
                pose(1.0, 2.0, 3.0, yaw=-3.0, pitch=0.2, roll=-0.4),
            ),
        ),
        parking=np.array([[1.0, 2, 0.5]]),
        parking_origins=("drawn",),
        furnished="light",
        network=NET,
        map_SE3_site=pose(104.0, -196.0, yaw=np.pi / 2),
        geo_reference="+proj=utm +zone=30",
        relief=Relief(0.06, 7),
        hybrid_radius=15.5,
    )


def _saved(tmp_path, change=None) -> tuple:
    path = tmp_path / "site.json"
    save_site(_small_site(), path)
    document = json.loads(path.read_text())
    if change:
        change(document)
        path.write_text(json.dumps(document))
    return path, document


empty_map = pytest.fixture(lambda: Draft)
crossroads = pytest.fixture(lambda: _crossroads)
box = pytest.fixture(lambda: _box)
put = pytest.fixture(lambda: _put)
imported = pytest.fixture(lambda: _imported)
union = pytest.fixture(lambda: _union)
on_lanes = pytest.fixture(lambda: _on_lanes)
check_site = pytest.fixture(lambda: _check)
of_kind = pytest.fixture(lambda: _of_kind)
top = pytest.fixture(lambda: _top)
small_site = pytest.fixture(lambda: _small_site)
saved = pytest.fixture(lambda: _saved)
