"""How many points does each sensor set put on a vehicle? (paper, impact of point density)

python examples/02_density_of_sensor_sets.py
"""

import tempfile
from pathlib import Path

import numpy as np

from toolkit import CoopDataset, Run, draw_density_cdf, simulate_dataset, survey

SETS = ((4,), (3, 4), (0, 2, 5), (1, 3, 4, 5), (0, 1, 2, 3, 4, 5))


def main(frames: int = 40) -> None:
    """Record a few frames, count, and draw the distribution for each sensor set."""
    with tempfile.TemporaryDirectory() as folder:
        simulate_dataset("tjunction", Path(folder, "few.hdf5"), run=Run(frames=frames))
        with CoopDataset(Path(folder, "few.hdf5")) as recording:
            counts = survey(recording)
    for chosen in SETS:
        points = counts.points_on_vehicles(chosen)
        print(
            f"{chosen!s:<20} median {np.median(points):6.0f} points, {counts.unseen(chosen):6.1%} "
            "without any"
        )
    draw_density_cdf(
        {str(chosen): counts.points_on_vehicles(chosen) for chosen in SETS}, "out/density.png"
    )
    print("drawn in out/density.png")


if __name__ == "__main__":
    main()
