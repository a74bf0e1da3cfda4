"""AP of the general weights on random junctions with random sensors, by the number of points on the vehicle.

    python tests/benchmarks/models/bench_general.py [--sites 20] [--frames 10] [--seed 9001] [--weights general]

Early fusion of all sensors, exact protocol. In each line only vehicles with so many points count, the others are
neither missed nor false alarms.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[3]))

BINS = ((0, 10), (10, 30), (30, 100), (100, 300), (300, 1000), (1000, np.inf), (0, np.inf))


def main() -> None:
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    for name, default in (("sites", 20), ("frames", 10), ("seed", 9001)):
        arguments.add_argument(f"--{name}", type=int, default=default)
    arguments.add_argument("--weights", default="general")
    asked = arguments.parse_args()

    from models import load_detector
    from toolkit.boxes import count_points
    from toolkit.datasets.dataset import noisy
    from toolkit.datasets.random_recordings import random_recording
    from toolkit.detection.metrics import evaluate
    from toolkit.objects import VEHICLE
    from toolkit.points import centred_in, frame_points

    detections, truths, points, inside = [], [], [], []
    for number in range(asked.sites):
        recording = random_recording(asked.seed, number, asked.frames)
        detector = load_detector(asked.weights, area=recording.site.area)
        for frame in recording.frames:
            cloud = np.concatenate(frame_points(noisy(frame, 0), area=recording.site))
            detections.append(detector(cloud))
            truths.append(frame.objects)
            points.append(count_points(cloud, frame.objects.boxes))
            inside.append(centred_in(frame.objects.boxes, recording.site.area))
        print(f"site {number}: {len(recording.frames[0].sensors)} sensors", file=sys.stderr, flush=True)
    print(f"{'points':>12s} {'vehicles':>8s} {'AP@0.7':>8s} {'AP@0.8':>8s} {'AP@0.9':>8s}")
    for low, high in BINS:
        counted = [i & (p >= low) & (p < high) for i, p in zip(inside, points, strict=True)]
        vehicles = sum(int((c & (t.labels == VEHICLE)).sum()) for c, t in zip(counted, truths, strict=True))
        found = evaluate(detections, truths, iou_thresholds=(0.7, 0.8, 0.9), counted=counted)
        figures = " ".join(f"{result.ap:8.4f}" for result in found.values())
        print(f"{low:5g} to {high:4g} {vehicles:8d} {figures}")


if __name__ == "__main__":
    main()
