"""Simulate crowds: the recordings, denser than any junction, that the shipped site weights were
last trained on.

    python tests/benchmarks/models/make_crowds.py tjunction crowds.hdf5 [--frames 900] [--seed 1]
        [--most 60] [--pedestrians 0.55] [--cyclists 0.35] [--prams 0.27]

Nine in ten road users stand anywhere, nearly half of them in company, from 5 cm apart. One in three
bicycles are children's, two in five two-wheelers e-scooters. No command of coview makes such
traffic: what is rare is common here.
"""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[3]))

CHILDREN, E_SCOOTERS = 0.35, 0.42


def crowd(pedestrians: float, cyclists: float, prams: float) -> None:
    """Change the traffic of this process."""
    from toolkit.bodies import drawn_bodies, drawn_people, drawn_two_wheelers, fleet
    from toolkit.mesh import stand
    from toolkit.objects import CYCLIST, HEAVY, PEDESTRIAN, VEHICLE
    from toolkit.traffic import obstacles, strays

    strays.STRAY_SHARES = {PEDESTRIAN: pedestrians, CYCLIST: cyclists, VEHICLE: 0.05, HEAVY: 0.03}
    strays.COMPANION_SHARE, strays.MIN_STRAY_GAP_M, obstacles.BODY_GAP_M = 0.45, 0.1, 0.05
    more = {VEHICLE: 0.7, HEAVY: 0.7, CYCLIST: 2.8, PEDESTRIAN: 2.8}
    fleet.SPAWN_COUNTS = {
        label: (int(n * more[label]), per * more[label])
        for label, (n, per) in fleet.SPAWN_COUNTS.items()
    }
    children = 0.1 + 0.45 * (0.9 - prams)
    drawn_people.EVEN_LIMITS = (0.0, 0.1, children, children + prams, children + prams + 0.06, 1.0)

    class Childish:
        """Generator whose first draw, which makes a child's bicycle of it, is low more often."""

        def __init__(self, rng):
            self.rng, self.first = rng, True

        def random(self, *size):
            share, self.first = (0.12 / CHILDREN if self.first else 1.0), False
            return self.rng.random(*size) * share

        def __getattr__(self, name):
            return getattr(self.rng, name)

    def draw_two_wheeler(rng, evenly=False):
        kinds = (
            drawn_two_wheelers.draw_bicycle,
            drawn_two_wheelers.draw_e_scooter,
            drawn_two_wheelers.draw_motorcycle,
            drawn_two_wheelers.draw_scooter,
        )
        draw = kinds[int(rng.choice(4, p=(0.92 - E_SCOOTERS, E_SCOOTERS, 0.04, 0.04)))]
        drawn = draw(Childish(rng) if draw is drawn_two_wheelers.draw_bicycle else rng)
        return drawn._replace(mesh=stand(drawn.mesh))

    vars(drawn_bodies)["draw_two_wheeler"] = draw_two_wheeler


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("site")
    parser.add_argument("out", type=Path)
    for name, default in (("frames", 900), ("seed", 1), ("most", 60)):
        parser.add_argument(f"--{name}", type=int, default=default)
    for name, share in (("pedestrians", 0.55), ("cyclists", 0.35), ("prams", 0.27)):
        parser.add_argument(f"--{name}", type=float, default=share)
    asked = parser.parse_args(arguments)
    crowd(asked.pedestrians, asked.cyclists, asked.prams)

    from toolkit.bodies.fleet import fleet_named
    from toolkit.datasets.simulation import simulate_dataset
    from toolkit.runtime.run import Simulation
    from toolkit.traffic.snapshots import Mix

    # other processes would not know of the crowd
    run = Simulation(frames=asked.frames, seed=asked.seed, workers=1)
    mix = Mix(most=asked.most, parked=5, strays=0.9)
    simulate_dataset(asked.site, asked.out, run=run, fleet=fleet_named("even"), mix=mix)


if __name__ == "__main__":
    main()
