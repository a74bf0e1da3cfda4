"""From nothing to a map policy: junctions are prepared, lessons made of them, a network taught by these, and trained on
by what its answers are worth where that is asked for.

All is kept in one folder, so what was stopped goes on: files for each junction, one for each lesson, and a checkpoint
every minute of training.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache, partial
from pathlib import Path

from placement_env.checks import check_whole
from placement_env.envs.maps.junctions import (
    JUNCTION_FRAMES,
    JUNCTION_PLACES,
    POSES,
    Junction,
    JunctionSource,
    prepare_from,
)
from placement_env.rl.maps.imitation import Teaching, imitate
from placement_env.rl.maps.lessons import Lesson, lesson_of
from placement_env.rl.maps.map_policy import MapPolicy
from placement_env.rl.maps.practice import Practice
from placement_env.rl.maps.reinforcement import Reinforcement, reinforce
from toolkit.runtime.files import write_text
from toolkit.runtime.json_files import read_json
from toolkit.runtime.parallel import spread

LEAST_VEHICLES = 5  # of a lesson, or little can be learned from it
OWN_DRAWS = 4  # of candidates and traffic at each own site
KEPT_COURSES = 256  # junctions in memory
POLICY, IMITATED = "policy.safetensors", "imitated.safetensors"
JUNCTION_SETTINGS = "settings.json"

SchoolProgress = Callable[[str, int, int, dict[str, float]], None]


@dataclass(frozen=True, kw_only=True)
class JunctionFolder:
    """How junctions are prepared, and where they are kept: the settings of
    `placement_env.envs.maps.junctions.prepare`."""

    folder: Path
    frames: int = JUNCTION_FRAMES
    places: int = JUNCTION_PLACES
    poses: int = POSES

    def __post_init__(self) -> None:
        for name, number in self.settings.items():
            check_whole(name, number, least=1)

    @property
    def settings(self) -> dict[str, int]:
        """All but the folder."""
        return {"frames": self.frames, "places": self.places, "poses": self.poses}

    def junction(self, source: JunctionSource) -> Junction:
        """A junction, prepared or read."""
        return prepare_from(source, self.folder, frames=self.frames, places=self.places, poses=self.poses)


def train_map_policy(
    seeds: Sequence[int],
    out: str | Path,
    *,
    sites: Sequence[str | Path] = (),
    draws: int = OWN_DRAWS,
    prepared: str | Path | None = None,
    frames: int = JUNCTION_FRAMES,
    places: int = JUNCTION_PLACES,
    poses: int = POSES,
    teaching: Teaching | None = None,
    reinforcement: Reinforcement | None = None,
    seed: int = 0,
    workers: int = 1,
    progress: SchoolProgress | None = None,
) -> MapPolicy:
    """A policy taught at the random junctions of `seeds` and at own sites; written to out/policy.safetensors.

    sites: files, or names of built-in sites, each with `draws` draws of candidates and traffic; prepared: folder of the
    junctions, out/junctions where it is None; frames, places, poses: of
    `placement_env.envs.maps.junctions.prepare`; reinforcement: how the policy is trained further by rewards, None for
    imitation alone; the imitated one is then in out/imitated.safetensors; workers: processes that prepare; progress:
    called with a stage ("junctions", "passes", "steps"), how many are done, of how many, and figures of the last.
    Raises ValueError without seeds and sites, where a file in `out` is damaged or of other settings, and where hardly
    any vehicle is to be seen anywhere.
    """
    sources = sources_of(seeds, sites, draws)
    if not sources:
        raise ValueError("a policy is taught at junctions, got no seeds and no sites")
    folder, teaching = Path(out), teaching or Teaching()
    place = folder / "junctions" if prepared is None else Path(prepared)
    junctions = JunctionFolder(folder=place, frames=frames, places=places, poses=poses)
    _check_begun(folder, junctions)
    report = progress or (lambda *_: None)
    jobs = spread(partial(make_lesson, junctions, folder / "lessons"), sources, workers=workers)
    taught = []
    for number, (source, path) in enumerate(zip(sources, jobs, strict=True)):
        if len((lesson := Lesson.load(path)).cell) > LEAST_VEHICLES:
            taught.append((source, lesson))
        report("junctions", number + 1, len(sources), {})
    lessons = [lesson for _, lesson in taught]
    network = imitate(
        lessons, folder, teaching=teaching, seed=seed, progress=lambda n, f: report("passes", n, teaching.passes, f)
    )
    policy = MapPolicy(network, f"{described([source for source, _ in taught])}, {teaching.passes} passes")
    if reinforcement is not None:
        policy.save(folder / IMITATED)
        steps = reinforcement.steps
        course = lru_cache(KEPT_COURSES)(lambda number: practised(junctions, *taught[number]))
        network = reinforce(
            network, [partial(course, number) for number in range(len(taught))], folder, settings=reinforcement,
            teaching=teaching, seed=seed, progress=lambda n, f: report("steps", n, steps, f),
        )  # fmt: skip
        policy = MapPolicy(network, f"{policy.source}, {steps} steps by reward")
    policy.save(folder / POLICY)
    return policy


def sources_of(seeds: Sequence[int], sites: Sequence[str | Path], draws: int = OWN_DRAWS) -> list[JunctionSource]:
    """Of random junctions and own sites. Raises ValueError where one is there twice."""
    check_whole("draws", draws, least=1)
    sources = [JunctionSource.of_seed(each) for each in seeds]
    sources += [JunctionSource.of_site(site, draw) for site in sites for draw in range(draws)]
    names = [source.name for source in sources]
    if len(set(names)) < len(names):
        again = next(name for name in names if names.count(name) > 1)
        raise ValueError(f"junctions must differ, {again} is there twice: leave one of them out")
    return sources


def described(sources: Sequence[JunctionSource]) -> str:
    """How many junctions of which kind.

    >>> described([JunctionSource("000001", 1), JunctionSource("mine", 0, "{}")])
    '1 random junctions, 1 own'
    """
    own = sum(bool(source.drawing) for source in sources)
    return f"{len(sources) - own} random junctions" + (f", {own} own" if own else "")


def make_lesson(junctions: JunctionFolder, folder: Path, source: JunctionSource) -> Path:
    """The file of a lesson, made where it is missing."""
    path = folder / f"{source.name}.npz"
    if not path.exists():
        made = junctions.junction(source)
        path.parent.mkdir(parents=True, exist_ok=True)
        lesson_of(made, source.seed).save(path)
    return path


def practised(junctions: JunctionFolder, source: JunctionSource, lesson: Lesson) -> tuple[Practice, Lesson]:
    """What a policy learns from at a junction by rewards, with its lesson."""
    return Practice.of(junctions.junction(source), lesson), lesson


def _check_begun(folder: Path, junctions: JunctionFolder) -> None:
    """Raise ValueError where lessons of other settings are in a folder."""
    path = folder / JUNCTION_SETTINGS
    if not path.exists():
        write_text(path, json.dumps(junctions.settings) + "\n")
    elif (begun := read_json(path)) != junctions.settings:
        raise ValueError(
            f"{path} is of other lessons, {json.dumps(begun)} and not {json.dumps(junctions.settings)}: choose "
            "another folder or remove it with the lessons"
        )
