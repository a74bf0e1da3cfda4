"""Frames on level ground, ready to train a network."""

from collections.abc import Iterable, Iterator
from dataclasses import replace
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
    half_x, half_y = place.half
    method = place.level or "map"
    map_place = replace(place, level=method)
    for frame, stand in map_place.stands(frames):
        if not any(len(cloud.points) for cloud in frame.clouds):
            continue
        if stand.ground is None and method != "none":
            continue
        clouds = []
        for cloud in frame.clouds:
            points = cloud.in_world()
            # a point is in the region with complete labels if a small box (10 cm) around it is
            sizes = np.full((len(points), 3), 0.1)
            small_boxes = np.column_stack([points, sizes, np.zeros(len(points))])
            labelled_points = points[frame.complete.covers(small_boxes)]
            clouds.append(crop_points(stand.lift(labelled_points), stand.area))
        # only x and y, the first two columns of boxes, are counted from the middle
        boxes = frame.objects.boxes - np.array([*stand.middle, 0, 0, 0, 0, 0])
        if stand.ground is not None and len(boxes):
            boxes = stand.ground.boxes(boxes)
        max_distance = np.array([half_x, half_y]) + OBJECT_MARGIN_M
        is_near = (np.abs(boxes[:, :2]) <= max_distance).all(axis=1)
        objects = Objects(boxes, frame.objects.labels, frame.objects.ids)[np.asarray(is_near)]
        yield LevelFrame(
            sensors=tuple(sensor.name for sensor in frame.sensors),
            clouds=tuple(clouds),
            objects=objects,
            area=(-half_x, -half_y, half_x, half_y),
        )
