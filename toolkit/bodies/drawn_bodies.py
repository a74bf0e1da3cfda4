"""Bodies drawn at random for a class: cars, heavy vehicles, two-wheelers and people.

The ground truth box of a drawn vehicle is the body without its wing mirrors, which stick out of it
by 8 to 25 cm (`toolkit.bodies.body.include_mirrors` gives the other convention). Roof signs, roof
boxes, racks, loads and spare wheels belong to the box, and so does a trailer, which makes a car an
articulated heavy vehicle: straight, as a body is rigid."""

from toolkit.arrays import Rng
from toolkit.bodies.body import Body, make_boxed_body
from toolkit.bodies.car_extras import CARRIED, draw_load, draw_mirrors
from toolkit.bodies.car_shapes import CAR_KINDS, build_block_car, draw_proportions, loft_car
from toolkit.bodies.drawn_buses import BUSES, draw_bus
from toolkit.bodies.drawn_people import PEOPLE, draw_person
from toolkit.bodies.drawn_trucks import SUPERSTRUCTURES, draw_semi_trailer, draw_truck
from toolkit.bodies.drawn_two_wheelers import TWO_WHEELERS, draw_two_wheeler
from toolkit.bodies.mesh_parts import DrawnMesh
from toolkit.bodies.trailers import TRAILERS, draw_trailer
from toolkit.mesh import merge
from toolkit.objects import CYCLIST, HEAVY, LABELS, PEDESTRIAN, VEHICLE, label_index

BLOCK_CAR_SHARE = 0.25  # share of cars that are built of blocks
TOWING_SHARE = 0.1  # share of heavy vehicles that are cars with a trailer
HEAVY_SHARES = (0.55, 0.17, 0.28)  # trucks, articulated trucks and buses of the others


def draw_body(label: int | str, rng: Rng, evenly: bool = False) -> Body:
    """Draw a body of a class; its name gives class and kind, such as "vehicle/estate".

    label: number or name of the class (`LABELS`); evenly: True to draw rare kinds of people nearly
    as often as adults."""
    label = label_index(label)
    drawn = _draw_mesh(label, rng, evenly)
    return make_boxed_body(f"{LABELS[label]}/{drawn.kind}", label, drawn.mesh, drawn.outside)


def _draw_mesh(label: int, rng: Rng, evenly: bool) -> DrawnMesh:
    """Draw a mesh of a class, by the class number.

    evenly: rare kinds of people and two-wheelers are drawn nearly as often as the usual ones."""
    if label == VEHICLE:
        return _draw_car(rng)
    if label == HEAVY:
        # a car counts as heavy with its trailer
        return _draw_towing_car(rng) if rng.random() < TOWING_SHARE else draw_heavy(rng)
    if label == PEDESTRIAN:
        return draw_person(rng, evenly)
    return draw_two_wheeler(rng, evenly)


def _draw_car(rng: Rng) -> DrawnMesh:
    """Draw a car: lofted, with or without a load, or built of blocks."""
    shape = draw_proportions(rng)
    if rng.random() < BLOCK_CAR_SHARE:
        block_car = build_block_car(shape, rng)
        return DrawnMesh(f"block_{shape.kind}", block_car, outside=draw_mirrors(shape, rng))
    load_kind, load = draw_load(shape, rng)
    kind = f"{shape.kind}_{load_kind}" if load_kind else shape.kind
    return DrawnMesh(kind, merge([loft_car(shape), load]), outside=draw_mirrors(shape, rng))


def _draw_towing_car(rng: Rng) -> DrawnMesh:
    """Draw a car with a trailer, straight behind it."""
    shape = draw_proportions(rng)
    trailer_kind, trailer = draw_trailer(shape, rng)
    mesh = merge([loft_car(shape), trailer])
    return DrawnMesh(f"{shape.kind}_with_{trailer_kind}", mesh, outside=draw_mirrors(shape, rng))


def draw_heavy(rng: Rng) -> DrawnMesh:
    """Draw a truck, an articulated truck or a bus. x forward, wheels on z = 0."""
    draw = (draw_truck, draw_semi_trailer, draw_bus)[int(rng.choice(3, p=HEAVY_SHARES))]
    return draw(rng)


def possible_names() -> tuple[str, ...]:
    """Names that drawn bodies may have: class and kind, such as "vehicle/van"."""
    cars = [kind.name for kind in CAR_KINDS]
    towing_cars = [f"{car}_with_{trailer}" for car in cars for trailer in TRAILERS]
    trucks = [f"{load}_truck" for load in SUPERSTRUCTURES]
    trucks += [f"articulated_{load}" for load in SUPERSTRUCTURES]
    loaded_cars = [f"{car}_{load}" for car in cars for load in CARRIED]
    block_cars = [f"block_{car}" for car in cars]
    kinds = {  # by class number
        VEHICLE: [*cars, *block_cars, *loaded_cars],
        CYCLIST: TWO_WHEELERS,
        PEDESTRIAN: PEOPLE,
        HEAVY: [*trucks, *BUSES, *towing_cars],
    }
    return tuple(f"{LABELS[label]}/{name}" for label, names in kinds.items() for name in names)
