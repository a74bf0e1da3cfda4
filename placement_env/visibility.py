"""`Visibility`: how many points each candidate has on each vehicle, and how many it sends, without its noise.

A point counts for a vehicle when it lies on it and in the crop, which is what `toolkit.boxes.count_points` counts in
the cropped cloud but for the few points of the ground that uneven ground lifts into the foot of a box.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from placement_env.candidates import Candidates
from placement_env.traffic_frames import Traffic, scored
from toolkit.arrays import Float32, Float64, Int64
from toolkit.fusion import hybrid_radius
from toolkit.points import beyond, inside, unproject
from toolkit.sensors import Sensor

BLOCK = 50  # candidates


@dataclass(frozen=True, eq=False)
class Visibility:
    """What C candidates see of the O scored objects (vehicles centred in the area) of F frames, frame after frame.

    points: on each object inside the crop; nearest: m from the sensor to the object's centre, whether or not it is
    seen; frame: of each object, ascending; boxes: of the objects; sent: points in the crop of each frame; far: those of
    them farther off than the radius of hybrid fusion, horizontally.
    """

    points: Float32[np.ndarray, "C O"]
    nearest: Float32[np.ndarray, "C O"]
    frame: Int64[np.ndarray, " O"]
    boxes: Float64[np.ndarray, "O 7"]
    sent: Float32[np.ndarray, "C F"]
    far: Float32[np.ndarray, "C F"]

    @property
    def frames(self) -> int:
        """How many frames."""
        return self.sent.shape[1]

    def __len__(self) -> int:
        return len(self.points)

    def select(self, indices: Sequence[int] | Int64[np.ndarray, " n"]) -> Visibility:
        """What some of the candidates see, in the order given."""
        chosen = np.asarray(indices, np.int64)
        per_candidate = (self.points[chosen], self.nearest[chosen])
        return Visibility(*per_candidate, self.frame, self.boxes, self.sent[chosen], self.far[chosen])


def see(
    traffic: Traffic,
    candidates: Candidates,
    *,
    workers: int = 1,
    progress: Callable[[int], None] | None = None,
    cache: str | Path | None = None,
) -> Visibility:
    """What the candidates see of the traffic. progress: told how many candidates are done."""
    blocks = [range(first, min(first + BLOCK, len(candidates))) for first in range(0, len(candidates), BLOCK)]
    seen = []
    for block in blocks:
        seen.append(_render(traffic, [candidates.sensors[c] for c in block]))
        if progress:
            progress(block.stop)
    frame, boxes = scored_boxes(traffic)
    points, sent, far = (np.concatenate(parts) for parts in zip(*seen, strict=True))
    return Visibility(points, nearest(candidates.sensors, boxes), frame, boxes, sent, far)


def scored_boxes(traffic: Traffic) -> tuple[Int64[np.ndarray, " O"], Float64[np.ndarray, "O 7"]]:
    """Frame and box of every scored object."""
    rows = [scored(snapshot.objects, traffic.site) for snapshot in traffic.snapshots]
    frame = np.repeat(np.arange(len(rows)), [int(row.sum()) for row in rows])
    chosen = [snapshot.objects.boxes[row] for snapshot, row in zip(traffic.snapshots, rows, strict=True)]
    return frame, np.concatenate([np.zeros((0, 7)), *chosen])


def nearest(sensors: Sequence[Sensor], boxes: Float64[np.ndarray, "O 7"]) -> Float32[np.ndarray, "C O"]:
    """Distance (m) from each sensor to the centre of each box."""
    positions = np.array([sensor.position for sensor in sensors]).reshape(-1, 1, 3)
    return np.linalg.norm(boxes[:, :3] - positions, axis=2).astype(np.float32)


def _render(traffic: Traffic, sensors: Sequence[Sensor]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    from toolkit.render import Renderer

    site = traffic.site
    renderer, radius = Renderer(site, traffic.bodies, sensors), hybrid_radius(site)
    points, sent, far = [], [], []
    for snapshot in traffic.snapshots:
        rows = scored(snapshot.objects, site)
        for sensor, depth, hits in zip(sensors, *renderer.render(snapshot), strict=True):
            xyz, valid = unproject(sensor, depth)
            keep = valid & inside(xyz.T, site.area, site.height)
            points.append(np.bincount(hits.ravel()[keep] + 1, minlength=len(rows) + 1)[1:][rows])
            sent.append(keep.sum())
            far.append(beyond(xyz.T[keep], sensor, radius).sum())
    of_sensor = [np.concatenate(points[s :: len(sensors)]) for s in range(len(sensors))]
    per_frame = (np.reshape(each, (-1, len(sensors))).T.astype(np.float32) for each in (sent, far))
    return np.array(of_sensor, np.float32), *per_frame
