"""Ways of road users through a site: SUMO moves them from gate to gate, in steps of 0.1 s.

Nobody appears or vanishes inside the view: who comes in at a gate leaves at another, or is under
way when the recording begins or ends. SUMO moves points along the middles of lanes; `move_driver`
and `move_pedestrian` turn them into the motion of bodies."""

import warnings
from array import array
from collections import Counter
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field
from types import ModuleType
from typing import NamedTuple

import numpy as np

from toolkit.arrays import Float64
from toolkit.objects import CYCLIST, HEAVY, PEDESTRIAN, VEHICLE
from toolkit.sites.site import Site
from toolkit.traffic.body_motion import (
    face_course,
    move_driver,
    move_pedestrian,
    shift_left,
    smooth_direction,
)
from toolkit.traffic.deadlocks import end_deadlocks
from toolkit.traffic.detours import send_round
from toolkit.traffic.flow import ROAD_USER_KINDS, Flow
from toolkit.traffic.gates import Gates, Passage
from toolkit.traffic.road_lanes import Roads
from toolkit.traffic.sumo import FINE_STEP_S, running
from toolkit.traffic.supply import HEAVY_SHARE, LANE_OFFSETS_M, SWAY_DEG, Supply

WARM_UP_S = 150.0  # before the first frame, so that the roads are as full as they stay
MAX_STRIPE_SHIFT_M = 0.3  # sideways, of a pedestrian from the middle of its stripe
GROUP_SHARES = (0.7, 0.19, 0.08, 0.03)  # pedestrians with 0, 1, 2, 3 companions
COMPANION_GAP_M = (0.15, 0.4)  # lowest and highest gap between companions next to each other
MAX_QUEUE = 10  # road users who wait to come in at an entry, without a warning
STEPS_BETWEEN_DETOURS = 10  # stuck drivers are looked for once a second
# By default SUMO's drivers change lanes and enter a junction only if nobody has to brake, and they
# jam roundabouts that could carry them. These change lanes into gaps half as long, and enter as
# others do after 90 s of waiting.
LANE_CHANGE_ASSERTIVENESS = 2.0
IMPATIENCE = 0.5  # 0 to 1, which SUMO's drivers reach after 180 s
LABELS_OF_KIND = {"vehicle": (VEHICLE, HEAVY), "cyclist": (CYCLIST,), "pedestrian": (PEDESTRIAN,)}


class NoPassage(ValueError):
    """No road leads from one border of a site's network past its area to another."""


class Traveller(NamedTuple):
    """Road user on its way.

    Attributes:
        id: its number.
        body: row of its body in the supply.
        entry: name of the gate at which it comes in.
        exit: name of the gate at which it leaves."""

    id: int
    body: int
    entry: str
    exit: str


class Journey(NamedTuple):
    """Way of one road user.

    Attributes:
        traveller: the road user.
        first: number of the step (`FINE_STEP_S`) of the first pose; 0 is that of the first frame,
            and steps before it are negative.
        poses: x, y of the middle of the body (m), yaw (rad), one for each step."""

    traveller: Traveller
    first: int
    poses: Float64[np.ndarray, "steps 3"]


@dataclass
class _Course:
    """Course of one object in SUMO.

    Attributes:
        traveller: the road user.
        first: number of the step of the first position.
        points: x and y (m) in turn, step after step; numbers in an array take a seventh of the
            memory of pairs.
        yaw: heading at the first step (rad)."""

    traveller: Traveller
    first: int = 0
    points: "array[float]" = field(default_factory=lambda: array("d"))
    yaw: float = 0.0


def possible_movements(site: Site, supply: Supply) -> dict[str, dict[str, list[str]]]:
    """Names of the exits that each kind of road user can reach, by kind and name of the entry."""
    with running(site.network, _describe_types(supply), seed=0, step=FINE_STEP_S) as sumo:
        return _Demand(sumo, site, supply).possible()


def simulate_ways(
    site: Site,
    supply: Supply,
    *,
    seconds: float,
    flow: Flow | None = None,
    progress: Callable[[int], None] | None = None,
) -> list[Journey]:
    """Ways of all road users within so many seconds, in the order in which they set out.

    Args:
        site: Site with a network.
        supply: Gives bodies, ids and random numbers.
        seconds: Time from the first to the last frame.
        flow: Demand, None to draw it.
        progress: Called with the number of simulated seconds.

    Raises `NoPassage` for a network without a passage near the area, ValueError for a flow that it
    has no way for, and the errors of `toolkit.traffic.sumo.running`."""
    steps = round(seconds / FINE_STEP_S) + 1
    warm_up = round(WARM_UP_S / FINE_STEP_S)
    types = _describe_types(supply)
    seed = int(supply.rng.integers(2**31 - 1))
    options = {"max-depart-delay": -1, "default.action-step-length": FINE_STEP_S}
    with running(site.network, types, seed=seed, step=FINE_STEP_S, options=options) as sumo:
        demand = _Demand(sumo, site, supply)
        possible = demand.possible()
        if not possible["vehicle"]:
            raise NoPassage(
                f"site {site.name!r}: no road leads from one border of its network past the area "
                "to another: import a larger piece of the map"
            )
        if flow is None:
            flow = Flow.draw(possible, supply.rng)
        flow.check(possible)
        courses: dict[int, _Course] = {}
        for step in range(-warm_up, steps):
            demand.add_due(flow, courses)
            sumo.simulationStep()
            _record(sumo, step, courses)
            if step % STEPS_BETWEEN_DETOURS == 0:
                send_round(sumo, demand.roads)
                end_deadlocks(sumo)
            if progress is not None and step >= 0 and step % 10 == 0:
                progress(step // 10)
    _warn_of_queues(courses.values())
    ways = []
    for name in list(courses):
        course = courses.pop(name)  # so that its points are not kept while others become ways
        if course.points:
            ways += _make_ways(course, supply)
    return ways


def _warn_of_queues(courses: Collection[_Course]) -> None:
    """Warn of entries at which more than `MAX_QUEUE` road users wait to come in at the end."""
    users = Counter(course.traveller.entry for course in courses)
    waiting = Counter(course.traveller.entry for course in courses if not course.points)
    for entry, count in waiting.items():
        if count > MAX_QUEUE:
            warnings.warn(
                f"more road users are to come in at {entry!r} than its road takes: {count} of "
                f"{users[entry]} still waited outside at the end, so lower per_hour of this entry "
                "in the flow",
                stacklevel=3,
            )


def _describe_types(supply: Supply) -> str:
    """Text of SUMO's additional file with a type for each body; a type's id is the body's row.

    Random numbers are drawn at each call."""
    rng = supply.rng
    rows = []
    for row, (label, (length, width, height)) in enumerate(
        zip(supply.labels.tolist(), supply.sizes, strict=True)
    ):
        if label == PEDESTRIAN:
            habits = {"minGap": 0.5, "speedFactor": np.clip(rng.normal(1, 0.15), 0.6, 1.4)}
        else:
            habits = {
                "minGap": rng.uniform(1.0, 2.5),
                "latAlignment": np.clip(rng.normal(0, LANE_OFFSETS_M[label]), -1.2, 1.2),
                "speedFactor": np.clip(rng.normal(1, 0.1), 0.8, 1.2),
                "accel": rng.uniform(1.4, 2.4) if label != HEAVY else rng.uniform(0.8, 1.3),
                "decel": rng.uniform(2.5, 4.0),
                "emergencyDecel": 7.0,
                "tau": rng.uniform(1.0, 1.6),
                "lcAssertive": LANE_CHANGE_ASSERTIVENESS,
                "impatience": IMPATIENCE,
            }
        text = " ".join(f'{name}="{value:.3f}"' for name, value in habits.items())
        model = "" if label == PEDESTRIAN else ' carFollowModel="IDM" maxSpeedLat="0.6" lcSigma="0"'
        rows.append(
            f'<vType id="{row}" vClass="{supply.classes[row]}" length="{length:.3f}" '
            f'width="{width:.3f}" height="{height:.3f}" {text}{model}/>'
        )
    return "<additional>\n" + "\n".join(rows) + "\n</additional>\n"


class _Demand:
    """Set road users out on their passages when they are due.

    Args:
        sumo: libsumo module with a running simulation.
        site: Site of the network.
        supply: Gives bodies, ids and random numbers.

    Attributes:
        roads: Lanes of the network."""

    def __init__(self, sumo: ModuleType, site: Site, supply: Supply) -> None:
        """Find the passages that each SUMO class may take."""
        self._sumo = sumo
        self._supply = supply
        self.roads = Roads.read(sumo)
        gates = Gates(sumo, site, self.roads)
        # by SUMO class: passages by names of entry and exit
        self._passages: dict[str, dict[tuple[str, str], Passage]] = {}
        for row, vehicle_class in enumerate(supply.classes):
            if vehicle_class not in self._passages:
                self._passages[vehicle_class] = gates.passages(vehicle_class, str(row))
        self._bodies = {
            label: np.flatnonzero(supply.labels == label)
            for label in (VEHICLE, HEAVY, CYCLIST, PEDESTRIAN)
        }
        self._routes: set[str] = set()  # names of the routes that SUMO knows

    def possible(self) -> dict[str, dict[str, list[str]]]:
        """Exits that each kind can reach, by kind and entry."""
        possible: dict[str, dict[str, list[str]]] = {kind: {} for kind in ROAD_USER_KINDS}
        for kind in ROAD_USER_KINDS:
            label = LABELS_OF_KIND[kind][0]
            for vehicle_class in sorted({self._supply.classes[row] for row in self._bodies[label]}):
                for entry, leave in self._passages[vehicle_class]:
                    exits = possible[kind].setdefault(entry, [])
                    if leave not in exits:
                        exits.append(leave)
        return possible

    def add_due(self, flow: Flow, courses: dict[int, _Course]) -> None:
        """Add to SUMO the road users that set out in this step, and to `courses` a course of each.

        courses: by id of the road user."""
        rng = self._supply.rng
        numbers = rng.poisson(flow.per_hour * FINE_STEP_S / 3600)  # by movement
        if not numbers.any():
            return
        for number in np.repeat(np.arange(len(numbers)), numbers).tolist():
            kind, entry, leave, _ = flow.movements[number]
            labels = LABELS_OF_KIND[kind]
            is_heavy = len(labels) > 1 and rng.random() < HEAVY_SHARE
            body = self._choose_body(labels[1] if is_heavy else labels[0], (entry, leave))
            if body is None:
                continue
            name = next(self._supply.ids)
            passage = self._passages[self._supply.classes[body]][entry, leave]
            if kind == "pedestrian":
                self._add_pedestrian(str(name), body, passage)
            else:
                self._add_driver(str(name), body, passage)
            courses[name] = _Course(Traveller(id=name, body=body, entry=entry, exit=leave))

    def _choose_body(self, label: int, gates: tuple[str, str]) -> int | None:
        """Draw a body of a class with a passage between two gates; None if no body has one.

        label: number of the class; gates: names of entry and exit. Returns the body's row."""
        rows = [
            row
            for row in self._bodies[label].tolist()
            if gates in self._passages[self._supply.classes[row]]
        ]
        if not rows:
            return None
        body = self._supply.offer(np.array(rows))
        self._supply.take(body)
        return body

    def _add_driver(self, name: str, body: int, passage: Passage) -> None:
        """Add a vehicle to SUMO, which lets it in when there is room.

        name: its id; body: row of its body, whose number is the id of SUMO's type; passage: its
        drive."""
        route = " ".join(passage.edges)
        if route not in self._routes:
            self._sumo.route.add(route, passage.edges)
            self._routes.add(route)
        self._sumo.vehicle.add(
            name, route, str(body), departLane="best", departPos="base", departSpeed="max"
        )

    def _add_pedestrian(self, name: str, body: int, passage: Passage) -> None:
        """Add a person to SUMO, who walks the passage."""
        self._sumo.person.add(name, passage.edges[0], passage.start_m, typeID=str(body))
        self._sumo.person.appendWalkingStage(name, passage.edges, passage.end_m)


def _record(sumo: ModuleType, step: int, courses: Mapping[int, _Course]) -> None:
    """Add the present positions of all objects to their courses. step: number of this step."""
    for domain in (sumo.vehicle, sumo.person):
        find_position = domain.getPosition  # looked up once, since it is called for each object
        for name in domain.getIDList():
            course = courses[int(name)]
            points = course.points
            if not points:
                course.first = step
                angle = domain.getAngle(name)
                if np.isfinite(angle):  # not of some vehicles that change lanes
                    course.yaw = float(np.pi / 2 - np.radians(angle))
            points.extend(find_position(name))


def _make_ways(course: _Course, supply: Supply) -> list[Journey]:
    """Way of an object of SUMO; a pedestrian may have companions, with ways next to it."""
    rng = supply.rng
    traveller = course.traveller
    label = int(supply.labels[traveller.body])
    points = np.array(course.points).reshape(-1, 2)
    turn = float(np.radians(rng.normal(0, SWAY_DEG[label])))
    if label != PEDESTRIAN:
        length = float(supply.sizes[traveller.body, 0])
        poses = move_driver(points, course.yaw, length)
        poses[:, 2] += turn
        return [Journey(traveller, course.first, poses)]
    walked = move_pedestrian(points, course.yaw)
    directions = smooth_direction(walked[:, 2])
    ways = []
    left = rng.uniform(-MAX_STRIPE_SHIFT_M, MAX_STRIPE_SHIFT_M)  # of the walked course (m)
    for companions in range(int(rng.choice(len(GROUP_SHARES), p=GROUP_SHARES)), -1, -1):
        poses = shift_left(walked, directions, left)
        poses[:, 2] = face_course(poses[:, :2], course.yaw)
        poses[:, 2] += turn
        ways.append(Journey(traveller, course.first, poses))
        if companions:  # the next one walks to the left of this one
            body = int(supply.several(np.flatnonzero(supply.labels == PEDESTRIAN), 1)[0])
            left += supply.sizes[[traveller.body, body], 1].mean() + rng.uniform(*COMPANION_GAP_M)
            traveller = traveller._replace(id=next(supply.ids), body=body)
            turn = float(np.radians(rng.normal(0, SWAY_DEG[label])))
    return ways
