"""Fuse the clouds of two depth cameras with Open3D, crop them to the detection area and see who saw
what.

python examples/01_fuse_two_clouds.py
"""

import numpy as np

from toolkit import (
    Renderer,
    catalogue,
    crop,
    from_depth,
    fuse,
    load_site,
    points_per_box,
    sensor_numbers,
    simulate,
)


def main() -> None:
    """Render one moment of the T-junction from two posts."""
    site = load_site("tjunction")
    bodies = catalogue()
    moment = next(simulate(site, bodies, frames=1, seed=0))
    pair = site.sensors[1], site.sensors[5]
    measurements = Renderer(site, bodies, pair).render(moment).measurements

    rng = np.random.default_rng(0)
    clouds = [
        from_depth(sensor, depth, rng=rng, sensor_id=number)
        for number, (sensor, depth) in enumerate(zip(pair, measurements, strict=True))
    ]
    # an open3d.t.geometry.PointCloud: save, view and filter it with Open3D
    cloud = crop(fuse(clouds), site)

    print(
        f"{len(cloud.point.positions)} points, {np.bincount(sensor_numbers(cloud)).tolist()} of "
        "them per sensor"
    )
    print("points per object:", points_per_box(cloud, moment.objects.boxes).tolist())


if __name__ == "__main__":
    main()
