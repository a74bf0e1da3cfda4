"""`coview teach`: train a policy for `coview propose`, and say how it compares to greedy search."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path

from coview.arguments import check_least
from coview.exits import OK
from coview.outputs import check_writable
from coview.printing import print_result
from coview.progress_bar import progress_bar


def teach(
    *,
    out: Path,
    junctions: int = 300,
    first: int = 0,
    sites: tuple[str, ...] = (),
    draws: int = 4,
    prepared: Path | None = None,
    frames: int = 16,
    places: int = 12,
    poses: int = 24,
    passes: int = 30,
    reinforce: int = 0,
    held_out: int = 20,
    held_out_first: int = 30000,
    held_out_sites: tuple[str, ...] = (),
    budgets: tuple[int, ...] = (2, 3, 4),
    seed: int = 0,
    workers: int = 1,
    json: bool = False,
) -> int:
    """Train a policy for coview propose at random junctions and at your own sites. Killed at any moment and started
    again it goes on, to the same weights.

    It is taught by the surrogate's scores there (imitation of greedy search), and with --reinforce trained further by
    what the sets that it draws itself are worth. Then it is tried at junctions that it was not taught, beside greedy.

    Example: coview teach --out runs/policy --junctions 300 --sites mine.json --reinforce 2000

    Args:
        out: Folder for lessons, checkpoints and policy.safetensors.
        junctions: Random junctions that it is taught.
        first: Seed of the first; the others follow.
        sites: Own site files beside them, or names of built-in sites.
        draws: Of other candidates and other traffic at each own site.
        prepared: Folder where prepared junctions are kept, to share them; OUT/junctions when left out.
        frames: Of traffic at each junction.
        places: Poles at each junction that are drawn as candidates.
        poses: Poses of sensors that are drawn at each.
        passes: Of imitation over all lessons.
        reinforce: Steps of reinforcement learning after imitation, at one junction each.
        held_out: Random junctions that it is tried at.
        held_out_first: Seed of the first.
        held_out_sites: Own sites that it is tried at.
        budgets: Sensors to place there.
        seed: Of weights and order.
        workers: Processes that prepare junctions.
        json: Print as JSON.
    """
    from placement_env.rl.maps.held_out import compared, tables
    from placement_env.rl.maps.school_plan import SchoolPlan, teach_and_try

    for option, value, least in (
        ("--junctions", junctions, 0), ("--first", first, 0), ("--reinforce", reinforce, 0),
        ("--held-out", held_out, 0), ("--held-out-first", held_out_first, 0), ("--workers", workers, 1),
    ):  # fmt: skip
        check_least(option, value, least)
    check_writable(out.resolve(), out)
    plan = SchoolPlan(
        out=out, seeds=range(first, first + junctions), sites=sites, draws=draws, prepared=prepared, frames=frames,
        places=places, poses=poses, passes=passes, steps=reinforce, budgets=budgets, seed=seed, workers=workers,
        held_out_seeds=range(held_out_first, held_out_first + held_out), held_out_sites=held_out_sites,
    )  # fmt: skip
    with progress_bar("", hidden=json) as bar:

        def report(stage: str, done: int, total: int, figures: dict[str, float]) -> None:
            bar.stage(stage, done, total)
            bar.figures(figures)

        path, source, rows = teach_and_try(plan, progress=report)
    means = compared(rows)
    lines = [f"{path}: taught at {source}", *tables(means)]
    result = {"policy": str(path), "source": source, "held_out": [asdict(each) for each in means]}
    print_result(result, "\n".join(lines), as_json=json)
    return OK
