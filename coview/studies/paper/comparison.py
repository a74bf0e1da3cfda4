"""Comparison of a paper's experiment with ours, with reasons for large differences.

A reason consists of measurements of its row: the share of vehicles on which the sensors have a
point, which no detector can exceed, the share of these vehicles that is found, how well the boxes
fit, and the AP of the same detections as the published code counts. The letters refer to the causes
listed on the page; each cause is measured in `docs/figures.md` or `docs/model-card.md`, or stated
by the paper.

Figures that the paper reports, and the causes, are in `paper.toml`.

The page is one file that opens from disk, requests nothing and prints. In charts our bars are
filled and the paper's hatched or hollow, so that they differ in grey print too."""

import csv
from base64 import b64encode
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from html import escape
from io import StringIO
from itertools import groupby
from math import isnan
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import numpy as np

from placement_env.analysis.intervals import Interval
from toolkit.arrays import Float64
from toolkit.frozen import set_fields
from toolkit.plots.canvas import blank_figure
from toolkit.runtime.files import read_own_table, writing

if TYPE_CHECKING:
    from matplotlib.axes import Axes

PAPER_SITES = ("tjunction", "roundabout")
TEST_FRAMES = 1000  # of each test collection, section III
DEPTH_NOISE_M = 0.015  # section III
IOU_BINS = 200  # uniform bins of point density, section IV-E
# the paper: "accuracy below 70 is poor, but increases significantly above 100"
POOR_POINTS = 70
GOOD_POINTS = 100
PLACE_NAMES = {"tjunction": "T-junction", "roundabout": "roundabout"}
LARGE_AP_DIFFERENCE = 0.05  # a reason is given for larger differences
MAX_COUNTING_SHARE = 0.6  # counting comes first in a reason if it leaves less of the difference
MIN_BOX_IOU = 0.75  # from which the fit of the boxes matters more than whether vehicles are seen
GIVEN_DETECTOR = (
    "The detector is not the shipped one: what the causes say about the shipped network does not "
    "apply to it."
)
HEADS = ("unit", "ours", "low", "high", "paper", "difference", "reason")
# colours that colour-blind readers can distinguish (Okabe and Ito)
OUR_COLOUR = "#0072b2"
PAPER_COLOUR = "#e69f00"

SensorSet = tuple[int, ...]
Relation = Literal["is", "more than", "less than"]


class SchemeRow(NamedTuple):
    """Fusion scheme of table 1.

    ap: at IoU 0.7, 0.8 and 0.9; kbit: per sensor and frame; ms: on the authors' GPU."""

    ap: tuple[float, float, float]
    kbit: float
    ms: float


class SetRow(NamedTuple):
    """Sensor set of table 2: early and late AP."""

    sensors: SensorSet
    early: float
    late: float


class RegionRow(NamedTuple):
    """AP of table 3: early fusion in the region that both sensors of a pair have in view."""

    region: SensorSet
    sensors: SensorSet
    ap: float


class Statement(NamedTuple):
    """Figure that the paper's text gives or bounds."""

    of: Literal["no points", "below 300 points", "greatest recall", "precision at recall 0.95"]
    sensors: SensorSet
    relation: Relation
    value: float


class BenchmarkRow(NamedTuple):
    """Method of table 4: its reported AP with one sensor and with two sensors."""

    method: str
    single: tuple[float, ...]
    two: float | None = None


def _tuples(value: Any) -> Any:
    return tuple(map(_tuples, value)) if isinstance(value, list) else value


_PAPER = read_own_table(__file__, "paper.toml")
CAUSES: dict[str, str] = _PAPER["causes"]
BENCHMARK_TABLE = tuple(BenchmarkRow(*row) for row in _tuples(_PAPER["benchmarks"]))
BENCHMARK_PAIR: dict[str, SensorSet] = {}  # the single sensor is the first of the pair
SCHEME_TABLE: dict[str, dict[str, SchemeRow]] = {}
SET_TABLE: dict[str, tuple[SetRow, ...]] = {}
REGION_TABLE: dict[str, tuple[RegionRow, ...]] = {}
CURVE_STATEMENTS: dict[str, tuple[Statement, ...]] = {}
DENSITY_STATEMENTS: dict[str, tuple[Statement, ...]] = {}
for _site in PAPER_SITES:
    _tables = _PAPER[_site]
    BENCHMARK_PAIR[_site] = _tuples(_tables["pair"])
    SCHEME_TABLE[_site] = {
        scheme: SchemeRow(*_tuples(row)) for scheme, row in _tables["schemes"].items()
    }
    SET_TABLE[_site] = tuple(SetRow(*row) for row in _tuples(_tables["sets"]))
    REGION_TABLE[_site] = tuple(RegionRow(*row) for row in _tuples(_tables["regions"]))
    CURVE_STATEMENTS[_site] = tuple(Statement(*row) for row in _tuples(_tables["curves"]))
    DENSITY_STATEMENTS[_site] = tuple(Statement(*row) for row in _tuples(_tables["densities"]))


@dataclass(frozen=True)
class Listed:
    """Table 2 of one site, rows in the paper's order."""

    rows: tuple[SetRow, ...]

    @cached_property
    def best(self) -> dict[str, tuple[SensorSet, ...]]:
        """Best set of each size with early and with late fusion, most sensors first.

        With early fusion these are the rows in bold. The paper draws their PR curves and density
        curves."""
        sizes = [list(rows) for _, rows in groupby(self.rows, key=lambda row: len(row.sensors))]
        early = tuple(max(rows, key=lambda row: row.early).sensors for rows in sizes)
        late = tuple(max(rows, key=lambda row: row.late).sensors for rows in sizes)
        return {"early": early, "late": late}


def sensor_sets(site: str) -> Listed:
    """Return table 2 of a site."""
    return Listed(SET_TABLE[site])


def set_name(sensors: SensorSet) -> str:
    """Return the name of a sensor set, as the paper writes it."""
    return ",".join(map(str, sensors))


Unit = Literal["AP", "share", "IoU", "kbit", "ms", "points", "rank correlation"]
DIGITS: dict[Unit, int] = {
    "AP": 4,
    "share": 4,
    "IoU": 4,
    "kbit": 2,
    "ms": 1,
    "points": 0,
    "rank correlation": 3,
}
BOUND: dict[Relation, str] = {"is": "", "more than": "> ", "less than": "< "}

TableRow = tuple[str | float, ...]


@dataclass(frozen=True)
class Compared:
    """One of our figures and the paper's.

    Attributes:
        labels: A cell for each of the experiment's heads.
        unit: Unit of both figures.
        ours: Our figure, None if missing.
        paper: The paper's figure, None if missing.
        interval: Interval of our figure; an interval that is NaN becomes None.
        relation: Relation of the paper's statement to its figure.
        reason: Reason for a large difference, "" without one."""

    labels: tuple[str, ...]
    unit: Unit
    ours: float | None
    paper: float | None
    interval: Interval | None = None
    relation: Relation = "is"
    reason: str = ""

    def __post_init__(self) -> None:
        if self.interval is not None and isnan(self.interval.low):
            set_fields(self, interval=None)

    @property
    def difference(self) -> float | None:
        """Our figure minus the paper's.

        It is 0 if our figure keeps a bound in the paper, None if a figure is missing."""
        if self.ours is None or self.paper is None or isnan(self.ours):
            return None
        difference = self.ours - self.paper
        keeps_bound = difference > 0 if self.relation == "more than" else difference < 0
        return 0.0 if keeps_bound and self.relation != "is" else difference

    @property
    def large(self) -> bool:
        """True for an AP that differs by more than `LARGE_AP_DIFFERENCE`."""
        if self.unit != "AP" or self.difference is None:
            return False
        return abs(self.difference) > LARGE_AP_DIFFERENCE

    @property
    def cells(self) -> tuple[str, ...]:
        """The row as text: labels, unit, ours, interval, paper's, difference, reason."""
        digits = DIGITS[self.unit]
        ours = "–" if self.ours is None or isnan(self.ours) else f"{self.ours:.{digits}f}"
        interval = "–"
        if self.interval is not None:
            interval = f"{self.interval.low:.{digits}f}–{self.interval.high:.{digits}f}"
        paper = "–" if self.paper is None else f"{BOUND[self.relation]}{self.paper:.{digits}f}"
        difference = "–" if self.difference is None else f"{self.difference:+.{digits}f}"
        return (*self.labels, self.unit, ours, interval, paper, difference, self.reason)


@dataclass(frozen=True, eq=False)
class Experiment:
    """Experiment of the paper.

    Attributes:
        name: Name of its files.
        title: Title.
        source: Table or figure, and section, of the paper.
        heads: Heads of the labels of its rows.
        rows: Our figures and the paper's.
        basis: Data behind our figures.
        conclusion: Conclusion in a sentence or two.
        draw: Function that writes its picture.
        curves: More tables by file name, heads first."""

    name: str
    title: str
    source: str
    heads: tuple[str, ...]
    rows: tuple[Compared, ...]
    basis: str
    conclusion: str
    draw: Callable[[Path], None]
    curves: tuple[tuple[str, tuple[TableRow, ...]], ...] = ()

    @property
    def csv(self) -> str:
        """Rows as CSV, figures unrounded."""
        rows: list[TableRow] = [(*self.heads, *HEADS)]
        for row in self.rows:
            low, high = row.interval or ("", "")
            values = (row.ours, low, high, row.paper, row.difference)
            figures = ["" if value is None else str(value) for value in values]
            rows.append((*row.labels, row.unit, *figures, row.reason))
        return to_csv(rows)

    def as_dict(self) -> dict[str, object]:
        """Return the values for JSON."""
        rows = []
        for row in self.rows:
            values: dict[str, object] = dict(zip(self.heads, row.labels, strict=True))
            for name in ("unit", "ours", "interval", "paper", "relation", "difference", "reason"):
                values[name] = getattr(row, name)
            rows.append(values)
        return {
            "name": self.name,
            "title": self.title,
            "source": self.source,
            "basis": self.basis,
            "conclusion": self.conclusion,
            "rows": rows,
        }


def to_csv(rows: Sequence[TableRow]) -> str:
    """Format rows of cells as CSV."""
    text = StringIO()
    csv.writer(text, lineterminator="\n").writerows(rows)
    return text.getvalue()


class RowEvidence(NamedTuple):
    """Measurements with the row's sensors, NaN if not measured.

    visible: share of the vehicles with a point; recall: share of the vehicles that are found;
    hit_iou: mean IoU of the hits; published: AP by the published protocol."""

    visible: float
    recall: float
    hit_iou: float = float("nan")
    published: float = float("nan")


def explain_difference(
    ours: float, paper: float, evidence: RowEvidence, *, iou: float = 0.7
) -> str:
    """Explain in one line a difference from the paper's AP.

    Returns "" if it is no more than `LARGE_AP_DIFFERENCE`."""
    if isnan(ours) or abs(ours - paper) <= LARGE_AP_DIFFERENCE:
        return ""
    visible_share = evidence.visible
    found_share = min(evidence.recall / visible_share, 1.0) if visible_share else 0.0
    if visible_share < paper and ours < paper:
        words = (
            f"only {percent(visible_share)} of the vehicles have a point here: no detector can "
            "reach the paper's figure (C)"
        )
    elif iou > MIN_BOX_IOU:
        fit = "" if isnan(evidence.hit_iou) else f", mean IoU of the hits {evidence.hit_iou:.3f}"
        words = f"{percent(evidence.recall)} of the vehicles are found at this IoU{fit} (B)"
    else:
        cause = "A" if ours > paper else "A, C"
        words = (
            f"{percent(visible_share)} of the vehicles have a point here and "
            f"{percent(found_share)} of these are found; the paper's AP is {percent(paper)} "
            f"({cause})"
        )
    if isnan(evidence.published):
        return words
    counting = f"by the published code's counting ours is {evidence.published:.4f} (D)"
    remaining = abs(evidence.published - paper)
    if remaining < abs(ours - paper) * MAX_COUNTING_SHARE:
        return f"{counting}; {words}"
    return f"{words}; {counting}"


def percent(share: float | None) -> str:
    """Format a share in percent; a dash for None."""
    return "–" if share is None else f"{100 * share:.1f} %"


def paper_page(
    title: str,
    experiments: Sequence[Experiment],
    pictures: Mapping[str, bytes],
    *,
    conditions: Mapping[str, str],
    causes: Mapping[str, str],
) -> str:
    """Build the page as HTML.

    pictures: SVG by experiment; conditions: how the figures were computed; causes: by letter."""
    rows = [row for experiment in experiments for row in experiment.rows]
    compared_count = sum(row.unit == "AP" and row.difference is not None for row in rows)
    condition_rows = "".join(
        f"<tr><th>{escape(name)}</th><td>{escape(value)}</td></tr>"
        for name, value in conditions.items()
    )
    large_count = sum(row.large for row in rows)
    links = "".join(
        f'<a href="#{experiment.name}">{escape(experiment.title)}</a>' for experiment in experiments
    )
    parts = [
        f"<h1>{escape(title)}</h1>",
        f"<p>{large_count} of {compared_count} AP values differ from the paper's by more than "
        f"{LARGE_AP_DIFFERENCE:g}; the reason stands in the row. Intervals are 95 % intervals of a "
        "bootstrap over blocks of eight frames.</p>",
        f"<nav>{links}</nav>",
        "<table><caption>How the figures were computed</caption>"
        f"<tbody>{condition_rows}</tbody></table>",
    ]
    parts += [_section(experiment, pictures[experiment.name]) for experiment in experiments]
    parts.append('<section id="causes"><h2>Causes of differences</h2><dl>')
    parts += [
        f"<dt>{escape(letter)}</dt><dd>{escape(text)}</dd>" for letter, text in causes.items()
    ]
    parts.append("</dl></section>")
    body = "\n".join(parts)
    style = (Path(__file__).parent / "page.css").read_text(encoding="utf-8")
    head = f'<meta charset="utf-8"><title>{escape(title)}</title><style>\n{style}</style>'
    return f'<!DOCTYPE html>\n<html lang="en"><head>{head}</head><body>\n{body}\n</body></html>\n'


def _section(experiment: Experiment, picture: bytes) -> str:
    def cells(tag: str, texts: Sequence[str]) -> str:
        # labels, unit and reason are words; the columns between unit and reason are numbers
        first_number = len(experiment.heads) + 1
        parts = []
        for column, text in enumerate(texts):
            is_number = first_number <= column < first_number + 4
            kind = ' class="number"' if is_number else ""
            parts.append(f"<{tag}{kind}>{escape(text)}</{tag}>")
        return "".join(parts)

    heads = cells(
        "th", (*experiment.heads, "unit", "ours", "interval", "paper", "difference", HEADS[-1])
    )
    rows = []
    for row in experiment.rows:
        kind = ' class="large"' if row.large else ""
        rows.append(f"<tr{kind}>{cells('td', row.cells)}</tr>")
    title = escape(experiment.title)
    table_rows = "\n".join(rows)
    image = b64encode(picture).decode()
    lines = [
        f'<section id="{experiment.name}"><h2>{title}</h2>',
        (
            f'<p class="basis">Paper: {escape(experiment.source)}. Ours: '
            f"{escape(experiment.basis)}.</p>"
        ),
        f"<p>{escape(experiment.conclusion)}</p>",
        f'<img alt="{title}" src="data:image/svg+xml;base64,{image}">',
        f"<table><thead><tr>{heads}</tr></thead><tbody>\n{table_rows}\n</tbody></table>",
        "</section>",
    ]
    return "\n".join(lines)


def draw_pairs(names: Sequence[str], rows: Sequence[Compared], out: Path, *, title: str) -> None:
    """Draw AP as pairs of bars, ours with its interval."""
    with _chart(out, max(5.5, 0.55 * len(rows) + 1.5), 4.0) as axes:
        positions = np.arange(len(rows))
        ours = [np.nan if row.ours is None else row.ours for row in rows]
        paper = [np.nan if row.paper is None else row.paper for row in rows]
        axes.bar(positions - 0.2, ours, 0.38, color=OUR_COLOUR, label="ours")
        axes.bar(
            positions + 0.2,
            paper,
            0.38,
            color="white",
            edgecolor=PAPER_COLOUR,
            hatch="///",
            label="paper",
        )
        for x, row in zip(positions, rows, strict=True):
            if row.interval is not None:
                axes.plot(
                    [x - 0.2] * 2,
                    row.interval,
                    color="black",
                    linewidth=1.2,
                    marker="_",
                    markersize=6,
                )
        rotation = 0 if len(names) < 7 else 45
        axes.set_xticks(positions, names, fontsize=7, rotation=rotation, ha="center")
        axes.set(ylabel="AP", ylim=(0, 1.05), title=title)
        axes.grid(axis="y", alpha=0.3)
        axes.set_axisbelow(True)
        axes.legend(fontsize=8, loc="upper left", bbox_to_anchor=(1.0, 1.0), frameon=False)


def draw_agreement(
    groups: Mapping[str, Sequence[tuple[str, float, float]]], out: Path, *, title: str
) -> None:
    """Draw our figures over the paper's. groups: (name, paper, ours) of each marker."""
    with _chart(out, 6.0, 5.2) as axes:
        axes.plot([0, 1], [0, 1], color="#888888", linewidth=0.8, linestyle="dashed")
        styles = ((OUR_COLOUR, "o"), (PAPER_COLOUR, "^"))
        for (group, rows), (colour, marker) in zip(groups.items(), styles, strict=False):
            paper = [row[1] for row in rows]
            ours = [row[2] for row in rows]
            axes.scatter(
                paper, ours, s=26, color=colour, marker=marker, label=f"{group} fusion", zorder=3
            )
            for name, x, y in rows:
                if len(name) <= 5:  # up to three sensors: larger sets crowd in a corner
                    axes.annotate(
                        name, (x, y), fontsize=6, xytext=(3, 3), textcoords="offset points"
                    )
        axes.set(
            xlabel="AP of the paper",
            ylabel="AP of ours",
            xlim=(0, 1.03),
            ylim=(0, 1.03),
            title=title,
        )
        axes.set_aspect("equal")
        axes.grid(alpha=0.3)
        axes.legend(fontsize=8, loc="lower right")


def draw_log_fit(
    density: Float64[np.ndarray, " bins"],
    iou: Float64[np.ndarray, " bins"],
    coefficients: tuple[float, float],
    out: Path,
    *,
    title: str,
) -> None:
    """Draw mean IoU over point density, and its fit: intercept + slope · ln(density)."""
    with _chart(out, 6.0, 4.2) as axes:
        axes.scatter(density, iou, s=12, color=OUR_COLOUR, label="mean of a bin", zorder=3)
        intercept, slope = coefficients
        if len(density) and np.isfinite(intercept):
            x = np.geomspace(max(float(density.min()), 1.0), float(density.max()), 200)
            fit = f"{intercept:.3f} + {slope:.3f} ln(points)"
            axes.plot(
                x, intercept + slope * np.log(x), color=PAPER_COLOUR, linewidth=1.8, label=fit
            )
        axes.set(
            xlabel="points on the vehicle",
            ylabel="IoU",
            xlim=(0, None),
            ylim=(0, 1.02),
            title=title,
        )
        axes.grid(alpha=0.3)
        axes.legend(fontsize=8, loc="lower right")


@contextmanager
def _chart(out: Path, width: float, height: float) -> "Iterator[Axes]":
    """Yield axes to draw on, and write the picture at the end."""
    from matplotlib import rc_context

    with rc_context({"svg.hashsalt": "coview", "hatch.linewidth": 0.6}):
        figure = blank_figure(width, height, constrained=True)
        yield figure.subplots()
        metadata = {"Date": None} if out.suffix == ".svg" else None
        with writing(out) as unfinished:
            figure.savefig(unfinished, dpi=150, metadata=metadata)
