"""Styles of lines and marks in pictures."""

from typing import TYPE_CHECKING, Any, Literal, NamedTuple

if TYPE_CHECKING:
    from matplotlib.artist import Artist

Entry = tuple["Artist", str]  # artist and name, of a legend
PlotStyle = dict[str, Any]  # keyword arguments of matplotlib
Dashes = Literal["solid"] | tuple[float, tuple[float, ...]]  # its line styles
Outcome = Literal["hit", "missed", "false alarm", "not scored", "detection"]


class LineStyle(NamedTuple):
    """Outline style and mark of one outcome.

    Attributes:
        colour: #rrggbb.
        line: dashes of the outline.
        width: width of the outline in points.
        marker: matplotlib's name of the mark in the middle, "" for no mark.
        size: size of the mark in points.
        order: greater is drawn above.
    """

    colour: str
    line: Dashes
    width: float
    marker: str = ""
    size: float = 0.0
    order: float = 4.0
