"""Piece of a map file to import as a site."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import shapely

from toolkit.arrays import Float64
from toolkit.sites.site import Furnishing

MAP_REACH_M = 80.0  # road kept around the area, for traffic to enter
SURROUNDINGS_M = 30.0  # margin around the area with buildings and furniture


@dataclass(frozen=True)
class MapPiece:
    """Piece of a map file to import as a site.

    Raises FileNotFoundError for a missing file, ValueError for an empty one and for an impossible
    place.

    Attributes:
        path: map file.
        centre: place of the site's origin in the map: x, y (m) of an OpenDRIVE map, longitude and
            latitude (degrees) of OpenStreetMap.
        size: lengths of the detection area along the site's x and y (m).
        heading: direction of the site's x (rad, counter-clockwise from the map's east).
        seed: seed of the surroundings that coview draws because the map lacks them; None to draw
            none.
        density: density of the drawn surroundings."""

    path: Path
    centre: tuple[float | int, float | int]
    size: tuple[float | int, float | int]
    heading: float = 0.0
    seed: int | None = None
    density: Furnishing = "dense"

    def __post_init__(self) -> None:
        """Raise FileNotFoundError without the map, ValueError for a wrong place or size.

        centre: x, y or longitude, latitude; size: along x and y (m)."""
        path = self.path
        centre = self.centre
        size = self.size
        if not path.is_file():
            raise FileNotFoundError(f"no map {str(path)!r}: give an .xodr or .osm file")
        if path.stat().st_size == 0:
            raise ValueError(f"{path}: the file is empty: download the map again")
        if not (len(centre) == 2 and np.isfinite([*centre, self.heading]).all()):
            raise ValueError(
                f"centre must be two finite numbers and heading one, got {centre} and "
                f"{self.heading}"
            )
        if not (len(size) == 2 and np.isfinite(size).all() and min(size) > 0 and max(size) <= 1000):
            raise ValueError(
                f"size must be two lengths above 0 and at most 1000 m, got {size}: give --size X Y"
            )

    @property
    def area(self) -> Float64[np.ndarray, "4"]:
        """Detection area xmin ymin xmax ymax (m) in the site's frame, centred on its origin."""
        length, width = self.size
        return np.array([-length, -width, length, width]) / 2

    def around(self, margin: float) -> shapely.Polygon:
        """Rectangle of the ground up to `margin` m around the area, in the site's frame."""
        return shapely.box(*(self.area + margin * np.array([-1, -1, 1, 1])))

    def no_road(self, nearest: tuple[float, float] | None = None, nearby: str = "") -> ValueError:
        """Make the error for a piece without a road, for the caller to raise.

        nearest: place x, y on the nearest road, in the map's coordinates; nearby: words for what
        the map has here instead, "" for nothing."""
        x, y = self.centre
        found = f" ({nearby})" if nearby else ""
        example = ""
        if nearest is not None:
            nearest_x, nearest_y = nearest
            example = f", as --centre {nearest_x:.10g} {nearest_y:.10g}"
        return ValueError(
            f"{self.path}: no road within the area about {x:.10g} {y:.10g}{found}: move --centre "
            f"onto a road{example}"
        )

    def no_carriageway(self, kinds: Sequence[str]) -> ValueError:
        """Make the error for a piece whose roads have no carriageway, for the caller to raise.

        kinds: types of the roads' lanes in the map's words."""
        kind_list = ", ".join(kind[:30] for kind in kinds[:12])
        x, y = self.centre
        problem = (
            f"the roads within the area about {x:.10g} {y:.10g} have no carriageway, but lanes of "
            f"the types {kind_list}"
        )
        return ValueError(f"{self.path}: {problem}: give --centre X Y on another road")
