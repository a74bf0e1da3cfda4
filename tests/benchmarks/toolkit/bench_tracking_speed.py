"""Time that tracking takes a frame, live and offline, by the number of road users.

    OMP_NUM_THREADS=1 python tests/benchmarks/toolkit/bench_tracking_speed.py [--objects 30 300]
        [--frames 100]

Cars drive side by side at 10 Hz, each seen in nine frames of ten with errors of centimetres, and a
tenth as many false alarms appear at random. Times are of the processor, the best of three runs.
"""

import argparse
from time import process_time

import numpy as np

from toolkit.objects import Detections
from toolkit.tracking.smoothing import smooth_tracks
from toolkit.tracking.tracker import Tracker

INTERVAL_S = 0.1
LANE_M = 4.0
GAP_M = 12.0
SPEED_M_S = 8.0
SEEN_SHARE = 0.9
RUNS = 3


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--objects", nargs="+", type=int, default=[30, 300])
    parser.add_argument("--frames", type=int, default=100)
    options = parser.parse_args()
    print("| road users | live (ms a frame) | offline (ms a frame) |")
    print("|---|---|---|")
    for count in options.objects:
        frames = make_frames(count, options.frames)
        times = [INTERVAL_S * k for k in range(len(frames))]
        live = min(time_live(frames, times) for _ in range(RUNS))
        offline = min(time_offline(frames, times) for _ in range(RUNS))
        print(f"| {count} | {live:.2f} | {offline:.2f} |", flush=True)


def make_frames(count: int, frames: int) -> list[Detections]:
    """Detections of cars that drive side by side, and false alarms, in each frame."""
    rng = np.random.default_rng(5)
    rows = int(np.ceil(np.sqrt(count)))
    number = np.arange(count)
    start = np.column_stack([GAP_M * (number // rows), LANE_M * (number % rows)])
    found = []
    for k in range(frames):
        seen = rng.random(count) < SEEN_SHARE
        boxes = np.empty((count, 7))
        boxes[:, :2] = start + np.array([SPEED_M_S * INTERVAL_S * k, 0.0])
        boxes[:, 2:] = [0.75, 4.5, 1.8, 1.5, 0.0]
        boxes += rng.normal(0, 0.03, boxes.shape)
        false_alarms = boxes[rng.integers(0, count, count // 10)]
        false_alarms[:, :2] += rng.uniform(2, 6, (len(false_alarms), 2))
        kept = np.concatenate([boxes[seen], false_alarms])
        scores = np.concatenate([np.full(int(seen.sum()), 0.9), np.full(len(false_alarms), 0.2)])
        found.append(Detections(kept, scores, doubts=np.full((len(kept), 5), 0.05)))
    return found


def time_live(frames: list[Detections], times: list[float]) -> float:
    """Milliseconds of the processor a frame."""
    began = process_time()
    tracker = Tracker()
    for detections, time in zip(frames, times, strict=True):
        tracker.update(detections, time)
    return (process_time() - began) / len(frames) * 1e3


def time_offline(frames: list[Detections], times: list[float]) -> float:
    """Milliseconds of the processor a frame."""
    began = process_time()
    smooth_tracks(frames, times)
    return (process_time() - began) / len(frames) * 1e3


if __name__ == "__main__":
    main()
