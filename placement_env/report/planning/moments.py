"""Frames of the final traffic for pictures and the 3D scene of a report."""

import numpy as np

from placement_env.fidelity.detector import FALSE_ALARM, IGNORED, Detected
from placement_env.report import content
from toolkit.arrays import Float32

MOMENTS = 8  # frames of pictures
MOMENT_POINTS = 2500  # points of each sensor in such a frame, at most


def pick_moments(
    detected: Detected,
    members: tuple[int, ...],
    *,
    count: int = MOMENTS,
    points: int = MOMENT_POINTS,
    seed: int = 0,
) -> tuple[content.SceneMoment, ...]:
    """Pick the consecutive frames that have the most scored objects, the first run if several tie.

    Args:
        detected: Detector on the frames to pick from.
        members: Indices of the set's candidates.
        count: Number of frames, fewer if there are not as many.
        points: Most points to keep of each sensor's cloud.
        seed: Seed by which these points are drawn."""
    object_counts = np.array([detected.scored(k).sum() for k in range(detected.frames)], np.int64)
    count = min(count, detected.frames)
    # number of objects in every run of `count` frames, by its first frame
    run_counts = np.convolve(object_counts, np.ones(count, np.int64), mode="valid")
    first = int(run_counts.argmax())
    return tuple(
        build_scene_moment(detected, members, k, points, seed) for k in range(first, first + count)
    )


def build_scene_moment(
    detected: Detected, members: tuple[int, ...], k: int, points: int, seed: int
) -> content.SceneMoment:
    """Return frame k with its thinned clouds, objects and detections.

    Hits are at the detector's threshold `iou`.

    Args:
        detected: Detector on its frames.
        members: Indices of the set's candidates.
        k: Index of the frame.
        points: Most points of each cloud.
        seed: Each cloud is drawn from this number, the frame and the candidate."""
    (outcome,) = detected.outcomes([members], [k])[members]  # one for each frame
    # for each detection the index of the object that it hits
    truth = outcome.truth[detected.ious.index(detected.iou)]
    objects = detected.renders.objects(k)
    is_scored = detected.scored(k)
    scored_indices = np.flatnonzero(is_scored)
    is_hit = np.zeros(len(objects), np.bool_)
    # `truth` counts scored objects only, from 0; negative numbers mean no hit
    is_hit[scored_indices[truth[truth > FALSE_ALARM]]] = True
    return content.SceneMoment(
        clouds=tuple(thin(detected.renders.clouds(k, c), points, [seed, k, c]) for c in members),
        truth=objects,
        detections=detected.detections(members, k),
        truth_hit=is_hit,
        truth_ignored=~is_scored,
        detection_hit=truth >= 0,
        detection_ignored=truth == IGNORED,
    )


def thin(
    cloud: Float32[np.ndarray, "n 3"], points: int, seed: list[int]
) -> Float32[np.ndarray, "m 3"]:
    """Draw at most `points` points of a cloud without replacement; they keep their order.

    A cloud without more points comes back unchanged. cloud: x, y, z (m); seed: numbers that decide
    the draw together."""
    if len(cloud) <= points:
        return cloud
    rng = np.random.default_rng(seed)
    kept_indices = rng.choice(len(cloud), points, replace=False)
    return cloud[np.sort(kept_indices)]
