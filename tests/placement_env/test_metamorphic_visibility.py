"""What must hold of what candidates see, and of coverage and surrogate on top of it: relations, on
a rendered scene."""

from dataclasses import replace

import numpy as np
import pytest

from placement_env.analysis.worth import exact_worth
from placement_env.candidates.candidates import Axes, Candidates, paper_candidates
from placement_env.fidelity.coverage import Coverage
from placement_env.fidelity.hit_model import shipped_model
from placement_env.fidelity.renders import Renders
from placement_env.fidelity.seeing import see
from placement_env.fidelity.surrogate import Surrogate
from placement_env.fidelity.traffic import Traffic
from placement_env.objective import Objective
from placement_env.setting import Setting, Weights
from placement_env.subsets import all_subsets
from toolkit.bodies.fleet import catalogue
from toolkit.boxes import count_points
from toolkit.geometry import look
from toolkit.objects import HEAVY, VEHICLE, Objects
from toolkit.runtime.cache import Cache
from toolkit.sensors.models import DepthCamera, SpinningLidar
from toolkit.sensors.sensor import Sensor
from toolkit.sites.site import Mount, Site, Solid
from toolkit.traffic.snapshots import Snapshot

SCHEMES = ("early", "late", "hybrid")
SETS = all_subsets(6)
CAMERA = DepthCamera(width=100, height=75, stride=1)
LIDAR = SpinningLidar(channels=24, azimuth_step=0.025)
PLACES = {  # x, y, z, heading, tilt
    "west": (-18.0, 2.0, 5.0, 0.0, 0.3),
    "north": (1.0, 17.0, 6.0, -1.5, 0.4),
    "east": (17.0, -3.0, 4.0, 3.0, 0.2),
    "twin": (17.0, -3.0, 4.0, 3.0, 0.2),
    "away": (-18.0, -18.0, 5.0, -2.4, 0.0),
    "mast": (-3.0, -16.0, 5.0, 1.2, 0.0),
}
TWIN, AWAY = 3, 4


def scene(x=0.0, y=0.0, turns=0, frames=range(3)):
    """Traffic and candidates of a square junction, shifted (m) and turned to the left by quarters
    of a circle."""
    turn = turns * np.pi / 2
    matrix = np.round([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    here = np.array([x, y])

    def place(xy):
        return np.asarray(xy) @ matrix.T + here

    sensors = tuple(
        Sensor(
            name,
            LIDAR if name == "mast" else CAMERA,
            look((*place((u, v)), z), heading + turn, tilt),
        )
        for name, (u, v, z, heading, tilt) in PLACES.items()
    )
    mounts = tuple(
        Mount(f"m{i}", np.append(s.position[:2], 0.0), price=1.0 + i) for i, s in enumerate(sensors)
    )
    wall = Solid(place([(-3.0, 3.0), (3.0, 3.0), (3.0, 4.0), (-3.0, 4.0)]), 0.0, 5.0)
    area = np.append(here - 20.0, here + 20.0)
    site = Site("square", area, solids=(wall,), mounts=mounts, sensors=sensors)
    models = tuple(dict.fromkeys(sensor.model for sensor in sensors))
    # each on its mount
    factors = np.column_stack([np.arange(len(sensors)), np.zeros((len(sensors), 4), np.int64)])
    candidates = Candidates(
        sensors, mounts, factors, Axes(np.zeros(1), np.zeros(1), np.zeros(1), models)
    )
    bodies = tuple(body for body in catalogue() if body.label in (VEHICLE, HEAVY))
    return Traffic(
        site, bodies, tuple(snapshot(bodies, place, turn, k) for k in frames)
    ), candidates


def snapshot(bodies, place, turn, k):
    rng = np.random.default_rng([3, k])
    chosen = rng.permutation(len(bodies))[:9]
    size = np.array([bodies[body].size for body in chosen])
    # the last row has its centres outside
    columns, rows = np.meshgrid([-13.0, 0.0, 13.0], [-10.0, 8.0, 21.0])
    xy = place(np.column_stack([columns.ravel(), rows.ravel()]) + rng.uniform(-0.9, 0.9, (9, 2)))
    yaw = rng.uniform(-0.1, 0.1, 9) + turn
    boxes = np.column_stack([xy, size[:, 2] / 2, size, np.arctan2(np.sin(yaw), np.cos(yaw))])
    return Snapshot(
        Objects(boxes, np.array([bodies[b].label for b in chosen]), np.arange(9)), chosen
    )


MODELS = {  # made up
    scheme: replace(shipped_model("early", 0.7), scheme=scheme, norm=norm)
    for scheme, norm in zip(SCHEMES, (1.0, 4.0, 2.0), strict=True)
}


def fidelities(visibility, scheme):
    return (
        *(Coverage(visibility, scheme), Coverage(visibility, scheme, min_points=5.0, views=2)),
        Surrogate(visibility, scheme, MODELS[scheme]),
    )


@pytest.fixture(scope="module")
def seen():
    return see(*scene())


@pytest.fixture(scope="module", params=SCHEMES)
def scored(request, seen):
    """Scheme, and its fidelities with the scores of all sets."""
    return request.param, [
        (fidelity, fidelity(SETS)) for fidelity in fidelities(seen, request.param)
    ]


def assert_same(one, other):
    for a, b in zip(one, other, strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-5, atol=1e-6)


def test_the_scene_tells_sensors_apart_whose_points_are_sent(seen):
    assert seen.points.shape[0] == 6
    assert 10 < seen.points.shape[1] < 27
    assert (seen.points.sum(axis=1) > 0).tolist() == [True, True, True, True, False, True]
    assert ((seen.points == 0).any(axis=0) & (seen.points > 0).any(axis=0)).any()
    on_objects = np.stack(
        [seen.points[:, seen.frame == k].sum(axis=1) for k in range(seen.frames)], axis=1
    )
    assert (on_objects <= seen.sent).all()
    assert (seen.far <= seen.sent).all()
    for figure in (seen.points, seen.sent, seen.far, seen.distance):
        assert (figure[TWIN] == figure[TWIN - 1]).all()
    assert not seen.points[AWAY].any()


def test_selected_sensors_see_the_same_alone(seen):
    order = [5, 2, 0]
    traffic, candidates = scene()
    alone = see(traffic, candidates.select(order))
    chosen = seen.select(order)
    for one, other in (
        (alone.points, chosen.points),
        (alone.sent, chosen.sent),
        (alone.far, chosen.far),
    ):
        assert one.tolist() == other.tolist()
    traffic, candidates = scene()
    assert paper_candidates(traffic.site).sensors == candidates.sensors


@pytest.mark.parametrize(
    "move", [{"x": 512.0, "y": -256.0}, {"turns": 1}, {"x": -64.0, "turns": 2}]
)
def test_moving_and_turning_site_traffic_and_sensors_together_changes_nothing(move, seen):
    there = see(*scene(**move))
    assert there.frame.tolist() == seen.frame.tolist()
    np.testing.assert_allclose(there.distance, seen.distance, atol=1e-3)
    # rays that graze go either way
    np.testing.assert_allclose(there.points, seen.points, rtol=0.01, atol=3)
    for one, other in ((there.sent, seen.sent), (there.far, seen.far)):
        # level ground lies on the crop's edge, z > 0: by rounding
        np.testing.assert_allclose(one, other, rtol=0.2)
    for scheme in SCHEMES:
        for moved, before in zip(fidelities(there, scheme), fidelities(seen, scheme), strict=True):
            np.testing.assert_allclose(moved(SETS).ap, before(SETS).ap, atol=0.06)


def test_frames_walls_points_and_names_change_nothing_else(seen):
    last = see(*scene(frames=[2]))
    assert last.points.tolist() == seen.points[:, seen.frame == 2].tolist()
    assert last.sent[:, 0].tolist() == seen.sent[:, 2].tolist()
    traffic, candidates = scene()
    open_site = replace(traffic.site, solids=())
    cleared = see(replace(traffic, site=open_site), candidates)
    assert (cleared.points >= seen.points).all()
    assert cleared.points.sum() > seen.points.sum()
    assert replace(traffic, site=open_site).digest() != traffic.digest()
    figures = [Coverage(seen, min_points=least)(SETS).ap for least in (1.0, 10.0, 50.0)]
    figures += [Coverage(seen, min_points=50.0, views=views)(SETS).ap for views in (1, 2, 3)]
    for more, less in ((0, 1), (1, 2), (3, 4), (4, 5)):
        assert (figures[more] >= figures[less]).all()
    traffic, candidates = scene()
    renamed = tuple(
        replace(sensor, name=f"other{i}") for i, sensor in enumerate(candidates.sensors)
    )
    assert (
        see(traffic, replace(candidates, sensors=renamed)).points.tolist() == seen.points.tolist()
    )
    traffic, candidates = scene()
    renders = Renders(traffic, candidates, noise_seed=None)
    for k in range(len(traffic)):
        boxes = seen.boxes[seen.frame == k]
        for c in range(len(candidates)):
            counted = count_points(renders.clouds(k, c), boxes)
            # and its ground
            np.testing.assert_allclose(counted, seen.points[c, seen.frame == k], rtol=0.1, atol=8)


def test_order_and_sensors_that_look_away_change_nothing_but_the_price(seen, scored):
    scheme, before = scored
    order = np.array([4, 0, 5, 2, 1, 3])
    for other, (_, expected) in zip(fidelities(seen.select(order), scheme), before, strict=True):
        assert_same(other(SETS[:, order]), expected)
    scheme, with_scores = scored
    candidates = scene()[1]
    for fidelity, _ in with_scores:
        objective = Objective(
            Setting(
                candidates=candidates,
                fidelity=fidelity,
                scheme=scheme,
                weights=Weights(comm=0.0, price=0.01),
            )
        )
        without, with_it = objective.score([0, 1]), objective.score([0, 1, AWAY])
        assert with_it.ap == without.ap
        assert with_it.recall == without.recall
        assert with_it.price == without.price + candidates.prices[AWAY]
        assert with_it.reward == pytest.approx(without.reward - 0.01 * candidates.prices[AWAY])
        assert with_it.kbit >= without.kbit
        assert objective.score([AWAY]).ap == 0


def test_sets_are_scored_alike_and_doubles_add_nothing(scored):
    shuffled = np.random.default_rng(0).permutation(len(SETS)).repeat(3)
    for fidelity, expected in scored[1]:
        assert_same(fidelity(SETS[shuffled]), [figure[shuffled] for figure in expected])
        assert_same(fidelity(SETS[[37]]), [figure[[37]] for figure in expected])
    for _, estimate in scored[1]:
        for i in range(6):
            without = np.flatnonzero(~SETS[:, i])
            for figure in estimate:
                assert (figure[without | 1 << i] >= figure[without] - 1e-6).all()
    for _, estimate in scored[1]:
        assert [figure[0] for figure in estimate] == [0, 0, 0]
    coverage = scored[1][0][0]
    worth = exact_worth(lambda sets: coverage(sets).ap, 6)
    assert (worth.synergy <= 1e-12).all()
    (coverage, estimate), *_ = scored[1]
    alone = np.flatnonzero(SETS[:, TWIN - 1] & ~SETS[:, TWIN])
    assert estimate.ap[alone].tolist() == estimate.ap[alone | 1 << TWIN].tolist()
    sent = estimate.kbit[1 << TWIN]
    assert estimate.kbit[alone | 1 << TWIN] == pytest.approx(estimate.kbit[alone] + sent)
    worth = exact_worth(lambda sets: coverage(sets).ap, 6)
    assert worth.shapley[TWIN] == pytest.approx(worth.shapley[TWIN - 1])
    assert worth.synergy[TWIN, TWIN - 1] <= 0
    swapped = SETS.copy()
    swapped[:, [TWIN - 1, TWIN]] = SETS[:, [TWIN, TWIN - 1]]
    for fidelity, expected in scored[1]:
        assert_same(fidelity(swapped), expected)


def test_a_cache_of_renders_is_shared_but_never_by_what_changed(tmp_path):
    traffic, candidates = scene(frames=[0])
    east, cache = 2, Cache(tmp_path / "cache.sqlite")
    first = Renders(traffic, candidates, cache).clouds(0, east)
    assert Renders(traffic, candidates, cache).clouds(0, east).tobytes() == first.tobytes()
    assert (
        Renders(traffic, candidates.select([5, east]), cache).clouds(0, 1).tobytes()
        == first.tobytes()
    )
    assert len(cache) == 2  # the empty site, and what changed

    sensors = list(candidates.sensors)
    sensors[east] = Sensor("east", CAMERA, look((17.0, -3.0, 4.0), 3.0, 0.5))
    changed = {
        "wall": (replace(traffic, site=replace(traffic.site, solids=())), candidates),
        "traffic": (scene(frames=[1])[0], candidates),
        "area": (
            replace(traffic, site=replace(traffic.site, area=traffic.site.area / 2)),
            candidates,
        ),
        "pose": (traffic, replace(candidates, sensors=tuple(sensors))),
    }
    for what in changed.values():
        kept, anew = Renders(*what, cache).clouds(0, east), Renders(*what).clouds(0, east)
        assert kept.tobytes() == anew.tobytes() != first.tobytes()
    assert (
        len(
            {Renders(*what).digest for what in changed.values()}
            | {Renders(traffic, candidates).digest}
        )
        == 4
    )
