"""Random junctions: 3 to 5 legs or a roundabout, with surroundings, mounts and sensors.

Each has a seed."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from toolkit.arrays import Float64, Rng
from toolkit.geometry import look, pose
from toolkit.sensors.models import DepthCamera, SpinningLidar
from toolkit.sensors.sensor import Sensor
from toolkit.sites.furniture import on_ground, raise_onto_ground
from toolkit.sites.network import (
    XmlAttributes,
    build_network,
    line,
    road_polygons,
    shoulders,
    street,
)
from toolkit.sites.site import Mount, Relief, Site
from toolkit.sites.surroundings.furnish import furnish
from toolkit.sites.surroundings.mount_places import place_mounts
from toolkit.sites.surroundings.parking_bays import BAY_DEPTHS_M
from toolkit.sites.surroundings.plot import Road
from toolkit.sites.surroundings.road_works import CLOSED_LANE_M
from toolkit.sites.surroundings.things import draw_everything

LEG_LENGTH_M = 140.0  # from the middle of the junction
MIN_MOUNT_HEIGHT_M = 1.6  # for sensors, above the foot of their mount
MAX_MOUNT_HEIGHT_M = 9.0  # for sensors, above the foot of their mount
_LOW_MOUNT_SHARE = 0.35  # share of mounts that allow a sensor at eye level
SLOPING_SHARE = 0.4  # share of sites on a slope
MAX_STREET_SLOPE = 0.06  # m per m
_MAX_TILT_RAD = np.deg2rad(35.0)


@dataclass(frozen=True)
class Shoulder:
    """Strip without traffic between lanes and footway."""

    width: float = 0.0  # m, 0 for none
    # angle between its parking bays and the kerb (degrees, a key of `BAY_DEPTHS_M`: 0 for bays
    # along the kerb); None: no bays, but road works if the shoulder has a width
    angle: int | None = None


@dataclass(frozen=True)
class Leg:
    """Road that meets the junction.

    Attributes:
        path: points x, y (m, site frame) of the line between the two directions, from the
            junction outwards.
        inbound: number of lanes towards the junction, 0 if the leg is one-way outwards.
        outbound: number of lanes away from the junction, 0 if the leg is one-way inwards.
        lane: width of a lane (m).
        footway: width of the footways (m).
        shoulders: shoulders of the inbound and of the outbound side, in this order.
        speed: speed limit (m/s)."""

    path: Float64[np.ndarray, "k 2"]
    inbound: int
    outbound: int
    lane: float
    footway: float
    shoulders: tuple[Shoulder, Shoulder]
    speed: float

    @property
    def half_widths(self) -> tuple[float, float]:
        """Distances (m) from the path to the outer edges of the footways: left, right.

        Seen outwards along the path, left is the inbound side and right the outbound side, as
        traffic keeps right. A side without lanes has width 0."""
        inbound_shoulder, outbound_shoulder = self.shoulders
        left = self._measure_side(self.inbound, inbound_shoulder)
        right = self._measure_side(self.outbound, outbound_shoulder)
        return left, right

    def _measure_side(self, lanes: int, shoulder: Shoulder) -> float:
        """Width (m) of one direction with its footway and shoulder, 0 without lanes.

        lanes: number of lanes of the direction."""
        return lanes * self.lane + self.footway + shoulder.width if lanes else 0.0


def random_site(rng: Rng | int) -> Site:
    """Draw a junction from a generator or a seed; the same seed gives the same site.

    rng: a generator, which the draws advance, or a whole number from 0 up as seed.

    The junction is near the origin; the detection area, 60 to 110 m by 40 to 110 m, need not be
    centred on it. There are at least 12 mounts with 1 to 10 default sensors. By chance there are
    avenues with crowns over the road, vehicles parked along kerbs, road works, and hedges,
    containers and the like next to the lanes and on islands.

    Raises ValueError for a negative seed."""
    if not isinstance(rng, np.random.Generator) and rng < 0:
        raise ValueError(f"seed of a random site must be a whole number from 0 up, got {rng}")
    rng = np.random.default_rng(rng)  # a generator remains the same object
    # a changed order of the draws below changes all random sites
    name = f"random-{rng.integers(16**6):06x}"
    size = np.array([rng.uniform(60.0, 110.0), rng.uniform(40.0, 110.0)])
    middle = rng.uniform(-size / 8, size / 8)
    area = np.round(np.concatenate([middle - size / 2, middle + size / 2]), 1)
    legs, network = (_draw_roundabout if rng.random() < 0.25 else _draw_crossroads)(rng)
    lanes, footways = road_polygons(network, area)
    # angles of parking bays (degrees), by edge: in0, out0, ... as `_leg_edges` names them
    angles = {}
    for i, leg in enumerate(legs):
        for way, shoulder in zip(("in", "out"), leg.shoulders, strict=True):
            if shoulder.angle is not None:
                angles[f"{way}{i}"] = shoulder.angle
    road = Road(
        paths=[leg.path for leg in legs],
        half_widths=[leg.half_widths for leg in legs],
        lanes=lanes,
        footways=footways,
        strips=shoulders(network),
        angles=angles,
    )
    amplitude = round(float(rng.uniform(0.0, 0.12)), 3)
    relief = sloping(Relief(amplitude=amplitude, seed=int(rng.integers(2**31))))
    mounts = place_mounts(road, area, rng)
    is_low = rng.random(len(mounts)) < _LOW_MOUNT_SHARE
    mounts = tuple(
        replace(mount, min_height=MIN_MOUNT_HEIGHT_M) if low else mount
        for mount, low in zip(mounts, is_low, strict=True)
    )
    solids, bays = furnish(road, area, mounts, rng)
    site = Site(
        name, area, lanes=lanes, footways=footways, parking=bays, network=network, relief=relief
    )
    site = draw_everything(
        replace(site, solids=raise_onto_ground(solids, relief), mounts=on_ground(mounts, site))
    )
    return replace(site, sensors=random_sensors(site, rng))


def sloping(relief: Relief) -> Relief:
    """Return a relief with a slope drawn from its seed, or unchanged.

    A share `SLOPING_SHARE` of all seeds gets a slope of 0.01 to `MAX_STREET_SLOPE` m per m in any
    direction; the others get the same relief back."""
    # 6: other numbers than the seed gives to the unevenness
    rng = np.random.default_rng([relief.seed, 6])
    if rng.random() > SLOPING_SHARE:
        return relief
    rise = rng.uniform(0.01, MAX_STREET_SLOPE)
    uphill = rng.uniform(0, 2 * np.pi)  # direction, rad from the site's +x
    rise_x = round(float(rise * np.cos(uphill)), 4)
    rise_y = round(float(rise * np.sin(uphill)), 4)
    return replace(relief, slope=(rise_x, rise_y))


def random_sensors(site: Site, rng: Rng | int, count: int | None = None) -> tuple[Sensor, ...]:
    """Draw depth cameras and lidars on a site's mounts; return the sensors in order of name.

    They are `MIN_MOUNT_HEIGHT_M` to `MAX_MOUNT_HEIGHT_M` above the foot of their mount as far as
    it allows, with more tilt if they are higher, and most are headed for the middle of the area.
    All mounts get a sensor before one gets a second. Cameras come first: d0, d1, ... then lidars,
    whose numbers go on: l2, l3, ...; numbers are padded with zeros to one length.

    rng: a generator, which the draws advance, or a seed; count: number of sensors, drawn from 1 to
    10 if None. Sensors that the site has already are neither heeded nor returned.

    Raises ValueError for a site without mounts and for a count below 1."""
    rng = np.random.default_rng(rng)
    count = int(rng.integers(1, 11)) if count is None else count
    if count < 1:
        raise ValueError(f"count must be at least 1, got {count}")
    if not site.mounts:
        raise ValueError(f"site {site.name!r} has no mounts to hang sensors on: give it some")
    # a round gives each mount one sensor; -(-a // b) is a / b, rounded up
    rounds = -(-count // len(site.mounts))
    orders = [rng.permutation(len(site.mounts)) for _ in range(rounds)]
    mounts = [site.mounts[i] for i in np.concatenate(orders)[:count]]
    lidar_count = int(rng.binomial(count, 0.35))
    digits = len(str(count - 1))
    sensors = []
    for i, mount in enumerate(mounts):
        is_lidar = i >= count - lidar_count  # cameras come first
        name = f"{'l' if is_lidar else 'd'}{i:0{digits}}"
        sensors.append(_draw_sensor(name, mount, site, rng, is_lidar=is_lidar))
    return tuple(sensors)


def _draw_sensor(name: str, mount: Mount, site: Site, rng: Rng, *, is_lidar: bool) -> Sensor:
    """Sensor of random model, height and aim on a mount.

    name: the sensor's; is_lidar: a lidar, not a camera. The order of the draws must not change, or
    all random sites do."""
    x, y, z = mount.position.tolist()
    # heights above the foot of the mount (m); most sensors at eye level remain below low + 1.5
    low = min(max(MIN_MOUNT_HEIGHT_M, mount.min_height), mount.max_height)
    top = max(low, min(MAX_MOUNT_HEIGHT_M, mount.max_height))
    height = rng.uniform(low, low + 1.5 if low < 2.0 and rng.random() < 0.6 else top)
    z += min(height, top)
    low_corner = site.area[:2]  # x, y
    high_corner = site.area[2:]
    # a point near the middle of the area
    aim_x, aim_y = rng.normal((low_corner + high_corner) / 2, (high_corner - low_corner) / 6)
    heading_to_aim = np.arctan2(aim_y - y, aim_x - x) + rng.normal(0.0, np.deg2rad(15.0))
    heading = heading_to_aim if rng.random() < 0.8 else rng.uniform(-np.pi, np.pi)
    # down to level ground 10 to 45 m away, about 2 degrees off (rad, positive below the horizon)
    tilt = np.arctan2(height, rng.uniform(10.0, 45.0)) + rng.normal(0.0, np.deg2rad(2.0))
    tilt = float(np.clip(tilt, 0.0, _MAX_TILT_RAD))
    if not is_lidar:
        width = int(rng.choice([320, 360, 400, 440, 480]))
        camera = DepthCamera(
            width=width, height=width * 3 // 4, fov=float(np.deg2rad(rng.uniform(60.0, 100.0)))
        )
        return Sensor(name, camera, look((x, y, z), heading, tilt))
    lidar = SpinningLidar(
        channels=int(rng.choice([16, 32, 64, 128])),
        fov_up=float(np.deg2rad(rng.uniform(0.0, 15.0))),
        fov_down=float(np.deg2rad(rng.uniform(-50.0, -15.0))),
        azimuth_step=float(np.deg2rad(rng.choice([0.2, 0.4, 0.8]))),
        azimuth_fov=2 * np.pi if rng.random() < 0.7 else float(np.deg2rad(120.0)),
        sigma=float(rng.uniform(0.005, 0.03)),
    )
    # lidars are tilted less than cameras, as their field of view reaches far down
    return Sensor(name, lidar, pose(x, y, z, yaw=heading, pitch=tilt / 3))


def _draw_crossroads(rng: Rng) -> tuple[tuple[Leg, ...], str]:
    """Draw three to five legs that meet in one junction; return them and their network.

    The network is a SUMO net.xml text, with the junction at node c in the origin."""
    count = int(rng.choice([3, 4, 5], p=[0.4, 0.42, 0.18]))
    directions = _draw_directions(rng, count)
    legs = _draw_legs(rng, directions, start=0.0, max_lanes=3 if count < 5 else 2)
    rule = str(rng.choice(["priority", "traffic_light", "right_before_left"], p=[0.45, 0.35, 0.2]))
    radius = round(float(rng.uniform(3.0, 8.0)), 1)  # radius of the kerbs at corners (m)
    middle = {"id": "c", "x": 0, "y": 0, "type": rule, "radius": radius}
    major = rng.permutation(count)[:2]  # indices of the two legs that have the right of way
    edges: list[XmlAttributes] = []
    for i, leg in enumerate(legs):
        edges += _leg_edges(leg, number=i, junction="c", priority=3 if i in major else 1)
    return legs, build_network([middle, *_outer_nodes(legs)], edges)


def _draw_roundabout(rng: Rng) -> tuple[tuple[Leg, ...], str]:
    """Draw three to five legs that meet a ring; return them and their network.

    The network is a SUMO net.xml text. The ring is driven counter-clockwise; leg i starts on it at
    node r{i}."""
    count = int(rng.choice([3, 4, 5], p=[0.3, 0.5, 0.2]))
    lane_count = 2 if rng.random() < 0.25 else 1  # lanes of the ring
    # radius of the middle of the ring's lanes (m)
    radius = rng.uniform(11.0, 17.0) + 2.0 * (count - 3) + 7.0 * (lane_count - 1)
    directions = _draw_directions(rng, count)
    legs = _draw_legs(rng, directions, start=radius, max_lanes=lane_count)
    footway = round(rng.uniform(1.5, 3.0), 2)
    ring_lanes = street(lane_count, width=4.5, footway=footway, speed=7.0)
    nodes: list[XmlAttributes] = []
    edges: list[XmlAttributes] = []
    for i, leg in enumerate(legs):
        x, y = leg.path[0]
        nodes.append({"id": f"r{i}", "x": x, "y": y, "type": "priority"})
        edges += _leg_edges(leg, number=i, junction=f"r{i}", priority=1)
    for i in range(count):
        shape = _arc(radius, start=directions[i], end=directions[(i + 1) % count])
        edges.append(
            {
                "id": f"ring{i}",
                "from": f"r{i}",
                "to": f"r{(i + 1) % count}",
                "shape": line(shape),
                "spreadType": "center",
                "priority": 3,
                "lanes": ring_lanes,
            }
        )
    ring = {
        "nodes": " ".join(f"r{i}" for i in range(count)),
        "edges": " ".join(f"ring{i}" for i in range(count)),
    }
    return legs, build_network(nodes + _outer_nodes(legs), edges, roundabouts=[ring])


def _arc(radius: float, start: float, end: float) -> Float64[np.ndarray, "n 2"]:
    """Points x, y (m) of an arc about the origin, counter-clockwise from start to end.

    radius: m; start, end: directions from the origin (rad from +x)."""
    # the remainder is positive, so the arc runs counter-clockwise past 2 pi too
    angles = np.linspace(start, start + (end - start) % (2 * np.pi), 16)
    return radius * np.stack([np.cos(angles), np.sin(angles)], axis=1)


def _draw_directions(rng: Rng, count: int) -> Float64[np.ndarray, " n"]:
    """Draw directions of 3 to 5 legs, 45° apart or more.

    count: number of legs. Returns rad, counter-clockwise from +x in ascending order, not wrapped to
    a full turn."""
    even_directions = np.arange(count) * 360.0 / count  # degrees
    if count == 3 and rng.random() < 0.6:
        even_directions = np.array([0.0, 90.0, 180.0])  # a T-junction
    # degrees by which a leg may be off its even direction: neighbours stay 45 degrees apart
    max_skew = {3: 22.0, 4: 22.0, 5: 13.0}[count]
    skews = rng.uniform(-max_skew, max_skew, count)
    return np.deg2rad(even_directions + skews + rng.uniform(0.0, 360.0))


def _draw_legs(
    rng: Rng, directions: np.ndarray, *, start: float, max_lanes: int
) -> tuple[Leg, ...]:
    """Draw a gently bent leg along each direction, `LEG_LENGTH_M` out from the junction's middle.

    directions: rad from +x; start: distance (m) from the middle at which legs begin; max_lanes:
    largest number of lanes of one direction. In a fifth of all draws one leg is one-way."""
    lane_width = round(float(rng.uniform(3.0, 3.75)), 2)
    mean_footway = rng.uniform(1.5, 4.0)
    # index of the leg that is one-way, -1 for none
    one_way = int(rng.integers(len(directions))) if rng.random() < 0.2 else -1
    usual_lanes = int(rng.choice([1, 2, 3], p=[0.6, 0.3, 0.1]))
    legs = []
    for i, direction in enumerate(directions):
        # lanes inbound and outbound: usually as on other legs, else one more or one less
        changes = rng.integers(-1, 2, 2) * (rng.random(2) < 0.3)
        lanes = np.clip(usual_lanes + changes, 1, max_lanes)
        if i == one_way:
            lanes[rng.integers(2)] = 0
        path = _draw_path(rng, direction, start=start)
        leg_shoulders = _draw_shoulder(rng), _draw_shoulder(rng)
        footway = float(np.clip(mean_footway + rng.uniform(-0.5, 0.5), 1.5, 4.0))
        speed = round(float(rng.choice([8.3, 11.1, 13.9])), 1)
        inbound, outbound = lanes.tolist()
        legs.append(
            Leg(
                path=path,
                inbound=inbound,
                outbound=outbound,
                lane=lane_width,
                footway=round(footway, 2),
                shoulders=leg_shoulders,
                speed=speed,
            )
        )
    return tuple(legs)


def _draw_path(rng: Rng, direction: float, *, start: float) -> Float64[np.ndarray, "n 2"]:
    """Draw points x, y (m) of a gently bent line away from the origin, up to `LEG_LENGTH_M`.

    direction: rad from +x at the origin; start: m from the origin to the first point."""
    distances = np.linspace(start, LEG_LENGTH_M, 15)
    # m to the left of the straight line: 0 at the start and more and more outwards
    bends = rng.uniform(-14.0, 14.0) * ((distances - start) / LEG_LENGTH_M) ** 2
    ahead = np.array([np.cos(direction), np.sin(direction)])
    left = np.array([-ahead[1], ahead[0]])
    path = distances[:, None] * ahead + bends[:, None] * left
    return path.round(3)


def _outer_nodes(legs: Sequence[Leg]) -> list[XmlAttributes]:
    """Attributes of SUMO's nodes e0, e1, ... at the outer ends of the legs."""
    outer_points = [leg.path[-1] for leg in legs]
    return [{"id": f"e{i}", "x": x, "y": y} for i, (x, y) in enumerate(outer_points)]


def _leg_edges(leg: Leg, number: int, junction: str, priority: int) -> list[XmlAttributes]:
    """SUMO edges of a leg: in{number} towards the junction, out{number} away from it, or both.

    A direction without lanes has no edge. number: the leg's; junction: id of the node at which
    the leg begins; priority: right of way over edges of a lower one."""
    outer_node = f"e{number}"
    inbound_shoulder, outbound_shoulder = leg.shoulders
    inbound: XmlAttributes = {
        "id": f"in{number}",
        "from": outer_node,
        "to": junction,
        "shape": line(leg.path[::-1]),  # the path runs outwards
        "priority": priority,
        "lanes": _list_lanes(leg, leg.inbound, inbound_shoulder),
    }
    outbound: XmlAttributes = {
        "id": f"out{number}",
        "from": junction,
        "to": outer_node,
        "shape": line(leg.path),
        "priority": priority,
        "lanes": _list_lanes(leg, leg.outbound, outbound_shoulder),
    }
    rows = [inbound] if leg.inbound else []
    return rows + ([outbound] if leg.outbound else [])


def _list_lanes(leg: Leg, count: int, shoulder: Shoulder) -> list[XmlAttributes]:
    """Attributes of SUMO's lanes of one direction of a leg. count: lanes for vehicles."""
    return street(
        count, width=leg.lane, footway=leg.footway, shoulder=shoulder.width, speed=leg.speed
    )


def _draw_shoulder(rng: Rng) -> Shoulder:
    """Draw a shoulder: none (width 0), a lane closed for works (no angle), or parking bays."""
    use = rng.random()
    if use < 0.5:
        return Shoulder()
    if use > 0.9:
        return Shoulder(width=round(float(rng.uniform(*CLOSED_LANE_M)), 2))
    # the chances belong to the angles in their order in the table
    angle = int(rng.choice(list(BAY_DEPTHS_M), p=[0.55, 0.15, 0.15, 0.15]))
    return Shoulder(width=BAY_DEPTHS_M[angle], angle=angle)
