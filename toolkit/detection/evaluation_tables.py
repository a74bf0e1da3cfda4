"""Tables of an evaluation as text."""

from collections.abc import Iterable, Sequence

from toolkit.detection.figures import ClassFigures, Row
from toolkit.display import format_share
from toolkit.runtime.text_tables import align_columns


def format_table(rows: Iterable[Row]) -> str:
    """Format rows as text like the paper's first table, class by class.

    Each scheme and sensor set has a line, each IoU threshold a column of AP. Recall is at the first
    threshold."""
    by_class: dict[str, list[Row]] = {}
    for row in rows:
        by_class.setdefault(row.label, []).append(row)
    tables = []
    for label, class_rows in by_class.items():
        lines: dict[tuple[str, str], dict[float, Row]] = {}
        for row in class_rows:
            lines.setdefault((row.scheme, sensor_text(row.sensors)), {})[row.iou] = row
        ious = list(dict.fromkeys(row.iou for row in class_rows))
        aps = [f"AP@{iou:g}" for iou in ious]
        table = [["scheme", "sensors", *aps, f"recall@{ious[0]:g}", "kbit/sensor", "ms/frame"]]
        for texts, line in lines.items():
            row = line[ious[0]]
            costs = [
                format_share(row.recall, row.truths),
                f"{row.kbit_per_sensor:.2f}",
                f"{row.ms_per_frame:.1f}",
            ]
            aps = [format_share(line[iou].ap, line[iou].truths) for iou in ious]
            table.append([*texts, *aps, *costs])
        heading = f"{label}, {class_rows[0].truths} to find\n" if len(by_class) > 1 else ""
        tables.append(heading + align_columns(table, texts=2))
    return "\n\n".join(tables)


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
        shares = (row.precision, row.false_alarms_per_frame, row.reliability.error)
        texts = [row.label, row.scheme, sensor_text(row.sensors), str(row.truths)]
        texts.append(format_share(row.recall, row.truths))
        table.append([*texts, *(f"{figure:.3f}" for figure in shares), f"{row.iou:g}"])
    return align_columns(table, texts=3)


def sensor_text(sensors: Sequence[int]) -> str:
    """Join indices of sensors to text, such as "0,2,5"; "none" without sensors."""
    return ",".join(map(str, sensors)) or "none"
