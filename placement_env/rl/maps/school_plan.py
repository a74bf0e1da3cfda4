"""`SchoolPlan`: a policy as the command line asks for it: what it is taught, how, and what it is tried at."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from placement_env.checks import check_whole
from placement_env.envs.maps.junctions import JUNCTION_FRAMES, JUNCTION_PLACES, POSES, JunctionSource
from placement_env.rl.maps.held_out import HELD_OUT_BUDGETS, HeldOut, tried_at
from placement_env.rl.maps.imitation import Teaching
from placement_env.rl.maps.map_policy import MapPolicy
from placement_env.rl.maps.reinforcement import Reinforcement
from placement_env.rl.maps.schooling import (
    IMITATED,
    OWN_DRAWS,
    POLICY,
    JunctionFolder,
    SchoolProgress,
    sources_of,
    train_map_policy,
)


@dataclass(frozen=True, kw_only=True)
class SchoolPlan:
    """seeds, sites, draws, prepared, frames, places, poses, seed, workers: as of
    `placement_env.rl.maps.schooling.train_map_policy`; passes: of imitation; steps: of reinforcement after it, 0 for
    none; held_out_seeds, held_out_sites: of the junctions that the policies are tried at; budgets: sensors there.

    Raises ValueError for settings that do not fit, and where a junction would be taught and held out."""

    out: Path
    seeds: Sequence[int] = ()
    sites: Sequence[str | Path] = ()
    draws: int = OWN_DRAWS
    prepared: Path | None = None
    frames: int = JUNCTION_FRAMES
    places: int = JUNCTION_PLACES
    poses: int = POSES
    passes: int = Teaching().passes
    steps: int = 0
    held_out_seeds: Sequence[int] = ()
    held_out_sites: Sequence[str | Path] = ()
    budgets: Sequence[int] = HELD_OUT_BUDGETS
    seed: int = 0
    workers: int = 1

    def __post_init__(self) -> None:
        for name, least in (("passes", 1), ("steps", 0), ("workers", 1), ("seed", 0)):
            check_whole(name, getattr(self, name), least=least)
        for budget in self.budgets:
            check_whole("budget", budget, least=1)
        both = {source.name for source in self.taught} & {source.name for source in self.held_out}
        if both:
            raise ValueError(f"junctions that are taught cannot be held out, {min(both)} is both: choose other ones")

    @property
    def taught(self) -> list[JunctionSource]:
        """What the policy is taught at."""
        return sources_of(self.seeds, self.sites, self.draws)

    @property
    def held_out(self) -> list[JunctionSource]:
        """What it is tried at."""
        return sources_of(self.held_out_seeds, self.held_out_sites, self.draws)

    @property
    def folder(self) -> JunctionFolder:
        """Where junctions are kept, and how they are prepared."""
        folder = self.out / "junctions" if self.prepared is None else self.prepared
        return JunctionFolder(folder=folder, frames=self.frames, places=self.places, poses=self.poses)


def teach_and_try(plan: SchoolPlan, *, progress: SchoolProgress | None = None) -> tuple[Path, str, list[HeldOut]]:
    """The file of a policy, what it was taught, and what it reaches at the junctions held out, beside greedy search and
    the shipped policy. progress: as of `placement_env.rl.maps.schooling.train_map_policy`."""
    reinforcement = Reinforcement(steps=plan.steps) if plan.steps else None
    policy = train_map_policy(
        plan.seeds, plan.out, sites=plan.sites, draws=plan.draws, prepared=plan.prepared, frames=plan.frames,
        places=plan.places, poses=plan.poses, teaching=Teaching(passes=plan.passes), reinforcement=reinforcement,
        seed=plan.seed, workers=plan.workers, progress=progress,
    )  # fmt: skip
    policies = {"shipped": MapPolicy.load()}
    if reinforcement is None:
        policies["taught"] = policy
    else:
        policies |= {"taught": MapPolicy.load(plan.out / IMITATED), "reinforced": policy}
    rows = tried_at(plan.held_out, plan.folder, policies, budgets=plan.budgets, progress=progress)
    return plan.out / POLICY, policy.source, rows
