"""Drawn people: adults and children on foot, with bags, umbrellas, prams, walkers, and people in wheelchairs."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from toolkit.bodies.cars import wheel_at
from toolkit.bodies.drawn.cars import plank
from toolkit.bodies.pedestrians import (
    Figure,
    backpack,
    bag,
    grown,
    hat,
    person,
    pushchair,
    skirt,
    stick,
    striding,
    trolley,
    umbrella,
)  # fmt: skip
from toolkit.mesh import Mesh, merge, mirrored, shifted, tube

PEOPLE = ("adult", "child", "pram", "walker", "wheelchair")
_PUSHING = {
    "elbows": ((0.02, 0.14, 0.65), (0.02, -0.14, 0.65)),
    "hands": ((0.20, 0.12, 0.58), (0.20, -0.12, 0.58)),
}


def drawn_person(rng: np.random.Generator) -> tuple[str, Mesh]:
    """Somebody on foot or in a wheelchair and the word for it, facing +x, soles or wheels on z = 0."""
    chance = rng.random()
    if chance < 0.035:
        return "wheelchair", standing(_wheelchair(rng))
    if chance < 0.2:
        height = float(rng.uniform(0.95, 1.55))
        parts = [person(_walking(rng, stout=rng.uniform(0.92, 1.12)), height)]
        parts += [backpack(height)] if rng.random() < 0.3 else []
        return "child", standing(merge(parts))
    height = float(np.clip(rng.normal(1.71, 0.09), 1.48, 2.02))
    if chance < 0.25:
        pushing = replace(_walking(rng), **_PUSHING)  # type: ignore[arg-type]  # pairs by construction
        return "pram", standing(merge([person(pushing, height), grown(pushchair(), float(rng.uniform(0.85, 1.1)))]))
    if chance < 0.27:
        pushing = replace(_walking(rng, lean=0.06), **_PUSHING)  # type: ignore[arg-type]  # pairs by construction
        return "walker", standing(merge([person(pushing, height), _walker(height)]))
    figure = _walking(rng, stout=float(np.clip(rng.normal(1.0, 0.13), 0.8, 1.4)))
    parts = [person(figure, height)]
    wears, carries = rng.random(2)
    if wears < 0.2:
        parts.append(skirt(height, float(rng.uniform(0.1, 0.34)), figure.stout))
    elif wears < 0.28:
        parts.append(hat(height))
    for least, extra in ((0.08, backpack), (0.2, bag), (0.25, umbrella), (0.28, stick)):
        if carries < least:
            parts.append(extra(height))
            break
    else:
        if carries < 0.32:
            parts.append(trolley())
    return "adult", standing(merge(parts))


def drawn_pose(rng: np.random.Generator, stout: float) -> Figure:
    """Somebody who stands: arms hanging or at an ear."""
    figure = replace(Figure(), stout=stout)
    if rng.random() < 0.25:
        elbows, hands = ((0.08, 0.13, 0.66), (0.10, -0.12, 0.68)), ((0.16, 0.05, 0.80), (0.08, -0.07, 0.80))
        figure = replace(figure, elbows=elbows, hands=hands)
    return figure


def standing(mesh: Mesh) -> Mesh:
    """The mesh let down or lifted onto z = 0."""
    return Mesh(mesh.vertices - [0.0, 0.0, mesh.vertices[:, 2].min()], mesh.triangles)


def _walking(rng: np.random.Generator, stout: float | None = None, lean: float | None = None) -> Figure:
    stout = float(rng.uniform(0.85, 1.2)) if stout is None else float(stout)
    if rng.random() < 0.2:
        return drawn_pose(rng, stout)
    lean = float(rng.uniform(0.0, 0.05)) if lean is None else lean
    figure = striding(float(rng.uniform(0.08, 0.45)), float(rng.uniform(0.2, 1.0)), lean, stout)
    return figure if rng.random() < 0.5 else _other_foot(figure)


def _other_foot(figure: Figure) -> Figure:
    """The figure with left and right exchanged."""
    swapped = {
        name: tuple((x, -y, z) for x, y, z in reversed(getattr(figure, name)))
        for name in ("knees", "ankles", "elbows", "hands")
    }
    return replace(figure, **swapped)  # type: ignore[arg-type]  # pairs by construction


def _wheelchair(rng: np.random.Generator) -> Mesh:
    """Somebody seated between two large wheels, sometimes with a companion who pushes."""
    height, radius = float(rng.uniform(1.5, 1.85)), float(rng.uniform(0.27, 0.31))
    half, seat = float(rng.uniform(0.26, 0.31)), float(rng.uniform(0.45, 0.52))
    hip = seat / height + 0.05
    figure = Figure(
        hip=(-0.05, 0.0, hip),
        neck=(-0.07, 0.0, hip + 0.31),
        knees=((0.19, 0.06, hip + 0.02), (0.19, -0.06, hip + 0.02)),
        ankles=((0.26, 0.05, 0.1), (0.26, -0.05, 0.1)),
        elbows=((0.0, 0.16, hip + 0.13), (0.0, -0.16, hip + 0.13)),
        hands=((0.14, 0.13, hip + 0.09), (0.14, -0.13, hip + 0.09)),
        stout=float(rng.uniform(0.9, 1.2)),
    )
    wheels = [wheel_at(-0.08, half, radius, 0.04, 14), wheel_at(0.38, half - 0.05, 0.08, 0.04, 8)]
    chair = [plank((0.42, 1.7 * half, 0.06), 0.0, 0.0, seat - 0.06), plank((0.05, 1.7 * half, 0.45), -0.24, 0.0, seat)]
    parts = [person(figure, height), *wheels, *(mirrored(wheel) for wheel in wheels), *chair]
    if rng.random() < 0.3:
        pushing = replace(_walking(rng), **_PUSHING)  # type: ignore[arg-type]  # pairs by construction
        companion = person(pushing, float(rng.uniform(1.55, 1.85)))
        parts.append(shifted(companion, -0.75))
    return merge(parts)


def _walker(height: float) -> Mesh:
    """A frame on four wheels held in front."""
    legs = [tube([(x, y, 0.05), (0.35, y, 0.52 * height)], 0.015, 5) for x in (0.3, 0.75) for y in (-0.25, 0.25)]
    wheels = [wheel_at(x, y, 0.09, 0.04, 8) for x in (0.3, 0.75) for y in (-0.25, 0.25)]
    return merge([*legs, *wheels, plank((0.25, 0.46, 0.05), 0.5, 0.0, 0.5)])
