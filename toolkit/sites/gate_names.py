"""Names of gates: the compass directions in which they are."""

from collections import Counter
from collections.abc import Sequence

# clockwise from north, 45 degrees apart
DIRECTIONS = (
    "north",
    "north-east",
    "east",
    "south-east",
    "south",
    "south-west",
    "west",
    "north-west",
)


def name_gates(bearings_deg: Sequence[float], distances_m: Sequence[float]) -> list[str]:
    """Name gates by the compass direction in which they lie.

    Gates in one direction are numbered from the nearest on.

    Args:
        bearings_deg: Direction of each gate, clockwise from north.
        distances_m: Distance of each gate."""
    sectors = [round(bearing / 45) % 8 for bearing in bearings_deg]
    names = [""] * len(sectors)
    numbers = Counter[int]()
    for row in sorted(range(len(sectors)), key=lambda row: (sectors[row], distances_m[row])):
        sector = sectors[row]
        numbers[sector] += 1
        suffix = f" {numbers[sector]}" if numbers[sector] > 1 else ""
        names[row] = DIRECTIONS[sector] + suffix
    return names
