"""What an exact table costs: processor seconds per frame of each scheme, detector calls, and hours for 200 frames.

python tests/benchmarks/placement_env/bench_tables.py RECORDING.hdf5 [FRAMES] [WEIGHTS]
"""

import sys
from pathlib import Path
from tempfile import TemporaryDirectory
from time import process_time

import numpy as np
import torch

from models import load_detector
from placement_env.fidelity.detector import Detected
from placement_env.fidelity.renders import Renders
from placement_env.subsets import all_subsets
from toolkit.arrays import Float32
from toolkit.datasets.dataset import CoopDataset
from toolkit.detection.schemes import PAPER_SCHEMES
from toolkit.objects import Detections
from toolkit.runtime.cache import Cache


class Counted:
    """A detector that counts its calls and the seconds they take."""

    def __init__(self, name: str) -> None:
        self.detector = load_detector(name)
        self.digest, self.calls, self.seconds = self.detector.digest, 0, 0.0

    def __call__(self, points: Float32[np.ndarray, "n 3"], /) -> Detections:
        """Detect."""
        start = process_time()
        found = self.detector(points)
        self.calls, self.seconds = self.calls + 1, self.seconds + process_time() - start
        return found


def main() -> None:
    """Score all sets in a few frames, in one process and thread; then once more, from what was kept."""
    torch.set_num_threads(1)
    dataset = CoopDataset(sys.argv[1])
    frames = int(sys.argv[2]) if len(sys.argv) > 2 else 2
    detector = Counted(sys.argv[3] if len(sys.argv) > 3 else dataset.site.name)
    renders, subsets = Renders.of(dataset), all_subsets(len(dataset.sensors))
    with TemporaryDirectory() as folder:
        memo, all_start = Cache(Path(folder) / "memo"), process_time()
        for kept in ("detected", "kept"):
            for scheme in PAPER_SCHEMES:
                start, calls, inside = process_time(), detector.calls, detector.seconds
                Detected(renders, detector, scheme, memo=memo, frames=frames)(subsets)
                seconds, each = (process_time() - start) / frames, (detector.calls - calls) / frames
                inside = (detector.seconds - inside) / frames
                print(f"{kept:9} {scheme:7} {seconds:8.3f} s per frame, {each:5.0f} detector calls: {inside:.3f} s")
            if kept == "detected":
                hours = (process_time() - all_start) / frames * 200 / 3600
                print(f"{len(subsets) - 1} sets, three schemes, 200 frames: {hours:.2f} processor hours")


if __name__ == "__main__":
    main()
