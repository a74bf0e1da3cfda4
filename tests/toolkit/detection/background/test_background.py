"""The space an empty site fills."""

import numpy as np
import pytest

from toolkit.detection.background.background import Background


def slab(step=0.1):
    """A street at 0 with a wall along x = 5 from 0 to 3 m."""
    x, y = np.meshgrid(np.arange(-5, 5, step), np.arange(-5, 5, step))
    ground = np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)])
    y, z = np.meshgrid(np.arange(-5, 5, step), np.arange(0, 3, step))
    return np.concatenate([ground, np.column_stack([np.full(y.size, 5.0), y.ravel(), z.ravel()])])


def test_it_holds_what_lies_in_or_beside_its_voxels_and_nothing_else():
    background = Background.learn(slab())
    own = slab() + np.random.default_rng(0).normal(0, 0.03, slab().shape)
    assert background.holds(own).all()
    above = np.array([[0.0, 0, 0.5], [0, 0, 3.0], [4.5, 0, 1.0], [-40, 0, 0], [0, 0, -5]])
    assert not background.holds(above).any()
    assert background.holds(np.array([[0.0, 0, 0.14], [4.87, 0, 1.0]])).all()


@pytest.mark.parametrize(
    "points", [np.zeros((0, 3)), np.full((3, 3), np.nan), np.array([[0.0, 0, 0], [1e5, 1e5, 1e5]])]
)
def test_a_background_that_is_none_is_refused(points):
    with pytest.raises(ValueError, match="background"):
        Background.learn(points)


def test_the_digest_is_of_all_it_holds():
    background = Background.learn(slab())
    assert background.digest == Background.learn(slab()).digest
    others = [Background.learn(slab()[:-600]), Background.learn(slab(), voxel=0.2), Background.learn(slab(), cell=2.0)]
    moved = slab()
    moved[:, 0] += 0.01
    others.append(Background.learn(moved))
    assert len({background.digest, *(each.digest for each in others)}) == 5
