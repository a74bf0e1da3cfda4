"""A canvas of the house: fonts and lines the same on every machine, text as it is, PNG and SVG the same each time.

Pictures are made and written inside `house_style()`, so that no setting of the user's reaches them.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import contextmanager
from hashlib import sha256
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any
from warnings import catch_warnings, filterwarnings

import numpy as np

from toolkit.arrays import Shaped
from toolkit.plots.palette import INK
from toolkit.runtime.files import write_bytes

if TYPE_CHECKING:
    from matplotlib.figure import Figure

DPI = 150
STYLE: Any = {
    "font.family": ["DejaVu Sans"],  # comes with matplotlib
    "font.size": 9.0,
    "axes.titlesize": 11.0,
    "axes.labelsize": 9.0,
    "axes.edgecolor": INK,
    "axes.labelcolor": INK,
    "axes.linewidth": 0.8,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.axisbelow": True,
    "axes.unicode_minus": True,
    "axes.formatter.use_mathtext": False,
    "axes.formatter.useoffset": False,
    "axes.facecolor": "white",
    "figure.facecolor": "white",
    "figure.dpi": 100.0,
    "savefig.facecolor": "auto",
    "savefig.bbox": None,
    "savefig.transparent": False,
    "grid.color": "#d5d5d5",
    "grid.linewidth": 0.6,
    "grid.alpha": 1.0,
    "grid.linestyle": "-",
    "hatch.linewidth": 0.8,
    "image.composite_image": False,
    "legend.fontsize": 8.0,
    "legend.frameon": False,
    "lines.linewidth": 1.6,
    "path.simplify": True,
    "svg.fonttype": "path",  # makers of PDF need no font
    "svg.hashsalt": "coview",
    "text.color": INK,
    "text.parse_math": False,  # a name may hold dollars
    "text.usetex": False,
    "xtick.color": INK,
    "xtick.labelsize": 8.0,
    "ytick.color": INK,
    "ytick.labelsize": 8.0,
}


@contextmanager
def house_style() -> Iterator[None]:
    """Within it, pictures look as all of the house's do."""
    from matplotlib import rc_context

    with rc_context(STYLE), catch_warnings():
        filterwarnings("ignore", message="Glyph .* missing from font")  # an empty box in the picture says it
        yield


def blank_figure(width: float, height: float, *, constrained: bool = False) -> Figure:
    """A figure of so many inches that belongs to no window; `constrained`: its axes make room for their texts."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), layout="constrained" if constrained else None)
    FigureCanvasAgg(figure)
    return figure


def check_picture(out: Path | str) -> None:
    """Raise ValueError where the name of a picture ends in neither .png nor .svg.

    >>> check_picture("frame.jpg")
    Traceback (most recent call last):
    ValueError: a picture's name must end in .png or .svg, got frame.jpg
    """
    if Path(out).suffix.lower() not in (".png", ".svg"):
        raise ValueError(f"a picture's name must end in .png or .svg, got {Path(out).name}")


def write_figure(figure: Figure, out: Path | str) -> None:
    """Write SVG where the file's name ends in .svg, PNG where it ends in .png; the same picture, the same bytes.

    Raises ValueError for another ending.
    """
    check_picture(out)
    if Path(out).suffix.lower() == ".svg":
        write_bytes(out, f'<?xml version="1.0" encoding="utf-8"?>\n{svg_text(figure)}\n'.encode())
        return
    drawn = BytesIO()
    figure.savefig(drawn, format="png", dpi=DPI, metadata={"Software": None})
    write_bytes(out, drawn.getvalue())


def drawn_pixels(figure: Figure) -> Shaped[np.ndarray, "height width 3"]:
    """The figure as RGB, uint8, at its own resolution (100 pixels an inch)."""
    canvas: Any = figure.canvas
    canvas.draw()
    return np.array(canvas.buffer_rgba())[..., :3]


def svg_text(figure: Figure, title: str = "") -> str:
    """The figure as an <svg> element with texts as outlines, to be put into a page or a file; title: what readers of
    the screen say. Its ids begin with a digest of it, so that several pictures can stand in one page."""
    drawn = BytesIO()
    nothing = dict.fromkeys(("Date", "Creator", "Format", "Type"))
    figure.savefig(drawn, format="svg", dpi=DPI, metadata=nothing)
    text = drawn.getvalue().decode()
    text = re.sub(r"<!--.*?-->\s*", "", text[text.index("<svg") :], flags=re.DOTALL).strip()
    text = re.sub(r"\s*<metadata>.*?</metadata>", "", text, flags=re.DOTALL)
    text = re.sub(r' d="([^"]*)"', _short_path, text)
    mark = "p" + sha256(text.encode()).hexdigest()[:8]
    text = re.sub(r'\bid="([^"]+)"', rf'id="{mark}-\1"', text)
    text = re.sub(r'(url\(#|href="#)', rf"\g<1>{mark}-", text)
    if title:
        head = text.index(">") + 1
        text = f'{text[: head - 1]} role="img">\n <title>{_escaped(plain(title))}</title>{text[head:]}'
    return text


def plain(text: str) -> str:
    """Text of one line, with a space for whatever cannot be printed."""
    return "".join(letter if letter.isprintable() else " " for letter in text)


def shortened(text: str, most: int) -> str:
    """Plain text of at most so many letters, with "…" for its middle where it is longer.

    >>> shortened("north-east pole, camera", 12)
    'north-…amera'
    """
    text = plain(text)
    if len(text) <= most:
        return text
    head = most // 2
    return f"{text[:head]}…{text[len(text) - (most - head - 1) :]}"


def _short_path(attribute: re.Match[str]) -> str:
    """Coordinates of a path to a hundredth of a point, without the spaces round its letters."""
    rounded = re.sub(r"-?\d+\.\d+", _hundredths, attribute[1])
    short = re.sub(r"\s*([A-Za-z])\s*", r"\1", rounded).strip()
    return f' d="{short}"'


def _hundredths(number: re.Match[str]) -> str:
    return f"{float(number[0]):.2f}".rstrip("0").rstrip(".")


def _escaped(text: str) -> str:
    return text.replace("&", "&amp;").replace("<", "&lt;").replace(">", "&gt;")
