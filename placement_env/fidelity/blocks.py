"""Views of sensors on traffic, block by block. Finished blocks are kept, so an interrupted run resumes there."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from placement_env.fidelity.occlusion import Seen
from toolkit.runtime.cache import Cache
from toolkit.runtime.run import Run

Block = tuple[int, int]  # first index of the block, and the first after it


def see_blocks(
    look: Callable[[Block], Seen],
    key: Callable[[Block], bytes],
    blocks: Sequence[Block],
    run: Run,
    progress: Callable[[int], None] | None = None,
) -> list[Seen]:
    """Views of each block, from the run's cache or computed now.

    look, key: view and cache key of a block, picklable; progress: called with the end of each finished block.
    """
    job = _Job(look, key, run.memo)
    kept = {block: found for block in blocks if (found := job.cached(block)) is not None}
    made = run.map(job, [block for block in blocks if block not in kept])
    seen = []
    for block in blocks:
        seen.append(kept[block] if block in kept else next(made))
        if progress:
            progress(block[1])
    return seen


@dataclass(frozen=True, eq=False)
class _Job:
    """View one block, unless it is already cached. The job is sent to every worker."""

    look: Callable[[Block], Seen]
    key: Callable[[Block], bytes]
    cache: Cache | None

    def __call__(self, block: Block) -> Seen:
        if (found := self.cached(block)) is None:
            found = self.look(block)
            if self.cache is not None:
                self.cache.put({self.key(block): found})
        return found

    def cached(self, block: Block) -> Seen | None:
        arrays = None if self.cache is None else self.cache.get([self.key(block)])[0]
        return None if arrays is None else Seen(*arrays)
