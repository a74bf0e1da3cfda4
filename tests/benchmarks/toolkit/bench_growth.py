"""Processor time and peak memory of one, two and four times as much work.

    python tests/benchmarks/toolkit/bench_growth.py [AXIS ...]

Each amount runs in a process of its own, so that memory is not what an earlier one left. The
exponent is that of the work without the start of the process: 1 if twice the work takes twice the
time, 2 if it takes four times as long.
"""

import json
import math
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

MAX_EXPONENT = 1.2
SEED = 7
CHILD = """
import sys
from tests.benchmarks.toolkit.bench_growth import WORK
WORK[sys.argv[1]](int(sys.argv[2]), sys.argv[3])
"""


class Cost(NamedTuple):
    """Cost of one amount of work.

    Attributes:
        seconds: Processor time of all processes.
        megabytes: Peak memory of the largest process.
    """

    seconds: float
    megabytes: float


def command(*words: object) -> None:
    from coview.main import main

    main([str(word) for word in words])


def simulate_frames(frames: int, folder: str) -> None:
    file = Path(folder, "frames.hdf5")
    command("simulate", "tjunction", "--frames", frames, "--workers", 1, "--out", file)


def evaluate_frames(frames: int, folder: str) -> None:
    file = Path(folder, f"evaluated-{frames}.hdf5")
    out = Path(folder, f"evaluation-{frames}")
    command("simulate", "tjunction", "--frames", frames, "--workers", 1, "--out", file)
    command("evaluate", file, "--schemes", "early", "late", "--out", out)


def search_candidates(poles: int, folder: str) -> None:
    """Greedy search over poles on both sides of the junction, with the usual headings of each."""
    from toolkit.sites.files import format_site, load_site

    # in rows behind the pavements, so that all are off the carriageway and apart
    rows_y = np.array([-20.0, -19.0, -18.0, -17.0, 17.0, 18.0, 19.0, 20.0])
    columns_x = np.linspace(-38, 38, -(-poles // len(rows_y)))
    positions = np.stack(np.meshgrid(columns_x, rows_y, indexing="ij"), axis=-1).reshape(-1, 2)
    features = [
        {
            "type": "Feature",
            "geometry": {"type": "Point", "coordinates": [x, y]},
            "properties": {"name": f"pole {number}"},
        }
        for number, (x, y) in enumerate(positions[:poles].tolist())
    ]
    site = json.loads(format_site(load_site("tjunction")))
    file = Path(folder, f"poles-{poles}.geojson")
    file.write_text(json.dumps(site | {"features": features}))
    command(
        "search",
        "tjunction",
        "--candidates",
        file,
        "--method",
        "greedy",
        "--budget",
        3,
        "--frames",
        8,
        "--workers",
        1,
    )


def simulate_sensors(sensors: int, folder: str) -> None:
    """Recording by many sensors on a ring around the junction."""
    from toolkit.datasets.simulation import simulate_dataset
    from toolkit.runtime.run import Simulation
    from toolkit.sites.files import load_site

    site = load_site("tjunction")
    rng = np.random.default_rng(SEED)
    chosen = rng.integers(len(site.sensors), size=sensors)
    many = tuple(
        replace(site.sensors[index], name=f"sensor {number}")
        for number, index in enumerate(chosen.tolist())
    )
    file = str(Path(folder, f"sensors-{sensors}.hdf5"))
    simulate_dataset(replace(site, sensors=many), file, run=Simulation(frames=4, workers=1))
    command("evaluate", file, "--schemes", "early", "late", "--out", Path(folder, f"s-{sensors}"))


def track_objects(objects: int, folder: str) -> None:
    """Fifty frames of road users on a lattice, tracked and scored."""
    from toolkit.objects import VEHICLE, Detections
    from toolkit.tracking.tracker import Tracker

    side = math.ceil(math.sqrt(objects))
    numbers = np.arange(objects)
    boxes = np.zeros((objects, 7))
    boxes[:, 0] = numbers % side * 8.0
    boxes[:, 1] = numbers // side * 6.0
    boxes[:, 3:6] = (4.2, 1.8, 1.6)
    tracker = Tracker((-10.0, -10.0, side * 8.0 + 10, side * 6.0 + 10))
    rng = np.random.default_rng(SEED)
    for frame in range(50):
        moved = boxes + rng.normal(0, 0.05, boxes.shape) * [1, 1, 0, 1, 1, 1, 0]
        moved[:, 0] += 0.5 * frame
        found = Detections(
            boxes=moved, scores=np.full(objects, 0.9), labels=np.full(objects, VEHICLE)
        )
        tracker.update(found, frame / 10)


def detect_area(side: int, folder: str) -> None:
    """Three detections in a square area with four points a square metre of ground."""
    from models import load_detector

    rng = np.random.default_rng(SEED)
    half = side / 2
    cloud = rng.uniform((-half, -half, 0), (half, half, 0.05), (4 * side * side, 3))
    detect = load_detector("general", area=(-half, -half, half, half))
    for _ in range(3):
        detect(cloud.astype(np.float32))


def simulate_processes(processes: int, folder: str) -> None:
    file = Path(folder, f"processes-{processes}.hdf5")
    command("simulate", "tjunction", "--frames", 60, "--workers", processes, "--out", file)


WORK: dict[str, Callable[[int, str], None]] = {
    "frames simulated": simulate_frames,
    "frames evaluated": evaluate_frames,
    "poles searched": search_candidates,
    "sensors of a recording": simulate_sensors,
    "road users tracked": track_objects,
    "side of the area, m": detect_area,
    "processes": simulate_processes,
}
# three amounts, each twice the one before; the side of an area doubles it by a root of 2
AMOUNTS: dict[str, tuple[int, ...]] = {
    "frames simulated": (60, 120, 240),
    "frames evaluated": (30, 60, 120),
    "poles searched": (250, 500, 1000),
    "sensors of a recording": (50, 100, 200),
    "road users tracked": (250, 500, 1000),
    "side of the area, m": (200, 283, 400),
    "processes": (1, 2),
}


def measure(axis: str, amount: int) -> Cost:
    """Cost of an amount of work in a process of its own."""
    with tempfile.TemporaryDirectory() as folder:
        words = [sys.executable, "-c", CHILD, axis, str(amount), folder]
        with subprocess.Popen(words, stdout=subprocess.DEVNULL) as child:
            _, status, usage = os.wait4(child.pid, 0)  # with what its own children used
            child.returncode = os.waitstatus_to_exitcode(status)
    if child.returncode:
        raise RuntimeError(f"{axis} {amount} ended with {child.returncode}")
    return Cost(seconds=usage.ru_utime + usage.ru_stime, megabytes=usage.ru_maxrss * 1024 / 1e6)


def find_exponent(seconds: list[float]) -> float:
    """Exponent of the growth from the middle to the last of three amounts, without the start."""
    first, middle, last = seconds
    return math.log2((last - middle) / max(middle - first, 1e-9))


def main() -> None:
    """Print a line for each axis, or for those that are named."""
    for axis in sys.argv[1:] or WORK:
        costs = [measure(axis, amount) for amount in AMOUNTS[axis]]
        cells = [
            f"{amount}: {cost.seconds:.1f} s, {cost.megabytes:.0f} MB"
            for amount, cost in zip(AMOUNTS[axis], costs, strict=True)
        ]
        line = f"{axis:24s} {'; '.join(cells)}"
        if len(costs) == 3:
            exponent = find_exponent([cost.seconds for cost in costs])
            line += f"; exponent {exponent:.2f}{'' if exponent <= MAX_EXPONENT else '  MISSED'}"
        print(line, flush=True)


if __name__ == "__main__":
    main()
