"""Columns stand below each other."""

import pytest

from toolkit.runtime.text_tables import align_columns


def test_texts_stand_left_and_numbers_right():
    table = [
        ["scheme", "sensors", "AP"],
        ["late", "0,1", "0.5"],
        ["hybrid", "all of them", "12.25"],
    ]
    assert align_columns(table, texts=2).splitlines() == [
        *("scheme  sensors         AP", "late    0,1            0.5", "hybrid  all of them  12.25")
    ]
    assert (
        align_columns([["sensor", "AP", ""], ["n", "0.25", "x"]], texts=1).splitlines()[0]
        == "sensor    AP"
    )
    with pytest.raises(ValueError, match="shorter"):
        align_columns([["a", "b"], ["c"]], texts=1)
