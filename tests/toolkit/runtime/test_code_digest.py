"""The digest of source files."""

from pathlib import Path

from toolkit.runtime.code_digest import DETECTION, RENDERING, code_digest

TOP = Path(__file__).parents[3]


def test_it_tells_files_and_their_order_apart_and_names_files_that_are_there():
    assert all((TOP / name).is_file() for name in RENDERING + DETECTION)
    assert not set(RENDERING) & set(DETECTION)
    assert len({code_digest(*RENDERING), code_digest(*DETECTION), code_digest(*reversed(DETECTION))}) == 3
