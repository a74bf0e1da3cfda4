"""AP of the general weights on random junctions with random sensors, by points on the vehicle and by class.

    python tests/benchmarks/models/bench_general.py [--sites 20] [--frames 10] [--seed 9001] [--weights general]
        [--background]

Early fusion of all sensors, exact protocol. In each line only vehicles with so many points count, the others are
neither missed nor false alarms. By class everybody in the area counts, unseen ones too; precision, recall and false
alarms are of the weights' own thresholds, at the IoU from which a detection is true (0.5, of pedestrians 0.25).
"""

import argparse
import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[3]))

LOWEST_SCORE = 0.03  # of the detections that AP is computed from
IOUS = {"vehicle": (0.7, 0.8, 0.9), "heavy": (0.25, 0.5), "cyclist": (0.25, 0.5), "pedestrian": (0.25, 0.5)}
BINS = ((0, 10), (10, 30), (30, 100), (100, 300), (300, 1000), (1000, np.inf), (0, np.inf))


def main() -> None:
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    for name, default in (("sites", 20), ("frames", 10), ("seed", 9001)):
        arguments.add_argument(f"--{name}", type=int, default=default)
    arguments.add_argument("--weights", default="general")
    arguments.add_argument("--background", action="store_true", help="detectors that know the empty sites")
    asked = arguments.parse_args()

    from models import load_detector
    from toolkit.boxes import count_points
    from toolkit.datasets.recordings import with_errors
    from toolkit.datasets.simulation import random_recording
    from toolkit.detection.background import KnownBackground, site_background
    from toolkit.detection.metrics import TRUE_IOU, evaluate
    from toolkit.objects import VEHICLE, label_index
    from toolkit.points import detect_on_ground, frame_points, has_centre_inside

    detections, reported, truths, points, inside = [], [], [], [], []
    for number in range(asked.sites):
        recording = random_recording(asked.seed, number, asked.frames)
        area = recording.site.area
        known = site_background(recording.site) if asked.background else None
        unsure, own = (load_detector(asked.weights, area=area, score_threshold=least) for least in (LOWEST_SCORE, None))
        all_of_them, detector = (bare if known is None else KnownBackground(bare, known) for bare in (unsure, own))
        for frame in recording.frames:
            cloud = np.concatenate(frame_points(with_errors(frame, "paper", 0), area=recording.site))
            detections.append(detect_on_ground(all_of_them, cloud, recording.site))
            reported.append(detect_on_ground(detector, cloud, recording.site))
            truths.append(frame.objects)
            points.append(count_points(cloud, frame.objects.boxes))
            inside.append(has_centre_inside(frame.objects.boxes, recording.site.area))
        print(f"site {number}: {len(recording.frames[0].sensors)} sensors", file=sys.stderr, flush=True)
    print(f"{'points':>12s} {'vehicles':>8s} {'AP@0.7':>8s} {'AP@0.8':>8s} {'AP@0.9':>8s}")
    for low, high in BINS:
        counted = [i & (p >= low) & (p < high) for i, p in zip(inside, points, strict=True)]
        vehicles = sum(int((c & (t.labels == VEHICLE)).sum()) for c, t in zip(counted, truths, strict=True))
        found = evaluate(detections, truths, iou_thresholds=(0.7, 0.8, 0.9), counted=counted)
        figures = " ".join(f"{result.ap:8.4f}" for result in found.values())
        print(f"{low:5g} to {high:4g} {vehicles:8d} {figures}")
    print(f"\n{'class':>12s} {'to find':>8s}  false/frame precision recall  AP")
    for label, ious in IOUS.items():
        true = TRUE_IOU[label_index(label)]
        above = evaluate(reported, truths, iou_thresholds=(true,), counted=inside, label=label)[true]
        found = evaluate(detections, truths, iou_thresholds=ious, counted=inside, label=label)
        said = f"{above.fp / len(truths):11.2f} {above.precision:9.2f} {above.recall:6.2f}"
        print(f"{label:>12s} {above.truths:8d}  {said}  " + " ".join(f"@{iou}: {r.ap:.3f}" for iou, r in found.items()))


if __name__ == "__main__":
    main()
