"""Views of sensors on traffic, block by block.

Each block is kept when it is done, so an interrupted run resumes there.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

from placement_env.fidelity.occlusion import Seen
from toolkit.runtime.cache import Cache
from toolkit.runtime.run import Run

Block = tuple[int, int]  # first index of the block, and the first after it


@runtime_checkable
class BlockView(Protocol):
    """View of a block, as a picklable callable."""

    def __call__(self, block: Block, /) -> Seen:
        """View of a block."""
        ...

    def key(self, block: Block) -> bytes:
        """Cache key of a block."""
        ...


def see_blocks(
    look: BlockView, blocks: Sequence[Block], run: Run, progress: Callable[[int], None] | None = None
) -> list[Seen]:
    """Views of each block.

    They come from the run's cache where an earlier call kept them, else they are computed now. progress: called with
    the end of each finished block.
    """
    job = _Job(look, run.memo)
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

    look: BlockView
    cache: Cache | None

    def __call__(self, block: Block) -> Seen:
        found = self.cached(block)
        if found is None:
            found = self.look(block)
            if self.cache is not None:
                self.cache.put({self.look.key(block): found})
        return found

    def cached(self, block: Block) -> Seen | None:
        """Result of an earlier call. None where it is missing or damaged."""
        arrays = None if self.cache is None else self.cache.get([self.look.key(block)])[0]
        return None if arrays is None else Seen(*arrays)
