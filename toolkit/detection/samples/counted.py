"""What a recording of clouds holds, before any detector: objects, points on each, and whether the set counts so too."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np

from toolkit.boxes import count_points
from toolkit.datasets.records.labels import add_problems
from toolkit.datasets.sample import Sample
from toolkit.objects import LABELS, label_index


def survey_samples(samples: Iterable[Sample], *, classes: Sequence[str | int] = LABELS) -> dict[str, Any]:
    """Figures for JSON: samples, points per cloud of each sensor (mean), objects per sample by class, of each class the
    points on an object (mean, median, share without any), how many cuboids hold as many points as the set says, and
    what was met in reading. Raises ValueError where there is no sample.
    """
    wanted = [label_index(label) for label in classes]
    points: dict[str, list[int]] = {}
    on_objects: dict[int, list[np.ndarray]] = {label: [] for label in range(len(LABELS))}
    problems: dict[str, int] = {}
    agree = known = number = 0
    for sample in samples:
        number += 1
        for cloud in sample.clouds:
            points.setdefault(cloud.name, []).append(len(cloud.points))
        together = sample.points()
        counts = count_points(together, sample.objects.boxes)
        for label, so_far in on_objects.items():
            so_far.append(counts[sample.objects.labels == label])
        for boxes, own in ((sample.objects.boxes, sample.counts), (sample.others.boxes, sample.others.counts)):
            if own is not None:
                agree, known = agree + int((count_points(together, boxes) == own).sum()), known + len(own)
        add_problems(problems, sample.problems)
    if not number:
        raise ValueError("there is no sample to survey: check the path and the layout")
    every = {label: np.concatenate(parts) for label, parts in on_objects.items()}
    return {
        "samples": number,
        "points_per_cloud": {name: float(np.mean(counts)) for name, counts in points.items()},
        "objects_per_sample": {LABELS[label]: len(counts) / number for label, counts in every.items()},
        "classes": {LABELS[label]: _of(every[label]) for label in wanted},
        "counts_that_agree": [agree, known] if known else None,
        "problems": problems,
    }


def _of(counts: np.ndarray) -> dict[str, Any]:
    figures = (counts.mean(), np.median(counts), (counts == 0).mean()) if len(counts) else (None,) * 3
    named = zip(("mean_points", "median_points", "unseen"), figures, strict=True)
    return {"objects": len(counts)} | {name: None if value is None else float(value) for name, value in named}


def survey_text(figures: dict[str, Any]) -> str:
    """The figures in lines of text."""
    objects = "  ".join(f"{name} {count:.2f}" for name, count in figures["objects_per_sample"].items())
    clouds = ", ".join(f"{name} {count:.0f}" for name, count in figures["points_per_cloud"].items())
    lines = [f"{figures['samples']} samples; points per cloud: {clouds}", f"objects per sample: {objects}"]
    for label, each in figures["classes"].items():
        if each["objects"]:
            lines.append(
                f"{label}: {each['unseen']:.1%} of {each['objects']} without a point, mean {each['mean_points']:.1f}, "
                f"median {each['median_points']:g} points"
            )
    if figures["counts_that_agree"]:
        agree, known = figures["counts_that_agree"]
        lines.append(f"{agree} of {known} labelled cuboids hold as many points as the set says")
    lines += [f"{number} {kind}" for kind, number in figures["problems"].items()]
    return "\n".join(lines)
