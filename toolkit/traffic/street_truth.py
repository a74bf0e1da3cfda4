"""Trajectories of simulated road users, without frames and rays."""

import numpy as np

from toolkit.counting.trajectories import Trajectory, split_trajectories
from toolkit.traffic.continuous import ContinuousTraffic


def list_trajectories(traffic: ContinuousTraffic) -> list[Trajectory]:
    """Trajectories of the moving road users of continuous traffic, on level ground."""
    # frame of each row
    frames = np.repeat(np.arange(len(traffic)), np.diff(traffic.begin))
    # body and id of each traveller
    bodies = np.array([traveller.body for traveller in traffic.travellers], np.int64)
    ids = np.array([traveller.id for traveller in traffic.travellers], np.int64)
    return split_trajectories(
        ids=ids[traffic.traveller],
        labels=traffic.labels[bodies[traffic.traveller]],
        boxes=traffic.boxes,
        seconds=frames * traffic.interval,
    )
