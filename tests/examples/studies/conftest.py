"""Recordings of these tests are short: their intervals are plain percentiles, whatever the number
of blocks."""

import pytest

from placement_env.analysis import intervals


@pytest.fixture(autouse=True, scope="module")
def _intervals_of_few_blocks():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(intervals, "count_blocks", lambda frames: float("inf"))
        patch.setattr(intervals, "BLOCK_FRAMES", 4)
        yield
