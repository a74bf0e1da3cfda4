"""People drawn at random, on foot or in a wheelchair."""

from dataclasses import replace

import numpy as np

from toolkit.arrays import Rng
from toolkit.bodies import people
from toolkit.bodies.figures import Figure, Pair, pair, person, phone, push, striding
from toolkit.bodies.mesh_parts import DrawnMesh, plank
from toolkit.bodies.wheels import make_wheel
from toolkit.mesh import Mesh, flip_sides, merge, place, scale_mesh, stand, tube

PEOPLE = ("adult", "child", "pram", "walker", "wheelchair")
PHONING_SHARE = 0.25
# Draws below these limits are a wheelchair, child, pram, walker or adult: in the street, and evenly
WHEELCHAIR_LIMIT = 0.035
CHILD_LIMIT = 0.2
PRAM_LIMIT = 0.25
WALKER_LIMIT = 0.27
STREET_LIMITS = (0.0, WHEELCHAIR_LIMIT, CHILD_LIMIT, PRAM_LIMIT, WALKER_LIMIT, 1.0)
EVEN_LIMITS = (0.0, 0.13, 0.35, 0.62, 0.7, 1.0)

# burden of a person whose random number is below the limit, and above the limit before
_BURDENS = {
    0.08: people.backpack,
    0.2: people.bag,
    0.25: people.umbrella,
    0.28: people.stick,
    0.32: people.trolley,
}


def draw_person(rng: Rng, evenly: bool = False) -> DrawnMesh:
    """Draw a person, facing +x, soles or wheels on z = 0.

    evenly: rare kinds are drawn nearly as often as adults, instead of as often as in the street."""
    chance = rng.random()
    if evenly:  # move the limits between kinds from even shares to the shares in the street
        chance = float(np.interp(chance, EVEN_LIMITS, STREET_LIMITS))
    if chance < WHEELCHAIR_LIMIT:
        return DrawnMesh("wheelchair", stand(_draw_wheelchair(rng)))
    if chance < CHILD_LIMIT:
        return DrawnMesh("child", stand(_draw_child(rng)))
    height = float(np.clip(rng.normal(1.71, 0.09), 1.48, 2.02))
    if chance < PRAM_LIMIT:
        return DrawnMesh("pram", stand(_draw_pram(height, rng)))
    if chance < WALKER_LIMIT:
        return DrawnMesh("walker", stand(_draw_walker(height, rng)))
    return DrawnMesh("adult", stand(_draw_adult(height, rng)))


def _draw_child(rng: Rng) -> Mesh:
    """Draw a child, sometimes with a rucksack."""
    height = float(rng.uniform(0.95, 1.55))
    parts = [person(_draw_walking(rng, stout=rng.uniform(0.92, 1.12)), height)]
    if rng.random() < 0.3:
        parts.append(people.backpack(height))
    return merge(parts)


def _draw_pram(height: float, rng: Rng) -> Mesh:
    """Draw a person of a height (m) with a pushchair."""
    pushing_person = person(push(_draw_walking(rng)), height)
    pushchair = scale_mesh(people.pushchair(height), float(rng.uniform(0.85, 1.1)))
    return merge([pushing_person, pushchair])


def _draw_walker(height: float, rng: Rng) -> Mesh:
    """Draw a person of a height (m) with a wheeled walker."""
    # x, y (m) of the feet of the walker's four legs, which lean towards its seat; each has a wheel
    feet = [(x, y) for x in (0.3, 0.75) for y in (-0.25, 0.25)]
    legs = [tube([(x, y, 0.05), (0.35, y, 0.52 * height)], radii=0.015, sides=5) for x, y in feet]
    wheels = [make_wheel(x, y, radius=0.09, breadth=0.04, sides=8) for x, y in feet]
    pushing_person = person(push(_draw_walking(rng, lean=0.06)), height)
    seat = plank((0.25, 0.46, 0.05), x=0.5, y=0.0, z=0.5)
    return merge([pushing_person, *legs, *wheels, seat])


def _draw_adult(height: float, rng: Rng) -> Mesh:
    """Draw an adult of a height (m), with clothes and a burden or without."""
    figure = _draw_walking(rng, stout=float(np.clip(rng.normal(1.0, 0.13), 0.8, 1.4)))
    parts = [person(figure, height)]
    clothes_chance, burden_chance = rng.random(2)
    if clothes_chance < 0.2:
        parts.append(people.skirt(height, float(rng.uniform(0.1, 0.34)), figure.stout))
    elif clothes_chance < 0.28:
        parts.append(people.hat(height))
    # `_BURDENS`: limits of the chance in increasing order, and the function that makes each burden;
    # the first limit above the chance decides
    burden_makers = [make for limit, make in _BURDENS.items() if burden_chance < limit]
    if burden_makers:
        make_burden = burden_makers[0]
        parts.append(make_burden(height))
    return merge(parts)


def draw_pose(rng: Rng, stout: float) -> Figure:
    """Draw a figure without a step: arms at the sides, or one hand at an ear.

    stout: breadth of trunk and limbs relative to an average adult."""
    figure = Figure(stout=stout)
    return phone(figure) if rng.random() < PHONING_SHARE else figure


def _draw_walking(rng: Rng, stout: float | None = None, lean: float | None = None) -> Figure:
    """Draw the figure of a person in mid-stride, or without a step.

    stout: breadth relative to an average adult; lean: how far the neck is in front of the hips, as
    a part of the height; both None to draw them."""
    stout = float(rng.uniform(0.85, 1.2)) if stout is None else float(stout)
    if rng.random() < 0.2:
        return draw_pose(rng, stout)
    lean = float(rng.uniform(0.0, 0.05)) if lean is None else lean
    figure = striding(
        float(rng.uniform(0.08, 0.45)), swing=float(rng.uniform(0.2, 1.0)), lean=lean, stout=stout
    )
    return figure if rng.random() < 0.5 else _mirror_figure(figure)


def _mirror_figure(figure: Figure) -> Figure:
    """Figure with left and right exchanged."""
    return replace(
        figure,
        knees=_mirror_pair(figure.knees),
        ankles=_mirror_pair(figure.ankles),
        elbows=_mirror_pair(figure.elbows),
        hands=_mirror_pair(figure.hands),
    )


def _mirror_pair(joints: Pair) -> Pair:
    """Mirror a left and a right joint: each becomes the other side's."""
    (x, y, z), (right_x, right_y, right_z) = joints
    return (right_x, -right_y, right_z), (x, -y, z)


def _draw_wheelchair(rng: Rng) -> Mesh:
    """Draw a person in a wheelchair with two large and two small wheels, sometimes pushed."""
    height = float(rng.uniform(1.5, 1.85))  # the person's when standing (m)
    wheel_radius = float(rng.uniform(0.27, 0.31))
    half_width = float(rng.uniform(0.26, 0.31))  # the chair's (m)
    seat = float(rng.uniform(0.45, 0.52))  # height (m)
    hip = seat / height + 0.05
    figure = Figure(  # joints: x, y, z in parts of the height
        hip=(-0.05, 0.0, hip),
        neck=(-0.07, 0.0, hip + 0.31),
        knees=pair(0.19, 0.06, hip + 0.02),
        ankles=pair(0.26, 0.05, 0.1),
        elbows=pair(0.0, 0.16, hip + 0.13),
        hands=pair(0.14, 0.13, hip + 0.09),
        stout=float(rng.uniform(0.9, 1.2)),
    )
    # x and y, of the left side
    wheels = [
        make_wheel(-0.08, half_width, radius=wheel_radius, breadth=0.04, sides=14),
        make_wheel(0.38, half_width - 0.05, radius=0.08, breadth=0.04, sides=8),
    ]
    # seat and back; sizes: length, width, height (m)
    chair = [
        plank((0.42, 1.7 * half_width, 0.06), x=0.0, y=0.0, z=seat - 0.06),
        plank((0.05, 1.7 * half_width, 0.45), x=-0.24, y=0.0, z=seat),
    ]
    right_wheels = [flip_sides(wheel) for wheel in wheels]
    parts = [person(figure, height), *wheels, *right_wheels, *chair]
    if rng.random() < 0.3:
        pushing_figure = push(_draw_walking(rng))
        pushing_person = person(pushing_figure, float(rng.uniform(1.55, 1.85)))
        parts.append(place(pushing_person, x=-0.75))
    return merge(parts)
