"""Places for sensors at the kerb and behind the footway."""

import numpy as np
import shapely

from toolkit.arrays import Float, Rng
from toolkit.sites.site import Mount
from toolkit.sites.surroundings.places import points_along
from toolkit.sites.surroundings.plot import Road

MIN_MOUNTS = 12  # for a site
POLE_HEIGHT_M = 2.8  # height of a mount's pole: sensors are above it
Extent = Float[np.ndarray, "4"]  # xmin ymin xmax ymax (m)


def place_mounts(
    road: Road,
    area: Extent,
    rng: Rng,
    *,
    spacing: float = 5.0,
    avoid: shapely.Geometry | None = None,
) -> tuple[Mount, ...]:
    """Choose sensor places at the kerb and behind the footway, their feet at z = 0.

    There are `MIN_MOUNTS` to twice as many mounts in and up to 5 m around `area`, or fewer if even
    0.5 m between them leaves no room for so many. Names are pole00, pole01, ...; prices are drawn.

    spacing: least distance (m) between two mounts, lowered until `MIN_MOUNTS` have room; avoid:
    ground to keep free, as the carriageway is."""
    window = shapely.box(*area).buffer(5.0)
    # x, y, direction every metre
    kerb = points_along(road.carriageway.buffer(0.7).boundary.intersection(window), 1.0)
    behind = points_along(road.surface.buffer(0.6).boundary.intersection(window), 1.0)
    behind = behind[rng.random(len(behind)) < 0.5]
    candidates = rng.permutation(np.concatenate([kerb, behind]))[:, :2]
    kept_clear = road.carriageway.buffer(0.6).union(avoid or shapely.Polygon())
    candidates = candidates[~shapely.intersects_xy(kept_clear, candidates)]
    max_mounts = int(rng.integers(MIN_MOUNTS, 2 * MIN_MOUNTS + 1))
    while True:
        feet = np.zeros((0, 2))
        for point in candidates:
            if len(feet) < max_mounts and (np.hypot(*(feet - point).T) >= spacing).all():
                feet = np.vstack([feet, point])
        if len(feet) >= MIN_MOUNTS or spacing <= 0.5:
            break
        spacing *= 0.7
    feet = np.column_stack([feet, np.zeros(len(feet))]).round(3)
    return tuple(
        Mount(
            f"pole{i:02}",
            foot,
            min_height=3.0,
            max_height=10.0,
            price=round(float(rng.uniform(0.5, 2.0)), 2),
        )
        for i, foot in enumerate(feet)
    )
