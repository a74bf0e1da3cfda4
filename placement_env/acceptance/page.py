"""Page of an acceptance: promised and measured side by side, as a report's document and as text."""

import math
from collections.abc import Sequence

from placement_env.acceptance.acceptance import Acceptance
from placement_env.acceptance.class_checks import BLOCK_S, ClassCheck
from placement_env.acceptance.consistency import Consistency
from placement_env.acceptance.sensor_checks import (
    MAX_NOISE_RATIO,
    MAX_POSE_MOVE_M,
    MAX_POSE_TURN_DEG,
    MIN_RANGE_SHARE,
    MIN_RETURN_SHARE,
    PoseError,
    SensorCheck,
)
from placement_env.acceptance.sensor_figures import SensorFigures
from placement_env.analysis.intervals import MIN_BLOCKS
from placement_env.cases import iou_text
from placement_env.report import charts
from placement_env.report.content import Judgement
from placement_env.report.pages.columns import iou_value, text_columns
from placement_env.report.pages.document import (
    Bullets,
    Cell,
    Column,
    Content,
    Document,
    Fact,
    Facts,
    PageDrawing,
    Paragraph,
    ReportBlock,
    Section,
    build_content,
    build_table,
)
from placement_env.report.pages.figure_texts import (
    UNDEFINED_MARK,
    ap_text,
    interval_text,
    number_text,
    percent,
)
from toolkit.display import describe_count
from toolkit.runtime.text_tables import align_columns

UNMEASURED = SensorFigures(0.0, float("nan"), float("nan"))  # a sensor that is not recorded
NO_LABELS = "The recording has no labels, so AP, recall and HOTA are unknown."
TOO_SHORT_TO_COMPARE = (
    f"AP has an interval from {MIN_BLOCKS} blocks of {BLOCK_S:.0f} s on: record "
    f"{MIN_BLOCKS * BLOCK_S / 60:.0f} minutes or more."
)


def build_page(acceptance: Acceptance, plan: str, recording: str) -> Document:
    """Return the page as a document of sections.

    plan, recording: names of the plan's folder and of the recording."""
    contents = {
        "decision": ("Does the street keep the plan's promise?", _verdict_content(acceptance)),
        "sensors": ("Sensors", _list_sensors(acceptance)),
        "detection": ("Detection", _list_classes(acceptance)),
        "method": ("How it was checked", _explain(acceptance)),
    }
    sections = tuple(Section(key, title, *section) for key, (title, section) in contents.items())
    seconds = "" if math.isnan(acceptance.seconds) else f", {acceptance.seconds:.0f} s"
    subtitle = f"{recording}: {describe_count(acceptance.frames, 'frame')}{seconds}; plan {plan}"
    return Document(f"Acceptance of {acceptance.site}", subtitle, sections)


def describe_acceptance(acceptance: Acceptance) -> str:
    """Return the verdict, faults, tables of sensors and classes, and findings as plain text."""
    parts = ["\n".join([acceptance.verdict, *(f"  {fault}" for fault in acceptance.faults)])]
    headings = ["sensor", "returns", "range m", "noise cm", "pose off", "from plan", "fault"]
    table = [headings, *(_sensor_texts(check) for check in acceptance.sensors)]
    parts.append(align_columns(table, texts=1))
    if acceptance.classes:
        headings = ["class", "IoU", "AP promised", "AP measured", "recall", "HOTA", "found"]
        table = [headings, *(_class_texts(check) for check in acceptance.classes)]
        parts.append(align_columns(table, texts=1))
    if acceptance.consistency is not None:
        parts.append(_describe_consistency(acceptance.consistency, acceptance.promised_recall))
    if acceptance.findings:
        parts.append("\n".join(["doctor:", *(f"  {finding}" for finding in acceptance.findings)]))
    return "\n\n".join(parts)


def _verdict_content(acceptance: Acceptance) -> Content:
    """Return the verdict with faults, results of classes, and what else was found.

    Findings are those of `coview doctor` in the recording: suspected mistakes of labels, poses and
    clocks."""
    facts = [Fact("Fault", fault, alarm=True) for fault in acceptance.faults]
    working = [check for check in acceptance.sensors if not check.faults()]
    count = describe_count(len(acceptance.sensors), "sensor")
    facts.append(Fact("Sensors", f"{len(working)} of {count} are as planned."))
    for check in acceptance.classes:
        if check.measured is not None:
            text = (
                f"Promised {ap_text(check.promised)}, measured {ap_text(check.measured)}, at IoU "
                f"{iou_text(check.iou)}. {_compare(check)}"
            )
            facts.append(Fact(check.label.capitalize(), text, alarm=check.falls_short))
    if acceptance.consistency is not None:
        text = _describe_consistency(acceptance.consistency, acceptance.promised_recall)
        facts.append(Fact("Consistency", text))
    if acceptance.extra_sensors:
        facts.append(Fact("Not planned", f"Sensors {', '.join(acceptance.extra_sensors)}."))
    blocks: list[ReportBlock] = [Facts(tuple(facts))]
    if acceptance.findings:
        blocks.append(Paragraph("The doctor suspects in the recording:"))
        blocks.append(Bullets(tuple(map(str, acceptance.findings))))
    return build_content(acceptance.verdict, *blocks)


def _compare(check: ClassCheck) -> str:
    """Say in a sentence whether promised and measured AP agree."""
    if not check.is_promised:
        return "This class does not count in the plan."
    if not check.is_compared:
        return TOO_SHORT_TO_COMPARE
    if check.falls_short:
        return "The street falls short."
    if check.measured is not None and check.measured.low > check.promised.high:
        return "The street does better."
    return "The intervals overlap."


def _list_sensors(acceptance: Acceptance) -> Content:
    """Return a table of promised and measured figures of each sensor."""
    columns = text_columns(
        "Sensor", "returns", "range (m)", "noise (cm)", "off stated pose", "off plan", "fault"
    )
    rows = [_sensor_cells(check) for check in acceptance.sensors]
    faulty = [check.name for check in acceptance.sensors if check.faults()]
    conclusion = "Every sensor is as planned."
    if faulty:
        conclusion = f"Not as planned: {', '.join(faulty)}."
    notes = tuple(
        f"Pose of {check.name}: {check.pose_note}."
        for check in acceptance.sensors
        if check.pose_note
    )
    caption = (
        "Returns are a share of the promised ones, with a 95% interval; range and noise as "
        "measured and as promised; poses with standard deviations"
    )
    blocks: tuple[ReportBlock, ...] = build_table(caption, columns, rows)
    return build_content(conclusion, *blocks, *((Bullets(notes),) if notes else ()))


def _sensor_cells(check: SensorCheck) -> tuple[Cell | str, ...]:
    """Return a row of the table of sensors: name, returns, range, noise, two pose errors, faults.

    Returns are a share of the promised ones; range and noise have the measured and the promised
    figure. The pose found is compared with the pose that the recording states, then with the plan's
    pose."""
    measured = check.measured or UNMEASURED
    returns = percent(check.returns_share)
    if not math.isnan(check.returns_low):
        returns += f" ({100 * check.returns_low:.1f}–{100 * check.returns_high:.1f})"
    range_text = number_text(measured.range_m, 0)
    noise_text = number_text(100 * measured.noise_m, 1)
    return (
        check.name,
        Cell(returns, check.returns_share),
        Cell(f"{range_text} of {check.promised.range_m:.0f}", measured.range_m),
        Cell(f"{noise_text} of {100 * check.promised.noise_m:.1f}", measured.noise_m),
        _pose_text(check.pose_error),
        _pose_text(check.mount_error),
        "; ".join(check.faults()) or "none",
    )


def _pose_text(error: PoseError | None) -> str:
    """Format a difference of poses with its standard deviations."""
    if error is None:
        return UNDEFINED_MARK
    return (
        f"{error.turn_deg:.2f} ± {number_text(error.turn_deviation_deg, 2)}°, "
        f"{100 * error.move_m:.1f} ± {number_text(100 * error.move_deviation_m, 1)} cm"
    )


def _sensor_texts(check: SensorCheck) -> list[str]:
    """Return a row of the plain table, promised and measured with a slash between."""
    promised = check.promised
    measured = check.measured or UNMEASURED
    return [
        check.name,
        percent(check.returns_share),
        f"{number_text(promised.range_m, 0)}/{number_text(measured.range_m, 0)}",
        f"{number_text(100 * promised.noise_m, 1)}/{number_text(100 * measured.noise_m, 1)}",
        *(_short_pose(error) for error in (check.pose_error, check.mount_error)),
        "yes" if check.faults() else "no",
    ]


def _short_pose(error: PoseError | None) -> str:
    """Format a difference of poses, such as "0.52° 3.1 cm"; a dash if it is unknown."""
    if error is None:
        return UNDEFINED_MARK
    return f"{error.turn_deg:.2f}° {100 * error.move_m:.1f} cm"


def _list_classes(acceptance: Acceptance) -> Content:
    """Return chart and table of promised and measured results of each class.

    A recording without labels has no classes; its sensors are compared with each other instead."""
    if not acceptance.classes:
        blocks: list[ReportBlock] = []
        if acceptance.consistency is not None:
            text = _describe_consistency(acceptance.consistency, acceptance.promised_recall)
            blocks = [Paragraph(text)]
        return build_content(NO_LABELS, *blocks)
    short = [check.label for check in acceptance.classes if check.falls_short]
    conclusion = "No class falls short of its promised AP."
    if short:
        conclusion = f"Short of the promised AP: {', '.join(short)}."
    elif not any(check.is_compared for check in acceptance.classes):
        conclusion = f"Promised and measured AP cannot be compared. {TOO_SHORT_TO_COMPARE}"
    columns = (
        *text_columns("Class"),
        Column("IoU", digits=2),
        *text_columns("AP promised", "AP measured", "recall promised", "measured"),
        Column("HOTA", digits=3),
        Column("objects", digits=0),
    )
    rows = [_class_cells(check) for check in acceptance.classes]
    return build_content(
        conclusion,
        *_draw_classes(acceptance.classes),
        *build_table("Promised and measured, by class", columns, rows),
    )


def _draw_classes(checks: Sequence[ClassCheck]) -> tuple[ReportBlock, ...]:
    """Return a chart of promised and measured AP, nothing if no class has objects."""
    bars: list[tuple[str, Judgement | None]] = []  # name and AP
    for check in checks:
        if check.measured is not None:
            bars.append((f"{check.label}, promised", check.promised))
            bars.append((f"{check.label}, measured", check.measured))
    if not bars:
        return ()
    alt = "; ".join(f"{name}: {ap_text(judged)}" for name, judged in bars if judged is not None)
    svg = charts.interval_bars(bars, "AP, promised and measured")
    return (PageDrawing(svg, "AP with 95% intervals.", alt),)


def _class_cells(check: ClassCheck) -> tuple[Cell | str | float | None, ...]:
    """Return a row of the table of classes: class, IoU, AP and recall twice, HOTA, objects."""
    measured = check.measured
    return (
        check.label,
        iou_value(check.iou),
        _ap_cell(check.promised),
        UNDEFINED_MARK if measured is None else _ap_cell(measured),
        percent(check.promised.recall),
        UNDEFINED_MARK if measured is None else percent(measured.recall),
        check.hota,
        0 if measured is None else measured.vehicles,
    )


def _ap_cell(judged: Judgement) -> Cell:
    """Return an AP with its interval."""
    return Cell(f"{judged.format_ap()} ({interval_text(judged)})", judged.ap)


def _class_texts(check: ClassCheck) -> list[str]:
    """Return a row of the text table of classes.

    Columns: class, IoU, AP promised and measured with intervals, recall of both, HOTA, outcome."""
    promised = check.promised
    measured = check.measured
    measured_ap = UNDEFINED_MARK
    measured_recall = None
    if measured is not None:
        measured_ap = f"{measured.format_ap()} ({interval_text(measured)})"
        measured_recall = measured.recall
    return [
        check.label,
        iou_text(check.iou),
        f"{promised.format_ap()} ({interval_text(promised)})",
        measured_ap,
        f"{percent(promised.recall)}/{percent(measured_recall)}",
        number_text(check.hota),
        _outcome(check),
    ]


def _outcome(check: ClassCheck) -> str:
    """Return the result of the comparison in a word or two."""
    if not check.is_promised:
        return "not promised"
    if check.falls_short:
        return "less"
    return "as promised" if check.is_compared else "unknown"


def _describe_consistency(consistency: Consistency, promised_recall: float) -> str:
    """Describe in sentences what a recording without labels shows.

    The detections by each half of the sensors are compared with those by the other half.

    promised_recall: recall in the plan."""
    if not consistency.detections:
        return "Neither half of the sensors found anything to compare."
    interval = ""
    if not math.isnan(consistency.recall_low):
        low = percent(consistency.recall_low)
        interval = f" ({low} to {percent(consistency.recall_high)})"
    sentences = [
        f"Of {describe_count(consistency.detections, 'detection')} by half of the sensors, the "
        f"other half confirms {percent(consistency.second_share)} and "
        f"{percent(consistency.first_share)}; so both together find at most "
        f"{percent(consistency.recall)}{interval} of the road users, the plan promises "
        f"{percent(promised_recall)}."
    ]
    if consistency.tracks:
        ended = describe_count(consistency.tracks, "track")
        vanished = percent(consistency.vanished_share)
        sentences.append(f"Of {ended} that end, {vanished} end inside the area.")
    return " ".join(sentences)


def _explain(acceptance: Acceptance) -> Content:
    """Say how figures and faults are defined."""
    rules = (
        f"Returns, range and noise are compared with the empty planned site and the catalogue: "
        f"below {MIN_RETURN_SHARE:.0%} of the returns, {MIN_RANGE_SHARE:.0%} of the range or above "
        f"{MAX_NOISE_RATIO:g} times the noise is a fault. Range is the distance within which "
        "95% of the returns are.",
        "Poses are found by what stands still, as by coview calibrate. A fault is a turn of more "
        f"than {MAX_POSE_TURN_DEG:g}° or a move of more than {100 * MAX_POSE_MOVE_M:.0f} cm that "
        "is above three standard deviations.",
        f"AP counts as in the plan. Intervals are a bootstrap over blocks of {BLOCK_S:.0f} s. A "
        "class that counts in the plan falls short if the interval of its measured AP is below the "
        "interval of the promised one.",
        "Without labels, every other sensor must confirm the detections of the rest.",
    )
    steps = describe_count(acceptance.frames, "frame")
    return build_content(f"Everything is computed from {steps} of the recording.", Bullets(rules))
