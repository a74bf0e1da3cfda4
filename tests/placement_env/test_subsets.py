import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from placement_env.subsets import (
    BLOCK_FIGURES,
    BLOCK_SETS,
    MAX_LISTED_SENSORS,
    MemberSums,
    all_subsets,
    list_set_members,
    sum_figures,
)


@pytest.mark.parametrize("sensors", [0, 1, 5])
def test_all_subsets_are_all_and_in_binary_order(sensors):
    sets = all_subsets(sensors)
    assert sets.shape == (2**sensors, sensors)
    assert (sets @ (1 << np.arange(sensors))).tolist() == list(range(2**sensors))


@pytest.mark.parametrize("sensors", [-1, MAX_LISTED_SENSORS + 1])
def test_too_many_subsets(sensors):
    with pytest.raises(ValueError, match=f"too many sets.*got {sensors}"):
        all_subsets(sensors)


@given(st.integers(0, 10_000), st.sampled_from([np.uint16, np.float32, np.float64]))
@settings(max_examples=25, deadline=None)
def test_sums_are_those_of_the_members_whatever_is_beside_them(seed, dtype):
    rng = np.random.default_rng(seed)
    rows = rng.integers(0, 1000, (9, 5)).astype(dtype) / dtype(1 if dtype is np.uint16 else 3)
    rows = rows.astype(dtype)
    sets = rng.random((20, 9)) < rng.random()
    sums = MemberSums(rows)
    np.testing.assert_allclose(sums(sets), sets @ rows.astype(float), rtol=1e-5)
    np.testing.assert_array_equal(sums(sets[3:4]), sums(sets)[3:4])
    assert sums(np.zeros((0, 9), bool)).shape == (0, 5)


@pytest.mark.parametrize(
    ("sets", "candidates"), [(0, 5), (3, 0), (1, 7), (BLOCK_SETS + 1, 300), (3 * BLOCK_SETS, 9)]
)
def test_members_and_sums_of_figures_are_numpys(sets, candidates):
    rng = np.random.default_rng(sets)
    subsets = rng.random((2 * sets, candidates)) < 0.2
    figures = rng.integers(0, 1 << 20, candidates).astype(float)
    for rows in (subsets[:sets], subsets[::2]):  # the second is not contiguous
        np.testing.assert_array_equal(list_set_members(rows), np.nonzero(rows))
        np.testing.assert_array_equal(sum_figures(rows, figures), rows @ figures)


def test_blocks_together_are_all_sums_of_the_same_candidates():
    rows = np.random.default_rng(0).random((6, BLOCK_FIGURES // 10))
    sets = np.random.default_rng(1).random((25, 6)) < 0.5
    blocks = list(MemberSums(rows).blocks(sets))
    assert len(blocks) > 1
    np.testing.assert_array_equal(
        np.concatenate([sums for _, sums in blocks]), MemberSums(rows)(sets)
    )
    assert [block.start for block, _ in blocks] == sorted(block.start for block, _ in blocks)
    with pytest.raises(ValueError, match="rows of 6 booleans"):
        MemberSums(np.zeros((6, 2))).blocks(np.zeros((2, 5), bool))
