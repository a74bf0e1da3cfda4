"""A fusion scheme of your own: within a budget of bits a sensor sends its foreground, else the
boxes that it detects.

python examples/10_own_scheme.py
"""

import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from toolkit import (
    ClusterDetector,
    Comparison,
    CoopDataset,
    Detections,
    Fused,
    Run,
    Scheme,
    View,
    evaluate_recording,
    find_scheme,
    format_table,
    simulate_dataset,
    suppress,
)


@dataclass(frozen=True)
class Budgeted:
    """Foreground from sensors where it takes at most `budget_bits` in a frame, boxes from all
    others."""

    budget_bits: int = 4000
    name: str = "budgeted"
    sends_points: bool = True
    sends_boxes: bool = True

    @property
    def digest(self) -> str:
        """Key of cached results."""
        return repr(self)

    def fuse(self, view: View, sensors: Sequence[int], /) -> Fused:
        """Detect in all foreground together, and add the boxes of the other sensors."""
        foreground = find_scheme("foreground")
        late = find_scheme("late")
        fits = [
            sensor
            for sensor in sensors
            if foreground.fuse(view, [sensor]).bits[0] <= self.budget_bits
        ]
        rest = [sensor for sensor in sensors if sensor not in fits]
        parts = [(fits, foreground.fuse(view, fits)), (rest, late.fuse(view, rest))]
        bits = {
            sensor: sent
            for chosen, part in parts
            for sensor, sent in zip(chosen, part.bits, strict=True)
        }
        detections = suppress(Detections.merge(part.detections for _, part in parts))
        return Fused(
            detections,
            np.array([bits[sensor] for sensor in sensors]),
            max(part.ms for _, part in parts),
        )

    def sent_points(self, counts: Any, /) -> np.ndarray:
        """Raise ValueError: it depends on what each sensor sees, so only a detector can score this
        scheme."""
        raise ValueError("the budgeted scheme needs --fidelity detector")

    def mask_pooled(self, distance: np.ndarray, radius: float, /) -> None:
        """Return None: no sensor sends both points and boxes of an object."""


def main(frames: int = 10) -> None:
    """An own scheme goes wherever a built-in one does."""
    with tempfile.TemporaryDirectory() as folder:
        simulate_dataset("tjunction", Path(folder, "few.hdf5"), run=Run(frames=frames))
        with CoopDataset(Path(folder, "few.hdf5")) as recording:
            schemes: list[Scheme | str] = ["late", Budgeted(), "foreground", "early"]
            detector = ClusterDetector.from_recording(recording)
            asked = Comparison(schemes=schemes, iou_thresholds=(0.5,))
            print(format_table(evaluate_recording(recording, detector, asked)))


if __name__ == "__main__":
    main()
