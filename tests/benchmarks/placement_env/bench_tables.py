"""What an exact table costs: processor seconds per frame of each scheme, detections, and hours for
200 frames; with all sets of a frame detected in at once, from what was kept then, and one set after
the other.

python tests/benchmarks/placement_env/bench_tables.py RECORDING.hdf5 [FRAMES] [WEIGHTS]
"""

import sys
from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from time import process_time

import numpy as np
import torch

from models import load_detector
from placement_env.fidelity.detector import Detected
from placement_env.fidelity.renders import Recorded
from placement_env.subsets import all_subsets
from toolkit.arrays import Bool, Float32
from toolkit.datasets.dataset import CoopDataset
from toolkit.detection.schemes import PAPER_SCHEMES
from toolkit.objects import Detections
from toolkit.runtime.cache import Cache


class OneByOne:
    """A detector that counts what it is asked for and the seconds that takes."""

    def __init__(self, name: str) -> None:
        self.detector = load_detector(name)
        self.digest, self.labels = self.detector.digest, self.detector.labels
        self.detections, self.seconds = 0, 0.0

    def __call__(self, points: Float32[np.ndarray, "n 3"], /) -> Detections:
        start = process_time()
        found = self.detector(points)
        self.detections, self.seconds = self.detections + 1, self.seconds + process_time() - start
        return found


class AtOnce(OneByOne):
    """One that can be asked for many unions of clouds at once."""

    def unions(
        self, clouds: Sequence[Float32[np.ndarray, "_ 3"]], unions: Bool[np.ndarray, "U C"]
    ) -> list[Detections]:
        start = process_time()
        found = self.detector.unions(clouds, unions)
        self.detections, self.seconds = (
            self.detections + len(unions),
            self.seconds + process_time() - start,
        )
        return found


def main() -> None:
    torch.set_num_threads(1)
    dataset = CoopDataset(sys.argv[1])
    frames = int(sys.argv[2]) if len(sys.argv) > 2 else 2
    weights = sys.argv[3] if len(sys.argv) > 3 else dataset.site.name
    with TemporaryDirectory() as folder:
        memo = Cache(Path(folder) / "memo")
        for how, detector, kept in (
            ("at once", AtOnce(weights), memo),
            ("kept", AtOnce(weights), memo),
            ("one by one", OneByOne(weights), Cache()),
        ):
            seconds = sum(
                _scored(how, dataset, detector, scheme, kept, frames) for scheme in PAPER_SCHEMES
            )
            print(
                f"{how:10} all sets, three schemes, 200 frames: {seconds * 200 / 3600:.2f} "
                "processor hours"
            )


def _scored(
    how: str, dataset: CoopDataset, detector: OneByOne, scheme: str, memo: Cache, frames: int
) -> float:
    """Processor seconds a frame of all sets in a scheme."""
    renders, subsets = Recorded(dataset), all_subsets(len(dataset.sensors))
    start, detections, inside = process_time(), detector.detections, detector.seconds
    Detected(renders, detector, scheme, memo=memo).partial(subsets, frames)
    seconds, each = (process_time() - start) / frames, (detector.detections - detections) / frames
    inside = (detector.seconds - inside) / frames
    print(f"{how:10} {scheme:7} {seconds:8.3f} s per frame, {each:5.0f} detections: {inside:.3f} s")
    return seconds


if __name__ == "__main__":
    main()
