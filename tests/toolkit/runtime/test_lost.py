"""Work that does not come back is an error of one line, of a kind of its own."""

import os

import pytest

from toolkit.runtime.lost import WorkLost
from toolkit.runtime.parallel import spread
from toolkit.runtime.ray_backend import RETRIES


def dies(x: int) -> int:
    os._exit(7)


def test_work_that_kills_every_process_is_given_up():
    with pytest.raises(WorkLost, match=f"died {RETRIES + 1} times in a row, at or near input 1") as error:
        list(spread(dies, [1], workers=2))
    assert "\n" not in str(error.value)
    assert isinstance(error.value, RuntimeError)
