"""A large pool is narrowed to the poses that see most, on poles that see most; kept poles stay."""

from dataclasses import replace

import numpy as np
import pytest

from placement_env.cases import Cases
from placement_env.search import first_look
from placement_env.search.first_look import describe_narrowing, narrow_pool, prepare_first_look
from placement_env.setting import Setting
from toolkit.runtime.run import Run


@pytest.fixture(scope="module")
def few():
    return prepare_first_look(
        Setting("tjunction", candidates="pool", cases=Cases()), Run(frames=24, seed=3)
    )


@pytest.mark.slow
def test_the_first_look_has_a_few_frames(few):
    assert few.visibility.frames == first_look.LOOK_FRAMES


def test_a_pool_that_can_be_searched_stays_whole(few):
    assert len(few.setting.pool) <= first_look.MAX_POSES
    assert narrow_pool(few.setting, few.run) is None


@pytest.mark.slow
def test_poles_and_poses_that_see_most_go_on(few, limits):
    limits(first_look, MAX_POSES=200)
    pool = few.setting.pool
    chosen = first_look.choose_at_first_look(few)
    assert chosen is not None
    assert len(chosen) == 200
    assert (np.diff(chosen) > 0).all()
    score = np.log1p(np.minimum(few.visibility.points, 299.0)).sum(axis=1)
    best = np.array([score[pool.mount == mount].max() for mount in range(len(pool.mounts))])
    assert set(pool.mount[chosen]) == set(range(len(pool.mounts)))
    assert score[chosen].max() == score.max()
    counts = np.bincount(pool.mount[chosen])
    assert counts[counts > 0].min() >= first_look.MIN_POSES_ON_POLE
    text = describe_narrowing(pool, chosen, 1000)
    assert text.startswith(
        f"48 poles with {len(pool):,} poses are too many to search: the 200 poses on 48 poles go on"
    )
    assert text.endswith("see most in the first 8 frames.")
    # a search of fewer frames looks at all, and says how many
    assert describe_narrowing(pool, chosen, 3).endswith("see most in the first 3 frames.")
    worst = int(np.argmin(best))
    kept = first_look.choose_poses(pool, score.astype(float), np.array([worst]))
    assert worst in pool.mount[kept]


def test_poles_are_thinned_evenly_and_kept_ones_stay(few, limits):
    limits(first_look, MAX_POLES=12)
    pool = few.setting.pool
    kept = pool.mounts[-1].name
    mounts = first_look.thin_poles(pool, replace(few.setting, keep=(kept,)))
    assert len(mounts) <= 12
    assert len(pool.mounts) - 1 in mounts
    feet = np.array([mount.position[:2] for mount in pool.mounts])
    gaps = np.linalg.norm(feet[:, None] - feet[mounts], axis=2).min(axis=1)
    assert gaps.max() < 40  # every pole left out has one that goes on nearby
    many = tuple(mount.name for mount in pool.mounts[:20])
    mounts = first_look.thin_poles(pool, replace(few.setting, keep=many))
    assert mounts.tolist() == list(range(20))  # more than go on otherwise, and no others
    limits(first_look, MAX_POSES=100)
    chosen = narrow_pool(few.setting, few.run)
    assert chosen is not None
    assert len(chosen) == 100
    assert len(np.unique(pool.mount[chosen])) <= 12
