"""Score early against late fusion on a recording: AP, kbit per sensor and milliseconds, as in the
paper's first table.

python examples/04_evaluate_a_scheme.py
"""

import tempfile
from pathlib import Path

import numpy as np

from toolkit import (
    ClusterDetector,
    Comparison,
    CoopDataset,
    Run,
    empty_scene,
    evaluate_recording,
    format_table,
    frame_points,
    simulate_dataset,
)


def main(frames: int = 20) -> None:
    """Any function from points (n, 3) to `Detections` is a detector; the classical one needs no
    training."""
    with tempfile.TemporaryDirectory() as folder:
        simulate_dataset("tjunction", Path(folder, "few.hdf5"), run=Run(frames=frames))
        with CoopDataset(Path(folder, "few.hdf5")) as recording:
            detector = ClusterDetector.learn(
                frame_points(
                    empty_scene(recording), area=recording.site, rng=np.random.default_rng(0)
                )
            )
            rows = evaluate_recording(
                recording,
                detector,
                Comparison(
                    schemes=("early", "late"),
                    sensor_sets=(None, (0, 2, 5)),
                    iou_thresholds=(0.5, 0.7),
                ),
            )
    print(format_table(rows))


if __name__ == "__main__":
    main()
