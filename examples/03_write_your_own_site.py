"""Describe a crossroads of your own, hang sensors, save it: `coview simulate` then records it like
the built-in ones.

python examples/03_write_your_own_site.py
coview simulate out/crossroads.json --frames 100 --out out/crossroads.hdf5
"""

from pathlib import Path

import numpy as np

from toolkit import (
    DepthCamera,
    Mount,
    Relief,
    Sensor,
    Site,
    Solid,
    SpinningLidar,
    build_network,
    load_site,
    look,
    road_polygons,
    save_site,
    street,
)

AREA = (-30.0, -30.0, 30.0, 30.0)  # xmin, ymin, xmax, ymax: metres, x east, y north


def crossroads() -> Site:
    """Four legs of one lane each way, a house on a corner, a camera and a lidar."""
    ends = {"east": (120, 0), "north": (0, 120), "west": (-120, 0), "south": (0, -120)}
    nodes = [{"id": name, "x": x, "y": y} for name, (x, y) in ends.items()]
    nodes.append({"id": "middle", "x": 0, "y": 0, "type": "priority"})
    lanes = street(1, width=3.5, shoulder=0.5, footway=2.5, speed=13.9)
    pairs = [pair for name in ends for pair in ((name, "middle"), ("middle", name))]
    edges = [
        {"id": f"{a}_{b}", "from": a, "to": b, "priority": 1, "lanes": lanes} for a, b in pairs
    ]
    network = build_network(nodes, edges)
    roads, footways = road_polygons(network, np.array(AREA))
    house = Solid(
        np.array([[12.0, 12.0], [26.0, 12.0], [26.0, 24.0], [12.0, 24.0]]), 0.0, 7.0, "building"
    )
    return Site(
        name="crossroads",
        area=np.array(AREA),
        lanes=roads,
        footways=footways,
        solids=(house,),
        mounts=tuple(
            Mount(f"pole{i}", np.array([x, y, 0.0])) for i, (x, y) in enumerate([(9, -9), (-9, 9)])
        ),
        sensors=(
            Sensor(
                "d0",
                DepthCamera(),
                look((9.0, -9.0, 6.0), heading=np.deg2rad(135), tilt=np.deg2rad(10)),
            ),
            Sensor("lidar", SpinningLidar(channels=32), look_up((-9.0, 9.0, 5.0))),
        ),
        network=network,
        relief=Relief(amplitude=0.05, seed=1),
    )


def look_up(position: tuple[float, float, float]) -> np.ndarray:
    """An upright lidar: its axes are the world's."""
    world_SE3_sensor = np.eye(4)
    world_SE3_sensor[:3, 3] = position
    return world_SE3_sensor


def main() -> None:
    """Save it and read it back, validated."""
    out = Path("out/crossroads.json")
    out.parent.mkdir(exist_ok=True)
    save_site(crossroads(), out)
    site = load_site(out)
    print(
        f"{site.name}: {len(site.lanes)} lane polygons, {len(site.sensors)} sensors, written to "
        f"{out}"
    )


if __name__ == "__main__":
    main()
