"""Time and memory of the published network as published, ours of the same size, and the light one, on one fused cloud.

python tests/benchmarks/bench_voxelnet.py [--threads 2] [--rounds 5]
"""

from __future__ import annotations

import numpy as np

# x y heading of the T-junction's six sensors, and footprints (xmin ymin xmax ymax, height) of what stands around it
SENSORS = ((40.9, 8.1, 155), (-7.7, 21.9, 295), (-45.6, 10.1, 15), (8.0, 5.6, 52), (-8.3, 18.5, 208), (-5.5, -27.5, 64))
SOLIDS = (
    (-38.6, -4.5, -27.7, 5.9, 4), (-26.5, -6.2, -14.7, 6.2, 5), (-26.5, -17.4, -14.7, -6.2, 8),
    (-49, -29, -28, -4.8, 12), (-28.8, -29, -19, -19.4, 8), (-40, 21, 40, 24, 6), (36, -19, 40, 5, 3),
)  # fmt: skip


def fused_cloud(seed: int = 0) -> np.ndarray:
    """About 76,000 points (n, 3) float32 that six depth cameras would see of a T-junction with 30 cars, site frame."""
    rng = np.random.default_rng(seed)
    boxes = np.array([*SOLIDS, *(_car(rng) for _ in range(30))])
    clouds = [_seen(np.array([x, y, 5.2]), np.radians(heading), boxes) for x, y, heading in SENSORS]
    points = np.concatenate(clouds)
    points += rng.normal([0, 0, 0.03], 0.02, points.shape)
    inside = (np.abs(points[:, 0]) < 40) & (np.abs(points[:, 1]) < 20) & (points[:, 2] > 0) & (points[:, 2] < 4)
    return points[inside].astype(np.float32)


def _car(rng: np.random.Generator) -> tuple[float, ...]:
    if rng.random() < 0.7:
        x, y, half = rng.uniform(-38, 38), rng.choice([11.6, 15.6]) + rng.normal(0, 0.3), (2.1, 0.9)
    else:
        x, y, half = rng.choice([-2.8, 1.2]) + rng.normal(0, 0.3), rng.uniform(-18, 6), (0.9, 2.1)
    return x - half[0], y - half[1], x + half[0], y + half[1], 1.5


def _seen(eye: np.ndarray, heading: float, boxes: np.ndarray, tilt: float = 0.2) -> np.ndarray:
    """Where 200 x 150 rays first meet the ground or a box."""
    u, v = np.meshgrid((np.arange(200) - 99.5) / 100, (np.arange(150) - 74.5) / 100)
    forward, up = np.cos(tilt) - v * np.sin(tilt), -np.sin(tilt) - v * np.cos(tilt)
    ray = np.stack(
        (forward * np.cos(heading) + u * np.sin(heading), forward * np.sin(heading) - u * np.cos(heading), up)
    )
    ray = ray.reshape(3, -1).T + 1e-12
    distance = np.where(ray[:, 2] < 0, -eye[2] / ray[:, 2], 200.0)
    for xmin, ymin, xmax, ymax, top in boxes:
        lower, upper = (np.array([xmin, ymin, 0]) - eye) / ray, (np.array([xmax, ymax, top]) - eye) / ray
        near, far = np.minimum(lower, upper).max(1), np.maximum(lower, upper).min(1)
        hit = (near < far) & (near > 0) & (near < distance)
        distance[hit] = near[hit]
    return eye + distance[:, None] * ray
