"""Traffic alone: frames a second, objects, and how many frames had to be repaired so that no bodies intersect.

python tests/benchmarks/toolkit/bench_traffic.py
"""

from time import perf_counter

import numpy as np

from toolkit.bodies.fleet import catalogue
from toolkit.sites.files import load_site
from toolkit.traffic.snapshots import simulate

FRAMES = 400


def main() -> None:
    """One line per built-in site."""
    bodies = catalogue()
    for name in ("tjunction", "roundabout"):
        started = perf_counter()
        snapshots = list(simulate(load_site(name), bodies, frames=FRAMES, seed=1))
        seconds = perf_counter() - started
        objects = np.array([len(snapshot.objects) for snapshot in snapshots])
        repaired = np.array([snapshot.repaired for snapshot in snapshots])
        print(
            f"{name}: {FRAMES / seconds:.0f} frames/s, {objects.mean():.1f} objects a frame (most {objects.max()}), "
            f"{(repaired > 0).mean():.1%} of the frames repaired, {repaired.sum() / objects.sum():.1%} of the objects"
        )


if __name__ == "__main__":
    main()
