"""Which sets are worth their price and their bits? The front of AP against kbit against price.

python examples/07_pareto_front.py
"""

from placement_env import Objective, Setting, exhaustive
from toolkit import Run


def main(frames: int = 6) -> None:
    """Print the exact front of the six sensors' sets."""
    objective = Objective(
        Setting("tjunction", scheme="hybrid", fidelity="coverage"), Run(frames=frames)
    )
    found = exhaustive.search(objective, budget=6)
    print("price    kbit  covered  sensors")
    for score in found.front:
        print(f"{score.price:5.1f} {score.kbit:7.0f} {score.ap:8.3f}  {score.subset}")
    print(found.certificate.note)


if __name__ == "__main__":
    main()
