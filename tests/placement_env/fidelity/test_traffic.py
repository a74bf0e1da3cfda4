import pickle
from dataclasses import replace

import numpy as np
import pytest

from placement_env.analysis.intervals import BLOCK_FRAMES
from placement_env.fidelity.traffic import scored, simulate_traffic
from toolkit.objects import HEAVY, PEDESTRIAN, VEHICLE, Objects
from toolkit.sites.files import load_site
from toolkit.traffic.snapshots import Snapshot
from toolkit.traffic.spawner import LIFE


def test_seeds_give_frames_whose_objects_stay_in_their_block():
    site = load_site("tjunction")
    once, again, other = (simulate_traffic(site, 2, seed) for seed in (3, 3, 4))
    assert len(once) == 2
    assert once.digest() == again.digest() != other.digest()
    with pytest.raises(ValueError, match="frames must be a whole number of at least 1, got 0"):
        simulate_traffic(site, 0)
    assert BLOCK_FRAMES == 2 * LIFE
    frames = simulate_traffic(load_site("tjunction"), 5 * BLOCK_FRAMES, 3).snapshots
    blocks = [
        {
            name
            for frame in frames[first : first + BLOCK_FRAMES]
            for name in frame.objects.ids.tolist()
        }
        for first in range(0, len(frames), BLOCK_FRAMES)
    ]
    for n, block in enumerate(blocks):
        assert not any(block & later for later in blocks[n + 2 :])


def test_digests_know_what_can_be_seen_and_what_is_scored(small_traffic):
    digests = {
        small_traffic.digest(),
        replace(small_traffic, snapshots=small_traffic.snapshots[:-1]).digest(),
    }
    digests.add(replace(small_traffic, site=replace(small_traffic.site, height=3.0)).digest())
    digests.add(replace(small_traffic, bodies=small_traffic.bodies[::-1]).digest())
    first = small_traffic.snapshots[0]
    moved = Objects(first.objects.boxes + np.array([1e-9, 0, 0, 0, 0, 0, 0]), first.objects.labels)
    digests.add(replace(small_traffic, snapshots=(Snapshot(moved, first.bodies),)).digest())
    digests.add(replace(small_traffic, snapshots=(first,)).digest())
    assert len(digests) == 6
    assert pickle.loads(pickle.dumps(small_traffic)).digest() == small_traffic.digest()
    boxes = np.array([[x, 0, 1, 4, 2, 1.5, 0] for x in (0.0, 0, 0, 20, 20.1)])
    objects = Objects(boxes, np.array([VEHICLE, HEAVY, PEDESTRIAN, VEHICLE, VEHICLE]))
    assert scored(objects, small_traffic.site).tolist() == [True, False, False, True, False]
