"""What a surrogate was fitted to, and that it says so where it is asked about something else."""

import numpy as np
import pytest

from placement_env.fidelity.hit_model import HitDomain, build_domain

DOMAIN = HitDomain(50.0, 100.0, ("DepthCamera",), 2, 30, 9)
NEAR = np.full((2, 50), 30.0, np.float32)


def test_domains_mention_what_lies_outside_alone():
    points = [np.array([[0.0, 10.0, 20.0]]), np.array([[30.0], [0.0]])]
    distance = [np.array([[99.0, 10.0, 20.0]]), np.array([[30.0], [99.0]])]
    found = build_domain(points, distance, ["b", "a", "b"], 7)
    assert (found.farthest, found.most_points) == (29.8, 29.8)
    assert (found.sensors, found.sites, found.objects, found.sets) == (("a", "b"), 2, 4, 7)
    with pytest.raises(ValueError, match="no sensor has a point on any object"):
        build_domain([np.zeros((2, 3))], [np.ones((2, 3))], [], 1)
    assert DOMAIN.outside(NEAR, NEAR, ["DepthCamera"]) == ()
    few = NEAR.copy()
    few[0, :5] = 999.0
    assert DOMAIN.outside(NEAR, few) == ()  # 5 %
    assert DOMAIN.outside(np.where(few > 100, 0, NEAR), few) == ()  # not seen
    assert DOMAIN.outside(NEAR, np.full_like(NEAR, 54.0)) == ()
    far = NEAR.copy()
    far[0, :25] = 56.0
    assert DOMAIN.outside(NEAR, far) == (
        (
            "25% of what the candidates see is beyond 50 m, farther than what the surrogate was "
            "fitted to"
        ),
    )
    said = DOMAIN.outside(np.full_like(NEAR, 500.0), NEAR, ["SpinningLidar", "DepthCamera"])
    assert said == (
        (
            "100% of what the candidates see has more than 100 points, more than what the "
            "surrogate was fitted to"
        ),
        "the surrogate was fitted to DepthCamera, not to SpinningLidar",
    )


@pytest.mark.parametrize(
    "change", [{"farthest": 0.0}, {"sites": True}, {"most_points": "9"}, {"sensors": (3,)}]
)
def test_what_is_no_domain_is_refused(change):
    with pytest.raises((TypeError, ValueError)):
        HitDomain(**vars(DOMAIN) | change)
