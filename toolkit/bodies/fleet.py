"""Fleets: bodies that traffic may use, from the catalogue, drawn, or from meshes."""

from dataclasses import dataclass
from functools import lru_cache
from itertools import cycle, islice
from pathlib import Path

from toolkit.arrays import Rng
from toolkit.bodies.body import Body, include_mirrors, make_body, make_boxed_body
from toolkit.bodies.catalogue_cars import CAR_NAMES, cars
from toolkit.bodies.catalogue_trucks import trucks
from toolkit.bodies.drawn_bodies import draw_body, possible_names
from toolkit.bodies.meshes import TakenMesh, take_meshes
from toolkit.bodies.people import pedestrians
from toolkit.bodies.two_wheelers import two_wheelers
from toolkit.objects import CYCLIST, HEAVY, LABELS, PEDESTRIAN, VEHICLE

HELD_OUT = CAR_NAMES[-5:]  # cars that no shipped detector has been trained on
FLEETS = ("catalogue", "own", "even", "meshes", "both")
LARGEST_DRAW = 60  # frames that a draw of bodies is enough for; in longer traffic they come again

# For each class the number of objects spawned at first, and per frame (30 objects, each seen in
# four frames), some to spare.
SPAWN_COUNTS = {VEHICLE: (26, 3.9), CYCLIST: (12, 1.4), PEDESTRIAN: (18, 2.2), HEAVY: (6, 0.5)}


def catalogue(meshes: str | Path | None = None, held_out: bool = False) -> tuple[Body, ...]:
    """Bodies of the catalogue: cars, two-wheelers, pedestrians, trucks, buses, then those of a
    folder of meshes.

    meshes: folder of mesh files, None for no more bodies; held_out: take the five cars of
    `HELD_OUT` in place of all others, to test on bodies never trained on."""
    bodies = []
    for body in _procedural():
        is_other_car = body.label == VEHICLE and (body.name in HELD_OUT) != held_out
        if not is_other_car:
            bodies.append(body)
    if meshes is not None:
        bodies += [taken.body for taken in take_meshes(meshes)]
    return tuple(bodies)


@dataclass(frozen=True, eq=False)
class Fleet:
    """Bodies of traffic: fixed ones, drawn ones, or both."""

    fixed: tuple[Body, ...] = ()  # the same in every recording
    # class numbers for which bodies are drawn; a class with fixed bodies too has half of each
    drawn: tuple[int, ...] = ()
    mirrors: bool = (
        False  # count wing mirrors into the boxes of drawn bodies, which end at the body otherwise
    )
    # rare kinds of people and two-wheelers are drawn hardly more seldom than adults and bicycles
    evenly: bool = False
    notes: tuple[str, ...] = ()  # a line on how each mesh of a folder was taken

    @property
    def names(self) -> tuple[str, ...]:
        """Names of all possible bodies, the fixed ones first."""
        return tuple(body.name for body in self.fixed) + (possible_names() if self.drawn else ())

    def bodies(self, frames: int, rng: Rng) -> tuple[Body, ...]:
        """Bodies for `frames` frames of traffic, class after class.

        Enough are drawn to use each once, but for no more than `LARGEST_DRAW` frames. A class that
        is half fixed repeats its fixed bodies to make up the other half."""
        if not self.drawn:
            return self.fixed
        bodies: list[Body] = []
        for label in range(len(LABELS)):
            fixed_bodies = [body for body in self.fixed if body.label == label]
            at_first, per_frame = SPAWN_COUNTS[label]
            needed_count = at_first + round(per_frame * min(frames, LARGEST_DRAW))
            drawn_count = 0
            if label in self.drawn:
                drawn_count = needed_count // 2 if fixed_bodies else needed_count
            for _ in range(drawn_count):
                body = draw_body(label, rng, self.evenly)
                bodies.append(include_mirrors(body) if self.mirrors else body)
            if fixed_bodies:  # each at least once, and again from the first
                fixed_count = max(needed_count - drawn_count, len(fixed_bodies))
                bodies += islice(cycle(fixed_bodies), fixed_count)
        return tuple(bodies)


def fleet_named(
    name: str | None = None,
    meshes: str | Path | None = None,
    *,
    held_out: bool = False,
    mirrors: bool = False,
) -> Fleet:
    """Find one of `FLEETS` by name.

    own: all bodies drawn; even: likewise, but with many prams and e-scooters, to learn from;
    catalogue: our 47 bodies and any meshes; meshes: those of the folder, and drawn ones for the
    other classes; both: half drawn, half from the folder, class by class; None: own, but meshes if
    a folder is given and catalogue if held-out cars are asked for. held_out: take only the five
    cars of the catalogue that no network was trained on; mirrors: count wing mirrors into ground
    truth boxes, also of meshes where they are seen to stick out.

    Raises ValueError for another name, a folder missing or given in vain, and arguments that
    exclude each other."""
    if name is None:
        name = "own" if meshes is None else "meshes"
        if held_out:
            name = "catalogue"
    if name not in FLEETS:
        raise ValueError(f"fleet must be one of {', '.join(FLEETS)}, got {name!r}")
    if held_out and name != "catalogue":
        raise ValueError(
            f"held-out cars are of the catalogue, got fleet {name!r}: choose one or the other"
        )
    if name in ("own", "even"):
        if meshes is not None:
            raise ValueError(
                f"fleet {name!r} takes no meshes, got {meshes}: choose the fleet 'meshes' or 'both'"
            )
        return Fleet(drawn=tuple(range(len(LABELS))), mirrors=mirrors, evenly=name == "even")
    if meshes is None and name != "catalogue":
        raise ValueError(f"fleet {name!r} needs a folder of meshes, got none: give one")
    loaded: tuple[TakenMesh, ...] = ()
    if meshes is not None:
        loaded = take_meshes(meshes, mirrors=mirrors)
    bodies = tuple(mesh.body for mesh in loaded)
    notes = tuple(f"{mesh.file}: {mesh.how}" for mesh in loaded)
    if name == "catalogue":
        catalogue_bodies = tuple(
            include_mirrors(body) if mirrors else body for body in catalogue(held_out=held_out)
        )
        return Fleet(catalogue_bodies + bodies, (), mirrors, notes=notes)
    mesh_labels = {body.label for body in bodies} if name == "meshes" else set()
    return Fleet(
        bodies,
        tuple(label for label in range(len(LABELS)) if label not in mesh_labels),
        mirrors,
        notes=notes,
    )


@lru_cache(maxsize=1)
def _procedural() -> tuple[Body, ...]:
    """Bodies of the catalogue in the order of their classes, made once.

    Mirrors of cars and trucks count as outside their boxes."""
    bodies = []
    for label, vehicles in ((VEHICLE, cars()), (HEAVY, trucks())):
        for name, (mesh, mirrors) in vehicles.items():
            bodies.append(make_boxed_body(name, label, mesh, outside=mirrors))
    for label, road_users in ((CYCLIST, two_wheelers()), (PEDESTRIAN, pedestrians())):
        for name, mesh in road_users.items():
            bodies.append(make_body(name, label, mesh.vertices, mesh.triangles))
    return tuple(sorted(bodies, key=lambda body: body.label))
