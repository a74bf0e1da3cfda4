"""Candidates as people name them."""

import pytest

from placement_env.candidates.choice import chosen_candidates
from placement_env.candidates.pool import paper_candidates, pool
from toolkit.sensors.models import SpinningLidar
from toolkit.sites.files import load_site

SITE = load_site("tjunction")


def test_by_name():
    assert chosen_candidates(SITE, "paper").digest() == paper_candidates(SITE).digest()
    assert chosen_candidates(SITE, "pool").digest() == pool(SITE).digest()


def test_models_are_for_poses_that_are_free():
    lidar = SpinningLidar()
    assert {sensor.model for sensor in chosen_candidates(SITE, "pool", [lidar]).sensors} == {lidar}
    with pytest.raises(ValueError, match="have their models"):
        chosen_candidates(SITE, "paper", [lidar])
    with pytest.raises(FileNotFoundError):
        chosen_candidates(SITE, "nowhere.geojson")
