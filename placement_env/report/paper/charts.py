"""The charts of the paper page that no other page has: figures side by side, ours against the paper's, and a log fit.

Ours is filled, the paper's hatched or hollow, so that both are told apart in grey print too.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from toolkit.arrays import Float64
from toolkit.runtime.files import writing

if TYPE_CHECKING:
    from collections.abc import Iterator

    from matplotlib.axes import Axes

OURS, THEIRS = "#0072b2", "#e69f00"  # told apart by colour-blind readers (Okabe and Ito)


def draw_pairs(
    names: Sequence[str],
    ours: Sequence[float | None],
    paper: Sequence[float | None],
    out: Path,
    *,
    title: str,
    label: str = "AP",
    intervals: Sequence[tuple[float, float] | None] = (),
) -> None:
    """A pair of bars for each name; intervals: of ours, drawn as whiskers."""
    with _chart(out, max(5.5, 0.55 * len(names) + 1.5), 4.0) as axes:
        place = np.arange(len(names))
        filled = [np.nan if each is None else each for each in ours]
        hollow = [np.nan if each is None else each for each in paper]
        axes.bar(place - 0.2, filled, 0.38, color=OURS, label="ours")
        axes.bar(place + 0.2, hollow, 0.38, color="white", edgecolor=THEIRS, hatch="///", label="paper")
        for x, ends in zip(place, intervals, strict=False):
            if ends is not None:
                axes.plot([x - 0.2] * 2, ends, color="black", linewidth=1.2, marker="_", markersize=6)
        axes.set_xticks(place, names, fontsize=7, rotation=0 if len(names) < 7 else 45, ha="center")
        axes.set(ylabel=label, ylim=(0, 1.05), title=title)
        axes.grid(axis="y", alpha=0.3)
        axes.set_axisbelow(True)
        axes.legend(fontsize=8, loc="upper left", bbox_to_anchor=(1.0, 1.0), frameon=False)


def draw_agreement(groups: Mapping[str, Sequence[tuple[str, float, float]]], out: Path, *, title: str) -> None:
    """Ours over the paper's, a marker for each (name, paper, ours) of each group, and the line of equal figures."""
    with _chart(out, 6.0, 5.2) as axes:
        axes.plot([0, 1], [0, 1], color="#888888", linewidth=0.8, linestyle="dashed")
        for (group, rows), (colour, marker) in zip(groups.items(), ((OURS, "o"), (THEIRS, "^")), strict=False):
            paper, ours = [row[1] for row in rows], [row[2] for row in rows]
            axes.scatter(paper, ours, s=26, color=colour, marker=marker, label=f"{group} fusion", zorder=3)
            for name, x, y in rows:
                if len(name) <= 5:  # three sensors and fewer: the others crowd in a corner
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
    """Mean IoU over point density, a marker for each bin, and intercept + slope · ln(density)."""
    with _chart(out, 6.0, 4.2) as axes:
        axes.scatter(density, iou, s=12, color=OURS, label="mean of a bin", zorder=3)
        intercept, slope = coefficients
        if len(density) and np.isfinite(intercept):
            x = np.geomspace(max(float(density.min()), 1.0), float(density.max()), 200)
            fit = f"{intercept:.3f} + {slope:.3f} ln(points)"
            axes.plot(x, intercept + slope * np.log(x), color=THEIRS, linewidth=1.8, label=fit)
        axes.set(xlabel="points on the vehicle", ylabel="IoU", xlim=(0, None), ylim=(0, 1.02), title=title)
        axes.grid(alpha=0.3)
        axes.legend(fontsize=8, loc="lower right")


@contextmanager
def _chart(out: Path, width: float, height: float) -> Iterator[Axes]:
    """Axes to draw on, written at the end: the same bytes for the same figures."""
    from matplotlib import rc_context
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    settings: dict[Any, Any] = {"svg.hashsalt": "coview", "hatch.linewidth": 0.6}
    with rc_context(settings):
        figure = Figure(figsize=(width, height), layout="constrained")
        FigureCanvasAgg(figure)
        yield figure.subplots()
        with writing(out) as unfinished:
            figure.savefig(unfinished, dpi=150, metadata={"Date": None} if out.suffix == ".svg" else None)
