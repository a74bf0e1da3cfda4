"""The fleet: every body that traffic may use, our own and those of a folder of meshes."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path

from toolkit.bodies.body import Body, centred
from toolkit.bodies.cars import CARS, car
from toolkit.bodies.cyclists import two_wheelers
from toolkit.bodies.pedestrians import pedestrians
from toolkit.bodies.trucks import trucks
from toolkit.objects import CYCLIST, HEAVY, PEDESTRIAN, VEHICLE

HELD_OUT = tuple(shape.name for shape in CARS[-5:])  # cars no detector of ours has been trained on


def catalogue(meshes: str | Path | None = None, held_out: bool = False) -> tuple[Body, ...]:
    """Every body traffic may use: cars, two-wheelers, pedestrians, trucks and buses, and the meshes of a folder.

    held_out: take the five cars of `HELD_OUT` in place of all others, to test on bodies never trained on;
    meshes: a folder of mesh files, see `toolkit.bodies.meshes`; theirs come last.

    >>> [sum(body.label == label for body in catalogue()) for label in range(4)]
    [21, 7, 14, 5]
    """
    ours = tuple(body for body in _procedural() if body.label != VEHICLE or (body.name in HELD_OUT) == held_out)
    if meshes is None:
        return ours
    from toolkit.bodies.meshes import load_meshes

    return ours + load_meshes(meshes)


@lru_cache(maxsize=1)
def _procedural() -> tuple[Body, ...]:
    groups = (
        (VEHICLE, {shape.name: car(shape) for shape in CARS}), (CYCLIST, two_wheelers()),
        (PEDESTRIAN, pedestrians()), (HEAVY, trucks()),
    )  # fmt: skip
    return tuple(centred(name, label, *mesh) for label, group in groups for name, mesh in group.items())
