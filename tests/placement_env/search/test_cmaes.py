from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from placement_env.candidates.candidates import aim_sensor
from placement_env.objective import Objective
from placement_env.search import cmaes, greedy
from placement_env.setting import Setting, Weights
from toolkit.runtime.run import Run

pytest.importorskip("cma")


def scorer(make, target, calls=None):
    """Scores sets by how near every sensor's height, heading and tilt are to a target; the score's
    other figures are of any set."""
    any_score = make(3, 1).score([0])

    def place(sets):
        if calls is not None:
            calls.append(len(sets))
        off = [
            np.mean([np.abs(np.subtract(cmaes.angles(s), target)).sum() for s in sensors])
            for sensors in sets
        ]
        return [replace(any_score, ap=float(np.exp(-o)), reward=float(np.exp(-o))) for o in off]

    return place


@pytest.fixture
def start(make):
    return make(4, 1).candidates.select([0, 2])


def test_it_finds_the_poses_that_score_most_and_never_worse(make, start):
    calls = []
    found = cmaes.improve(scorer(make, (6.0, 0.4, 0.3), calls), start, seed=1, evaluations=600)
    assert found.best.reward > 0.9
    assert found.evaluations == sum(calls) <= 600
    assert (np.diff(found.history.reward) >= 0).all()
    for sensor, mount in zip(found.sensors, start.mount, strict=True):
        assert np.array_equal(sensor.position[:2], start.mounts[mount].position[:2])
        assert 3.0 <= sensor.position[2] <= 8.0
    place = scorer(make, cmaes.angles(start.sensors[0]))
    assert (
        cmaes.improve(place, start, evaluations=10).best.reward >= place([start.sensors])[0].reward
    )
    np.random.seed(3)  # noqa: NPY002
    expected = np.random.random()  # noqa: NPY002
    np.random.seed(3)  # noqa: NPY002
    first, again = (
        cmaes.improve(scorer(make, (6.0, 0.4, 0.3)), start, seed=2, evaluations=60)
        for _ in range(2)
    )
    assert first.best.reward == again.best.reward
    assert first.sensors == again.sensors
    assert np.random.random() == expected  # noqa: NPY002


def test_moved_sensors_stay_on_mounts_that_may_be_built(make, start):
    coding = cmaes.Coding(start)
    rng = np.random.default_rng(0)
    for vector in [coding.encode(), *rng.random((20, 6))]:
        assert len({tuple(sensor.position[:2]) for sensor in coding.decode(vector)}) == 2
    assert [s.pose.round(9).tolist() for s in coding.decode(coding.encode())] == [
        s.pose.round(9).tolist() for s in start.sensors
    ]
    place = scorer(make, (6.0, 0.4, 0.3))

    def low_ones(sets):
        return [
            s if all(x.position[2] < 5.5 for x in sensors) else None
            for s, sensors in zip(place(sets), sets, strict=True)
        ]

    found = cmaes.improve(low_ones, start, evaluations=100)
    assert all(sensor.position[2] < 5.5 for sensor in found.sensors)
    candidates = cmaes.as_candidates([*start.sensors, *start.sensors], start)
    assert candidates.mount.tolist() == [*start.mount, *start.mount]
    assert len({sensor.name for sensor in candidates.sensors}) == 4


def test_objectives_and_mounts_must_allow_moving(make):
    crowded = make(2, 2).candidates
    name = crowded.mounts[0].name
    with pytest.raises(ValueError, match=f"mount {name} has 2 sensors but max_sensors 1: leave 1"):
        cmaes.improve(scorer(make, (6.0, 0.4, 0.3)), crowded)
    with pytest.raises(ValueError, match="no sensor to move: start from a set with at least one"):
        cmaes.improve(scorer(make, (6.0, 0.4, 0.3)), crowded.select([]))
    with pytest.raises(ValueError, match="made from a site"):
        cmaes.search(make(4, 1), 2)


@pytest.mark.one_in(2)
@pytest.mark.parametrize("fidelity", ["coverage", "surrogate"])
def test_poses_come_from_greedys_set_and_are_no_worse(fidelity):
    objective = Objective(Setting("tjunction", fidelity=fidelity), Run(frames=2))
    found = cmaes.search(objective, 2, evaluations=8)
    first = greedy.search(objective, 2)
    assert found.best.subset == first.best.subset
    assert found.best.reward >= first.best.reward
    assert len(found.sensors) == 2
    assert found.evaluations == 8


def test_sensors_that_stand_score_the_same_and_none_may_pay():
    objective = Objective(Setting("tjunction", fidelity="surrogate"), Run(frames=2))
    (moved,) = cmaes.build_pose_scorer(objective.preparation)(
        [tuple(objective.candidates.sensors[:2])]
    )
    assert moved.ap == pytest.approx(objective.score([0, 1]).ap, abs=1e-6)
    found = cmaes.search(
        Objective(
            Setting("tjunction", fidelity="coverage", weights=Weights(price=5.0)), Run(frames=2)
        ),
        2,
        evaluations=8,
    )
    assert found.best.subset == () == found.sensors


@pytest.fixture(scope="module")
def panoramic():
    return Objective(Setting("tjunction", fidelity="coverage", rendering="panorama"), Run(frames=1))


def test_poses_are_looked_at_in_panoramas_and_the_answer_is_scored_by_rays(panoramic):
    objective, made = panoramic, panoramic.preparation
    calls = []
    live = made.live

    def counted(candidates):
        calls.append(len(candidates))
        return live.see(candidates)

    vars(made)["live"] = SimpleNamespace(see=counted)
    found = cmaes.search(objective, 1, evaluations=8)
    assert sum(calls) == found.evaluations == 8
    start = objective.candidates.select(found.best.subset).sensors
    before, after = cmaes.build_pose_scorer(made)([start, found.sensors])
    assert (found.best.reward, found.certificate.value) == (after.reward, after.reward)
    assert after.reward >= before.reward


def test_an_answer_that_panoramas_overrate_is_its_start(panoramic):
    objective = panoramic
    start = objective.candidates.select(greedy.search(objective, 2).best.subset)
    skyward = tuple(aim_sensor(s, s.position, cmaes.angles(s)[1], -1.5) for s in start.sensors)
    by_rays = cmaes.build_pose_scorer(objective.preparation)
    result = cmaes.improve(by_rays, objective.candidates.select([0]), evaluations=1)
    found = cmaes.settle_by_rays(by_rays, start, replace(result, sensors=skyward))
    assert found.sensors == start.sensors
    assert found.best.reward == by_rays([start.sensors])[0].reward
