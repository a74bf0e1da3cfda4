"""Score fusion schemes and sensor sets over a recording with a detector: the first table of the paper.

What a sensor sees and detects is computed once per frame and shared by all schemes and sets (`toolkit.detection.view`);
of a frame only the fused boxes are kept, so memory does not grow with what the sensors measure. The truth is what
stands with its centre in the site's area. Under the exact protocol an object centred outside it is there but not
scored, neither a miss nor a false alarm (`counted` of `toolkit.detection.metrics.evaluate`); under the published one it
is not there.

Milliseconds are the median frame's, from measurements to fused boxes, sensors working side by side as in the paper.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Protocol, overload, runtime_checkable

import numpy as np

from toolkit.arrays import Bool
from toolkit.boxes import Overlap
from toolkit.datasets.readings import read_frame
from toolkit.detection.codec import PAPER, Codec, check_codec
from toolkit.detection.metrics import Curve, evaluate
from toolkit.detection.metrics import Protocol as Scoring
from toolkit.detection.provenance import dataset_origin, detector_origin, settings_origin, with_file_digest
from toolkit.detection.scheme import Fused, Scheme
from toolkit.detection.schemes import SCHEMES, scheme_of
from toolkit.detection.view import NMS_IOU, frame_view
from toolkit.frame import Frame
from toolkit.objects import Detections, Detector, Objects
from toolkit.points import centred_in, select_sensors
from toolkit.runtime.files import write_text, writing_together
from toolkit.sensors.errors.profile import ErrorProfile
from toolkit.sensors.errors.profiles import PAPER_ERRORS, check_drawn, profile_of
from toolkit.sensors.sensor import Sensor
from toolkit.sites.site import Site


@runtime_checkable
class Recording(Protocol):
    """Frames at a site, such as `toolkit.datasets.dataset.CoopDataset`."""

    site: Site
    sensors: tuple[Sensor, ...]

    def __len__(self) -> int: ...
    def __getitem__(self, index: int, /) -> Frame: ...


@dataclass(frozen=True)
class Row:
    """One scheme, sensor set (indices) and IoU threshold: AP, and at the last detection recall and precision; kbit per
    sensor and frame; milliseconds per frame; the PR curve."""

    scheme: str
    sensors: tuple[int, ...]
    iou: float
    ap: float
    recall: float
    precision: float
    kbit_per_sensor: float
    ms_per_frame: float
    curve: Curve = field(repr=False, compare=False)

    def as_dict(self) -> dict[str, Any]:
        """The row for JSON, without its curve; a figure that is undefined, such as AP without any truth, is None."""
        names = ("scheme", "sensors", "iou", "ap", "recall", "precision", "kbit_per_sensor", "ms_per_frame")
        row = {name: getattr(self, name) for name in names}
        return {k: None if isinstance(v, float) and math.isnan(v) else v for k, v in row.items()}


@dataclass(frozen=True)
class Evaluation(Sequence[Row]):
    """The rows of an evaluation, and where they come from: dataset, detector, settings and version."""

    rows: tuple[Row, ...]
    provenance: dict[str, Any]

    @overload
    def __getitem__(self, index: int) -> Row: ...
    @overload
    def __getitem__(self, index: slice) -> tuple[Row, ...]: ...
    def __getitem__(self, index: int | slice) -> Row | tuple[Row, ...]:
        return self.rows[index]

    def __len__(self) -> int:
        return len(self.rows)

    def __iter__(self) -> Iterator[Row]:
        return iter(self.rows)


def evaluate_dataset(
    dataset: Recording,
    detector: Detector,
    *,
    schemes: Sequence[Scheme | str] = tuple(SCHEMES),
    sensor_sets: Sequence[Sequence[int | str] | None] = (None,),
    iou_thresholds: Sequence[float] = (0.7, 0.8, 0.9),
    frames: int | None = None,
    noise_seed: int | None = 0,
    errors: ErrorProfile | str = PAPER_ERRORS,
    radius: float | None = None,
    codec: Codec = PAPER,
    nms_iou: float = NMS_IOU,
    protocol: Scoring = "exact",
    metric: Overlap = "3d",
    label: str | int = "vehicle",
    progress: Callable[[int], None] | None = None,
) -> Evaluation:
    """Score every scheme with every sensor set at every IoU threshold, in this order.

    schemes: objects or names; sensor_sets: indices or names, None for all; frames: only the first so many; noise_seed:
    None for none; errors: of the sensors, a profile or its name, drawn from that seed; radius: in place of the site's
    hybrid radius (m); codec: of what is sent; protocol, metric and label: see `toolkit.detection.metrics.evaluate`;
    progress is told the number of frames done. Raises ValueError for a scheme, sensor or error profile that does not
    exist, two schemes of one name, and a recording without frames.
    """
    count = min(len(dataset), len(dataset) if frames is None else frames)
    if count < 1 or isinstance(frames, float):
        raise ValueError(f"there must be a frame to evaluate, a whole number, got {frames} of {len(dataset)}")
    if not (len(schemes) and len(sensor_sets) and len(iou_thresholds)):
        raise ValueError("there must be a scheme, a sensor set and an IoU threshold to evaluate")
    errors = profile_of(errors)
    check_drawn(errors, noise_seed)
    site = dataset.site if radius is None else replace(dataset.site, hybrid_radius=radius)
    named = _named(schemes)
    sets = [tuple(select_sensors(dataset.sensors, chosen)) for chosen in sensor_sets]
    runs = {(name, chosen): _Run() for name in named for chosen in sets}
    settings: dict[str, Any] = {"codec": check_codec(codec), "nms_iou": nms_iou}
    truths, counted = [], []
    for k in range(count):
        frame = read_frame(dataset, k, errors=errors, noise_seed=noise_seed)
        truth, scored = _truth(frame.objects, site, protocol)
        truths.append(truth)
        counted.append(scored)
        view = frame_view(frame, detector, site, **settings)
        for (name, chosen), run in runs.items():
            run.add(named[name].fuse(view, sorted(chosen)))
        if progress is not None:
            progress(k + 1)

    scoring: dict[str, Any] = {"metric": metric, "protocol": protocol, "label": label}
    truth_of: dict[str, Any] = {"truths": truths, "counted": counted, "iou_thresholds": iou_thresholds}
    rows = tuple(
        Row(name, chosen, iou, at.ap, at.recall, at.precision, run.kbit_per_sensor, run.ms_per_frame, at.curve)
        for (name, chosen), run in runs.items()
        for iou, at in evaluate(run.detections, **truth_of, **scoring).items()
    )
    digests = {name: scheme.digest for name, scheme in named.items()}
    ious = [float(iou) for iou in iou_thresholds]
    place = {"site": site.name, "hybrid_radius": site.hybrid_radius, "frames": count, "noise_seed": noise_seed}
    drawn = {"errors": errors.origin}
    return Evaluation(
        rows,
        dataset_origin(dataset)
        | detector_origin(detector)
        | settings_origin(codec, **place, **drawn, schemes=digests, iou=ious, nms_iou=nms_iou, **scoring),
    )


def format_table(rows: Iterable[Row]) -> str:
    """The rows as the paper's first table: a line per scheme and sensor set, a column of AP per IoU threshold."""
    lines: dict[tuple[str, str], dict[float, Row]] = {}
    for row in rows:
        lines.setdefault((row.scheme, ",".join(map(str, row.sensors)) or "none"), {})[row.iou] = row
    ious = list(dict.fromkeys(iou for line in lines.values() for iou in line))
    heads = ["scheme", "sensors", *(f"AP@{iou:g}" for iou in ious), f"recall@{ious[0]:g}", "kbit/sensor", "ms/frame"]
    table = [heads]
    for (scheme, sensors), line in lines.items():
        first = line[ious[0]]
        ap = [f"{line[iou].ap:.4f}" for iou in ious]
        costs = [f"{first.recall:.4f}", f"{first.kbit_per_sensor:.2f}", f"{first.ms_per_frame:.1f}"]
        table.append([scheme, sensors, *ap, *costs])
    widths = [max(map(len, column)) for column in zip(*table, strict=True)]
    sides = [str.ljust] * 2 + [str.rjust] * (len(heads) - 2)
    return "\n".join(
        "  ".join(side(cell, width) for side, cell, width in zip(sides, line, widths, strict=True)) for line in table
    )


def save_evaluation(rows: Evaluation, folder: str | Path) -> None:
    """Write table.json, {"provenance": {...}, "rows": [...]}, and the PR curves, pr_0.7.png and so on, into a folder
    made if missing: all, or where that fails (OSError) none."""
    with writing_together(folder) as unfinished:
        _write_evaluation(rows, unfinished)


def _write_evaluation(rows: Evaluation, folder: Path) -> None:
    from toolkit.plots.curves import draw_pr_curves

    table = {"provenance": with_file_digest(rows.provenance), "rows": [row.as_dict() for row in rows]}
    write_text(folder / "table.json", json.dumps(table, indent=1))
    for iou in dict.fromkeys(row.iou for row in rows):
        curves = {
            f"{row.scheme} {','.join(map(str, row.sensors))}: AP {row.ap:.3f}": (row.curve.recall, row.curve.precision)
            for row in rows
            if row.iou == iou
        }
        draw_pr_curves(curves, folder / f"pr_{iou:g}.png", title=f"IoU {iou:g}")


class _Run:
    """What one scheme and sensor set gave so far."""

    def __init__(self) -> None:
        self.detections: list[Detections] = []
        self._kbit: list[float] = []
        self._ms: list[float] = []

    def add(self, fused: Fused) -> None:
        self.detections.append(fused.detections)
        self._kbit.append(fused.kbit_per_sensor)
        self._ms.append(fused.ms)

    @property
    def kbit_per_sensor(self) -> float:
        return float(np.mean(self._kbit))

    @property
    def ms_per_frame(self) -> float:
        return float(np.median(self._ms))


def _truth(objects: Objects, site: Site, protocol: Scoring) -> tuple[Objects, Bool[np.ndarray, " n"]]:
    """The objects that are there, and which of them are scored."""
    within = centred_in(objects.boxes, site.area)
    there = within if protocol == "published" else np.ones_like(within)
    return objects[there], within[there]


def _named(schemes: Sequence[Scheme | str]) -> dict[str, Scheme]:
    """The schemes by their names. Raises ValueError where two share one."""
    named: dict[str, Scheme] = {}
    for scheme in map(scheme_of, schemes):
        if named.setdefault(scheme.name, scheme) != scheme:
            raise ValueError(f"two schemes are called {scheme.name!r}, {named[scheme.name]} and {scheme}: rename one")
    return named
