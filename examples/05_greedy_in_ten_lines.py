"""Choose four poses out of a pool, one sensor after another.

python examples/05_greedy_in_ten_lines.py
"""

import numpy as np

from placement_env import Objective, Setting, greedy, pool
from toolkit import Run, load_site


def main(frames: int = 4) -> None:
    """A few poses on every mount of the T-junction, scored by the AP that the surrogate predicts
    for early fusion."""
    candidates = pool(load_site("tjunction"), heights=(6.0,), headings=4, tilts=(np.deg2rad(15.0),))
    objective = Objective(
        Setting("tjunction", scheme="early", fidelity="surrogate", candidates=candidates),
        Run(frames=frames),
    )
    found = greedy.search(objective, budget=4)
    print(found)
    for index in found.best.subset:
        print("  ", objective.names[index])
    print(
        f"AP {found.best.ap:.3f}, {found.best.kbit_per_sensor:.0f} kbit per sensor; "
        f"{found.certificate.note}"
    )


if __name__ == "__main__":
    main()
