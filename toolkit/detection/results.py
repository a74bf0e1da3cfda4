"""Detections in samples as files: our boxes.json, OpenLABEL, or KITTI's label_2 with scores."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any, Literal

import numpy as np

from toolkit.datasets.layouts.kitti import kitti_text
from toolkit.datasets.layouts.openlabel import openlabel_content
from toolkit.datasets.records import add_problems, boxes_record, write_boxes
from toolkit.detection.detect import Detected
from toolkit.runtime.files import write_text

Format = Literal["boxes", "openlabel", "kitti"]


def write_detections(
    found: Iterable[Detected], out: str | Path, form: Format = "boxes", **more: Any
) -> Iterator[Detected]:
    """Write detections as they come by, and hand them on: boxes to one file at the end, the others to a file each.

    out: the file of boxes, or a folder; form: boxes, openlabel or kitti; more: what else the file of boxes shall say.
    """
    out, entries = Path(out), []
    for each in found:
        sample = each.sample
        if form == "boxes":
            entries.append(boxes_record(sample.name, sample.time, each.detections))
        elif form == "openlabel":
            text = json.dumps(openlabel_content(sample, each.detections), indent=1)
            write_text(out / f"{file_name(sample.name)}.json", text)
        else:
            write_text(out / f"{file_name(sample.name)}.txt", kitti_text(sample, found=each.detections))
        yield each
    if form == "boxes":
        write_boxes(out, entries, **more)


def file_name(name: str) -> str:
    """The name of a sample without what no file can be called.

    >>> file_name("106-105/seq-1/00000")
    '106-105_seq-1_00000'
    """
    return "".join(letter if letter.isalnum() or letter in "-_.#" else "_" for letter in name)


def summary(found: Iterable[Detected]) -> dict[str, Any]:
    """How many samples, detections and labels there were, what was left out in reading, and median milliseconds."""
    samples = detections = 0
    problems: dict[str, int] = {}
    levelling, detecting = [], []
    for each in found:
        samples, detections = samples + 1, detections + len(each.detections)
        add_problems(problems, each.sample.problems)
        levelling.append(each.level_ms)
        detecting.append(each.detect_ms)
    medians = (float(np.median(times)) if times else None for times in (levelling, detecting))
    figures = dict(zip(("level_ms", "detect_ms"), medians, strict=True))
    return {"samples": samples, "detections": detections, "problems": problems, **figures}


def described(figures: dict[str, Any]) -> str:
    """A summary in a line of text."""
    times = [f"{figures[name]:.0f} ms {what}" for name, what in _TIMES if figures[name] is not None]
    problems = [f"{number} {kind}" for kind, number in figures["problems"].items()]
    counts = f"{figures['detections']} detections in {figures['samples']} clouds"
    return "; ".join([counts, *([", ".join(times)] if times else []), *([", ".join(problems)] if problems else [])])


_TIMES = (("level_ms", "to level"), ("detect_ms", "to detect"))
