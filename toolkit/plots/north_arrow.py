"""North arrow of a map."""

from typing import TYPE_CHECKING

import numpy as np

from toolkit.arrays import Float64
from toolkit.plots.palette import INK
from toolkit.sites.site import Site

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.transforms import Transform


def draw_north(
    axes: "Axes", place: tuple[float, float], direction: Float64[np.ndarray, "2"]
) -> None:
    """Draw an arrow that points north, with the letter N at its tip.

    place: middle of the arrow, in the coordinates of the axes' data; direction: unit vector towards
    north, on the page."""
    from matplotlib.transforms import ScaledTranslation

    def away(points: float) -> "Transform":
        """Shift of a place by points (1/72 inch) towards north, whatever the scale of the axes."""
        x, y = direction * points / 72
        return axes.transData + ScaledTranslation(x, y, axes.figure.dpi_scale_trans)

    style = {
        "arrowstyle": "-|>",
        "color": INK,
        "linewidth": 1.4,
        "shrinkA": 0,
        "shrinkB": 0,
        "mutation_scale": 13,
    }
    axes.annotate(
        "",
        xy=place,
        xycoords=away(11.0),
        xytext=place,
        textcoords=away(-11.0),
        arrowprops=style,
        zorder=9,
    )
    axes.text(
        *place,
        "N",
        transform=away(17.0),
        ha="center",
        va="center",
        fontsize=9,
        fontweight="bold",
        zorder=9,
    )


def north(site: Site) -> Float64[np.ndarray, "2"]:
    """Unit vector towards north, +y of the map, in the site's frame; +y without a direction."""
    # row of the rotation that gives the map's y: its entries are that axis in the site's frame
    towards = site.map_SE3_site[1, :2]
    length = float(np.hypot(*towards))
    return towards / length if length > 1e-9 else np.array([0.0, 1.0])
