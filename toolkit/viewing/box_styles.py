"""`BoxStyle`: the lines by which a scene shows boxes: edges, dashes and a mark on the roof."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from toolkit.arrays import BoxRows
from toolkit.viewing.box_lines import Segments, box_edges, dashes
from toolkit.viewing.scene_parts import add_lines

if TYPE_CHECKING:
    from viser import LineSegmentsHandle, SceneApi


class DashPattern(NamedTuple):
    """Lengths (m) of a dash and of the gap after it."""

    dash: float
    gap: float


@dataclass(frozen=True)
class BoxStyle:
    """Style of the lines that show boxes.

    Attributes:
        colour: Colour of all lines, #rrggbb.
        width: Width of all lines (pixels).
        dashes: Pattern of dashed edges, None for solid ones.
        mark: Function that returns the lines (start and end, m) of a mark on each box, such as
            `toolkit.viewing.box_lines.roof_crosses`; None for edges only.
    """

    colour: str
    width: float
    dashes: DashPattern | None = None
    mark: Callable[[BoxRows], Segments] | None = None

    def lines(self, boxes: BoxRows) -> Segments:
        """Lines that show boxes: their edges, then their marks."""
        edges = box_edges(boxes)
        if self.dashes is not None:
            edges = dashes(edges, dash=self.dashes.dash, gap=self.dashes.gap)
        if self.mark is None:
            return edges
        return np.concatenate([edges, self.mark(boxes)])


def add_boxes(
    api: "SceneApi", name: str, boxes: BoxRows, style: BoxStyle, *, visible: bool
) -> "LineSegmentsHandle | None":
    """Add boxes to a scene in a style, or return None without boxes.

    name: path of the node; visible: whether the node is seen at first."""
    return add_lines(
        api, name, style.lines(boxes), style.colour, width=style.width, visible=visible
    )
