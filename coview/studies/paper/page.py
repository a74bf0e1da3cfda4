"""Page of the paper's experiments, and its charts.

The page is one file that opens from disk, requests nothing and prints. In charts ours is filled and the paper's hatched
or hollow, so that the two are told apart in grey print too.
"""

from __future__ import annotations

from base64 import b64encode
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from coview.studies.paper.comparison import HEADS, LARGE, Compared, Experiment
from toolkit.arrays import Float64
from toolkit.plots.canvas import blank_figure
from toolkit.runtime.files import writing

if TYPE_CHECKING:
    from matplotlib.axes import Axes

OUR_COLOUR, PAPER_COLOUR = "#0072b2", "#e69f00"  # told apart by colour-blind readers (Okabe and Ito)

STYLE = """
body { font: 15px/1.45 system-ui, sans-serif; color: #1a1a1a; max-width: 70rem; margin: 2rem auto; padding: 0 1rem; }
h1 { font-size: 1.6rem; } h2 { font-size: 1.2rem; margin-top: 2.5rem; border-bottom: 1px solid #999; }
table { border-collapse: collapse; font-size: 0.82rem; margin: 0.8rem 0; } caption { text-align: left; color: #444; }
th, td { padding: 0.15rem 0.55rem; border-bottom: 1px solid #ddd; text-align: left; vertical-align: top; }
td.number, th.number { text-align: right; font-variant-numeric: tabular-nums; white-space: nowrap; }
tr.large td.number:nth-last-child(2) { font-weight: bold; } tr.large { background: #fff4df; }
img { max-width: 100%; height: auto; } dt { font-weight: bold; float: left; clear: left; width: 1.5rem; }
dd { margin: 0 0 0.5rem 2rem; } .basis { color: #444; font-size: 0.88rem; } nav a { margin-right: 1rem; }
@media print { body { margin: 0; max-width: none; font-size: 10pt; } section { break-before: page; }
  nav { display: none; }
  tr { break-inside: avoid; } thead { display: table-header-group; } tr.large { background: none; } }
"""


def paper_page(
    title: str,
    experiments: Sequence[Experiment],
    pictures: Mapping[str, bytes],
    *,
    conditions: Mapping[str, str],
    causes: Mapping[str, str],
) -> str:
    """Build the page as HTML.

    pictures: SVG by name of the experiment; conditions: how the figures were computed; causes: by letter.
    """
    rows = [row for each in experiments for row in each.rows]
    compared = sum(row.unit == "AP" and row.difference is not None for row in rows)
    about = "".join(f"<tr><th>{escape(name)}</th><td>{escape(value)}</td></tr>" for name, value in conditions.items())
    parts = [
        f"<h1>{escape(title)}</h1>",
        f"<p>{sum(row.large for row in rows)} of {compared} AP values differ from the paper's by more than {LARGE:g}; "
        "the reason stands in the row. Intervals are 95 % intervals of a bootstrap over blocks of eight frames.</p>",
        "<nav>" + "".join(f'<a href="#{each.name}">{escape(each.title)}</a>' for each in experiments) + "</nav>",
        f"<table><caption>How the figures were computed</caption><tbody>{about}</tbody></table>",
        *(_section(each, pictures[each.name]) for each in experiments),
        '<section id="causes"><h2>Causes of differences</h2><dl>',
        *(f"<dt>{escape(letter)}</dt><dd>{escape(text)}</dd>" for letter, text in causes.items()),
        "</dl></section>",
    ]
    head = f'<meta charset="utf-8"><title>{escape(title)}</title><style>{STYLE}</style>'
    return f'<!DOCTYPE html>\n<html lang="en"><head>{head}</head><body>\n' + "\n".join(parts) + "\n</body></html>\n"


def _section(experiment: Experiment, picture: bytes) -> str:
    def cells(tag: str, texts: Sequence[str]) -> str:
        places = range(-len(experiment.heads), len(HEADS))  # unit and reason are words, what is between is numbers
        number = [' class="number"' if 1 <= place <= 4 else "" for place in places]
        return "".join(f"<{tag}{kind}>{escape(text)}</{tag}>" for kind, text in zip(number, texts, strict=False))

    heads = cells("th", (*experiment.heads, "unit", "ours", "interval", "paper", "difference", HEADS[-1]))
    large = [' class="large"' if row.large else "" for row in experiment.rows]
    rows = [f"<tr{kind}>{cells('td', row.cells)}</tr>" for kind, row in zip(large, experiment.rows, strict=True)]
    lines = [
        f'<section id="{experiment.name}"><h2>{escape(experiment.title)}</h2>',
        f'<p class="basis">Paper: {escape(experiment.source)}. Ours: {escape(experiment.basis)}.</p>',
        f"<p>{escape(experiment.conclusion)}</p>",
        f'<img alt="{escape(experiment.title)}" src="data:image/svg+xml;base64,{b64encode(picture).decode()}">',
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
        axes.bar(place + 0.2, paper, 0.38, color="white", edgecolor=PAPER_COLOUR, hatch="///", label="paper")
        for x, each in zip(place, rows, strict=True):
            if each.interval is not None:
                axes.plot([x - 0.2] * 2, each.interval, color="black", linewidth=1.2, marker="_", markersize=6)
        axes.set_xticks(place, names, fontsize=7, rotation=0 if len(names) < 7 else 45, ha="center")
        axes.set(ylabel="AP", ylim=(0, 1.05), title=title)
        axes.grid(axis="y", alpha=0.3)
        axes.set_axisbelow(True)
        axes.legend(fontsize=8, loc="upper left", bbox_to_anchor=(1.0, 1.0), frameon=False)


def draw_agreement(groups: Mapping[str, Sequence[tuple[str, float, float]]], out: Path, *, title: str) -> None:
    """Draw our figures over the paper's. groups: (name, paper, ours) of each marker."""
    with _chart(out, 6.0, 5.2) as axes:
        axes.plot([0, 1], [0, 1], color="#888888", linewidth=0.8, linestyle="dashed")
        styles = ((OUR_COLOUR, "o"), (PAPER_COLOUR, "^"))
        for (group, rows), (colour, marker) in zip(groups.items(), styles, strict=False):
            paper, ours = [row[1] for row in rows], [row[2] for row in rows]
            axes.scatter(paper, ours, s=26, color=colour, marker=marker, label=f"{group} fusion", zorder=3)
            for name, x, y in rows:
                if len(name) <= 5:  # up to three sensors: larger sets crowd in a corner
                    axes.annotate(name, (x, y), fontsize=6, xytext=(3, 3), textcoords="offset points")
        axes.set(xlabel="AP of the paper", ylabel="AP of ours", xlim=(0, 1.03), ylim=(0, 1.03), title=title)
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
            axes.plot(x, intercept + slope * np.log(x), color=PAPER_COLOUR, linewidth=1.8, label=fit)
        axes.set(xlabel="points on the vehicle", ylabel="IoU", xlim=(0, None), ylim=(0, 1.02), title=title)
        axes.grid(alpha=0.3)
        axes.legend(fontsize=8, loc="lower right")


@contextmanager
def _chart(out: Path, width: float, height: float) -> Iterator[Axes]:
    """Axes to draw on, written at the end."""
    from matplotlib import rc_context

    with rc_context({"svg.hashsalt": "coview", "hatch.linewidth": 0.6}):
        figure = blank_figure(width, height, constrained=True)
        yield figure.subplots()
        with writing(out) as unfinished:
            figure.savefig(unfinished, dpi=150, metadata={"Date": None} if out.suffix == ".svg" else None)
