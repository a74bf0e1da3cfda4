"""Charts of our figures and the paper's.

Our bars are filled and the paper's hatched or hollow, so that they differ in grey print too."""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from examples.studies.paper.comparison import Compared
from toolkit.arrays import Float64
from toolkit.plots.canvas import blank_figure
from toolkit.runtime.writing import writing

if TYPE_CHECKING:
    from matplotlib.axes import Axes


# colours that colour-blind readers can distinguish (Okabe and Ito)
OUR_COLOUR = "#0072b2"
PAPER_COLOUR = "#e69f00"


def draw_pairs(names: Sequence[str], rows: Sequence[Compared], out: Path, *, title: str) -> None:
    """Draw AP as pairs of bars, ours with its interval.

    names: label below each pair; rows: figures of each pair; out: picture to write."""
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
    """Draw our AP over the paper's.

    groups: name of the sensor set, paper's AP and our AP of each marker, by scheme; out: picture to
    write."""
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
    """Draw mean IoU over point density, and its fit: intercept + slope · ln(density).

    density, iou: means of each bin; coefficients: intercept and slope, NaN for no fit; out: picture
    to write."""
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
    """Yield axes to draw on, and write the picture at the end.

    width, height: inches. The same drawing gives the same SVG, byte for byte."""
    from matplotlib import rc_context

    with rc_context({"svg.hashsalt": "coview", "hatch.linewidth": 0.6}):
        figure = blank_figure(width, height, constrained=True)
        yield figure.subplots()
        metadata = {"Date": None} if out.suffix == ".svg" else None
        with writing(out) as unfinished:
            figure.savefig(unfinished, dpi=150, metadata=metadata)
