"""A detector scored on recordings of clouds, with every fusion scheme: rows, times, kbit and what was left out."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from toolkit.calibration.poses import FoundPose
from toolkit.calibration.scenes import SampleScenes
from toolkit.datasets.sample import Sample
from toolkit.detection.breakdown import SampleRow, Scoring, format_rows
from toolkit.detection.codec import PAPER, Codec
from toolkit.detection.detect import DETECTION_REACH, Detected, Level, detect_samples, sends_images
from toolkit.detection.link.load import link_load
from toolkit.detection.results import described, summary
from toolkit.detection.scheme import Scheme
from toolkit.objects import Detector, check_known
from toolkit.runtime.files import replace_infinite, write_text


@dataclass(frozen=True)
class SampleEvaluation:
    """rows: of every scheme, class and protocol; schemes: samples, detections, problems, median milliseconds and mean
    kbit per sensor of each; poses: of the sensors, where they were found before."""

    rows: tuple[SampleRow, ...]
    schemes: dict[str, dict[str, Any]]
    poses: tuple[FoundPose, ...] = ()

    def with_poses(self, found: Sequence[FoundPose]) -> SampleEvaluation:
        """The same, saying where the sensors were found before."""
        return replace(self, poses=tuple(found))

    def as_dict(self) -> dict[str, Any]:
        """For JSON; None for a figure that is undefined."""
        poses = {"poses": {each.sensor.name: each.described() for each in self.poses}} if self.poses else {}
        return replace_infinite({"rows": [row.as_dict() for row in self.rows], "schemes": self.schemes, **poses})

    def text(self) -> str:
        """Tables by scheme, class and protocol."""
        parts = ["\n".join(map(str, self.poses))] if self.poses else []
        for name, figures in self.schemes.items():
            sent = _said(figures)
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
    scenes: SampleScenes | None = None,
    rate: float | None = None,
    seen: Callable[[Iterable[Detected]], Iterable[Detected]] = iter,
) -> SampleEvaluation:
    """Score a detector on the samples that `opened` gives, once for each scheme, in all clouds at once without any.

    scenes: of the sensors, learnt from these samples where they are needed and none are given; rate: frames per second,
    to say what each scheme puts on a link; seen: passes detections on as they come by, and may look at them; the other
    arguments are those of `detect_samples` and `toolkit.detection.breakdown`. Raises ValueError for a class that
    the detector does not know, and where there is no sample.
    """
    check_known(detector, classes)
    scenes = SampleScenes(opened) if scenes is None else scenes
    rows: list[SampleRow] = []
    figures: dict[str, dict[str, Any]] = {}
    for scheme in schemes or (None,):
        scoring, found = Scoring(half), []
        detected = detect_samples(
            opened(), detector, levelling=levelling, middle=middle, still=still, sensors=sensors, scheme=scheme,
            half=half, codec=codec, scenes=scenes,
        )  # fmt: skip
        for each in seen(detected):
            scoring.add(each)
            found.append(_without_clouds(each))
        if not found:
            raise ValueError("there is no sample to evaluate: check the path and the layout")
        name = "all clouds" if scheme is None else scheme.name
        rows += [replace(row, scheme=name) for row in scoring.rows(classes, iou_thresholds)]
        figures[name] = summary(found) | _sent(found, rate) | _not_shown(scheme, codec, scenes)
    return SampleEvaluation(tuple(rows), figures)


def _sent(found: Sequence[Detected], rate: float | None) -> dict[str, Any]:
    """What the sensors sent: the mean, and what it puts on a link."""
    bits = [each.bits for each in found if each.bits]
    if not bits:
        return {"kbit_per_sensor": None}
    figures: dict[str, Any] = {"kbit_per_sensor": float(np.mean([np.mean(each) for each in bits])) / 1000}
    if rate is not None and len({len(each) for each in bits}) == 1:
        figures["load"] = link_load(np.array(bits, np.int64), rate).as_dict()
    return figures


def _not_shown(scheme: Scheme | None, codec: Codec, scenes: SampleScenes) -> dict[str, Any]:
    """Points that images of the sensors do not show, by sensor and kind, with how many there are, where images are
    sent."""
    if not sends_images(scheme, codec):
        return {}
    every = scenes.every.items()
    return {"images": {name: {"points": each.points, **each.left_out} for name, each in every}}


def _said(figures: dict[str, Any]) -> str:
    """What was sent, in words."""
    kbit, load = figures["kbit_per_sensor"], figures.get("load")
    said = "" if kbit is None else f"; {kbit:.2f} kbit per sensor, {125 * kbit:.0f} bytes"
    if load is not None:
        shares = ", ".join(f"{share:.1%} of {link}" for link, share in load["shares"].items())
        said += f"; at {load['rate']:g} Hz {load['mbit_per_s']:.3f} Mbit/s together, {shares}"
    for name, each in figures.get("images", {}).items():
        kinds = ", ".join(f"{count} {kind}" for kind, count in each.items() if kind != "points")
        said += f"\n{name}: of {each['points']} points its images leave out {kinds or 'none'}"
    return said


def _without_clouds(each: Detected) -> Detected:
    return replace(each, sample=replace(each.sample, clouds=()), ground=None)
