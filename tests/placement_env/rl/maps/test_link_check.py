import numpy as np
import pytest

from placement_env.candidates.candidates import Candidates
from placement_env.candidates.pool import pool
from placement_env.fidelity.traffic import Traffic
from placement_env.fidelity.visibility import see
from placement_env.rl.maps.link_check import TRAFFIC_SHARE, sent_when_empty
from toolkit.objects import Objects
from toolkit.sensors.depth_camera import DepthCamera
from toolkit.sites.site import Mount, Site, Solid
from toolkit.traffic.snapshots import Snapshot

HOUSE = Solid(np.array([[-4.0, 4.0], [2.0, 4.0], [2.0, 8.0], [-4.0, 8.0]]), -0.2, 3.0)
MOUNTS = tuple(Mount(f"m{k}", np.array([-18.0, 6.0 * k - 6, 0.0])) for k in range(3))
SITE = Site("house", np.array([-20.0, -14, 20, 14]), solids=(HOUSE,), mounts=MOUNTS)


def candidates() -> Candidates:
    return pool(SITE, heights=(5.0,), headings=1, tilts=(0.2,), models=(DepthCamera(width=80, height=60),))


def test_what_is_sent_of_the_empty_site():
    some = candidates()
    nobody = Snapshot(Objects(np.zeros((0, 7)), np.zeros(0, np.int64)), np.zeros(0, np.int64), 0.0)
    kbit = see(Traffic(SITE, (), (nobody,)), some).sent[:, 0] * 96 / 1000
    assert kbit.min() > 1
    assert TRAFFIC_SHARE == 1.05
    sent = sent_when_empty(SITE, some)
    assert sent((0, 1, 2)) == pytest.approx(1.05 * kbit)
    assert sent((1,)) == pytest.approx(1.05 * kbit[[1]])
    assert sent(()).tolist() == []
