"""Tables of an evaluation as text."""

from collections.abc import Iterable, Sequence

from toolkit.detection.figures import ClassFigures, Row
from toolkit.display import format_share
from toolkit.runtime.text_tables import align_columns


def format_table(rows: Iterable[Row]) -> str:
    """Format rows as text like the paper's first table, class by class.

    Each scheme and sensor set has a line, each IoU threshold a column of AP. Recall is at the first
    threshold."""
    rows_by_class: dict[str, list[Row]] = {}
    for row in rows:
        rows_by_class.setdefault(row.label, []).append(row)
    tables = []
    for label, class_rows in rows_by_class.items():
        table = _format_rows(class_rows)
        has_heading = len(rows_by_class) > 1
        heading = f"{label}, {class_rows[0].truths} to find\n" if has_heading else ""
        tables.append(heading + table)
    return "\n\n".join(tables)


def _format_rows(rows: Sequence[Row]) -> str:
    """Format the rows of one class as a table of text.

    A line is for a scheme and a set of sensors, a row for one of its IoU thresholds; recall and
    costs are of the first threshold."""
    # row by IoU threshold of each line, by its scheme and sensors
    lines: dict[tuple[str, str], dict[float, Row]] = {}
    for row in rows:
        lines.setdefault((row.scheme, sensor_text(row.sensors)), {})[row.iou] = row
    ious = list(dict.fromkeys(row.iou for row in rows))
    first_iou = ious[0]
    headings = [f"AP@{iou:g}" for iou in ious]
    table = [["scheme", "sensors", *headings, f"recall@{first_iou:g}", "kbit/sensor", "ms/frame"]]
    for texts, row_by_iou in lines.items():
        row = row_by_iou[first_iou]
        costs = [
            format_share(row.recall, row.truths),
            f"{row.kbit_per_sensor:.2f}",
            f"{row.ms_per_frame:.1f}",
        ]
        aps = [format_share(row_by_iou[iou].ap, row_by_iou[iou].truths) for iou in ious]
        table.append([*texts, *aps, *costs])
    return align_columns(table, texts=2)  # the first two columns are texts, the rest numbers


def format_class_table(classes: Iterable[ClassFigures]) -> str:
    """Format the figures at the detector's score threshold as a table of text.

    Each class, scheme and sensor set has a line; the last column is the IoU from which a detection
    is true."""
    headings = [
        "class",
        "scheme",
        "sensors",
        "to find",
        "recall",
        "precision",
        "false/frame",
        "calibration error",
        "IoU",
    ]
    table = [headings]
    for row in classes:
        line = [
            row.label,
            row.scheme,
            sensor_text(row.sensors),
            str(row.truths),
            format_share(row.recall, row.truths),
            f"{row.precision:.3f}",
            f"{row.false_alarms_per_frame:.3f}",
            f"{row.reliability.error:.3f}",
            f"{row.iou:g}",
        ]
        table.append(line)
    return align_columns(table, texts=3)  # the first three columns are texts, the rest numbers


def sensor_text(sensors: Sequence[int]) -> str:
    """Join indices of sensors to text, such as "0,2,5"; "none" without sensors."""
    return ",".join(map(str, sensors)) or "none"
