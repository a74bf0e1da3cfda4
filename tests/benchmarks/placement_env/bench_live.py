"""Time of the live planner's answers at tjunction: six sensors, 60 frames, the pool of 2,363 poses.

python tests/benchmarks/placement_env/bench_live.py [MOVES]   (200) milliseconds, by the clock and
                                                              of processor, of turns, tilts and
                                                              lifts, of the map of what is seen, of
                                                              answers from poles that were never
                                                              used, of suggestions; memory after the
                                                              moves, and after ten times as many;
                                                              how far settled figures are from the
                                                              objective's own score
"""

import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from time import perf_counter, process_time

import numpy as np

from placement_env import LivePlanner
from placement_env.live.seen_map import SeenMaps


def measure(job: Callable[[], object]) -> tuple[float, float]:
    """Seconds by the clock, and of processor."""
    start = perf_counter(), process_time()
    job()
    return perf_counter() - start[0], process_time() - start[1]


def say(what: str, jobs: Sequence[Callable[[], object]]) -> None:
    clock, processor = 1000 * np.percentile([measure(job) for job in jobs], [50, 95, 100], axis=0).T
    for name, (p50, p95, worst) in (("clock", clock), ("processor", processor)):
        print(
            f"{what}, {name}: p50 {p50:.0f}, p95 {p95:.0f}, worst {worst:.0f} ms, of {len(jobs)}",
            flush=True,
        )


def resident() -> int:
    """MB of memory of this process."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * 4096 // 2**20


def main(moves: int = 200) -> None:
    planner, rng = LivePlanner("tjunction"), np.random.default_rng(0)
    planner.finish()
    names = [sensor.name for sensor in planner.sensors]

    def turn(k: int, lift: bool = True) -> object:
        up = rng.uniform(3, 8) if lift else None
        aim = rng.uniform(-np.pi, np.pi), rng.uniform(0, 0.7)
        return planner.move(names[k % len(names)], *aim, up, dragging=True)

    level = [lambda k=k: turn(k, lift=False) for k in range(moves)]  # type: ignore[misc]
    say("a turn and tilt", level)
    for name in names:  # panoramas of all heights, which a page makes while nobody moves anything
        for height in np.arange(3.0, 8.1, 0.5):
            planner.move(name, height=height)
            planner.finish()
    say("a turn, tilt and lift", [lambda k=k: turn(k) for k in range(moves)])  # type: ignore[misc]
    begin = resident()
    for k in range(10 * moves):
        turn(k)
    print(
        f"memory {begin} MB after {moves} moves, {resident()} MB after {10 * moves} more",
        flush=True,
    )
    apart = []
    for _ in range(4):
        for k in range(len(names)):
            turn(k)
        apart.append(abs(planner.finish().ap - planner.score().ap))
    print(
        (
            f"settled AP from the objective's: {np.mean(apart):.5f} in the mean, {max(apart):.5f} "
            "at worst"
        ),
        flush=True,
    )
    maps, stand = SeenMaps(planner.preparation, 1.0), planner.yard.build_sensor

    def draw(k: int) -> None:
        turn(k, lift=k % 2 == 1)
        maps.draw(stand(planner.variant, each) for each in planner.sensors)

    draw(0)
    say("a turn and the map of what is seen", [lambda k=k: draw(k) for k in range(0, 20, 2)])  # type: ignore[misc]
    say("a lift and the map of what is seen", [lambda k=k: draw(k) for k in range(1, 20, 2)])  # type: ignore[misc]
    free = [
        mount.name
        for mount in planner.yard.stock.mounts
        if mount.name not in {s.mount for s in planner.sensors}
    ]
    carried = [
        lambda pole=pole: planner.move("d0", height=5.3, position=pole) for pole in free[:20]
    ]  # type: ignore[misc]
    say("a pole never used, coarse", carried)
    print(
        f"views of the whole stock: {measure(lambda: all(iter(planner.refine, False)))} s",
        flush=True,
    )
    say("the best next sensor", [planner.suggest] * 3)
    say("the best place of one", [lambda: planner.suggest("move", "d1")] * 3)
    say("what to take away", [lambda: planner.suggest("remove")] * 3)


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
