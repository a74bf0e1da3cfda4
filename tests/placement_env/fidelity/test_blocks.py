"""What is seen block by block: order, what is kept, and what processes are spared."""

from dataclasses import dataclass, field

import numpy as np

from placement_env.fidelity.blocks import see_blocks
from placement_env.fidelity.occlusion import Seen
from toolkit.runtime.cache import make_key
from toolkit.runtime.run import Run


@dataclass
class Numbers:
    """Sees the numbers of a block, and remembers which it was asked for."""

    asked: list = field(default_factory=list)

    def __call__(self, block):
        self.asked.append(block)
        return Seen(*(np.arange(*block).reshape(-1, 1, 1) + part for part in range(len(Seen._fields))))

    def key(self, block):
        return make_key("numbers", block)


def seen(look, blocks, run=Run(), reported=None):
    return see_blocks(look, look.key, blocks, run, None if reported is None else reported.append)


def test_blocks_come_in_their_order_and_report_their_ends():
    look, reported = Numbers(), []
    first, second = seen(look, [(0, 3), (3, 5)], reported=reported)
    assert first[0].ravel().tolist() == [0, 1, 2]
    assert second[1].ravel().tolist() == [4, 5]
    assert reported == [3, 5]
    assert look.asked == [(0, 3), (3, 5)]


def test_what_was_seen_before_is_not_looked_at_again(tmp_path):
    run = Run(cache=tmp_path)
    seen(Numbers(), [(0, 3)], run)
    look, reported = Numbers(), []
    kept, made = seen(look, [(0, 3), (3, 5)], run, reported)
    assert look.asked == [(3, 5)]
    assert kept[0].ravel().tolist() == [0, 1, 2]
    assert made[0].ravel().tolist() == [3, 4]
    assert reported == [3, 5]


def test_without_a_cache_everything_is_looked_at_again():
    look = Numbers()
    seen(look, [(0, 3)])
    seen(look, [(0, 3)])
    assert look.asked == [(0, 3), (0, 3)]
