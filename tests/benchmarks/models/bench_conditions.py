"""A detector under conditions: AP of every class, false alarms and calibration, by recording and
error profile.

    python tests/benchmarks/models/bench_conditions.py tj_test.hdf5 rb_test.hdf5 [--weights W]
        [--errors paper typical] [--draws 10]

Early fusion of all sensors, exact protocol; vehicles and heavy ones at IoU 0.7 / 0.8 / 0.9, others
at 0.25 / 0.5 / 0.7. False alarms, precision and calibration error are of the detector's own
threshold, or of that which --least says: an AP ends where it stops, since whatever is less sure was
not reported. Figures are means over --draws of the sensors' errors; with several, the least and the
greatest AP follow. Tables are Markdown.
"""

import argparse
import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[3]))


def main() -> None:
    arguments = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    arguments.add_argument("recordings", nargs="+", type=Path)
    arguments.add_argument("--weights", help="the site's own, else general, when left out")
    arguments.add_argument("--errors", nargs="+", default=["paper", "surveyed", "typical", "poor"])
    arguments.add_argument("--frames", type=int, default=60)
    arguments.add_argument(
        "--least", type=float, help="score threshold of all classes, else the detector's own"
    )
    arguments.add_argument("--draws", type=int, default=1, help="of the sensors' errors")
    asked = arguments.parse_args()

    import torch

    from models.config import SHIPPED
    from models.detector_loading import load_detector
    from toolkit.datasets.dataset import CoopDataset

    torch.set_num_threads(1)
    for path in asked.recordings:
        dataset = CoopDataset(path)
        site = dataset.site
        own = site.name if (SHIPPED / f"{site.name}.safetensors").exists() else "general"
        detector = load_detector(asked.weights or own, area=site.area, score_threshold=asked.least)
        conditions(path, dataset, detector, asked)


def conditions(path, dataset, detector, asked) -> None:
    from toolkit.datasets.recording_views import Reads
    from toolkit.detection.comparison import Comparison
    from toolkit.detection.evaluation import evaluate_recording

    print(f"\n{path.stem}, {asked.frames} frames\n")
    print(
        "| errors | class | to find | AP | false / frame | precision | recall | calibration error |"
    )
    print("|---|---|---|---|---|---|---|---|")
    comparison = Comparison(schemes=("early",), classes=detector.config.labels)
    for errors in asked.errors:
        drawn = [
            Reads(frames=asked.frames, errors=errors, noise_seed=seed)
            for seed in range(asked.draws)
        ]
        answers = [
            evaluate_recording(dataset, detector, comparison, reads=reads) for reads in drawn
        ]
        for k, first in enumerate(answers[0].classes):
            each = [answer.classes[k] for answer in answers]
            ap = np.array(
                [[row.ap for row in answer if row.label == first.label] for answer in answers]
            )
            said = " / ".join(f"{x:.3f}" for x in ap.mean(axis=0))
            if asked.draws > 1:
                ends = zip(ap.min(axis=0), ap.max(axis=0), strict=True)
                said += " (" + " / ".join(f"{low:.3f}–{high:.3f}" for low, high in ends) + ")"
            false, precision, recall, off = np.mean(
                [
                    (x.false_alarms_per_frame, x.precision, x.recall, x.reliability.error)
                    for x in each
                ],
                axis=0,
            )
            shares = f"{false:.2f} | {precision:.3f} | {recall:.3f} | {off:.3f}"
            print(f"| {errors} | {first.label} | {first.truths} | {said} | {shares} |", flush=True)


if __name__ == "__main__":
    main()
