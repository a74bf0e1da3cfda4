"""Worth of sensors, against its definitions."""

from itertools import combinations, permutations
from math import comb, factorial

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from scipy.stats import t as student

from placement_env.analysis import worth as module
from placement_env.analysis.worth import (
    Failures,
    Worth,
    estimate_worth,
    exact_worth,
    failures,
    format_failures,
    format_worth,
    shapley,
    synergy,
)
from placement_env.subsets import all_subsets

set_functions = st.builds(
    lambda n, seed: np.random.default_rng(seed).uniform(-1, 1, 2**n),
    st.integers(1, 8),
    st.integers(0, 2**32 - 1),
)


def as_function(values):
    return lambda sets: values[sets @ (1 << np.arange(sets.shape[1]))]


def bits(sensors):
    return sum(1 << i for i in sensors)


def shapley_by_orders(values):
    """Mean gain over all orders, the definition."""
    n = len(values).bit_length() - 1
    gains = np.zeros(n)
    for order in permutations(range(n)):
        for k, i in enumerate(order):
            gains[i] += values[bits(order[: k + 1])] - values[bits(order[:k])]
    return gains / factorial(n)


def synergy_by_sum(values):
    """The sum over sets, as at the top of the module."""
    n = len(values).bit_length() - 1
    index = np.zeros((n, n))
    for i, j in permutations(range(n), 2):
        others = [k for k in range(n) if k not in (i, j)]
        for s in range(n - 1):
            for chosen in combinations(others, s):
                base = bits(chosen)
                joint = (
                    values[base | 1 << i | 1 << j]
                    - values[base | 1 << i]
                    - values[base | 1 << j]
                    + values[base]
                )
                index[i, j] += joint / ((n - 1) * comb(n - 2, s))
    return index


def test_the_worth_of_gloves_is_that_by_hand():
    # Sensor 0 is needed with 1 or 2 (a left glove and two right ones): 2/3, 1/6, 1/6.
    values = np.array([0, 0, 0, 1, 0, 1, 0, 1.0])
    assert shapley(values) == pytest.approx([2 / 3, 1 / 6, 1 / 6])
    assert synergy(values)[0, 1] == pytest.approx(1 / 2)
    assert synergy(values)[1, 2] == pytest.approx(-1 / 2)


def test_the_worth_of_coverage_adds_up_and_is_submodular():
    share = np.random.default_rng(0).uniform(size=16)
    worth = exact_worth(lambda sets: 1 - np.prod(np.where(sets, 1 - share, 1.0), axis=1), 16)
    assert worth.shapley.sum() == pytest.approx(1 - np.prod(1 - share))
    assert (worth.synergy <= 1e-12).all()  # coverage is submodular
    assert worth.evaluations == 65536


def test_the_worth_of_an_additive_function_is_exact():
    share = np.arange(1.0, 13.0)
    worth = estimate_worth(lambda sets: sets @ share, 12, rounds=8)
    assert worth.shapley == pytest.approx(share)
    assert worth.shapley_margin == pytest.approx(0, abs=1e-12)
    assert worth.synergy == pytest.approx(0, abs=1e-12)


def test_values_are_asked_once_and_must_be_finite():
    calls = []

    def value(sets):
        calls.append(sets)
        return sets.sum(axis=1) / 10.0

    worth = estimate_worth(value, 10, rounds=8)
    assert len(calls) == 1
    assert len(np.unique(calls[0], axis=0)) == len(calls[0]) == worth.evaluations <= 8 * 2 * 10**2
    with pytest.raises(ValueError, match="finite"):
        estimate_worth(lambda sets: np.full(len(sets), np.nan), 3)


@given(st.integers(1, 5), st.integers(0, 2**32 - 1))
@settings(max_examples=30, deadline=None)
def test_against_the_definitions(n, seed):
    values = np.random.default_rng(seed).uniform(-1, 1, 2**n)
    assert shapley(values) == pytest.approx(shapley_by_orders(values), abs=1e-12)
    assert synergy(values) == pytest.approx(synergy_by_sum(values), abs=1e-12)


@given(set_functions)
def test_efficiency(values):
    assert shapley(values).sum() == pytest.approx(values[-1] - values[0], abs=1e-12)


@given(set_functions, st.randoms())
def test_symmetry_under_renaming(values, random):
    n = len(values).bit_length() - 1
    renamed = np.array(random.sample(range(n), n))  # sensor i becomes renamed[i]
    other = np.empty_like(values)
    other[all_subsets(n) @ (1 << renamed)] = values
    assert shapley(other)[renamed] == pytest.approx(shapley(values), abs=1e-12)
    assert synergy(other)[np.ix_(renamed, renamed)] == pytest.approx(synergy(values), abs=1e-12)


@given(set_functions, st.floats(-1, 1))
def test_a_dummy_gets_what_it_adds_alone_and_has_no_synergy(values, alone):
    extended = np.concatenate([values, values + alone])
    assert shapley(extended)[-1] == pytest.approx(alone, abs=1e-12)
    assert shapley(extended)[:-1] == pytest.approx(shapley(values), abs=1e-12)
    assert synergy(extended)[-1] == pytest.approx(0, abs=1e-12)


@given(set_functions, st.floats(-2, 2), st.floats(-2, 2), st.integers(0, 2**32 - 1))
def test_additivity(values, a, b, seed):
    others = np.random.default_rng(seed).uniform(-1, 1, len(values))
    assert shapley(a * values + b * others) == pytest.approx(
        a * shapley(values) + b * shapley(others), abs=1e-11
    )
    assert synergy(a * values + b * others) == pytest.approx(
        a * synergy(values) + b * synergy(others), abs=1e-11
    )


@given(set_functions)
def test_synergy_is_what_a_sensor_takes_from_another_when_it_goes(values):
    # I(i, j) = value of i with j always there - value of i with j never there (Grabisch and
    # Roubens' recursion).
    n = len(values).bit_length() - 1
    sets = all_subsets(n)
    for j in range(n):
        with_j, without_j = shapley(values[sets[:, j]]), shapley(values[~sets[:, j]])
        assert np.delete(synergy(values)[j], j) == pytest.approx(with_j - without_j, abs=1e-12)


@pytest.mark.parametrize("n", [0, 1])
def test_degenerate_numbers_of_sensors(n):
    worth = exact_worth(lambda sets: sets.sum(axis=1) * 0.5, n)
    assert worth.shapley.tolist() == [0.5] * n
    assert worth.synergy.tolist() == [[0.0] * n] * n


@pytest.mark.parametrize(
    ("values", "message"),
    [
        *((np.zeros(0), "2\\^n sets"), (np.zeros(63), "got 63")),
        *(
            (np.array([0, 0.5, np.nan, 0.7]), r"set \[1\] is not"),
            (np.zeros(2**17), "at most 16 sensors, got 17"),
        ),
    ],
)
def test_refuses(values, message):
    with pytest.raises(ValueError, match=message):
        shapley(values)


@pytest.mark.parametrize("n", range(1, 10))
def test_williams_square(n):
    square = module.williams_square(n)
    assert (np.sort(square, axis=0) == np.arange(n)[:, None]).all()
    assert (np.sort(square, axis=1) == np.arange(n)).all()
    neighbours = np.zeros((n, n), int)
    np.add.at(neighbours, (square[:, :-1], square[:, 1:]), 1)
    assert (neighbours + neighbours.T == 2 * (1 - np.eye(n, dtype=int))).all()


@pytest.mark.parametrize("n", [2, 5, 6])
def test_sampling_is_unbiased(n):
    values = np.random.default_rng(n).uniform(size=2**n)
    exact, sampled = (
        exact_worth(as_function(values), n),
        estimate_worth(as_function(values), n, rounds=3000),
    )
    assert sampled.shapley == pytest.approx(exact.shapley, abs=0.01)
    assert sampled.synergy == pytest.approx(exact.synergy, abs=0.03)
    assert sampled.evaluations <= 2**n


def test_margins_are_students_over_the_rounds():
    n, rounds, values = 4, 9, np.random.default_rng(2).uniform(size=16)
    rng, gains, pairs = np.random.default_rng(5), np.zeros((rounds, n)), np.zeros((rounds, n, n))
    for r in range(rounds):
        orders = rng.permutation(n)[module.williams_square(n)].tolist()
        for order in orders:
            for k, i in enumerate(order):
                before = bits(order[:k])
                gains[r, i] += (values[before | 1 << i] - values[before]) / len(orders)
                for j in order[k + 1 : k + 2]:
                    joint = (
                        values[before | 1 << i | 1 << j]
                        - values[before | 1 << i]
                        - values[before | 1 << j]
                    )
                    # two are neighbours twice a round
                    pairs[r, [i, j], [j, i]] += (joint + values[before]) / 2
    worth = estimate_worth(as_function(values), n, rounds=rounds, confidence=0.9, seed=5)
    scale = student.ppf(0.95, rounds - 1) / np.sqrt(rounds)
    for found, margin, each in (
        (worth.shapley, worth.shapley_margin, gains),
        (worth.synergy, worth.synergy_margin, pairs),
    ):
        assert found == pytest.approx(each.mean(axis=0), abs=1e-12)
        assert margin == pytest.approx(scale * each.std(axis=0, ddof=1), abs=1e-12)


@given(set_functions, st.integers(0, 2**32 - 1))
@settings(max_examples=30, deadline=None)
def test_samples_share_out_everything_and_repeat_with_their_seed(values, seed):
    n = len(values).bit_length() - 1
    worth, again = (estimate_worth(as_function(values), n, rounds=8, seed=seed) for _ in range(2))
    assert worth.shapley.sum() == pytest.approx(values[-1] - values[0], abs=1e-12)
    assert worth.shapley.tobytes() == again.shapley.tobytes()
    assert worth.synergy_margin.tobytes() == again.synergy_margin.tobytes()


@pytest.mark.parametrize(
    "wrong", [{"rounds": 7}, {"confidence": 1.0}, {"confidence": 0.0}, {"sensors": 0}]
)
def test_sampling_refuses(wrong):
    with pytest.raises(ValueError, match="at least 8 rounds"):
        estimate_worth(lambda sets: np.zeros(len(sets)), **({"sensors": 3} | wrong))


def test_worth_is_listed_from_the_greatest():
    names = ["north", "south", "east", "west"]
    share = np.array([0.4, 0.2, 0.0, 0.1])
    head, best, *_ = format_worth(exact_worth(lambda sets: sets @ share, 4), names).splitlines()
    assert head == "sensor  Shapley       ±  with north  with south  with west  with east"
    assert best.split() == ["north", "0.4000", "0.0000", "+0.0000", "+0.0000", "+0.0000"]


def test_equal_sensors_are_listed_in_their_order():
    alike = [f"pole{k:02}" for k in range(40)]
    equal = Worth(np.repeat([0.01, 0.02], 20), np.eye(40), np.zeros(40), np.zeros((40, 40)), 1)
    rows = [line.split()[0] for line in format_worth(equal, alike).splitlines()[1:]]
    assert [row for row in rows if row in alike] == alike[20:] + alike[
        :20
    ]  # equal ones in their order


def test_failures_of_one_sensor_are_those_by_hand():
    share = np.array([0.4, 0.3, 0.2, 0.1])
    chosen = np.array([True, True, False, True])
    one = failures(lambda sets: sets @ share, chosen)
    assert one.intact == pytest.approx(0.8)
    assert one.lost.tolist() == [[0], [1], [3]]
    assert one.left == pytest.approx([0.4, 0.5, 0.7])
    assert one.mean == pytest.approx(1.6 / 3)
    assert one.worst == pytest.approx(0.4)
    assert one.most_missed == (0,)


def test_failures_of_two_and_three_sensors_are_those_by_hand():
    share, chosen = np.array([0.4, 0.3, 0.2, 0.1]), np.array([True, True, False, True])
    two = failures(lambda sets: sets @ share, chosen, failing=2)
    assert two.most_missed == (0, 1)
    assert two.left == pytest.approx([0.1, 0.3, 0.4])
    assert failures(lambda sets: sets @ share, chosen, failing=3).left.tolist() == [0.0]
    assert Failures(1.0, np.array([[2], [5]]), np.array([0.5, 0.5])).most_missed == (2,)


def test_failures_are_formatted_with_the_sensors_missed_most():
    share = np.array([0.4, 0.2, 0.0, 0.1])
    cases = [failures(lambda sets: sets @ share, np.ones(4, bool), failing=k) for k in (1, 2)]
    *_, last = format_failures(cases, ["north", "south", "east", "west"]).splitlines()
    assert last.split() == ["N-2", "0.7000", "0.3500", "0.1000", "north,", "south"]


def test_estimated_worth_covers_the_exact_one_as_often_as_it_says():
    n, values = 6, np.random.default_rng(1).uniform(size=64)
    exact = exact_worth(as_function(values), n)
    pairs = np.triu_indices(n, 1)
    covered, pairs_covered = [], []
    for seed in range(150):
        worth = estimate_worth(as_function(values), n, rounds=16, confidence=0.9, seed=seed)
        covered.append(np.abs(worth.shapley - exact.shapley) <= worth.shapley_margin)
        pairs_covered.append((np.abs(worth.synergy - exact.synergy) <= worth.synergy_margin)[pairs])
    assert 0.86 <= np.mean(covered) <= 0.94
    assert 0.86 <= np.mean(pairs_covered) <= 0.94


@pytest.mark.parametrize("failing", [0, 3])
def test_failures_refuse(failing):
    with pytest.raises(
        ValueError, match=f"all 2 sensors of the set can fail, got failing={failing}"
    ):
        failures(lambda sets: np.zeros(len(sets)), np.array([True, True, False]), failing=failing)


def test_orders_are_those_of_seed_0_unless_given():
    values = as_function(np.random.default_rng(3).uniform(size=32))
    usual, *others = (
        estimate_worth(values, 5, rounds=8, **seed).shapley.tolist()
        for seed in ({}, {"seed": 0}, {"seed": 1})
    )
    assert (usual == others[0], usual == others[1]) == (True, False)
