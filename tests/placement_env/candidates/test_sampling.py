"""Random sets: of the site's own sensors and of poses of its pool, one to a mount, the same for the same seed."""

from dataclasses import replace

import numpy as np
import pytest

from placement_env.candidates.sampling import MOST_POSES, own_and_random, random_sets
from toolkit.sites.files import load_site

SITE = load_site("tjunction")


def test_own_sensors_come_first_on_mounts_of_their_own():
    made = own_and_random(SITE, 12, np.random.default_rng(0))
    assert made.sensors[: len(SITE.sensors)] == SITE.sensors
    assert len(made) == len(SITE.sensors) + 12
    assert made.mount[: len(SITE.sensors)].tolist() == list(range(len(SITE.sensors)))
    assert made.mount[len(SITE.sensors) :].min() >= len(SITE.sensors)
    again = own_and_random(SITE, 12, np.random.default_rng(0))
    assert [s.name for s in again.sensors] == [s.name for s in made.sensors]
    assert len(own_and_random(SITE, 0, np.random.default_rng(0))) == len(SITE.sensors)


def test_a_site_without_sensors_has_its_pool_alone():
    bare = replace(SITE, sensors=())
    assert len(own_and_random(bare, 5, np.random.default_rng(0))) == 5
    for poses in (0, 10**6):
        with pytest.raises(ValueError, match=f"poses must be 1 to the .* got {poses}"):
            own_and_random(bare, poses, np.random.default_rng(0))


def test_half_of_the_sets_are_of_own_sensors_and_none_has_two_on_a_mount():
    own = len(SITE.sensors)
    made = own_and_random(SITE, 30, np.random.default_rng(1))
    sets = random_sets(made, own, 40, np.random.default_rng(2))
    of_own, of_pool = sets[:, :own].any(axis=1), sets[:, own:].any(axis=1)
    assert (of_own ^ of_pool).all()
    assert of_pool.sum() == 20
    assert 10 < of_own.sum() <= 20
    assert (made.per_mount(sets) <= 1).all()
    assert 1 <= sets.sum(axis=1).min() <= sets.sum(axis=1).max() <= MOST_POSES
    assert len(np.unique(sets, axis=0)) == len(sets)
    assert random_sets(made, 0, 10, np.random.default_rng(2)).sum(axis=1).min() >= 1
