"""What is each sensor worth, which of them work together, and what is left when one or two fail?

python examples/09_what_each_sensor_is_worth.py
"""

import numpy as np

from placement_env import (
    Objective,
    Setting,
    estimate_worth,
    exact_worth,
    failures,
    format_failures,
    format_worth,
)


def main(site: str = "tjunction") -> None:
    """A built-in site's own sensors with early fusion, by the AP that its detector reached with
    every set of them."""
    objective = Objective(Setting(site, scheme="early", fidelity="table"))
    names = objective.names
    sensors = len(objective.candidates)
    everything = np.ones(sensors, bool)

    def ap(sets: np.ndarray) -> np.ndarray:
        return objective.scores(sets).ap

    print(
        "Shares of the AP of all, and synergy of pairs (Shapley value and interaction index), "
        "from all 64 sets"
    )
    print(format_worth(exact_worth(ap, sensors), names))
    print(
        "\nThe same from a sample, as for sets of more than 16 sensors; ± is half of a 95 % "
        "interval"
    )
    print(format_worth(estimate_worth(ap, sensors, rounds=8, seed=0), names))
    print("\nAP when any one or two of them fail")
    print(format_failures([failures(ap, everything, failing=failing) for failing in (1, 2)], names))
    print("\nWhat each adds to the others, and for how much data")
    figures = objective.scores(np.vstack([everything, ~np.eye(sensors, dtype=bool)]))
    for name, gain, kbit in zip(
        names, figures.ap[0] - figures.ap[1:], figures.kbit[0] - figures.kbit[1:], strict=True
    ):
        print(f"{name}: {gain:+.4f} AP for {kbit:.2f} kbit")


if __name__ == "__main__":
    main()
