"""A detector scored on recordings of clouds, with every fusion scheme: rows, times, kbit and what was left out."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from toolkit.datasets.sample import Sample
from toolkit.detection.codec import PAPER, Codec
from toolkit.detection.samples.detected import DETECTION_REACH, Detected, Level, detect_samples
from toolkit.detection.samples.results import described, summary
from toolkit.detection.samples.scoring import SampleRow, Scoring, format_rows
from toolkit.detection.scheme import Scheme
from toolkit.objects import Detector, check_known
from toolkit.runtime.files import write_text
from toolkit.runtime.json_files import finite


@dataclass(frozen=True)
class SampleEvaluation:
    """rows: of every scheme, class and protocol; schemes: samples, detections, problems, median milliseconds and mean
    kbit per sensor of each."""

    rows: tuple[SampleRow, ...]
    schemes: dict[str, dict[str, Any]]

    def as_dict(self) -> dict[str, Any]:
        """For JSON; None for a figure that is undefined."""
        return finite({"rows": [row.as_dict() for row in self.rows], "schemes": self.schemes})

    def text(self) -> str:
        """Tables by scheme, class and protocol."""
        parts = []
        for name, figures in self.schemes.items():
            kbit = figures["kbit_per_sensor"]
            sent = "" if kbit is None else f"; {kbit:.2f} kbit per sensor"
            rows = [row for row in self.rows if row.scheme == name]
            parts.append(f"{name}: {described(figures)}{sent}\n\n{format_rows(rows)}")
        return "\n\n\n".join(parts)

    def save(self, path: str | Path) -> None:
        """Write rows and schemes as JSON, whole or not at all."""
        write_text(path, json.dumps(self.as_dict(), indent=1, allow_nan=False))


def evaluate_samples(
    opened: Callable[[], Iterable[Sample]],
    detector: Detector,
    *,
    schemes: Sequence[Scheme] = (),
    classes: Sequence[str] = ("vehicle",),
    iou_thresholds: Sequence[float] | None = None,
    levelling: Level = "map",
    middle: Sequence[float] | None = None,
    half: tuple[float, float] = (DETECTION_REACH, DETECTION_REACH),
    still: bool = False,
    sensors: Sequence[str] | None = None,
    codec: Codec = PAPER,
    seen: Callable[[Iterable[Detected]], Iterable[Detected]] = iter,
) -> SampleEvaluation:
    """Score a detector on the samples that `opened` gives, once for each scheme, in all clouds at once without any.

    seen: passes detections on as they come by, and may look at them; the other arguments are those of `detect_samples`
    and `toolkit.detection.samples.scoring`. Raises ValueError for a class that the detector does not know, and where
    there is no sample.
    """
    check_known(detector, classes)
    rows: list[SampleRow] = []
    figures: dict[str, dict[str, Any]] = {}
    for scheme in schemes or (None,):
        scoring, found, kbit = Scoring(half), [], []
        detected = detect_samples(
            opened(), detector, levelling=levelling, middle=middle, still=still, sensors=sensors, scheme=scheme,
            half=half, codec=codec,
        )  # fmt: skip
        for each in seen(detected):
            scoring.add(each)
            found.append(_without_clouds(each))
            kbit.append(each.kbit_per_sensor)
        if not found:
            raise ValueError("there is no sample to evaluate: check the path and the layout")
        name = "all clouds" if scheme is None else scheme.name
        rows += [replace(row, scheme=name) for row in scoring.rows(classes, iou_thresholds)]
        figures[name] = summary(found) | {"kbit_per_sensor": None if scheme is None else float(np.mean(kbit))}
    return SampleEvaluation(tuple(rows), figures)


def _without_clouds(each: Detected) -> Detected:
    return replace(each, sample=replace(each.sample, clouds=()), ground=None)
