"""Frames on level ground, ready to train a network."""

from collections.abc import Iterable, Iterator
from typing import NamedTuple

import numpy as np

from toolkit.arrays import Float32
from toolkit.calibration.place import Corners, Place, crop_points
from toolkit.frame import Frame
from toolkit.objects import Objects

OBJECT_MARGIN_M = 5.0  # around the area, so that objects on its edge are kept


class LevelFrame(NamedTuple):
    """Frame on level ground (z = 0), ready to train a network.

    x and y are counted from the middle of the detection area.

    Attributes:
        sensors: names of the frame's sensors.
        clouds: points (m) of each sensor, in the area and below 4 m.
        objects: objects whose centres are in the area or up to `OBJECT_MARGIN_M` outside it.
        area: xmin ymin xmax ymax (m), around the origin."""

    sensors: tuple[str, ...]
    clouds: tuple[Float32[np.ndarray, "_ 3"], ...]
    objects: Objects
    area: Corners


def level_frames(frames: Iterable[Frame], place: Place) -> Iterator[LevelFrame]:
    """Yield the frames of a recording on level ground, z = 0.

    place: detection area, and how its ground is found; None as method means a map of heights.
    Frames without points are left out, and frames without ground if a ground is looked for. Points
    outside the region with complete labels, in KITTI outside the camera's image, are left out:
    nobody labelled them, so they must not be learnt as background."""
    x, y = place.half
    method = place.level or "map"
    for frame, stand in Place(method, place.still, place.area).stands(frames):
        if not any(len(cloud.points) for cloud in frame.clouds):
            continue
        if stand.ground is None and method != "none":
            continue
        clouds = []
        for cloud in frame.clouds:
            points = cloud.in_world()
            # a point is in the region with complete labels if a small box around it is
            small = np.column_stack([points, np.full((len(points), 3), 0.1), np.zeros(len(points))])
            complete = points[frame.complete.covers(small)]
            clouds.append(crop_points(stand.lift(complete), stand.area))
        boxes = frame.objects.boxes - np.array([*stand.middle, 0, 0, 0, 0, 0])
        if stand.ground is not None and len(boxes):
            boxes = stand.ground.boxes(boxes)
        is_near = (np.abs(boxes[:, :2]) <= np.array([x, y]) + OBJECT_MARGIN_M).all(axis=1)
        objects = Objects(boxes, frame.objects.labels, frame.objects.ids)[np.asarray(is_near)]
        names = tuple(sensor.name for sensor in frame.sensors)
        yield LevelFrame(names, tuple(clouds), objects, (-x, -y, x, y))
