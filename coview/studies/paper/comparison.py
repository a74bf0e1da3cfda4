"""Comparison of one paper experiment with ours: figures side by side, with reasons for large
differences.

A reason is put together from measurements of its own row: the share of vehicles on which the
sensors have a point, which no detector can exceed, the share of these that is found, how well the
boxes fit, and the AP of the same detections by the published code's counting. The letters stand for
the causes listed on the page; each is measured in `docs/figures.md` or `docs/model-card.md`, or
stated by the paper.

Figures that the paper reports, and the causes, are in `paper.toml`.

The page is one file that opens from disk, requests nothing and prints. In charts ours is filled and
the paper's hatched or hollow, so that the two are told apart in grey print too."""

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
from operator import itemgetter
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import numpy as np

from placement_env.analysis.intervals import Interval
from toolkit.arrays import Float64
from toolkit.plots.canvas import blank_figure
from toolkit.runtime.files import read_own_table, writing

if TYPE_CHECKING:
    from matplotlib.axes import Axes

PAPER_SITES = ("tjunction", "roundabout")
TEST_FRAMES = 1000  # of each test collection, section III
DEPTH_NOISE = 0.015  # m, section III
IOU_BINS = 200  # uniform bins of point density, section IV-E
# points: "accuracy below 70 is poor, but increases significantly above 100"
POOR_BELOW = 70
GOOD_ABOVE = 100
PLACE_NAMES = {"tjunction": "T-junction", "roundabout": "roundabout"}

SensorSet = tuple[int, ...]
Relation = Literal["is", "more than", "less than"]


class SchemeRow(NamedTuple):
    """Fusion scheme of table 1: AP at IoU 0.7, 0.8 and 0.9, kbit per sensor and frame, ms on the
    authors' GPU."""

    ap: tuple[float, float, float]
    kbit: float
    ms: float


class SetRow(NamedTuple):
    """Sensor set of table 2: early and late AP."""

    sensors: SensorSet
    early: float
    late: float


class RegionRow(NamedTuple):
    """AP of table 3: early fusion with these sensors in the region that both sensors of a pair have
    in view."""

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
    """Method of table 4: its reported AP with one sensor and with two."""

    method: str
    single: tuple[float, ...]
    two: float | None = None


def _tuples(value: Any) -> Any:
    return tuple(map(_tuples, value)) if isinstance(value, list) else value


_PAPER = read_own_table(__file__, "paper.toml")
_SITES = {
    site: {name: _tuples(table) for name, table in _PAPER[site].items()} for site in PAPER_SITES
}
CAUSES: dict[str, str] = _PAPER["causes"]
BENCHMARK_TABLE = tuple(BenchmarkRow(*row) for row in _tuples(_PAPER["benchmarks"]))
# single: the first
BENCHMARK_PAIR: dict[str, SensorSet] = {site: own["pair"] for site, own in _SITES.items()}
SCHEME_TABLE = {
    site: {scheme: SchemeRow(*_tuples(row)) for scheme, row in own["schemes"].items()}
    for site, own in _SITES.items()
}
REGION_TABLE = {
    site: tuple(RegionRow(*row) for row in own["regions"]) for site, own in _SITES.items()
}
CURVE_STATEMENTS = {
    site: tuple(Statement(*row) for row in own["curves"]) for site, own in _SITES.items()
}
DENSITY_STATEMENTS = {
    site: tuple(Statement(*row) for row in own["densities"]) for site, own in _SITES.items()
}


@dataclass(frozen=True)
class Listed:
    """Table 2 of one site, rows in the paper's order."""

    rows: tuple[SetRow, ...]

    @cached_property
    def best(self) -> dict[str, tuple[SensorSet, ...]]:
        """Best set of each size with early and with late fusion, most sensors first. With early
        fusion these are the rows in bold; the paper draws PR curves and density curves of them."""
        sizes = [list(rows) for _, rows in groupby(self.rows, key=lambda row: len(row.sensors))]
        early, late = (
            tuple(max(rows, key=itemgetter(at)).sensors for rows in sizes) for at in (1, 2)
        )
        return {"early": early, "late": late}


def sensor_sets(site: str) -> Listed:
    """Table 2 of a site."""
    return Listed(tuple(SetRow(*row) for row in _SITES[site]["sets"]))


def set_name(sensors: SensorSet) -> str:
    """Name of a sensor set, as the paper writes it."""
    return ",".join(map(str, sensors))


LARGE = 0.05  # difference in AP from which a reason is stated
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
HEADS = ("unit", "ours", "low", "high", "paper", "difference", "reason")
MOSTLY_COUNTING = (
    0.6  # share of a difference left by the published counting, below which counting is named first
)
BOXES_FROM = 0.75  # IoU from which the fit of the boxes matters more than whether a vehicle is seen

TableRow = tuple[str | float, ...]


@dataclass(frozen=True)
class Compared:
    """Figure of ours beside the paper's.

    labels: a cell for each of the experiment's heads; ours, paper: None if missing; interval: of
    ours; relation: of the paper's statement to its figure; an interval that is NaN is None; reason:
    for a large difference, "" for none."""

    labels: tuple[str, ...]
    unit: Unit
    ours: float | None
    paper: float | None
    interval: Interval | None = None
    relation: Relation = "is"
    reason: str = ""

    def __post_init__(self) -> None:
        if self.interval is not None and isnan(self.interval.low):
            object.__setattr__(self, "interval", None)

    @property
    def difference(self) -> float | None:
        """Our figure minus the paper's. 0 if ours keeps a bound in the paper; None if one is
        missing."""
        if self.ours is None or self.paper is None or isnan(self.ours):
            return None
        difference = self.ours - self.paper
        kept = difference > 0 if self.relation == "more than" else difference < 0
        return 0.0 if kept and self.relation != "is" else difference

    @property
    def large(self) -> bool:
        """True for an AP that differs by more than `LARGE`."""
        return self.unit == "AP" and self.difference is not None and abs(self.difference) > LARGE

    @property
    def cells(self) -> tuple[str, ...]:
        """Return the row as text: labels, unit, ours, interval, paper's, difference, reason."""
        digits = DIGITS[self.unit]
        ours = "–" if self.ours is None or isnan(self.ours) else f"{self.ours:.{digits}f}"
        interval = (
            "–" if self.interval is None else "–".join(f"{end:.{digits}f}" for end in self.interval)
        )
        paper = "–" if self.paper is None else f"{BOUND[self.relation]}{self.paper:.{digits}f}"
        difference = "–" if self.difference is None else f"{self.difference:+.{digits}f}"
        return (*self.labels, self.unit, ours, interval, paper, difference, self.reason)


@dataclass(frozen=True, eq=False)
class Experiment:
    """Experiment of the paper.

    name: of its files; source: place in the paper; heads: of the labels of its rows; basis: data
    behind our figures; conclusion: a sentence or two; draw: writes its picture; curves: more tables
    by file name, heads first."""

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
            figures = [
                "" if each is None else each
                for each in (row.ours, low, high, row.paper, row.difference)
            ]
            rows.append((*row.labels, row.unit, *map(str, figures), row.reason))
        return to_csv(rows)

    def as_dict(self) -> dict[str, object]:
        """Return the values for JSON."""
        names = ("unit", "ours", "interval", "paper", "relation", "difference", "reason")
        heads = [dict(zip(self.heads, row.labels, strict=True)) for row in self.rows]
        rows = [
            head | {name: getattr(row, name) for name in names}
            for head, row in zip(heads, self.rows, strict=True)
        ]
        about = {
            name: getattr(self, name) for name in ("name", "title", "source", "basis", "conclusion")
        }
        return about | {"rows": rows}


def to_csv(rows: Sequence[TableRow]) -> str:
    """Format rows of cells as CSV."""
    text = StringIO()
    csv.writer(text, lineterminator="\n").writerows(rows)
    return text.getvalue()


class RowEvidence(NamedTuple):
    """Measurements with the row's sensors; NaN if not measured. visible: share of the vehicles with
    a point; hit_iou: mean IoU of the hits; published: AP by the published protocol."""

    visible: float
    recall: float
    hit_iou: float = float("nan")
    published: float = float("nan")


GIVEN = (
    "The detector is not the shipped one: what the causes say about the shipped network does not "
    "apply to it."
)


def explain_difference(
    ours: float, paper: float, evidence: RowEvidence, *, iou: float = 0.7
) -> str:
    """Explain in one line a difference from the paper's AP, "" if it is no more than `LARGE`."""
    if isnan(ours) or abs(ours - paper) <= LARGE:
        return ""
    seen = evidence.visible
    found = min(evidence.recall / seen, 1.0) if seen else 0.0
    if seen < paper and ours < paper:
        words = (
            f"only {percent(seen)} of the vehicles have a point here: no detector can reach the "
            "paper's figure (C)"
        )
    elif iou > BOXES_FROM:
        fit = "" if isnan(evidence.hit_iou) else f", mean IoU of the hits {evidence.hit_iou:.3f}"
        words = f"{percent(evidence.recall)} of the vehicles are found at this IoU{fit} (B)"
    else:
        cause = "A" if ours > paper else "A, C"
        words = (
            f"{percent(seen)} of the vehicles have a point here and {percent(found)} of these are "
            f"found; the paper's AP is {percent(paper)} ({cause})"
        )
    counted = f"by the published code's counting ours is {evidence.published:.4f} (D)"
    if isnan(evidence.published):
        return words
    mostly = abs(evidence.published - paper) < abs(ours - paper) * MOSTLY_COUNTING
    return f"{counted}; {words}" if mostly else f"{words}; {counted}"


def percent(share: float | None) -> str:
    """Format a share in percent; a dash for None."""
    return "–" if share is None else f"{100 * share:.1f} %"


# told apart by colour-blind readers (Okabe and Ito)
OUR_COLOUR = "#0072b2"
PAPER_COLOUR = "#e69f00"


def paper_page(
    title: str,
    experiments: Sequence[Experiment],
    pictures: Mapping[str, bytes],
    *,
    conditions: Mapping[str, str],
    causes: Mapping[str, str],
) -> str:
    """Build the page as HTML, from SVG by experiment, conditions of the figures, and causes by
    letter."""
    rows = [row for each in experiments for row in each.rows]
    compared = sum(row.unit == "AP" and row.difference is not None for row in rows)
    about = "".join(
        f"<tr><th>{escape(name)}</th><td>{escape(value)}</td></tr>"
        for name, value in conditions.items()
    )
    parts = [
        f"<h1>{escape(title)}</h1>",
        f"<p>{sum(row.large for row in rows)} of {compared} AP values differ from the paper's by "
        f"more than {LARGE:g}; the reason stands in the row. Intervals are 95 % intervals of a "
        "bootstrap over blocks of eight frames.</p>",
        "<nav>"
        + "".join(f'<a href="#{each.name}">{escape(each.title)}</a>' for each in experiments)
        + "</nav>",
        f"<table><caption>How the figures were computed</caption><tbody>{about}</tbody></table>",
        *(_section(each, pictures[each.name]) for each in experiments),
        '<section id="causes"><h2>Causes of differences</h2><dl>',
        *(f"<dt>{escape(letter)}</dt><dd>{escape(text)}</dd>" for letter, text in causes.items()),
        "</dl></section>",
    ]
    style = (Path(__file__).parent / "page.css").read_text(encoding="utf-8")
    head = f'<meta charset="utf-8"><title>{escape(title)}</title><style>\n{style}</style>'
    return (
        f'<!DOCTYPE html>\n<html lang="en"><head>{head}</head><body>\n'
        + "\n".join(parts)
        + "\n</body></html>\n"
    )


def _section(experiment: Experiment, picture: bytes) -> str:
    def cells(tag: str, texts: Sequence[str]) -> str:
        # unit and reason are words, what is between is numbers
        places = range(-len(experiment.heads), len(HEADS))
        number = [' class="number"' if 1 <= place <= 4 else "" for place in places]
        return "".join(
            f"<{tag}{kind}>{escape(text)}</{tag}>"
            for kind, text in zip(number, texts, strict=False)
        )

    heads = cells(
        "th", (*experiment.heads, "unit", "ours", "interval", "paper", "difference", HEADS[-1])
    )
    large = [' class="large"' if row.large else "" for row in experiment.rows]
    rows = [
        f"<tr{kind}>{cells('td', row.cells)}</tr>"
        for kind, row in zip(large, experiment.rows, strict=True)
    ]
    lines = [
        f'<section id="{experiment.name}"><h2>{escape(experiment.title)}</h2>',
        (
            f'<p class="basis">Paper: {escape(experiment.source)}. Ours: '
            f"{escape(experiment.basis)}.</p>"
        ),
        f"<p>{escape(experiment.conclusion)}</p>",
        (
            f'<img alt="{escape(experiment.title)}" '
            f'src="data:image/svg+xml;base64,{b64encode(picture).decode()}">'
        ),
        f"<table><thead><tr>{heads}</tr></thead><tbody>\n" + "\n".join(rows) + "\n</tbody></table>",
        "</section>",
    ]
    return "\n".join(lines)


def draw_pairs(names: Sequence[str], rows: Sequence[Compared], out: Path, *, title: str) -> None:
    """Draw AP as pairs of bars, ours with its interval."""
    with _chart(out, max(5.5, 0.55 * len(rows) + 1.5), 4.0) as axes:
        place = np.arange(len(rows))
        ours = [np.nan if each.ours is None else each.ours for each in rows]
        paper = [np.nan if each.paper is None else each.paper for each in rows]
        axes.bar(place - 0.2, ours, 0.38, color=OUR_COLOUR, label="ours")
        axes.bar(
            place + 0.2,
            paper,
            0.38,
            color="white",
            edgecolor=PAPER_COLOUR,
            hatch="///",
            label="paper",
        )
        for x, each in zip(place, rows, strict=True):
            if each.interval is not None:
                axes.plot(
                    [x - 0.2] * 2,
                    each.interval,
                    color="black",
                    linewidth=1.2,
                    marker="_",
                    markersize=6,
                )
        axes.set_xticks(place, names, fontsize=7, rotation=0 if len(names) < 7 else 45, ha="center")
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
    """Axes to draw on, written at the end."""
    from matplotlib import rc_context

    with rc_context({"svg.hashsalt": "coview", "hatch.linewidth": 0.6}):
        figure = blank_figure(width, height, constrained=True)
        yield figure.subplots()
        with writing(out) as unfinished:
            figure.savefig(
                unfinished, dpi=150, metadata={"Date": None} if out.suffix == ".svg" else None
            )
