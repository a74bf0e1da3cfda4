"""AP, precision and calibration of the general weights at junctions that they do not know, by class
and by points.

    python tests/benchmarks/models/bench_general.py [--sites 20] [--frames 10] [--seed 9001]
        [--weights general] [--background] [--at SITE ... --sensors cameras|lidars]

Random junctions with random sensors, or site files, such as imported ones, with six cameras or
eight level lidars placed by coverage, and traffic as `coview simulate` has it. Early fusion of all
sensors, exact protocol, the paper's noise. In the first table only vehicles with so many points
count, the others are neither missed nor false alarms. By class everybody in the area counts, unseen
ones too, then those with ten points alone; precision, false alarms and the expected calibration
error (ECE) are of the weights' own thresholds, at the IoU from which a detection is true (0.5, of
pedestrians 0.25). "by chance" is the ECE that as many scores would have if they were exactly right.
"""

import argparse
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[3]))

LOWEST_SCORE = 0.03  # of the detections that AP is computed from
IOUS = {
    "vehicle": (0.7, 0.8, 0.9),
    "heavy": (0.25, 0.5, 0.7),
    "cyclist": (0.25, 0.5),
    "pedestrian": (0.25, 0.5),
}
BINS = ((0, 10), (10, 30), (30, 100), (100, 300), (300, 1000), (1000, np.inf), (0, np.inf))


FEWEST_POINTS = 10
CAMERAS, LIDARS = 6, 8  # number at a site file


def recordings(asked):
    """Sites and their frames."""
    from placement_env.search.first_sensors import with_first_sensors
    from toolkit.datasets.dataset import CoopDataset
    from toolkit.datasets.simulation import random_recording, simulate_dataset
    from toolkit.runtime.run import Simulation
    from toolkit.sensors.models import SpinningLidar
    from toolkit.sites.files import load_site

    if not asked.at:
        for number in range(asked.sites):
            recording = random_recording(asked.seed, number, asked.frames)
            yield recording.site, recording.frames
    for number, path in enumerate(asked.at):
        site = load_site(path)
        lidars = {"models": (SpinningLidar(),), "tilts": (0.0,)}
        count, kinds = (LIDARS, lidars) if asked.sensors == "lidars" else (CAMERAS, {})
        sensors = with_first_sensors(site, count, **kinds).site.sensors
        with TemporaryDirectory() as folder:
            out, run = (
                Path(folder, "frames.hdf5"),
                Simulation(frames=asked.frames, seed=asked.seed + number, workers=1),
            )
            simulate_dataset(site, out, run=run, sensors=sensors)
            with CoopDataset(out) as dataset:
                yield dataset.site, [dataset[k] for k in range(len(dataset))]


def main() -> None:
    arguments = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    for name, default in (("sites", 20), ("frames", 10), ("seed", 9001)):
        arguments.add_argument(f"--{name}", type=int, default=default)
    arguments.add_argument("--weights", default="general")
    arguments.add_argument(
        "--background", action="store_true", help="detectors that know the empty sites"
    )
    arguments.add_argument(
        "--at", nargs="+", default=(), help="site files, in place of random junctions"
    )
    arguments.add_argument(
        "--sensors", choices=("cameras", "lidars"), default="cameras", help="at site files"
    )
    asked = arguments.parse_args()

    from models import load_detector
    from toolkit.boxes import count_points
    from toolkit.datasets.recording_views import with_errors
    from toolkit.detection.background import KnownBackground, site_background
    from toolkit.detection.metrics import TRUE_IOU, evaluate, matches, reliability
    from toolkit.objects import VEHICLE, label_index
    from toolkit.points import detect_on_ground, frame_points, has_centre_inside

    detections, reported, truths, points, inside = [], [], [], [], []
    for number, (site, frames) in enumerate(recordings(asked)):
        area = site.area
        known = site_background(site) if asked.background else None
        unsure, own = (
            load_detector(asked.weights, area=area, score_threshold=least)
            for least in (LOWEST_SCORE, None)
        )
        all_of_them, detector = (
            bare if known is None else KnownBackground(bare, known) for bare in (unsure, own)
        )
        for frame in frames:
            cloud = np.concatenate(frame_points(with_errors(frame, "paper", 0), area=site))
            detections.append(detect_on_ground(all_of_them, cloud, site))
            reported.append(detect_on_ground(detector, cloud, site))
            truths.append(frame.objects)
            points.append(count_points(cloud, frame.objects.boxes))
            inside.append(has_centre_inside(frame.objects.boxes, site.area))
        print(f"site {number}: {len(frames[0].sensors)} sensors", file=sys.stderr, flush=True)
    print(f"{'points':>12s} {'vehicles':>8s} {'AP@0.7':>8s} {'AP@0.8':>8s} {'AP@0.9':>8s}")
    for low, high in BINS:
        counted = [i & (p >= low) & (p < high) for i, p in zip(inside, points, strict=True)]
        vehicles = sum(
            int((c & (t.labels == VEHICLE)).sum()) for c, t in zip(counted, truths, strict=True)
        )
        found = evaluate(detections, truths, iou_thresholds=(0.7, 0.8, 0.9), counted=counted)
        figures = " ".join(f"{result.ap:8.4f}" for result in found.values())
        print(f"{low:5g} to {high:4g} {vehicles:8d} {figures}")
    for least in (0, FEWEST_POINTS):
        counted = [i & (p >= least) for i, p in zip(inside, points, strict=True)]
        print(
            f"\n{f'>= {least} points':>12s} {'to find':>8s}  false/frame precision recall   ECE "
            "by chance  AP"
        )
        for label, ious in IOUS.items():
            true = TRUE_IOU[label_index(label)]
            above = evaluate(
                reported, truths, iou_thresholds=(true,), counted=counted, label=label
            )[true]
            found = evaluate(detections, truths, iou_thresholds=ious, counted=counted, label=label)
            scores, hits = [np.zeros(0)], [np.zeros(0, bool)]
            for boxes, there, counts in zip(reported, truths, counted, strict=True):
                (at,) = matches(boxes, there, [true], label=label, counted=counts)
                kept = (boxes.labels == label_index(label)) & ~at.ignored
                scores.append(boxes.scores[kept])
                hits.append(at.truth[kept] >= 0)
            sure, rng = np.concatenate(scores), np.random.default_rng(0)
            error = reliability(sure, np.concatenate(hits)).error
            chance = np.mean(
                [reliability(sure, rng.random(len(sure)) < sure).error for _ in range(200)]
            )
            shares = f"{above.precision:9.2f} {above.recall:6.2f} {error:5.2f} {chance:9.2f}"
            figures = " ".join(f"@{iou}: {each.ap:.3f}" for iou, each in found.items())
            print(
                f"{label:>12s} {above.truths:8d}  {above.fp / len(truths):11.2f} {shares}  "
                f"{figures}"
            )


if __name__ == "__main__":
    main()
