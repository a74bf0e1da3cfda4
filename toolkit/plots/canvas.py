"""Canvas of all pictures: the same fonts and lines on every machine, literal text, reproducible PNG
and SVG. Pictures are drawn and written inside `house_style()`, so that no setting of the user
affects them.

Colours of all pictures: of sensors, classes, outcomes and ground, and scales for counts. Sensors,
classes and outcomes share no colour, and any two colours differ by at least 18 in CIELAB for normal
vision and for protanopia, deuteranopia and tritanopia as simulated by Machado et al. (2009, IEEE
TVCG 15(6)); the tests check it. No meaning depends on colour only: sensors have labels, outcomes
have different lines and marks, scales grow darker."""

import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from hashlib import sha256
from html import escape
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any
from warnings import catch_warnings, filterwarnings, warn

import numpy as np

from toolkit.arrays import Shaped
from toolkit.plots.fonts import choose_fonts, list_letters, name_letters, own_font
from toolkit.plots.palette import INK
from toolkit.runtime.writing import write_bytes

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure, FigureBase

DPI = 150  # pixels per inch of written pictures
CHART_INCHES = 7.0  # width of a chart


def add_legend(
    owner: "Axes | FigureBase", handles: "Sequence[Artist]", labels: Sequence[str], **look: Any
) -> None:
    """Add a legend whose labels are shown literally.

    owner: axes or figure to which the legend belongs; handles: artists that it explains; labels:
    their names, which may begin with "_"; look: other arguments of matplotlib's `legend`."""
    # `legend` would drop labels that begin with "_", so it gets numbers, which are replaced
    numbers = [str(k) for k in range(len(labels))]
    legend = owner.legend(handles, numbers, **look)
    for text, label in zip(legend.get_texts(), labels, strict=True):
        text.set_text(label)


@contextmanager
def house_style() -> Iterator[None]:
    """Context in which pictures have the common style, whatever the user's settings."""
    from matplotlib import style

    with style.context(Path(__file__).parent / "house.mplstyle"), catch_warnings():
        # `set_letters` replaces such a letter or its font, so the warning would mislead
        filterwarnings("ignore", message="Glyph .* missing from font")
        yield


def blank_figure(width: float, height: float, *, constrained: bool = False) -> "Figure":
    """Empty figure without a window.

    width, height: inches; constrained: whether matplotlib arranges its parts so that they do not
    overlap."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), layout="constrained" if constrained else None)
    FigureCanvasAgg(figure)
    return figure


def check_picture(out: Path | str) -> None:
    """Check that a picture's name ends in .png or .svg. Raises ValueError for another ending."""
    if Path(out).suffix.lower() not in (".png", ".svg"):
        raise ValueError(f"a picture's name must end in .png or .svg, got {Path(out).name}")


def write_figure(figure: "Figure", out: Path | str) -> None:
    """Write a figure as SVG or PNG by the suffix, with the same bytes each time.

    Raises ValueError for another suffix."""
    check_picture(out)
    set_letters(figure)
    if Path(out).suffix.lower() == ".svg":
        content = f'<?xml version="1.0" encoding="utf-8"?>\n{svg_text(figure)}\n'.encode()
    else:
        buffer = BytesIO()
        # without the version of matplotlib, which would change the bytes
        figure.savefig(buffer, format="png", dpi=DPI, metadata={"Software": None})
        content = buffer.getvalue()
    write_bytes(out, content)


def render_pixels(figure: "Figure") -> Shaped[np.ndarray, "height width 3"]:
    """Render the figure as RGB, uint8, 100 pixels an inch."""
    set_letters(figure)
    canvas: Any = figure.canvas
    canvas.draw()
    return np.array(canvas.buffer_rgba())[..., :3]  # without alpha


def set_letters(figure: "Figure") -> None:
    """Give texts another font of this computer if DejaVu Sans lacks their letters.

    The figure's texts are changed in place. A text that no font can set is replaced by a number,
    and a warning names it and its letters."""
    from matplotlib import ft2font
    from matplotlib.font_manager import fontManager
    from matplotlib.text import Text

    foreign = [text for text in figure.findobj(Text) if not text.get_text().isascii()]
    if not foreign:
        return
    # newer versions of matplotlib join and order letters by libraqm
    shaping = hasattr(ft2font, "__libraqm_version__")
    fonts = choose_fonts(
        (text.get_text() for text in foreign), own_font("DejaVuSans"), shaping=shaping
    )
    for file in fonts.files:
        fontManager.addfont(str(file))
    usual_letters = list_letters(own_font("DejaVuSans"))
    for text in foreign:
        letters = set(map(ord, text.get_text())) & usual_letters
        if not letters <= list_letters(Path(fontManager.findfont(text.get_fontproperties()))):
            text.set_fontweight("normal")  # the bold DejaVu Sans lacks some of the letters
        text.set_fontfamily([*text.get_fontfamily(), *fonts.families])
    numbers: dict[str, str] = {}
    for text in foreign:
        if fonts.unset & set(text.get_text()):
            number = numbers.setdefault(text.get_text(), f"({len(numbers) + 1})")
            text.set_text(number)
    if numbers:
        listed = ", ".join(f"{number} for {name!r}" for name, number in numbers.items())
        reason = (
            f"no font here can set the letters {''.join(sorted(fonts.unset))} "
            f"({name_letters(fonts.unset)})"
        )
        warn(
            (
                f"{reason}: the picture shows {listed}; install a font that has them, such as Noto "
                "Sans"
            ),
            stacklevel=3,
        )


def svg_text(figure: "Figure", title: str = "") -> str:
    """Return the figure as an <svg> element, for a page or a file, with texts as outlines.

    title: title for screen readers, "" without one. Ids begin with a digest of the figure, so that
    several pictures can share a page."""
    set_letters(figure)
    buffer = BytesIO()
    no_metadata = dict.fromkeys(("Date", "Creator", "Format", "Type"))  # None leaves an entry out
    figure.savefig(buffer, format="svg", dpi=DPI, metadata=no_metadata)
    text = buffer.getvalue().decode()
    # drop comments, metadata, and everything before the element
    text = re.sub(r"<!--.*?-->\s*", "", text[text.index("<svg") :], flags=re.DOTALL).strip()
    text = re.sub(r"\s*<metadata>.*?</metadata>", "", text, flags=re.DOTALL)
    text = re.sub(r' d="([^"]*)"', _shorten_path, text)
    # begin ids, and references to them, with the digest; an id must begin with a letter
    prefix = "p" + sha256(text.encode()).hexdigest()[:8]
    text = re.sub(r'\bid="([^"]+)"', rf'id="{prefix}-\1"', text)
    text = re.sub(r'(url\(#|href="#)', rf"\g<1>{prefix}-", text)
    if title:
        tag, rest = text.split(">", 1)  # the opening tag <svg ...> comes first
        title_text = escape(replace_unprintable(title), quote=False)
        text = f'{tag} role="img">\n <title>{title_text}</title>{rest}'
    return text


def draw_heading(figure: "Figure", title: str, subtitle: str) -> None:
    """Write a chart's title and subtitle at the top left."""
    # distances from the top in inches, which do not depend on the chart's height
    _, height = figure.get_size_inches()
    figure.text(
        0.015, 1 - 0.22 / height, shorten(title, 88), fontsize=11, fontweight="bold", va="center"
    )
    figure.text(0.015, 1 - 0.47 / height, replace_unprintable(subtitle), fontsize=8.5, va="center")


def draw_interval(axes: "Axes", x: float, low: float, high: float) -> None:
    """Draw an interval of y at `x` as an upright bar with capped ends."""
    axes.plot([x, x], [low, high], "_-", color=INK, linewidth=1.3, markersize=7, zorder=3)


def pad_limits(values: Sequence[float]) -> tuple[float, float]:
    """Limits of an axis from 0 to a tenth above the greatest value.

    They are 0 and 1 if no value is above 0."""
    greatest = max(0.0, *values) if len(values) else 0.0
    if greatest <= 0:
        return 0.0, 1.0
    return 0.0, 1.1 * float(greatest)


def replace_unprintable(text: str) -> str:
    """Replace unprintable characters by spaces."""
    return "".join(letter if letter.isprintable() else " " for letter in text)


def shorten(text: str, max_letters: int) -> str:
    """Shorten a text to at most `max_letters` letters, with "…" in its middle.

    Unprintable characters become spaces."""
    printable = replace_unprintable(text)
    if len(printable) <= max_letters:
        return printable
    head_letters = max_letters // 2
    tail_letters = max_letters - head_letters - 1  # one letter for "…"
    return f"{printable[:head_letters]}…{printable[len(printable) - tail_letters :]}"


def _shorten_path(attribute: re.Match[str]) -> str:
    """Shorten an SVG path: coordinates to a hundredth of a point, no spaces around letters.

    attribute: match of ` d="..."`, whose first group is the path. Returns the whole attribute."""
    path = attribute.group(1)

    def round_number(number: re.Match[str]) -> str:
        return f"{float(number.group()):.2f}".rstrip("0").rstrip(".")

    rounded_path = re.sub(r"-?\d+\.\d+", round_number, path)
    short_path = re.sub(r"\s*([A-Za-z])\s*", r"\1", rounded_path).strip()
    return f' d="{short_path}"'
