"""From nothing to a map policy: random junctions are prepared, lessons made of them, a network taught by these.

All three are kept in one folder, so what was stopped goes on: a file for each junction, one for each lesson, and a
checkpoint after each pass.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from placement_env.envs.maps.junctions import JUNCTION_FRAMES, JUNCTION_PLACES, POSES, prepare
from placement_env.rl.maps.imitation import Teaching, imitate
from placement_env.rl.maps.lessons import Lesson, lesson_of
from placement_env.rl.maps.map_policy import MapPolicy

LEAST_VEHICLES = 5  # of a lesson, or little can be learned from it


def train_map_policy(
    seeds: Sequence[int],
    out: str | Path,
    *,
    frames: int = JUNCTION_FRAMES,
    places: int = JUNCTION_PLACES,
    poses: int = POSES,
    teaching: Teaching | None = None,
    seed: int = 0,
    progress: Callable[[str, int, int], None] | None = None,
) -> MapPolicy:
    """A policy taught at the random junctions of `seeds`; written to out/policy.safetensors.

    frames, places, poses: of `placement_env.envs.maps.junctions.prepare`; progress: called with a stage ("junctions",
    "passes"), how many are done and of how many. Raises ValueError without seeds, where a file in `out` is damaged or
    of other settings, and where hardly any vehicle is to be seen anywhere.
    """
    folder, teaching = Path(out), teaching or Teaching()
    if not len(seeds):
        raise ValueError("a policy is taught at junctions, got no seeds")
    lessons = []
    for number, junction in enumerate(seeds):
        path = folder / "lessons" / f"{junction:06d}.npz"
        if not path.exists():
            made = prepare(junction, folder / "junctions", frames=frames, places=places, poses=poses)
            path.parent.mkdir(parents=True, exist_ok=True)
            lesson_of(made, junction).save(path)
        lessons.append(Lesson.load(path))
        if progress:
            progress("junctions", number + 1, len(seeds))
    lessons = [lesson for lesson in lessons if len(lesson.cell) > LEAST_VEHICLES]
    passes = teaching.passes
    report = None if progress is None else lambda done, _: progress("passes", done, passes)
    network = imitate(lessons, folder, teaching=teaching, seed=seed, progress=report)
    policy = MapPolicy(network, f"{len(lessons)} random junctions, {passes} passes")
    policy.save(folder / "policy.safetensors")
    return policy
