"""Trajectories of simulated road users, without frames and rays."""

import numpy as np

from toolkit.counting.trajectories import Trajectory, split_trajectories
from toolkit.traffic.continuous import ContinuousTraffic


def list_trajectories(traffic: ContinuousTraffic) -> list[Trajectory]:
    """Trajectories of the moving road users of continuous traffic, on level ground."""
    frames = np.repeat(np.arange(len(traffic)), np.diff(traffic.begin))
    bodies = np.array([traveller.body for traveller in traffic.travellers], np.int64)
    ids = np.array([traveller.id for traveller in traffic.travellers], np.int64)
    return split_trajectories(
        ids[traffic.traveller],
        traffic.labels[bodies[traffic.traveller]],
        traffic.boxes,
        frames * traffic.interval,
    )
