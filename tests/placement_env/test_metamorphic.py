"""What must hold of every way to score sensor sets, however good it is: relations between scores,
not their values.

The scene is flat, with cars in the middle of 6 m cells; the detector reports a car in each cell
that holds points, the better the more there are. Its sensors' points are drawn, not rendered, so
that every relation is exact.
"""

from dataclasses import dataclass, replace

import numpy as np
import pytest

from placement_env.analysis.worth import exact_worth
from placement_env.candidates.candidates import paper_candidates
from placement_env.fidelity.detector import Detected
from placement_env.objective import Objective
from placement_env.protocol import Estimate
from placement_env.racing import race
from placement_env.setting import Setting, Weights
from placement_env.subsets import all_subsets
from toolkit.geometry import look
from toolkit.objects import Detections, Objects
from toolkit.runtime.cache import Cache
from toolkit.sensors.models import DepthCamera
from toolkit.sensors.sensor import Sensor
from toolkit.sites.site import Site

CELL = 6.0  # m
CAR = np.array([4.4, 1.9, 1.5])
SCHEMES = ("early", "late", "hybrid")
SETS = all_subsets(4)
FEW = np.array([0, 1, 6, 11, 15])  # rows of SETS, enough where all sets are treated alike
FRAMES = 3


def site_at(x=0.0, y=0.0):
    places = [(-17.0, -11.0), (16.0, -12.0), (15.0, 13.0), (-16.0, 12.0)]
    sensors = tuple(
        Sensor(f"s{i}", DepthCamera(), look((x + u, y + v, 5.0), heading, 0.3))
        for i, ((u, v), heading) in enumerate(zip(places, (0.3, 1.9, 3.4, 5.0), strict=True))
    )
    return Site("square", np.array([x - 18.0, y - 18.0, x + 18.0, y + 18.0]), sensors=sensors)


@dataclass(frozen=True, eq=False)
class Scene:
    """Points of each sensor on each car of each frame, as
    `placement_env.fidelity.detector.Measured`."""

    site: Site
    sensors: tuple[Sensor, ...]
    origin: tuple[float, float] = (0.0, 0.0)
    frames: int = FRAMES
    digest: str = "as it is"
    order: tuple[int, ...] = tuple(range(FRAMES))
    blind: tuple[str, ...] = ()
    richness: float = 1.0
    ghosts: tuple[int, ...] = ()  # frames in which nothing is there, and yet there are points

    def _boxes(self, k):
        x, y = (
            np.random.default_rng([7, self.order[k]]).permutation(36)[:7] // np.array([[6], [1]])
        ) % 6
        middles = np.stack([x, y], axis=1) * CELL - 15.0 + self.origin
        return np.column_stack([middles, np.full(7, 0.75), np.tile(CAR, (7, 1)), np.zeros(7)])

    def objects(self, k):
        return Objects(self._boxes(k)[:0] if self.order[k] in self.ghosts else self._boxes(k))

    def clouds(self, k, c):
        sensor = self.sensors[c]
        if sensor.name in self.blind:
            return np.zeros((0, 3), np.float32)
        rng = np.random.default_rng([int(sensor.name[1]), self.order[k]])
        points = [np.zeros((0, 3))]
        for box in self._boxes(k):
            far = np.hypot(*(box[:2] - sensor.position[:2]))
            number = int(self.richness * rng.poisson(40 * np.exp(-far / 8)) * (rng.random() < 0.8))
            points.append(box[:3] + rng.uniform(-0.5, 0.5, (number, 3)) * CAR)
        return np.concatenate(points).astype(np.float32)


@dataclass(frozen=True)
class Cells:
    """Reports a car in each cell with `fewest` points or more, askew by less the more there are."""

    origin: tuple[float, float] = (0.0, 0.0)
    fewest: int = 3
    digest: str = "untrained"

    def __call__(self, points):
        cells, number = np.unique(
            np.floor((points[:, :2] - self.origin) / CELL), axis=0, return_counts=True
        )
        cells, number = cells[number >= self.fewest], number[number >= self.fewest]
        x, y = ((cells + 0.5) * CELL + self.origin).T.reshape(2, -1)
        size = np.tile(CAR, (len(cells), 1))
        boxes = np.column_stack(
            [x + 8.0 / number, y, np.full(len(cells), 0.75), size, np.zeros(len(cells))]
        )
        return Detections(boxes, number / (number + 30.0))


SCENE = Scene(site_at(), site_at().sensors)


def detected(scene=SCENE, scheme="early", detector=Cells(), **options):
    return Detected(scene, detector, scheme, **options)


@pytest.fixture(scope="module")
def scores():
    """AP, recall and kbit of all sets of the scene, by scheme."""
    return {scheme: detected(scheme=scheme)(SETS) for scheme in SCHEMES}


def some(estimate, rows=FEW):
    return Estimate(*(figure[rows] for figure in estimate))


def assert_same(one, other):
    for a, b in zip(one, other, strict=True):
        np.testing.assert_allclose(a, b, rtol=0, atol=1e-9)


def test_the_scene_tells_sets_apart_and_more_recall_no_less(scores):
    assert len(np.unique(scores["early"].ap.round(6))) > 10
    assert not np.allclose(scores["early"].ap, scores["late"].ap)
    assert not np.allclose(scores["hybrid"].kbit, scores["late"].kbit)
    for i in range(4):
        without = np.flatnonzero(~SETS[:, i])
        assert (scores["early"].recall[without | 1 << i] >= scores["early"].recall[without]).all()
    single = 1 << np.arange(4)
    assert_same([scores["early"].ap[single]], [scores["late"].ap[single]])
    assert_same([scores["early"].recall[single]], [scores["late"].recall[single]])


@pytest.mark.parametrize("scheme", SCHEMES)
def test_the_order_of_sensors_sets_and_frames_and_the_place_change_nothing(scheme, scores):
    order = [2, 0, 3, 1]
    scene = replace(SCENE, sensors=tuple(SCENE.sensors[i] for i in order))
    assert_same(detected(scene, scheme)(SETS[FEW][:, order]), some(scores[scheme]))
    shuffled = np.array([15, 3, 9, 3])
    assert_same(detected(scheme=scheme)(SETS[shuffled]), some(scores[scheme], shuffled))
    assert_same(detected(scheme=scheme)(SETS[[9]]), some(scores[scheme], [9]))
    assert_same(detected(replace(SCENE, order=(2, 0, 1)), scheme)(SETS[FEW]), some(scores[scheme]))
    there = site_at(384.0, -192.0)
    moved = Scene(there, there.sensors, origin=(384.0, -192.0))
    assert_same(
        detected(moved, scheme, Cells(origin=(384.0, -192.0)))(SETS[FEW]), some(scores[scheme])
    )
    assert scores[scheme].kbit == pytest.approx(SETS @ scores[scheme].kbit[1 << np.arange(4)])
    assert [figure[0] for figure in scores[scheme]] == [0, 0, 0]
    haunted = replace(SCENE, frames=FRAMES + 1, order=(*SCENE.order, 99), ghosts=(99,))
    spoilt, before = detected(haunted, scheme)(SETS[FEW]), some(scores[scheme])
    assert (spoilt.ap <= before.ap + 1e-12).all()
    assert spoilt.ap[-1] < before.ap[-1]
    assert_same([spoilt.recall], [before.recall])


def test_a_sensor_doubled_finds_nothing_new_late_and_sends_as_much_again():
    s0 = SCENE.sensors[0]
    twins = replace(SCENE, sensors=(*SCENE.sensors[:2], Sensor("s0'", s0.model, s0.pose)))
    both = detected(twins, "late")(
        np.array([[True, True, False], [True, True, True], [True, False, False]])
    )
    assert both.ap[1] == both.ap[0]
    assert both.recall[1] == both.recall[0]
    assert both.kbit[1] == pytest.approx(both.kbit[0] + both.kbit[2])


@pytest.mark.parametrize("scheme", SCHEMES)
def test_a_sensor_that_sees_nothing_adds_nothing_but_its_price(scheme):
    candidates = paper_candidates(SCENE.site)
    fidelity = detected(replace(SCENE, blind=("s3",)), scheme)
    objective = Objective(
        Setting(
            candidates=candidates,
            fidelity=fidelity,
            scheme=scheme,
            weights=Weights(comm=0.0, price=0.01),
        )
    )
    without, with_it = objective.score([0, 2]), objective.score([0, 2, 3])
    assert with_it.ap == without.ap
    assert with_it.recall == without.recall
    assert with_it.kbit == without.kbit
    assert with_it.price == without.price + candidates.prices[3]
    assert with_it.reward == pytest.approx(without.reward - 0.01 * candidates.prices[3])
    worth = exact_worth(lambda sets: fidelity(sets).ap, 4)
    assert worth.shapley[3] == pytest.approx(0, abs=1e-12)
    assert worth.synergy[3] == pytest.approx(0, abs=1e-12)


MOVED = replace(SCENE.sensors[0], pose=look((0.0, -3.0, 5.0), 0.3, 0.3))
SMALLER = replace(SCENE.site, area=SCENE.site.area + np.array([6.0, 0.0, 0.0, 0.0]))
CHANGES = {
    "weights": lambda: detected(detector=Cells(fewest=12, digest="trained")),
    "traffic": lambda: detected(replace(SCENE, order=(3, 4, 5), digest="of tomorrow")),
    "site": lambda: detected(replace(SCENE, site=SMALLER, digest="smaller")),
    "pose": lambda: detected(replace(SCENE, sensors=(MOVED, *SCENE.sensors[1:]))),
    "iou": lambda: detected(iou=0.55),
    "scheme": lambda: detected(scheme="late"),
}


@pytest.mark.parametrize("change", CHANGES)
def test_what_changed_never_gets_an_old_score(change, tmp_path, scores):
    """One file serves both; the changed one must get what it gets without any memory, and the first
    one its own."""
    memo = Cache(tmp_path / "memo.sqlite")
    changed, anew = CHANGES[change](), CHANGES[change]()
    changed.memo = memo
    before = some(scores["early"])
    assert_same(detected(memo=memo)(SETS[FEW]), before)
    got = changed(SETS[FEW])
    assert_same(got, anew(SETS[FEW]))
    assert not np.allclose(got.ap, before.ap)
    assert_same(detected(memo=Cache(tmp_path / "memo.sqlite"))(SETS[FEW]), before)


@pytest.mark.parametrize("scheme", SCHEMES)
def test_a_race_over_detections_finds_what_scoring_all_finds(scheme, scores):
    fidelity = detected(scheme=scheme)
    result = race(
        lambda sets, frames: fidelity.partial(sets, frames.tolist()).ap, SETS, FRAMES, first=1
    )
    assert result.scores[0] == pytest.approx(scores[scheme].ap[result.winners[0]], abs=1e-12)
    assert result.scores[0] >= 0.8 * scores[scheme].ap.max()
    assert result.spent < result.full
