"""`Lesson`: a junction as a policy is taught it: what its map says, and what the surrogate says of sets there.

The sets are prefixes of what greedy search chooses, random ones, and those that a policy comes by; of each it is known
what every other candidate would add to it. Beside these, how likely each vehicle is hit by each candidate alone.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np

from placement_env.candidates.outlook.outlook import Outlook, outlook
from placement_env.envs.maps.junctions import Junction
from placement_env.fidelity.surrogate import Surrogate
from placement_env.objective import Objective
from toolkit.arrays import Bool, Float32, Float64, Int64, Shaped
from toolkit.runtime.array_files import read_arrays, write_arrays

RANDOM_SETS = 12
LARGEST_SET = 6  # sensors of a set


@dataclass(frozen=True, eq=False)
class Lesson:
    """channels (Q, 8), view (C, Q, 5), features (C, 10): of `Outlook`, of the used cells; mount: of each candidate;
    kbit: that each sends in a frame; cell: place of each of O vehicles among the used cells; alone: chance that each
    candidate alone hits it; sets: that were scored; ap: of each set with each candidate beside it, NaN where its mount
    is taken."""

    channels: Float32[np.ndarray, "Q channels"]
    view: Shaped[np.ndarray, "C Q 5"]
    features: Float32[np.ndarray, "C features"]
    mount: Int64[np.ndarray, " C"]
    kbit: Float64[np.ndarray, " C"]
    cell: Int64[np.ndarray, " O"]
    alone: Shaped[np.ndarray, "C O"]
    sets: Bool[np.ndarray, "n C"]
    ap: Float32[np.ndarray, "n C"]

    def save(self, path: str | Path) -> None:
        """Write a file, all of it or nothing."""
        write_arrays(path, {field.name: getattr(self, field.name) for field in fields(self)})

    @staticmethod
    def load(path: str | Path) -> Lesson:
        """Read what `save` wrote. Raises FileNotFoundError; ValueError where the file is damaged or another one."""
        arrays, names = read_arrays(path), {field.name for field in fields(Lesson)}
        if arrays.keys() != names:
            raise ValueError(f"{path} must hold {', '.join(sorted(names))}, got {', '.join(sorted(arrays))}")
        return Lesson(**arrays)


def lesson_of(junction: Junction, seed: int) -> Lesson:
    """The lesson of a junction, its sets drawn from `seed`."""
    known = outlook(junction.site, junction.candidates)
    objective = objective_of(junction)
    rng = np.random.default_rng([seed, 8])
    sets = np.unique(np.concatenate([_greedy_sets(objective), _random_sets(junction.candidates.mount, rng)]), axis=0)
    cell, alone = _alone(junction, known, objective)
    ap = next_scores(objective, sets)
    joined = np.isfinite(ap).any(axis=1)  # which sets another candidate may join
    return Lesson(
        channels=known.plan.channels[known.plan.used],
        view=known.view.astype(np.float16),
        features=known.features,
        mount=junction.candidates.mount,
        kbit=objective.sent,
        cell=cell,
        alone=alone.astype(np.float16),
        sets=sets[joined],
        ap=ap[joined],
    )


def objective_of(junction: Junction) -> Objective:
    """AP by the surrogate of the general network at IoU 0.7, early fusion, of whatever is sent."""
    surrogate = Surrogate(junction.visibility, "early", radius=junction.site.hybrid_radius)
    return Objective.of(junction.candidates, surrogate, "early", site=junction.site, visibility=junction.visibility)


def next_scores(objective: Objective, sets: Bool[np.ndarray, "n C"]) -> Float32[np.ndarray, "n C"]:
    """AP of each set with each candidate beside it, NaN where its mount is taken."""
    mount = objective.candidates.mount
    ap = np.full(sets.shape, np.nan, np.float32)
    for row, chosen in enumerate(sets):
        free = np.flatnonzero(~np.isin(mount, mount[chosen]))
        if len(free):
            more = np.repeat(chosen[None], len(free), axis=0)
            more[np.arange(len(free)), free] = True
            ap[row, free] = objective.scored_by(more).ap
    return ap


def _greedy_sets(objective: Objective) -> Bool[np.ndarray, "n C"]:
    """What greedy search has chosen before each of its sensors, whatever links carry."""
    mount, chosen = objective.candidates.mount, np.zeros(len(objective.candidates), np.bool_)
    sets = []
    for _ in range(min(LARGEST_SET, len(np.unique(mount)))):
        sets.append(chosen.copy())
        chosen[int(np.nanargmax(next_scores(objective, chosen[None])[0]))] = True
    return np.array(sets)


def _random_sets(mount: Int64[np.ndarray, " C"], rng: np.random.Generator) -> Bool[np.ndarray, "n C"]:
    """Of 1 to `LARGEST_SET` - 1 candidates, one to a mount, with a mount to spare where there are two."""
    sets = np.zeros((RANDOM_SETS, len(mount)), np.bool_)
    for row in sets:
        members = rng.permutation(len(mount))
        _, first = np.unique(mount[members], return_index=True)
        row[members[np.sort(first)][: rng.integers(1, max(2, min(LARGEST_SET, len(first))))]] = True
    return sets


def _alone(
    junction: Junction, known: Outlook, objective: Objective
) -> tuple[Int64[np.ndarray, " O"], Float32[np.ndarray, "C O"]]:
    """The cell of each vehicle in a used one, and how likely each candidate alone hits it."""
    seen = junction.visibility
    place = np.full(len(known.plan.centres), -1)
    place[known.plan.used] = np.arange(len(known.plan.used))
    at = known.plan.cells_at(seen.boxes[:, :2])
    cell = np.where(at >= 0, place[at], -1)
    surrogate = objective.scored_by
    assert isinstance(surrogate, Surrogate)
    powers, of_size, model, _ = surrogate.evidence()[0]
    raw = np.minimum(seen.points, 1e5) ** model.norm
    return cell[cell >= 0], (model.probability(powers.copy(), raw) * of_size.astype(np.float32))[:, cell >= 0]
