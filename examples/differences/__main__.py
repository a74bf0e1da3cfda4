"""Compare `foreground` with `differences` on a second of traffic at the T-junction.

python -m examples.differences
"""

import tempfile
from pathlib import Path

from examples.differences.scheme import ForegroundDifferences
from toolkit import (
    ClusterDetector,
    Comparison,
    CoopDataset,
    Run,
    Scheme,
    evaluate_recording,
    format_table,
    simulate_dataset,
)


def main(frames: int = 10) -> None:
    """Print AP and kbit of both schemes: the AP is the same."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "sequence.hdf5")
        simulate_dataset("tjunction", path, run=Run(frames=frames), interval=0.1)
        with CoopDataset(path) as recording:
            schemes: list[Scheme | str] = [
                "foreground",
                ForegroundDifferences(),
                ForegroundDifferences(refers_to="key", name="differences to key"),
            ]
            detector = ClusterDetector.from_recording(recording)
            comparison = Comparison(schemes=schemes, iou_thresholds=(0.5,))
            print(format_table(evaluate_recording(recording, detector, comparison)))


if __name__ == "__main__":
    main()
