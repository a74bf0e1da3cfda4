"""A small junction in a few moments, put together by hand, and sensors of both kinds round it; and
a street on which everything is known: points that say which cars a sensor sees, and a detector that
reads them."""

from dataclasses import dataclass, replace
from types import SimpleNamespace

import numpy as np
import pytest

from placement_env.analysis import case_figures, intervals
from placement_env.candidates.candidates import Axes, Candidates, paper_candidates
from placement_env.fidelity.detector import Detected
from placement_env.fidelity.hit_model import HitModel
from placement_env.fidelity.seeing import see
from placement_env.fidelity.traffic import Traffic
from placement_env.fidelity.visibility import Visibility
from placement_env.objective import Objective
from placement_env.protocol import Estimate
from placement_env.report.planning import choosing
from placement_env.report.planning.judging import Judge
from placement_env.search.portfolio import evaluators, reward_race, schedule
from placement_env.setting import Setting, Weights
from toolkit.bodies.body import Body
from toolkit.bodies.fleet import catalogue
from toolkit.boxes import footprints
from toolkit.geometry import look, pose
from toolkit.objects import Detections, Objects
from toolkit.sensors.models import DepthCamera, SpinningLidar
from toolkit.sensors.sensor import Sensor
from toolkit.sites.site import Mount, Relief, Site, Solid
from toolkit.traffic.snapshots import Snapshot

CAMERA = DepthCamera(width=160, height=120)
LIDAR = SpinningLidar(channels=24, azimuth_step=float(np.deg2rad(2.0)))
PLACES = [((-22.0, -16.0, 6.0), 0.7), ((22.0, 16.0, 5.0), -2.4), ((0.0, -17.0, 4.0), 1.6)]


def sensors() -> tuple[Sensor, ...]:
    cameras = [
        Sensor(f"camera{i}", CAMERA, look(at, heading, 0.3))
        for i, (at, heading) in enumerate(PLACES)
    ]
    return *cameras, Sensor("lidar", LIDAR, pose(3.0, 9.0, 3.5, yaw=2.0))


def moment(
    site: Site, bodies: tuple[Body, ...], rng: np.random.Generator, count: int, time: float
) -> Snapshot:
    """Objects in rows, so that they stand before each other but do not overlap; some of them
    outside the area."""
    chosen = np.where(
        rng.random(count) < 0.6, rng.integers(20, size=count), rng.integers(len(bodies), size=count)
    )
    cells = rng.permutation(20)[:count]
    xy = np.column_stack([cells % 5 - 2, cells // 5 - 1.5]) * [12.0, 11.0]
    sizes = np.array([bodies[b].size for b in chosen]).reshape(-1, 3)
    boxes = np.column_stack([xy, sizes[:, 2] / 2, sizes, rng.uniform(-np.pi, np.pi, count)])
    boxes[:, 2] += site.ground(footprints(boxes)).mean(axis=1)
    return Snapshot(
        Objects(boxes, np.array([bodies[b].label for b in chosen], np.int64)), chosen, time
    )


@pytest.fixture(scope="session")
def small_traffic() -> Traffic:
    """Five frames, the third of them empty; the last two alike but for one object more."""
    house = Solid(np.array([[-4.0, 4.0], [2.0, 4.0], [2.0, 8.0], [-4.0, 8.0]]), -0.2, 5.0)
    site = Site(
        "small",
        np.array([-20.0, -14, 20, 14]),
        solids=(house,),
        sensors=sensors(),
        relief=Relief(0.05, 1),
    )
    bodies, rng = catalogue(), np.random.default_rng(5)
    moments = [moment(site, bodies, rng, count, 5.0 * i) for i, count in enumerate((12, 9, 0, 14))]
    last = moments[-1]
    fewer = Snapshot(last.objects[:-1], last.bodies[:-1], 15.0)
    return Traffic(site, bodies, (*moments[:3], fewer, last))


@pytest.fixture(scope="session")
def small_candidates(small_traffic) -> Candidates:
    return paper_candidates(small_traffic.site)


@pytest.fixture
def change_code(monkeypatch):
    """Give the code that a module of fidelities depends on another digest, as if it was edited:
    `change_code("placement_env.fidelity.seeing")`."""

    def change(module, digest="other"):
        monkeypatch.setattr(f"{module}.code_digest", lambda *modules: digest)

    return change


FREE = Weights()


def candidates_on(mounts, poses, *, capacity=2000.0, seed=0):
    """`poses` headings on each of `mounts` mounts, of random prices."""
    price = np.random.default_rng(seed).uniform(0.5, 2.0, mounts)
    posts = tuple(
        Mount(f"post{m}", np.array([10.0 * m, 0.0, 0.0]), price=float(price[m]), capacity=capacity)
        for m in range(mounts)
    )
    headings = np.linspace(0.0, 2 * np.pi, poses, endpoint=False)
    factors = np.array([(m, 0, h, 0, 0) for m in range(mounts) for h in range(poses)])
    sensors = tuple(
        Sensor(f"post{m}_h{h}", DepthCamera(), look((10.0 * m, 0.0, 5.0), float(headings[h])))
        for m, _, h, _, _ in factors
    )
    axes = Axes(np.array([5.0]), headings, np.array([0.0]), (DepthCamera(),))
    return Candidates(sensors, posts, factors, axes)


@dataclass
class Seen:
    """Share of objects that at least `views` sensors see: submodular for 1 view, not for more."""

    seen: np.ndarray
    sent: np.ndarray
    views: int = 1
    name: str = "coverage"
    calls: int = 0
    asked: int = 0

    def __call__(self, subsets):
        self.calls += 1
        self.asked += len(subsets)
        share = (subsets.astype(np.int64) @ self.seen.astype(np.int64) >= self.views).mean(axis=1)
        return Estimate(share, share, subsets @ self.sent)


def random_objective(
    mounts=6, poses=1, *, views=1, objects=60, seed=0, weights=FREE, capacity=2000.0, most=0.5
):
    rng = np.random.default_rng(seed)
    candidates = candidates_on(mounts, poses, capacity=capacity, seed=seed)
    seen = rng.random((len(candidates), objects)) < rng.uniform(
        0.1 * most, most, (len(candidates), 1)
    )
    sent = rng.uniform(100.0, 900.0, len(candidates))
    return Objective(
        Setting(
            candidates=candidates, fidelity=Seen(seen, sent, views), scheme="early", weights=weights
        )
    )


@pytest.fixture(scope="session")
def make():
    return random_objective


NARROW, WIDE = DepthCamera(width=40, height=30), DepthCamera(width=80, height=30)
CAR = np.array([4.0, 2.0, 1.5, 0.0])
FRAMES = 8
# Cars at these places in every frame, by sensor who sees them; sensor 2 also sees something at the
# last place.
CARS = np.array([[-12.0, 0.0], [0.0, 0.0], [12.0, 0.0], [0.0, 12.0]])
SEES = np.array([[1, 1, 0, 0], [0, 1, 1, 0], [0, 0, 0, 1], [1, 0, 0, 0]], bool)
GHOST = np.array([-14.0, -14.0])
SENDS = np.array([300.0, 200.0, 100.0, 700.0])  # kbit that the searches believe


class Street:
    """What four sensors measure: two points in the middle of every car that they see."""

    def __init__(self, site, sensors, frames=FRAMES):
        self.site, self.sensors, self.frames, self.digest = site, sensors, frames, "street"

    def clouds(self, k, c):
        places = [*CARS[SEES[c]], *([GHOST] if c == 2 else [])]
        return np.array([[x, y, 0.75] for x, y in places for _ in range(25)], np.float32).reshape(
            -1, 3
        )

    def objects(self, k):
        boxes = np.column_stack([CARS, np.full(4, 0.75), np.tile(CAR, (4, 1))])
        walker = [[5.0, -5.0, 0.9, 0.6, 0.6, 1.8, 0.0]]
        return Objects(np.vstack([boxes, walker]), np.array([0, 0, 0, 0, 2]))


class Reader:
    """A car at every place that has points; the ghost is believed most."""

    digest = "reader"

    def __call__(self, points, /):
        places = np.unique(points[:, :2], axis=0).astype(float)
        scores = np.where((places == GHOST).all(axis=1), 0.99, 0.5 + 0.01 * np.arange(len(places)))
        boxes = np.column_stack(
            [places, np.full(len(places), 0.75), np.tile(CAR, (len(places), 1))]
        )
        return Detections(boxes.reshape(-1, 7), scores)


class Known:
    """The share of cars that a set sees."""

    name = "surrogate"

    def __call__(self, subsets):
        share = (subsets.astype(int) @ SEES.astype(int) > 0).mean(axis=1)
        return Estimate(share, share.copy(), subsets @ SENDS)


@pytest.fixture
def blocks_of_four(limits):
    """Small examples have blocks of one life, four frames."""
    for module in (intervals, case_figures, evaluators, schedule, reward_race, choosing):
        limits(module, BLOCK_FRAMES=4)


@pytest.fixture
def street(blocks_of_four):
    """Site, candidates, the objective of the searches and a judge."""
    posts = [(-15.0, -15.0), (15.0, -15.0), (15.0, 15.0), (-15.0, 15.0)]
    mounts = tuple(
        Mount(f"post{m}", np.array([x, y, 0.0]), price=p, capacity=c)
        for m, ((x, y), p, c) in enumerate(
            zip(posts, (1.0, 1.0, 0.5, 3.0), (500.0, 500.0, 500.0, 500.0), strict=True)
        )
    )
    sensors = tuple(
        Sensor(
            f"post{m}_eye",
            (NARROW, WIDE)[m == 3],
            look((x, y, 5.0), float(np.arctan2(-y, -x)), 0.2),
        )
        for m, (x, y) in enumerate(posts)
    )
    factors = np.array([[m, 0, 0, 0, int(m == 3)] for m in range(4)])
    axes = Axes(np.array([5.0]), np.zeros(1), np.zeros(1), (NARROW, WIDE), (10.0, 20.0))
    candidates = Candidates(sensors, mounts, factors, axes)
    site = Site("street", np.array([-20.0, -20.0, 20.0, 20.0]), mounts=mounts)
    objective = Objective(Setting(candidates=candidates, fidelity=Known(), scheme="late"))
    detected = Detected(Street(site, sensors), Reader(), "early")
    return SimpleNamespace(
        site=site,
        candidates=candidates,
        objective=objective,
        detected=detected,
        judge=Judge((detected,)),
    )


def random_visibility(candidates=12, objects=300, frames=20, seed=0):
    rng = np.random.default_rng(seed)
    shape = (candidates, objects)
    points = np.where(rng.random(shape) < 0.3, np.rint(rng.lognormal(4, 1.5, shape)), 0).astype(
        np.float32
    )
    boxes = np.column_stack(
        [
            rng.uniform(-30, 30, (objects, 2)),
            np.tile([0.7, 4.4, 1.8, 1.5], (objects, 1)),
            rng.uniform(-3, 3, objects),
        ]
    )
    sent, far = (rng.integers(100, 5000, (candidates, frames)).astype(np.float32) for _ in range(2))
    distance = rng.uniform(5, 60, shape).astype(np.float32)
    return Visibility(points, distance, np.sort(rng.integers(0, frames, objects)), boxes, sent, far)


@pytest.fixture(scope="session")
def made_visibility():
    """Makes it up, of as many candidates, objects and frames as asked for."""
    return random_visibility


@pytest.fixture(scope="session")
def hit_model():
    return HitModel("early", 0.7, -4.0, 1.8, 0.98, 0.7, 0.3, "made up", 0.3, 0.6)


@pytest.fixture(scope="session")
def hit_models(hit_model):
    """One for each of the paper's schemes."""
    return {
        "early": hit_model,
        "late": replace(hit_model, scheme="late", norm=6.0),
        "hybrid": replace(hit_model, scheme="hybrid", norm=4.0),
    }


@pytest.fixture(scope="session")
def seen(small_traffic, small_candidates):
    return see(small_traffic, small_candidates)
