"""A detector under conditions: AP of every class, false alarms and calibration, by recording and error profile.

    python tests/benchmarks/models/bench_conditions.py tj_test.hdf5 rb_test.hdf5 [--weights W] [--errors paper typical]
    python tests/benchmarks/models/bench_conditions.py tj_test.hdf5 --crossing     early, hybrid, late by pose error
    python tests/benchmarks/models/bench_conditions.py tj_test.hdf5 --bodies       recall by kind of body

Early fusion of all sensors, exact protocol; vehicles and heavy ones at IoU 0.7 / 0.8 / 0.9, others at 0.25 / 0.5 / 0.7.
False alarms, precision and calibration error are of the detector's own threshold, or of that which --least says: an AP
ends where it stops, since whatever is less sure was not reported. Tables are Markdown.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections import defaultdict
from pathlib import Path

import h5py
import numpy as np

sys.path.insert(0, str(Path(__file__).parents[3]))

ROTATIONS = (0.0, 0.1, 0.2, 0.3, 0.5, 0.75, 1.0)  # degrees; each with 10 cm per degree


def main() -> None:
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("recordings", nargs="+", type=Path)
    arguments.add_argument("--weights", help="the site's own, else general, when left out")
    arguments.add_argument("--errors", nargs="+", default=["paper", "surveyed", "typical", "poor"])
    arguments.add_argument("--frames", type=int, default=60)
    arguments.add_argument(
        "--least", type=float, help="score threshold of all classes, the detector's own when left out"
    )
    arguments.add_argument("--crossing", action="store_true")
    arguments.add_argument("--bodies", action="store_true")
    asked = arguments.parse_args()

    import torch

    from models.detector import SHIPPED, load_detector
    from toolkit.datasets.dataset import CoopDataset

    torch.set_num_threads(1)
    shown = crossing if asked.crossing else bodies if asked.bodies else conditions
    for path in asked.recordings:
        dataset = CoopDataset(path)
        site = dataset.site
        own = site.name if (SHIPPED / f"{site.name}.safetensors").exists() else "general"
        detector = load_detector(asked.weights or own, area=site.area, score_threshold=asked.least)
        shown(path, dataset, detector, asked)


def conditions(path, dataset, detector, asked) -> None:
    """AP by class and error profile."""
    from toolkit.datasets.readings import Reads
    from toolkit.detection.evaluation import Comparison, evaluate_recording

    print(f"\n{path.stem}, {asked.frames} frames\n")
    print("| errors | class | to find | AP | false / frame | precision | recall | calibration error |")
    print("|---|---|---|---|---|---|---|---|")
    for errors in asked.errors:
        answer = evaluate_recording(
            dataset,
            detector,
            Comparison(schemes=("early",), classes=detector.config.labels),
            reads=Reads(frames=asked.frames, errors=errors),
        )
        for each in answer.classes:
            ap = " / ".join(f"{row.ap:.3f}" for row in answer if row.label == each.label)
            shares = f"{each.false_alarms_per_frame:.2f} | {each.precision:.3f} | {each.recall:.3f}"
            print(
                f"| {errors} | {each.label} | {each.truths} | {ap} | {shares} | {each.reliability.error:.3f} |",
                flush=True,
            )


def crossing(path, dataset, detector, asked) -> None:
    """AP of vehicles by scheme where sensors are believed to be where they are not."""
    from toolkit.datasets.readings import Reads
    from toolkit.detection.evaluation import Comparison, evaluate_recording
    from toolkit.sensors.error_profiles import ErrorProfile
    from toolkit.sensors.error_terms import Calibration, OwnNoise

    schemes = ("early", "hybrid", "late")
    print(f"\n{path.stem}, vehicles at 0.5 / 0.7 / 0.8, {asked.frames} frames\n")
    print("| rotation, translation | " + " | ".join(schemes) + " |")
    print("|---|" + "---|" * len(schemes))
    for rotation in ROTATIONS:
        pose = Calibration(float(np.deg2rad(rotation)), rotation / 10)
        answer = evaluate_recording(
            dataset,
            detector,
            Comparison(schemes=schemes, iou_thresholds=(0.5, 0.7, 0.8)),
            reads=Reads(frames=asked.frames, errors=ErrorProfile(f"calibration {rotation:g}", (OwnNoise(), pose))),
        )
        cells = (" / ".join(f"{row.ap:.3f}" for row in answer if row.scheme == scheme) for scheme in schemes)
        print(f"| {rotation:g}°, {rotation * 10:g} cm | " + " | ".join(cells) + " |", flush=True)


def bodies(path, dataset, detector, asked) -> None:
    """Share of the objects of each kind of body that is found, those with ten points and more."""
    from toolkit.boxes import count_points
    from toolkit.datasets.readings import read_frame
    from toolkit.detection.metrics import match
    from toolkit.objects import CYCLIST, LABELS, PEDESTRIAN
    from toolkit.points import frame_points, has_centre_inside

    with h5py.File(path) as file:
        names = json.loads(file["coview/bodies"][()])
        numbers = file["coview/object_bodies"][()]
    first, found, total = 0, defaultdict(int), defaultdict(int)
    for k in range(min(asked.frames, len(dataset))):
        frame = read_frame(dataset, k)
        kinds = numbers[first : first + len(frame.objects)]
        first += len(frame.objects)
        cloud = np.concatenate(frame_points(frame, area=dataset.site))
        answer, boxes = detector(cloud), frame.objects.boxes
        counts = has_centre_inside(boxes, dataset.site.area) & (count_points(cloud, boxes) >= 10)
        for label in range(len(LABELS)):
            iou = 0.5 if label in (CYCLIST, PEDESTRIAN) else 0.7
            at = match(answer, frame.objects, iou, label=label, counted=counts)
            hit = np.isin(np.arange(len(boxes)), at.truth[at.truth >= 0])
            for row in np.flatnonzero(counts & (frame.objects.labels == label)):
                kind = (LABELS[label], names[kinds[row]])
                total[kind] += 1
                found[kind] += int(hit[row])
    print(f"\n{path.stem}, {asked.frames} frames\n\n| class | body | objects | found |\n|---|---|---|---|")
    for kind in sorted(total, key=lambda kind: (kind[0], found[kind] / total[kind])):
        print(f"| {kind[0]} | {kind[1]} | {total[kind]} | {found[kind] / total[kind]:.3f} |")


if __name__ == "__main__":
    main()
