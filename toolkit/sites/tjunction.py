"""The paper's T-junction: CARLA Town01, junction 255, in the axes of the published overview picture.

Site frame: a (x) to the right along the through road, b (y) up, zero in the middle of the detection area:
a = 196 - y_carla, b = 104 - x_carla. Roads, buildings and sensor posts are at the published places; heights of
buildings, the furniture and the bays of parked cars are made up.

The tilt is not published. The paper's early fusion sends 516 kbit per sensor and frame; here it is about 500, 520,
540 and 580 at 0, 3, 5 and 10 degrees (60 frames of traffic, noise on, cropped to 0 < z < 4), so the tilt is 3. It
hardly matters for what is seen: 75 % of the vehicles have no point from sensor 4, 40 % none from 3 and 4, none is
missed by 0, 2 and 5, at each of these tilts (paper: more than 60 %, more than 30 %, 0). The relief's seed was picked,
among 250, for a mean over the area close to zero and for these figures: as on the paper's level ground with noise,
the crop takes about half of the ground's points, and how many exactly depends on what is high near the sensors.
"""

from __future__ import annotations

import numpy as np

from toolkit.geometry import look
from toolkit.sensors.depth_camera import DepthCamera
from toolkit.sensors.sensor import Sensor
from toolkit.sites import furniture as f
from toolkit.sites.network import build_network, road_polygons, street
from toolkit.sites.site import Mount, Relief, Site, Solid

_AREA = (-40.0, -20.0, 40.0, 20.0)
_RELIEF = Relief(amplitude=0.08, seed=196)
# right-handed CARLA map (x, -y_carla): x = 104 - b, y = a - 196
MAP_SE3_SITE = np.array([[0.0, -1, 0, 104], [1, 0, 0, -196], [0, 0, 1, 0], [0, 0, 0, 1]])

THROUGH_B, SIDE_A = 13.6, -0.8
_LANE, _SHOULDER, _FOOTWAY = 4.0, 0.3, 4.0

_HEIGHT = 5.2
_TILT_DEG = 3.0
_POSTS = (  # a, b, heading in degrees counter-clockwise from +a; the place in the tuple is the paper's sensor id
    (40.9, 8.1, 155.0),
    (-7.7, 21.9, 295.0),
    (-45.6, 10.1, 15.0),
    (8.0, 5.6, 52.0),
    (-8.3, 18.5, 208.0),
    (-5.5, -27.5, 64.0),
)
FEET = tuple((a, 9.15 if i == 2 else b) for i, (a, b, _) in enumerate(_POSTS))
_PARKING = np.array(  # x, y, yaw: two in the area only, for the paper has none; the others behind the through road
    [(10.4, -8.0, np.pi / 2), (-11.2, -13.5, -np.pi / 2)] + [(a, 25.8, np.pi / 2) for a in (-23.5, -4.0, 10.5, 37.0)]
)


def build() -> Site:
    """The site, its network made by netconvert."""
    net = _network()
    lanes, footways = road_polygons(net, _AREA)
    beside = f.clear_of_road([*_buildings(), *_street_furniture()], lanes, footways, gap=0.15)
    solids = f.settle([*beside, *sensor_posts(), *f.kerbs(lanes, footways)], _RELIEF)
    return Site(
        name="tjunction",
        area=np.array(_AREA),
        lanes=lanes,
        footways=footways,
        solids=solids,
        mounts=_mounts(lanes, footways, solids),
        sensors=_sensors(),
        parking=_PARKING,
        network=net,
        map_SE3_site=MAP_SE3_SITE,
        relief=_RELIEF,
        hybrid_radius=20.0,  # m, paper section IV-B
    )


def _network() -> str:
    """The through and the side road, both two-way and 80 m and more beyond the area; traffic lights, as in CARLA."""
    nodes = [
        {"id": "left", "x": -125, "y": THROUGH_B},
        {"id": "right", "x": 125, "y": THROUGH_B},
        {"id": "side", "x": SIDE_A, "y": -105},
        {"id": "junction", "x": SIDE_A, "y": THROUGH_B, "type": "traffic_light", "radius": 5.5},
    ]
    lanes = street(1, width=_LANE, shoulder=_SHOULDER, footway=_FOOTWAY, speed=11.1)
    ends = [(arm, "junction") for arm in ("left", "right", "side")]
    edges = [
        {
            "id": f"{start}_{end}",
            "from": start,
            "to": end,
            "priority": 1 if "side" in (start, end) else 3,
            "lanes": lanes,
        }
        for start, end in ends + [(end, start) for start, end in ends]
    ]
    return build_network(nodes, edges)


def _sensors() -> tuple[Sensor, ...]:
    """The paper's six depth cameras, named d0..d5 by its ids."""
    tilt = np.deg2rad(_TILT_DEG)
    return tuple(
        Sensor(f"d{i}", DepthCamera(), look((a, b, _HEIGHT), np.deg2rad(heading), tilt))
        for i, (a, b, heading) in enumerate(_POSTS)
    )


def _buildings() -> list[Solid]:
    """Houses and the pond of the published picture, and houses beyond the through road. Two of them reach over the
    footway in the picture (eaves): `build` cuts them off behind it."""
    return [
        f.building(-38.6, -4.5, -27.7, 5.9, 4.2),  # hut
        f.building(-26.5, -6.2, -14.7, 6.2, 4.8),  # pavilion
        f.building(-26.5, -17.4, -14.7, -6.2, 7.5),
        f.building(-49.0, -29.0, -28.0, -4.8, 11.0),
        f.building(-28.8, -29.0, -19.0, -19.4, 8.0),
        f.building(-44.0, 27.0, -26.0, 38.0, 7.0),
        f.building(-20.0, 28.0, -6.0, 40.0, 9.0),
        f.building(14.0, 27.5, 34.0, 39.0, 6.5),
        Solid(f.rectangle(13.0, -29.0, 35.0, 4.0), -1.5, -0.5, "pond"),
    ]


def sensor_posts() -> list[Solid]:
    """A post under each sensor. Post 2 stands on the footway: its camera hangs from an arm over the road's edge."""
    arm = Solid(f.bar((-45.6, 9.15), (-45.6, 10.1), 0.08), _HEIGHT + 0.1, _HEIGHT + 0.2, "post")
    return [*(f.post(*foot, _HEIGHT + 0.2 if foot == FEET[2] else _HEIGHT - 0.2) for foot in FEET), arm]


def _street_furniture() -> list[Solid]:
    """Lamps, trees, hedges, walls, signs and bins, all behind the footways."""
    lamps = [(a, 22.2) for a in (-36.0, -20.0, 6.0, 22.0, 38.0)] + [(a, 5.0) for a in (-42.0, 14.0, 28.0, 44.0)]
    lamps += [(-9.4, -16.0), (7.8, -22.0), (7.8, -8.0), (-9.4, -34.0), (-12.9, 2.8)]
    trees = [(-31.0, 23.6), (-15.0, 24.0), (1.5, 24.0), (12.0, 23.7), (29.0, 23.8), (42.0, 24.0)]
    trees += [(17.5, 4.6), (25.0, 4.6), (33.0, 4.6), (37.5, 3.5), (37.5, -6.0)]
    trees += [(-12.9, -2.6), (-12.2, -20.3), (11.8, -28.5)]
    return [
        *(f.post(a, b, 6.5, 0.09) for a, b in lamps),
        *(
            s
            for i, place in enumerate(trees)
            for s in f.tree(*place, height=6.0 + i % 4 * 0.7, crown=1.3 + i % 3 * 0.2)
        ),
        *f.hedge([(-48.0, 22.7), (-21.0, 22.7)], 1.5),
        *f.wall([(-18.5, 22.6), (-2.5, 22.6)], 1.9),
        *f.railing([(0.5, 22.6), (18.0, 22.6)]),
        *f.hedge([(31.0, 22.7), (48.0, 22.7)], 1.2),
        *f.shelter(19.5, 22.1, 24.0, 23.6),
        *f.railing([(35.3, -29.0), (35.3, 4.4), (12.7, 4.4), (12.7, -29.0)]),
        *f.hedge([(36.5, 4.8), (48.0, 4.8)], 1.0),
        *f.hedge([(-14.2, -17.0), (-14.2, -7.0)], 1.3),
        *f.bollards((-9.9, -0.1), (-14.2, 4.3), 4),
        *f.bollards((8.5, -0.1), (12.8, 4.3), 4),
        *f.sign(-9.7, -1.2, -np.pi / 2.0),
        *f.sign(-16.0, 22.3, np.pi),
        *f.sign(16.0, 4.9, 0.0),
        *(f.litter_bin(a, b) for a, b in ((-9.6, -10.2), (8.2, -14.3), (25.0, 22.4), (-23.0, 22.3), (38.5, 4.9))),
        f.bench(-13.3, -13.0, along_x=False),
        f.bench(9.0, 22.3),
        f.bench(30.0, 4.8),
    ]


def _mounts(lanes: f.Outlines, footways: f.Outlines, solids: tuple[Solid, ...]) -> tuple[Mount, ...]:
    """Where sensors may hang: the present posts, poles behind the footways every 5 m, and corners of buildings."""
    corners = [(-27.6, 5.2), (-14.6, 5.2), (-14.6, -6.2), (-14.6, -17.5), (-18.9, -19.3), (-38.7, 5.2)]
    places = f.kerbside(lanes, footways, behind=0.1, spacing=5.0)
    return (
        *f.poles(FEET, _RELIEF, "post"),
        *f.poles(f.free_places(places, solids, _AREA, 6.0), _RELIEF, "pole"),
        *f.poles(corners, _RELIEF, "corner", top=4.0, price=0.6, capacity=1000.0),
    )
