"""IoU, points in boxes and AP at the sizes in which they occur.

python tests/benchmarks/toolkit/bench_boxes.py
"""

import numpy as np
from timing import report

from toolkit.boxes import count_points, iou_3d, nms
from toolkit.detection.metrics import evaluate
from toolkit.objects import Detections, Objects

BENCH = "toolkit/bench_boxes.py"


def cars(n: int, rng: np.random.Generator) -> np.ndarray:
    place = rng.uniform([-40, -20, 0.6], [40, 20, 0.9], (n, 3))
    return np.hstack(
        [place, rng.normal([4.3, 1.8, 1.5], 0.2, (n, 3)), rng.uniform(-np.pi, np.pi, (n, 1))]
    )


def scene(rng: np.random.Generator) -> tuple[Detections, Objects]:
    """Ten cars, each detected eight times over more or less well, and twenty false alarms."""
    truth = cars(10, rng)
    near = np.repeat(truth, 8, axis=0) + rng.normal(
        0, [0.2, 0.2, 0.05, 0.1, 0.05, 0.05, 0.05], (80, 7)
    )
    return Detections(np.vstack([near, cars(20, rng)]), rng.random(100)), Objects(truth)


def main() -> None:
    rng = np.random.default_rng(0)
    a, b = cars(300, rng), cars(300, rng)
    report(
        "iou_3d of 300 x 300 boxes",
        lambda: iou_3d(a, b),
        limit_ms=20.0,
        row=("`iou_3d`, 300 × 300 boxes", BENCH),
    )
    points = rng.uniform([-40, -20, 0], [40, 20, 4], (80_000, 3)).astype(np.float32)
    boxes = cars(30, rng)
    report(
        "count_points of 80,000 points in 30 boxes",
        lambda: count_points(points, boxes),
        limit_ms=5.0,
        row=("`count_points`, 80,000 points in 30 boxes", BENCH),
    )
    crowd = cars(20, rng)[rng.integers(0, 20, 300)] + rng.normal(0, 0.05, (300, 7))
    scores = rng.random(300)
    report("nms of 300 boxes in 20 places", lambda: nms(crowd, scores, 0.1), limit_ms=20.0)
    detections, truths = zip(*(scene(rng) for _ in range(1000)), strict=True)
    report(
        "AP of 1000 frames x 100 detections",
        lambda: evaluate(detections, truths, iou_thresholds=[0.7]),
        limit_ms=2000.0,
        repeats=3,
        row=("AP of 1000 frames × 100 detections", BENCH),
    )


if __name__ == "__main__":
    main()
