"""Sensors that miss boxes.

A box is missed if a sensor sees the ground just in front of the box, but no point on it. Every
sensor misses a few. If one misses many that others see, its pose is wrong or its points were
lost."""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from toolkit.arrays import BoxRows, Float64, Mask, Points
from toolkit.boxes import count_points
from toolkit.calibration.ground import Ground
from toolkit.doctor.box_fits import MIN_FITTED_BOXES, GroundView
from toolkit.doctor.findings import Finding
from toolkit.doctor.sensor_clouds import sensor_names
from toolkit.frame import SensorCloud

# least number of points on the ground in front of a box that show that a sensor sees it
MIN_FRONT_POINTS = 5
FRONT_M = 2.0  # distance from the front of a box in which they are
MARGIN_M = 0.1  # distance that a point may be outside its box
GROUND_BAND_M = 0.2  # largest height of a point on the ground, above or below it
MIN_MISSED_SHARE = 0.5  # least share of missed boxes of a suspected sensor
MAX_USUAL_MISSED_SHARE = 0.2  # largest share of missed boxes of a sound sensor


class _Visibility(NamedTuple):
    """Visibility of a frame's boxes to one sensor.

    Attributes:
        must_see: mask of the boxes that it must see.
        is_hit: mask of the boxes that it has a point on."""

    must_see: Mask
    is_hit: Mask


def suspect_missed_boxes(views: Sequence[GroundView]) -> Iterator[Finding]:
    """Find sensors without points on boxes that they must see and other sensors see.

    views: frames with their ground. Nothing is found unless another sensor misses few boxes."""
    names = sensor_names([view.sample for view in views])
    if len(names) < 2:
        return
    # numbers of boxes, by name of the sensor: boxes that it must see, and boxes that it misses
    expected_counts = dict.fromkeys(names, 0)
    missed_counts = dict.fromkeys(names, 0)
    for view in views:
        sample = view.sample
        if view.ground is None or not len(sample.objects):
            continue
        visibilities = {
            cloud.name: _mark_visible_boxes(cloud, sample.objects.boxes, view.ground)
            for cloud in sample.clouds
        }
        for name, visibility in visibilities.items():
            other_hits = [
                other.is_hit for other_name, other in visibilities.items() if other_name != name
            ]
            no_hits = np.zeros(len(visibility.is_hit), bool)  # for a sensor that is alone
            is_expected = visibility.must_see & np.any([no_hits, *other_hits], axis=0)
            expected_counts[name] += int(is_expected.sum())
            missed_counts[name] += int((is_expected & ~visibility.is_hit).sum())
    missed_shares = {
        name: missed_counts[name] / expected_counts[name]
        for name in names
        if expected_counts[name] >= MIN_FITTED_BOXES
    }
    sound_names = [name for name, share in missed_shares.items() if share <= MAX_USUAL_MISSED_SHARE]
    for name, share in missed_shares.items():
        if share >= MIN_MISSED_SHARE and sound_names:
            evidence = (
                f"{missed_counts[name]} of {expected_counts[name]} boxes in front of which it sees "
                "the ground"
            )
            words = "boxes hold points of other sensors, and none of this one"
            remedy = "check its pose, its times, and whether its points are whole"
            yield Finding(
                severity="error",
                where=f"sensor {name}",
                suspected=words,
                evidence=evidence,
                remedy=remedy,
            )


def _mark_visible_boxes(cloud: SensorCloud, boxes: BoxRows, ground: Ground) -> _Visibility:
    """Mark the boxes that a sensor must see, and the boxes that it has a point on.

    It must see a box if it measured the ground between itself and the box, within `FRONT_M` of the
    box and within its inner half as seen from the sensor. cloud: the sensor's; boxes: (m, 7) in
    the world frame."""
    points = cloud.in_world()
    heights = points[:, 2] - ground.height(points[:, :2])  # above the ground (m)
    # x, y, z, length, width, height, yaw: a margin on all sides
    boxes_with_margin = boxes + np.array([0, 0, 0, 2, 2, 2, 0]) * MARGIN_M
    points_above = points[heights > GROUND_BAND_M]
    is_hit = count_points(points_above, boxes_with_margin) > 0
    ground_points = points[np.abs(heights) < GROUND_BAND_M]
    position = cloud.world_SE3_sensor[:2, 3]
    must_see = [_sees_front(ground_points, position, box) for box in boxes]
    return _Visibility(must_see=np.array(must_see, bool), is_hit=is_hit)


def _sees_front(
    ground_points: Points, position: Float64[np.ndarray, "2"], box: Float64[np.ndarray, "7"]
) -> bool:
    """Return True if a sensor has points on the ground just in front of a box.

    Args:
        ground_points: points (m) near the ground.
        position: x and y (m) of the sensor.
        box: x, y, z, length, width, height, yaw, in the same frame.

    Returns False for a box too close to the sensor."""
    length, width = box[3], box[4]
    yaw = box[6]
    # unit vectors in the plane: from the sensor to the box, and to its left
    to_box = box[:2] - position
    distance = float(np.hypot(*to_box))
    ahead = to_box / max(distance, 1e-9)
    aside = np.array([-ahead[1], ahead[0]])
    # unit vectors along the box, and across it
    heading = np.array([np.cos(yaw), np.sin(yaw)])
    across = np.array([-heading[1], heading[0]])
    # half of the box's extent (m) along and across the view
    half_depth = abs(heading @ ahead) * length / 2 + abs(across @ ahead) * width / 2
    half_width = abs(heading @ aside) * length / 2 + abs(across @ aside) * width / 2
    front_distance = distance - half_depth  # from the sensor to the box's front
    if distance <= half_depth + FRONT_M:
        return False
    offsets = ground_points[:, :2] - position  # from the sensor (m)
    along_view = offsets @ ahead
    is_in_front = (along_view > front_distance - FRONT_M) & (along_view < front_distance)
    is_in_inner_half = np.abs(offsets @ aside) < half_width / 2
    return int((is_in_front & is_in_inner_half).sum()) >= MIN_FRONT_POINTS
