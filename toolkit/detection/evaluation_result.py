"""Result of an evaluation: its rows, with their context."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, overload

from toolkit.calibration.found_pose import FoundPose
from toolkit.detection.breakdown import GroupRow, format_rows
from toolkit.detection.detect import describe_summary
from toolkit.detection.evaluation_tables import format_class_table, format_table
from toolkit.detection.figures import ClassFigures, Row
from toolkit.detection.link.load import SetLoad, format_loads
from toolkit.runtime.stage_times import describe_times
from toolkit.runtime.text_values import replace_infinite


@dataclass(frozen=True)
class Evaluation(Sequence[Row]):
    """Rows of an evaluation, with their context; a sequence of its rows.

    Attributes:
        rows: figures of each scheme, sensor set, class and IoU threshold.
        provenance: data, detector, settings and version.
        classes: figures of each scheme, sensor set and class at the detector's score threshold.
        loads: load of each scheme and sensor set on a link, empty if no rate was given.
        schemes: frames, detections, problems and median milliseconds of each scheme, by its name
            (followed by its sensors if there are several sets).
        breakdown: AP by range, by points and by other sets' protocols.
        poses: poses of the sensors, empty unless they were estimated before.
    """

    rows: tuple[Row, ...]
    provenance: dict[str, object]
    classes: tuple[ClassFigures, ...] = ()
    loads: tuple[SetLoad, ...] = ()
    schemes: dict[str, dict[str, Any]] = field(default_factory=dict)
    breakdown: tuple[GroupRow, ...] = ()
    poses: tuple[FoundPose, ...] = ()

    @overload
    def __getitem__(self, index: int) -> Row: ...
    @overload
    def __getitem__(self, index: slice) -> tuple[Row, ...]: ...
    def __getitem__(self, index: int | slice) -> Row | tuple[Row, ...]:
        return self.rows[index]

    def __len__(self) -> int:
        return len(self.rows)

    def text(self) -> str:
        """Return all figures as tables of text, with poses, loads and breakdown if there are any.

        Problems of reading are in the summaries of schemes if there is a breakdown, else they come
        last."""
        parts = ["\n".join(map(str, self.poses))] if self.poses else []  # a line for each sensor
        parts.append(format_table(self.rows))
        if self.loads:
            parts.append(
                f"on a link at {self.loads[0].load.rate:g} Hz:\n{format_loads(self.loads)}"
            )
        parts.append(f"above the detector's threshold:\n{format_class_table(self.classes)}")
        for name, figures in self.schemes.items():
            if "timings" in figures:
                parts.append(f"times of {name}:\n{describe_times(figures['timings'])}")
        if self.breakdown:
            for name, figures in self.schemes.items():
                parts.append(_format_scheme(name, figures))
                parts.append(format_rows([row for row in self.breakdown if row.scheme == name]))
            return "\n\n".join(parts)
        # all schemes have the same problems
        problems: Mapping[str, int] = next(
            (figures["problems"] for figures in self.schemes.values()), {}
        )
        if problems:
            counts = ", ".join(f"{number} {kind}" for kind, number in problems.items())
            parts.append(f"left out or doubtful: {counts}")
        return "\n\n".join(parts)

    def as_dict(self) -> dict[str, Any]:
        """Return all but the provenance for JSON; NaN and infinity become None.

        Loads, breakdown and poses are left out if there are none."""
        rows = [row.as_dict() for row in self.rows]
        classes = [figures.as_dict() for figures in self.classes]
        optional: dict[str, Any] = {"loads": [load.as_dict() for load in self.loads]}
        optional["breakdown"] = [vars(row) for row in self.breakdown]
        optional["poses"] = {pose.sensor.name: pose.as_dict() for pose in self.poses}
        filled_entries = {name: value for name, value in optional.items() if value}
        return replace_infinite(
            {"rows": rows, "classes": classes, "schemes": self.schemes, **filled_entries}
        )


def _format_scheme(name: str, figures: Mapping[str, Any]) -> str:
    """Return a scheme's summary as text, with a line for each sensor that sends images.

    The line counts the points that the sensor's images leave out, by kind. name: scheme, followed
    by its sensors if there are several sets; figures: its entry in `Evaluation.schemes`."""
    lines = [f"{name}: {describe_summary(dict(figures))}"]
    for sensor, counts in figures.get("images", {}).items():
        kinds = [f"{count} {kind}" for kind, count in counts.items() if kind != "points"]
        left_out = ", ".join(kinds) or "none"
        lines.append(f"{sensor}: of {counts['points']} points its images leave out {left_out}")
    return "\n".join(lines)
