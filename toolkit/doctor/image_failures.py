"""Failing sensors: frozen or blind.

A sensor is frozen if an image repeats an earlier one although its objects have left. It is blind
if it returns far less than usual while other sensors do not."""

from collections.abc import Iterator, Sequence

import numpy as np

from toolkit.arrays import Bool
from toolkit.boxes import count_points, iou_bev
from toolkit.datasets import published_layout as published
from toolkit.doctor.findings import Finding
from toolkit.doctor.moving_points import Rows
from toolkit.doctor.sensor_images import SensorImages
from toolkit.sites.site import Site

MIN_OBJECT_POINTS = 20  # least number of points that show an object
USUAL_QUANTILE = 0.9  # quantile, over the frames, of the number of returns that counts as usual
MAX_BLIND_SHARE = 0.5  # share of the usual number of returns below which a sensor is blind


def frozen_frames(
    view: SensorImages, rows: Sequence[Rows], site: Site
) -> Bool[np.ndarray, " frames"]:
    """Mask of frames in which a sensor repeats an image whose objects have left.

    Args:
        view: images of the sensor in the frames that are looked at.
        rows: published rows of the objects in each such frame.
        site: site of the recording."""
    is_frozen = np.zeros(len(view.depth), bool)
    original_frame = 0  # index of the frame that first had the image that is repeated
    for k in range(1, len(view.depth)):
        # an image without any return repeats nothing
        is_repeated = view.depth[k].any() and np.array_equal(view.depth[k], view.depth[k - 1])
        if not is_repeated:
            original_frame = k
            continue
        old_boxes = published.parse_rows(rows[original_frame], site.map_SE3_site).boxes
        boxes = published.parse_rows(rows[k], site.map_SE3_site).boxes
        # old boxes whose places no box overlaps any more
        left_boxes = old_boxes[~(iou_bev(old_boxes, boxes) > 0).any(axis=1)]
        point_counts = count_points(view.points(k), left_boxes)
        is_frozen[k] = bool((point_counts >= MIN_OBJECT_POINTS).any())
    return is_frozen


def blind_frames(views: Sequence[SensorImages]) -> Bool[np.ndarray, "sensors frames"]:
    """Mask of the frames in which a sensor, unlike others, has far fewer returns than usual.

    views: images of each sensor in the same frames. Axes of the mask: sensor, frame."""
    return_counts = np.array([(view.depth > 0).sum(axis=1) for view in views])  # sensor, frame
    usual_counts = np.quantile(return_counts, USUAL_QUANTILE, axis=1)[:, None]
    has_few_returns = return_counts < MAX_BLIND_SHARE * usual_counts
    # a frame in which all sensors return little shows an empty scene
    return np.asarray(has_few_returns & ~has_few_returns.all(axis=0))


def failing_sensors(
    views: Sequence[SensorImages], rows: Sequence[Rows], site: Site, frames: Sequence[int]
) -> Iterator[Finding]:
    """Yield a warning for each sensor that freezes or goes blind.

    Args:
        views: images of each sensor in the frames that are looked at.
        rows: published rows of the objects in each such frame.
        site: site of the recording.
        frames: numbers of the frames in the file."""
    if not views or not frames:
        return
    for view, is_blind in zip(views, blind_frames(views), strict=True):
        is_frozen = frozen_frames(view, rows, site)
        failures = (  # mask of the frames, suspected failure in words, its symptom in words
            (is_frozen, "it is frozen", "show objects where nobody is any more"),
            (
                is_blind,
                "it goes blind",
                "return less than half of what is usual, other sensors see as ever",
            ),
        )
        for is_failing, suspected, symptom in failures:
            if is_failing.any():
                first_frame = frames[int(is_failing.argmax())]
                evidence = (
                    f"{int(is_failing.sum())} of {len(frames)} frames that were looked at, "
                    f"the first is {first_frame}, {symptom}"
                )
                remedy = "leave these frames out, or the sensor"
                yield Finding(
                    severity="warning",
                    where=f"sensor {view.sensor.name}",
                    suspected=suspected,
                    evidence=evidence,
                    remedy=remedy,
                )
