"""Pools are full products less what they say they leave out; prices, factors and digests hold."""

import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
import shapely

from placement_env.candidates.candidates import (
    MAX_MOUNT_DISTANCE_M,
    MAX_RANDOM_POSES,
    Candidates,
    choose_candidates,
    own_and_random,
    paper_candidates,
    pool,
    random_sets,
)
from toolkit.geometry import look, pose
from toolkit.sensors.models import DepthCamera, SpinningLidar
from toolkit.sensors.sensor import Sensor
from toolkit.sites.files import load_site
from toolkit.sites.random import random_site
from toolkit.sites.site import Mount, Site

SITE = load_site("tjunction")
BUILT_IN = {"tjunction": 6, "roundabout": 8}


def square(mounts: int = 3, **changes) -> Site:
    stand = tuple(
        Mount(f"p{i}", np.array([10.0 * i - 10.0, -20.0, 0.5]), price=1.0 + i)
        for i in range(mounts)
    )
    return Site("square", np.array([-20.0, -20.0, 20.0, 20.0]), mounts=stand, **changes)


@pytest.fixture(scope="module")
def built_in_pools() -> dict[str, Candidates]:
    return {name: pool(load_site(name)) for name in BUILT_IN}


@pytest.mark.parametrize("name", BUILT_IN)
def test_paper_sensors_are_the_sites_own_each_on_its_own_mount(name):
    site = load_site(name)
    candidates = paper_candidates(site)
    assert (
        len(candidates)
        == BUILT_IN[name]
        == len(candidates.mounts)
        == len({m.name for m in candidates.mounts})
    )
    assert candidates.sensors == site.sensors
    for sensor, mount in zip(candidates.sensors, candidates.mounts, strict=True):
        assert np.hypot(*(sensor.position - mount.position)[:2]) <= MAX_MOUNT_DISTANCE_M
        assert mount.min_height <= sensor.position[2] - mount.position[2] <= mount.max_height
    assert (candidates.at(*candidates.factors.T) == np.arange(len(candidates))).all()
    assert candidates.mount_prices.tolist() == [mount.price for mount in candidates.mounts]


def test_sensors_of_either_model_have_mounts_wherever_they_stand():
    sensor = Sensor("mast", DepthCamera(), look((5.0, 5.0, 12.0), 0.3, 0.2))
    (mount,) = paper_candidates(square(sensors=(sensor,))).mounts
    assert mount.name == "mast_mount"
    assert mount.position.tolist() == [5.0, 5.0, 0.0]
    assert mount.max_height == 12.0
    script = (
        "from placement_env.candidates.candidates import pool; from toolkit.sites.files import "
        "load_site;print(pool(load_site('tjunction')).select(range(99)).digest())"
    )
    told = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=True
    ).stdout.strip()
    assert told == pool(load_site("tjunction")).select(range(99)).digest()
    for seed in range(2):
        candidates = paper_candidates(random_site(seed))
        heading, tilt, model = candidates.factors.T[2:]
        rebuilt = [
            look(s.position, float(y), float(t))
            if isinstance(m, DepthCamera)
            else pose(*s.position, yaw=y, pitch=t)
            for s, y, t, m in zip(
                candidates.sensors,
                candidates.axes.headings[heading],
                candidates.axes.tilts[tilt],
                (candidates.axes.models[k] for k in model),
                strict=True,
            )
        ]
        assert np.allclose([s.pose for s in candidates.sensors], rebuilt, atol=1e-5)


@pytest.mark.parametrize("name", BUILT_IN)
def test_built_in_pools_have_40_mounts_and_2000_poses_in_range(built_in_pools, name):
    candidates = built_in_pools[name]
    assert len(candidates) >= 2000
    assert len(np.unique(candidates.mount)) >= 40
    assert len({s.name for s in candidates.sensors}) == len(candidates)
    assert not any("/" in s.name for s in candidates.sensors)  # names of groups in a dataset
    height = np.array(
        [
            s.position[2] - candidates.mounts[m].position[2]
            for s, m in zip(candidates.sensors, candidates.mount, strict=True)
        ]
    )
    low, high = np.array([[m.min_height, m.max_height] for m in candidates.mounts])[
        candidates.mount
    ].T
    assert ((low - 1e-9 <= height) & (height <= high + 1e-9)).all()
    assert len(np.unique([s.pose for s in candidates.sensors], axis=0)) == len(candidates)


def test_each_pose_is_what_its_factors_say_on_mounts_outside_keep_out_areas():
    lidar = SpinningLidar(channels=4, azimuth_step=0.2, azimuth_fov=2.0)
    candidates = pool(
        square(), heights=(4.0, 6.0), headings=5, tilts=(0.1, 0.4), models=(DepthCamera(), lidar)
    )
    for sensor, (m, h, y, t, k) in zip(candidates.sensors, candidates.factors, strict=True):
        at = candidates.mounts[m].position + np.array([0.0, 0.0, candidates.axes.heights[h]])
        heading, tilt = float(candidates.axes.headings[y]), float(candidates.axes.tilts[t])
        expected = (
            look(at, heading, tilt) if k == 0 else pose(*map(float, at), yaw=heading, pitch=tilt)
        )
        assert np.allclose(sensor.pose, expected)
        assert sensor.model == candidates.axes.models[k]
    candidates = pool(square(), keep_out=[shapely.box(-1.0, -30.0, 30.0, 0.0)])
    assert [mount.name for mount in candidates.mounts] == ["p0"]
    mounts = (
        Mount("low", np.zeros(3), 3.0, 4.0),
        Mount("tall", np.array([1.0, 0.0, 0.0]), 7.0, 20.0),
    )
    candidates = pool(
        square(), mounts=mounts, heights=(4.5, 6.0, 9.0), headings=1, tilts=(0.0,), blind=True
    )
    assert [s.name for s in candidates.sensors] == [
        *("low_4.0m_h0_t0_camera", "tall_7.0m_h0_t0_camera", "tall_9.0m_h0_t0_camera")
    ]
    assert candidates.factors[:, 1].tolist() == [0, 1, 2]  # 7 m is what became of 6 m, not of 4.5 m


def test_blind_poses_go():
    site = square()
    some, every = (pool(site, heights=(6.0,), tilts=(0.1,), blind=blind) for blind in (False, True))
    assert len(every) == 3 * 8
    gone = {s.name for s in every.sensors} - {s.name for s in some.sensors}
    assert gone == {f"p{m}_6.0m_h{h}_t6_camera" for m in range(3) for h in (225, 270, 315)}
    assert some.at(0, 0, 6, 0, 0) == -1
    assert every.sensors[every.at(0, 0, 6, 0, 0)].name == "p0_6.0m_h270_t6_camera"


def test_every_pose_and_model_has_a_name():
    models = (DepthCamera(), DepthCamera(fov=1.0), SpinningLidar(channels=2))
    candidates = pool(
        square(1), headings=720, heights=(6.0,), tilts=(0.2,), models=models, blind=True
    )
    assert len({s.name for s in candidates.sensors}) == len(candidates) == 720 * 3
    assert candidates.sensors[3].name == "p0_6.0m_h0.5_t11_camera0"
    assert candidates.sensors[5].name == "p0_6.0m_h0.5_t11_lidar"


def test_candidates_are_chosen_by_name():
    with pytest.raises(ValueError, match="no sensors of its own"):
        paper_candidates(square())
    with pytest.raises(ValueError, match="has no mount"):
        pool(square(0))
    assert choose_candidates(SITE, "paper").digest() == paper_candidates(SITE).digest()
    assert choose_candidates(SITE, "pool").digest() == pool(SITE).digest()
    lidar = SpinningLidar()
    assert {sensor.model for sensor in choose_candidates(SITE, "pool", [lidar]).sensors} == {lidar}
    with pytest.raises(ValueError, match="have their models"):
        choose_candidates(SITE, "paper", [lidar])
    with pytest.raises(FileNotFoundError):
        choose_candidates(SITE, "nowhere.geojson")


@pytest.mark.parametrize(
    "change",
    [
        *(
            {"heights": (4.0,)},
            {"headings": 9},
            {"tilts": (0.1,)},
            {"models": (DepthCamera(sigma=0.02),)},
        ),
        {"mounts": tuple(replace(m, price=9.0) for m in square().mounts)},
        {"mounts": tuple(replace(m, capacity=9.0) for m in square().mounts)},
        *(
            {"mounts": tuple(replace(m, position=m.position + 1e-6) for m in square().mounts)},
            {"blind": True},
        ),
    ],
)
def test_digest_changes_with_all_it_depends_on(change):
    assert pool(square(), **change).digest() != pool(square()).digest()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        *(({"heights": ()}, "at least one height"), ({"headings": 0}, "at least one height")),
        *(({"tilts": (15.0,)}, "np.deg2rad"), ({"heights": (-1.0,)}, "not negative")),
        *(
            ({"mounts": ()}, "has no mount outside"),
            ({"mounts": square().mounts * 2}, "rename one"),
        ),
        (
            {"headings": 1, "mounts": (Mount("far", np.array([90.0, 0.0, 0.0])),)},
            "no pose sees the area",
        ),
    ],
)
def test_bad_arguments_are_refused_in_one_line(arguments, message):
    with pytest.raises(ValueError, match=message) as error:
        pool(square(), **arguments)
    assert "\n" not in str(error.value)


def test_own_sensors_come_first():
    made = own_and_random(SITE, 12, np.random.default_rng(0))
    assert made.sensors[: len(SITE.sensors)] == SITE.sensors
    assert len(made) == len(SITE.sensors) + 12
    assert made.mount[: len(SITE.sensors)].tolist() == list(range(len(SITE.sensors)))
    assert made.mount[len(SITE.sensors) :].min() >= len(SITE.sensors)
    again = own_and_random(SITE, 12, np.random.default_rng(0))
    assert [s.name for s in again.sensors] == [s.name for s in made.sensors]
    assert len(own_and_random(SITE, 0, np.random.default_rng(0))) == len(SITE.sensors)


def test_bare_sites_have_random_poses_and_counts_are_checked():
    bare = replace(SITE, sensors=())
    assert len(own_and_random(bare, 5, np.random.default_rng(0))) == 5
    for poses in (0, 10**6):
        with pytest.raises(ValueError, match=f"poses must be 1 to the .* got {poses}"):
            own_and_random(bare, poses, np.random.default_rng(0))


def test_half_of_the_random_sets_are_of_the_sites_sensors():
    own = len(SITE.sensors)
    made = own_and_random(SITE, 30, np.random.default_rng(1))
    sets = random_sets(made, own, 40, np.random.default_rng(2))
    of_own, of_pool = sets[:, :own].any(axis=1), sets[:, own:].any(axis=1)
    assert (of_own ^ of_pool).all()
    assert of_pool.sum() == 20
    assert 10 < of_own.sum() <= 20
    assert (made.per_mount(sets) <= 1).all()
    assert 1 <= sets.sum(axis=1).min() <= sets.sum(axis=1).max() <= MAX_RANDOM_POSES
    assert len(np.unique(sets, axis=0)) == len(sets)
    assert random_sets(made, 0, 10, np.random.default_rng(2)).sum(axis=1).min() >= 1
