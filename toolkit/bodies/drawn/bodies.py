"""Bodies drawn afresh, each from a random generator: what class it is of is asked for, everything else is drawn.

The ground truth box of a drawn vehicle is the body without its wing mirrors, which stick out of it by 8 to 25 cm where
it has any; roof signs, roof boxes, racks, loads and spare wheels are part of it, and so is a trailer, which makes a
car with one a heavy, articulated vehicle. `toolkit.bodies.body.tight` gives the other convention, mirrors included.
"""

from __future__ import annotations

import numpy as np

from toolkit.bodies.body import Body, boxed
from toolkit.bodies.drawn.cars import block_car, lofted_car
from toolkit.bodies.drawn.extras import CARRIED, NOTHING, TRAILERS, mirrors, on_roof, trailer
from toolkit.bodies.drawn.heavy import BUSES, SUPERSTRUCTURES, drawn_heavy
from toolkit.bodies.drawn.people import PEOPLE, drawn_person
from toolkit.bodies.drawn.proportions import KINDS, drawn_proportions
from toolkit.bodies.drawn.two_wheelers import TWO_WHEELERS, drawn_two_wheeler
from toolkit.mesh import Mesh, merge
from toolkit.objects import CYCLIST, HEAVY, LABELS, PEDESTRIAN, VEHICLE, label_index

BLOCKS = 0.25  # of the cars are built of plain blocks
TOWING = 0.1  # of the heavy vehicles are cars with a trailer


def drawn_body(label: int | str, rng: np.random.Generator) -> Body:
    """A body of a class, drawn: `vehicle`, `cyclist`, `pedestrian` or `heavy`; its name says what kind of one it is.

    >>> body = drawn_body("vehicle", np.random.default_rng(0))
    >>> body.label, len(body.size)
    (0, 3)
    """
    label = label_index(label)
    kind, mesh, outside = _DRAW[label](rng)
    return boxed(f"{LABELS[label]}/{kind}", label, mesh, outside)


def drawn_bodies(rng: np.random.Generator, counts: dict[int, int]) -> tuple[Body, ...]:
    """So many bodies of each class, in the order of the classes given."""
    return tuple(drawn_body(label, rng) for label, count in counts.items() for _ in range(count))


def drawn_names() -> tuple[str, ...]:
    """Every name a drawn body may have: its class and what kind of one it is."""
    cars = [kind.name for kind in KINDS]
    kinds = {
        VEHICLE: [*cars, *(f"block_{car}" for car in cars), *(f"{car}_{load}" for car in cars for load in CARRIED)],
        CYCLIST: [*TWO_WHEELERS, *(f"{kind}_alone" for kind in TWO_WHEELERS)],
        PEDESTRIAN: list(PEOPLE),
        HEAVY: [
            *(f"{load}_truck" for load in SUPERSTRUCTURES), *(f"articulated_{load}" for load in SUPERSTRUCTURES),
            *BUSES, *(f"{car}_with_{behind}" for car in cars for behind in TRAILERS),
        ],
    }  # fmt: skip
    return tuple(f"{LABELS[label]}/{name}" for label, names in kinds.items() for name in names)


def _car(rng: np.random.Generator) -> tuple[str, Mesh, Mesh]:
    shape = drawn_proportions(rng)
    if rng.random() < BLOCKS:
        return f"block_{shape.kind}", block_car(shape, rng), mirrors(shape, rng)
    carried, load = on_roof(shape, rng)
    name = f"{shape.kind}_{carried}" if carried else shape.kind
    return name, merge([lofted_car(shape), load]), mirrors(shape, rng)


def _heavy(rng: np.random.Generator) -> tuple[str, Mesh, Mesh]:
    if rng.random() >= TOWING:
        return drawn_heavy(rng)
    shape = drawn_proportions(rng)
    kind, behind = trailer(shape, rng)
    return f"{shape.kind}_with_{kind}", merge([lofted_car(shape), behind]), mirrors(shape, rng)


def _without_mirrors(kind: str, mesh: Mesh) -> tuple[str, Mesh, Mesh]:
    return kind, mesh, NOTHING


_DRAW = {
    VEHICLE: _car,
    CYCLIST: lambda rng: _without_mirrors(*drawn_two_wheeler(rng)),
    PEDESTRIAN: lambda rng: _without_mirrors(*drawn_person(rng)),
    HEAVY: _heavy,
}
