"""Sensors whose points are below the ground: their pose is wrong or missing."""

from collections.abc import Iterator, Sequence

import numpy as np

from toolkit.doctor.box_fits import GroundView
from toolkit.doctor.findings import Finding, report_error
from toolkit.doctor.sensor_clouds import find_cloud, sensor_names

MIN_BURIED_M = 1.0  # depth of a buried point below the ground that all sensors together show
MIN_BURIED_SHARE = 0.3  # least share of a sensor's points, which no ramp or ditch explains
MAX_USUAL_BURIED_SHARE = 0.05  # largest share of buried points of a sound sensor


def suspect_buried_points(views: Sequence[GroundView]) -> Iterator[Finding]:
    """Find sensors whose points are below the ground that other sensors see.

    views: frames with their ground, in the world frame. Nothing is found unless another sensor has
    hardly any points below it."""
    buried_shares: dict[str, float] = {}  # share of each sensor's points
    for name in sensor_names([view.sample for view in views]):
        heights_by_frame = [np.zeros(0)]  # heights (m) of points above the ground
        for view in views:
            cloud = find_cloud(view.sample, name)
            if cloud is not None and view.ground is not None:
                points = cloud.in_world()
                heights_by_frame.append(points[:, 2] - view.ground.height(points[:, :2]))
        heights = np.concatenate(heights_by_frame)
        if len(heights):
            buried_shares[name] = float((heights < -MIN_BURIED_M).mean())
    sound_names = [name for name, share in buried_shares.items() if share <= MAX_USUAL_BURIED_SHARE]
    for name, share in buried_shares.items():
        if share >= MIN_BURIED_SHARE and sound_names:
            evidence = (
                f"{share:.0%} of its points are more than {MIN_BURIED_M:g} m below it, of "
                f"{sound_names[0]}'s hardly any"
            )
            yield report_error(
                where=f"sensor {name}",
                suspected="its points are below the ground that others see",
                evidence=evidence,
                remedy="check its pose: its height, and which way is up",
            )
