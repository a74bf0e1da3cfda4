"""Files of an evaluation: its table and its pictures."""

import json
from collections.abc import Sequence
from pathlib import Path

from toolkit.datasets.dataset import CoopDataset
from toolkit.datasets.recording_views import with_errors
from toolkit.detection.comparison import class_thresholds
from toolkit.detection.evaluation_result import Evaluation
from toolkit.detection.metrics import matches
from toolkit.detection.provenance import detector_origin, with_file_digest
from toolkit.detection.schemes import fuse_frame
from toolkit.display import format_share
from toolkit.objects import LABELS, VEHICLE, Detector
from toolkit.plots.curves import draw_pr_curves
from toolkit.plots.plan_view import FrameOutcome, draw_frame
from toolkit.points import frame_points, has_centre_inside
from toolkit.runtime.writing import write_text, writing_together
from toolkit.sensors.error_profiles import PAPER_ERRORS

EXAMPLE_IOU = 0.7  # at which a detection hits, in the paper's first column


def curve_files(
    classes: Sequence[str], iou_thresholds: Sequence[float] | None = None
) -> dict[str, tuple[str, float]]:
    """Return the class and IoU threshold of each picture of PR curves, by file name.

    classes: names of the classes; iou_thresholds: thresholds of all classes, None for
    each class's usual ones. Vehicles have no class in the name: pr_0.7.png, but
    pr_cyclist_0.5.png."""
    curves_by_file = dict[str, tuple[str, float]]()
    for label in classes:
        prefix = "pr_" if label == LABELS[VEHICLE] else f"pr_{label}_"
        for iou in class_thresholds(iou_thresholds, label):
            curves_by_file[f"{prefix}{iou:g}.png"] = (label, iou)
    return curves_by_file


def save_evaluation(rows: Evaluation, folder: str | Path) -> None:
    """Write table.json and pictures of PR curves into a folder, made if missing.

    rows: result of an evaluation. Each class and IoU threshold has one picture, named as in
    `curve_files`, with a curve for each scheme and sensor set. table.json is
    {"provenance": {...}, "rows": [...], "classes": [...]}. Either all files are written or, if that
    fails (OSError), no file is.
    """
    with writing_together(folder) as unfinished:
        table = {"provenance": with_file_digest(rows.provenance), **rows.as_dict()}
        write_text(unfinished / "table.json", json.dumps(table, indent=1))
        for label, iou in dict.fromkeys((row.label, row.iou) for row in rows):
            picture_rows = [row for row in rows if (row.label, row.iou) == (label, iou)]
            curves = {}
            for row in picture_rows:
                ap = format_share(row.ap, row.truths)
                legend = f"{row.scheme} {','.join(map(str, row.sensors))}: AP {ap}"
                curves[legend] = row.curve.recall, row.curve.precision
            (file_name,) = curve_files([label], [iou])  # a single class and threshold
            title = f"IoU {iou:g}" if label == LABELS[VEHICLE] else f"{label}, IoU {iou:g}"
            draw_pr_curves(curves, unfinished / file_name, title=title)


def draw_example(
    recording: CoopDataset, detector: Detector, out: str | Path, *, seed: int = 0
) -> None:
    """Draw the frame with the most objects from above, with early fusion of all sensors.

    Hits, misses and false alarms of vehicles are marked at `EXAMPLE_IOU`. Objects centred outside
    the area do not count. recording: frames of a known site; out: file to write; seed: seed of the
    sensors' noise."""
    site = recording.site
    fullest_frame = max(recording, key=lambda frame: len(frame.objects))
    frame = with_errors(fullest_frame, PAPER_ERRORS, seed)
    truth = frame.objects
    detections = fuse_frame("early", frame, detector, site=site).detections
    is_in_area = has_centre_inside(truth.boxes, site.area)
    (result,) = matches(detections, truth, [EXAMPLE_IOU], counted=is_in_area)
    sensor_count = len(frame.sensors)
    sensors = "1 sensor" if sensor_count == 1 else f"{sensor_count} sensors"
    outcome = FrameOutcome(
        EXAMPLE_IOU,
        truth_hit=result.hit,
        truth_ignored=~result.scored,
        detection_hit=result.truth >= 0,
        detection_ignored=result.ignored,
    )
    name = detector_origin(detector)["detector"]
    title = f"{site.name}, frame {frame.index}: early fusion of {sensors}, {name}"
    clouds = frame_points(frame, area=site)
    draw_frame(
        site, out, clouds=clouds, truth=truth, detections=detections, outcome=outcome, title=title
    )
