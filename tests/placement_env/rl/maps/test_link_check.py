import numpy as np

from placement_env.candidates.candidates import Candidates
from placement_env.candidates.drawing import with_mounts
from placement_env.candidates.pool import pool
from placement_env.fidelity.traffic import Traffic
from placement_env.fidelity.visibility import see
from placement_env.rl.maps.link_check import TRAFFIC_SHARE, links_carry
from toolkit.objects import Objects
from toolkit.sensors.depth_camera import DepthCamera
from toolkit.sites.site import Mount, Site, Solid
from toolkit.traffic.snapshots import Snapshot

HOUSE = Solid(np.array([[-4.0, 4.0], [2.0, 4.0], [2.0, 8.0], [-4.0, 8.0]]), -0.2, 3.0)
MOUNTS = tuple(Mount(f"m{k}", np.array([-18.0, 6.0 * k - 6, 0.0])) for k in range(3))
SITE = Site("house", np.array([-20.0, -14, 20, 14]), solids=(HOUSE,), mounts=MOUNTS)


def candidates() -> Candidates:
    return pool(SITE, heights=(5.0,), headings=1, tilts=(0.2,), models=(DepthCamera(width=80, height=60),))


def test_links_carry_what_the_empty_site_sends():
    some = candidates()
    nobody = Snapshot(Objects(np.zeros((0, 7)), np.zeros(0, np.int64)), np.zeros(0, np.int64), 0.0)
    kbit = see(Traffic(SITE, (), (nobody,)), some).sent[:, 0] * 96 / 1000
    assert kbit.min() > 1
    enough = (kbit * TRAFFIC_SHARE + 0.01).tolist()
    assert links_carry(SITE, with_mounts(some, [1.0] * 3, enough, [0.0]))((0, 1, 2)).all()
    narrow = [enough[0], kbit[1] * TRAFFIC_SHARE - 0.01, enough[2]]
    check = links_carry(SITE, with_mounts(some, [1.0] * 3, narrow, [0.0]))
    assert check((0, 1, 2)).tolist() == [True, False, True]
    assert check((1,)).tolist() == [False]
    assert check(()).tolist() == []
