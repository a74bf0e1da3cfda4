"""Tracks against single frames: AP of both, HOTA, and the time that tracking takes.

    python tests/benchmarks/models/bench_tracks.py [--sites tjunction roundabout] [--frames 300]
        [--seeds 11] [--errors paper typical]

A recording at 10 Hz of traffic that goes on is simulated for each site and seed; the site's network
detects in all sensors' points; detections, live tracks and offline tracks are scored alike.
"""

import argparse
import tempfile
from collections.abc import Sequence
from pathlib import Path
from time import process_time

import numpy as np

from models import load_detector
from toolkit.datasets.recording_views import ReadRecording, Reads
from toolkit.datasets.recordings import open_recording
from toolkit.datasets.simulation import simulate_dataset
from toolkit.detection.metrics import evaluate
from toolkit.frame import Recording
from toolkit.objects import LABELS, Detections, Objects
from toolkit.points import frame_points, has_centre_inside
from toolkit.runtime.run import Simulation
from toolkit.tracking.scores import score_tracks
from toolkit.tracking.smoothing import smooth_tracks
from toolkit.tracking.tracker import Tracker

# IoU thresholds of each class
THRESHOLDS = {
    "vehicle": (0.7, 0.8, 0.9),
    "cyclist": (0.25, 0.5),
    "pedestrian": (0.25, 0.5),
    "heavy": (0.5, 0.7),
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--sites", nargs="+", default=["tjunction", "roundabout"])
    parser.add_argument("--frames", type=int, default=300)
    parser.add_argument("--seeds", nargs="+", type=int, default=[11])
    parser.add_argument("--errors", nargs="+", default=["paper", "typical"])
    options = parser.parse_args()
    print("| recording | class at IoU | single frames | live | offline |")
    print("|---|---|---|---|---|")
    with tempfile.TemporaryDirectory() as folder:
        for site in options.sites:
            for seed in options.seeds:
                path = Path(folder) / f"{site}_{seed}.hdf5"
                run = Simulation(frames=options.frames, seed=seed, workers=None)
                simulate_dataset(site, path, interval=0.1, run=run)
                for errors in options.errors:
                    recording = open_recording(path)
                    print_rows(f"{site} {seed} {errors}", recording, site, errors)


def print_rows(name: str, recording: Recording, site: str, errors: str) -> None:
    """Print a row for each class of a recording, and one for the times."""
    assert recording.site is not None
    area = recording.site.area
    detect = load_detector(site)
    measured = ReadRecording(recording, Reads(errors))
    times = []
    truths = []
    frames = []
    for k in range(len(measured)):
        frame = measured[k]
        times.append(frame.time)
        truths.append(frame.objects)
        frames.append(detect(np.concatenate(frame_points(frame, area=recording.site))))
    began = process_time()
    tracker = Tracker(area.tolist())
    live = [tracker.update(found, time) for found, time in zip(frames, times, strict=True)]
    live_ms = (process_time() - began) / len(frames) * 1e3
    began = process_time()
    offline = smooth_tracks(frames, times, area.tolist())
    offline_ms = (process_time() - began) / len(frames) * 1e3
    for label, thresholds in THRESHOLDS.items():
        cells = [score(found, truths, area, label, thresholds) for found in (frames, live, offline)]
        if "nan" not in cells[0]:
            iou_text = "/".join(f"{iou:g}" for iou in thresholds)
            print(f"| {name} | {label} {iou_text} | {' | '.join(cells)} |", flush=True)
        inside = [objects[has_centre_inside(objects.boxes, area)] for objects in truths]
        hotas = [score_tracks(found, inside, label) for found in (live, offline)]
        if hotas[0].objects:
            texts = [f"{scores.hota:.3f} ({scores.switches} switches)" for scores in hotas]
            print(f"| {name} | {label} HOTA | | {' | '.join(texts)} |", flush=True)
    print(f"| {name} | ms of processor a frame | | {live_ms:.1f} | {offline_ms:.1f} |", flush=True)


def score(
    found: Sequence[Detections],
    truths: Sequence[Objects],
    area: np.ndarray,
    label: str,
    thresholds: Sequence[float],
) -> str:
    """AP at each threshold of what is inside the area, as in evaluations."""
    inside = [rows[has_centre_inside(rows.boxes, area)] for rows in found]
    to_find = [objects[has_centre_inside(objects.boxes, area)] for objects in truths]
    scores = evaluate(inside, to_find, iou_thresholds=thresholds, label=LABELS.index(label))
    return "/".join(f"{scores[iou].ap:.3f}" for iou in thresholds)


if __name__ == "__main__":
    main()
