"""A detector under conditions: AP of every class, false alarms and calibration, by recording and error profile.

    python tests/benchmarks/models/bench_conditions.py tj_test.hdf5 rb_test.hdf5 [--weights W] [--errors paper typical]

Early fusion of all sensors, exact protocol; vehicles and heavy ones at IoU 0.7 / 0.8 / 0.9, others at 0.25 / 0.5 / 0.7.
False alarms, precision and calibration error are of the detector's own threshold, or of that which --least says: an AP
ends where it stops, since whatever is less sure was not reported. Tables are Markdown.
"""

import argparse
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[3]))


def main() -> None:
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("recordings", nargs="+", type=Path)
    arguments.add_argument("--weights", help="the site's own, else general, when left out")
    arguments.add_argument("--errors", nargs="+", default=["paper", "surveyed", "typical", "poor"])
    arguments.add_argument("--frames", type=int, default=60)
    arguments.add_argument("--least", type=float, help="score threshold of all classes, else the detector's own")
    asked = arguments.parse_args()

    import torch

    from models.config import SHIPPED
    from models.detector import load_detector
    from toolkit.datasets.dataset import CoopDataset

    torch.set_num_threads(1)
    for path in asked.recordings:
        dataset = CoopDataset(path)
        site = dataset.site
        own = site.name if (SHIPPED / f"{site.name}.safetensors").exists() else "general"
        detector = load_detector(asked.weights or own, area=site.area, score_threshold=asked.least)
        conditions(path, dataset, detector, asked)


def conditions(path, dataset, detector, asked) -> None:
    from toolkit.datasets.recordings import Reads
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


if __name__ == "__main__":
    main()
