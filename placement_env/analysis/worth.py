"""Shapley values of sensors: shares of the AP, interactions, and failures.

With v a set function, such as the AP of a sensor set, N the n sensors and s = |S|:

    Shapley value, over S ∌ i:
        φ(i) = Σ s! (n-s-1)! / n! [v(S+i) - v(S)]
    Shapley interaction index, over S ∌ i, j:
        I(i,j) = Σ s! (n-s-2)! / (n-1)! [v(S+i+j) - v(S+i) - v(S+j) + v(S)]

(Shapley 1953; Grabisch and Roubens 1999). The shares add up to v(N) - v(∅). `synergy` is I: above 0
two sensors gain more together than apart, below 0 one makes up for the other. Both are exact from
the values of all 2^n sets, or sampled: sensors are added in random order; a sensor's gain averages
to φ, and the gain of two neighbours beyond their single gains averages to I. A round of the
sampling is a Williams square under a random renaming, so it is an unbiased sample of every φ and I,
stratified by the size of S, and independent of the other rounds.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from math import factorial

import numpy as np
from scipy.special import stdtrit

from placement_env.subsets import SetFunction, all_subsets
from toolkit.arrays import Bool, Float64, Int64, Rng
from toolkit.runtime.text_tables import align_columns

MIN_ROUNDS = 8  # rounds of sampling from which margins are given


@dataclass(frozen=True, eq=False)
class Worth:
    """Shapley values and synergies of n sensors, in the unit of the set function.

    Attributes:
        shapley: Shapley value of each sensor.
        synergy: Interaction of each pair, symmetric, 0 on the diagonal.
        shapley_margin: Half width of each value's confidence interval, 0 if exact.
        synergy_margin: Half width of each interaction's confidence interval, 0 if exact.
        evaluations: Number of scored sets.
    """

    shapley: Float64[np.ndarray, " n"]
    synergy: Float64[np.ndarray, "n n"]
    shapley_margin: Float64[np.ndarray, " n"]
    synergy_margin: Float64[np.ndarray, "n n"]
    evaluations: int


def shapley(values: Float64[np.ndarray, " sets"]) -> Float64[np.ndarray, " n"]:
    """Exact Shapley value of each of n sensors: its mean gain over all orders of adding sensors.

    It is φ(i) = Σ s! (n-s-1)! / n! [v(S+i) - v(S)] over the sets S without i, of s sensors each.

    values: Value of each of all 2^n sets, in the order of `all_subsets`. Raises ValueError if their
    number is not 2^n with n <= 16, or a value is not finite.
    """
    sets = _list_sets(values)
    n = sets.shape[1]
    size = sets.sum(axis=1)
    weight = _compute_weights(n)
    # a set with sensor i counts for it as S + i, a set without it as S; `size` - 1 of the empty set
    # reads a zero at the end
    return values * weight[size - 1] @ sets - values * weight[size] @ ~sets


def synergy(values: Float64[np.ndarray, " sets"]) -> Float64[np.ndarray, "n n"]:
    """Exact Shapley interaction index of each pair of n sensors; above 0 they gain more together.

    It is I(i,j) = Σ s! (n-s-2)! / (n-1)! [v(S+i+j) - v(S+i) - v(S+j) + v(S)] over the sets S
    without i and j, of s sensors each; 0 on the diagonal.

    values: Value of each of all 2^n sets, in the order of `all_subsets`. Raises ValueError if their
    number is not 2^n with n <= 16, or a value is not finite."""
    sets = _list_sets(values)
    n = sets.shape[1]
    size = sets.sum(axis=1)
    weight = _compute_weights(n - 1)  # by number of the other sensors; 0 for impossible numbers
    # 1 and 0, axes set and sensor
    is_member = sets.astype(float)
    is_absent = (~sets).astype(float)
    # Sums over the sets with both sensors of a pair, only the first, and neither. A negative index
    # reads a weight from the end, but its set is too small to count.
    both = is_member.T @ (is_member * (values * weight[size - 2])[:, None])
    only_first = is_member.T @ (is_absent * (values * weight[size - 1])[:, None])
    neither = is_absent.T @ (is_absent * (values * weight[size])[:, None])
    interaction = both - only_first - only_first.T + neither
    np.fill_diagonal(interaction, 0.0)
    return interaction


def exact_worth(value: SetFunction, sensors: int) -> Worth:
    """Exact Shapley values and synergies of n sensors, from the values of all 2^n sets.

    Args:
        value: Function that returns the value of each set, given as rows of booleans.
        sensors: Number of sensors n.

    Raises ValueError for n > 16, or a value that is not finite."""
    values = np.asarray(value(all_subsets(sensors)), float)
    return Worth(
        shapley=shapley(values),
        synergy=synergy(values),
        shapley_margin=np.zeros(sensors),
        synergy_margin=np.zeros((sensors, sensors)),
        evaluations=len(values),
    )


def estimate_worth(
    value: SetFunction,
    sensors: int,
    *,
    rounds: int = 32,
    confidence: float = 0.95,
    seed: int | Rng = 0,
) -> Worth:
    """Shapley values and synergies from `rounds` random Williams squares of at most 2 n² sets each.

    Margins are Student's over the rounds; they miss what no round contains, such as a rare set of
    great value. Raises ValueError for fewer than 8 rounds, no sensor, a confidence outside (0, 1),
    or values that are not finite.
    """
    if rounds < MIN_ROUNDS or sensors < 1 or not 0 < confidence < 1:
        rule = f"need at least {MIN_ROUNDS} rounds, 1 sensor and a confidence within (0, 1)"
        raise ValueError(f"{rule}, got {rounds}, {sensors} and {confidence}")
    rng = np.random.default_rng(seed)
    square = williams_square(sensors)  # orders × places
    # sensor at each place; axes: round, order, place
    orders = np.stack([rng.permutation(sensors)[square] for _ in range(rounds)])
    # place of each sensor in its order: rounds, orders, 1, sensors
    position = np.argsort(orders)[:, :, None]
    k = np.arange(sensors + 1)[:, None]
    chains = position < k  # the first 0, 1 … n sensors of each order
    # the first k sensors and sensor k + 2, up to n - 2
    swaps = (position < k[:-2]) | (position == k[1:-1])
    sets = np.concatenate([chains.reshape(-1, sensors), swaps.reshape(-1, sensors)])
    # each distinct set is scored once
    packed, row = np.unique(np.packbits(sets, axis=1), axis=0, return_inverse=True)
    values = np.asarray(value(np.unpackbits(packed, axis=1, count=sensors).astype(bool)), float)
    if not np.isfinite(values).all():
        raise ValueError(
            "values must be finite, but that of a sampled set is not: are there objects to find?"
        )
    figures = values[row.ravel()]
    # values of the sets; axes: round, order, k
    chain = figures[: chains.size // sensors].reshape(rounds, sensors, sensors + 1)
    swap = figures[chains.size // sensors :].reshape(rounds, sensors, sensors - 1)

    round_rows = np.arange(rounds)[:, None, None]
    gains = np.zeros((rounds, sensors))
    np.add.at(gains, (round_rows, orders), np.diff(chain) / sensors)
    synergies = np.zeros((rounds, sensors, sensors))
    first_sensor = orders[..., :-1]
    second_sensor = orders[..., 1:]
    # gain of two neighbours beyond their single gains; each pair is adjacent twice in a square
    joint_gain = (chain[..., 2:] - chain[..., 1:-1] - swap + chain[..., :-2]) / 2
    np.add.at(synergies, (round_rows, first_sensor, second_sensor), joint_gain)
    synergies += synergies.swapaxes(1, 2)

    scale = stdtrit(rounds - 1, (1 + confidence) / 2) / np.sqrt(rounds)  # Student's t
    return Worth(
        shapley=gains.mean(axis=0),
        synergy=synergies.mean(axis=0),
        shapley_margin=scale * gains.std(axis=0, ddof=1),
        synergy_margin=scale * synergies.std(axis=0, ddof=1),
        evaluations=len(packed),
    )


def format_worth(worth: Worth, names: Sequence[str]) -> str:
    """Table with a line per sensor, the highest Shapley value first.

    Columns are the value, its margin of error, and the synergy with each other sensor. names: names
    of the sensors."""
    order = np.argsort(-worth.shapley, kind="stable").tolist()
    rows = [["sensor", "Shapley", "±"] + [f"with {names[j]}" for j in order]]
    for i in order:
        synergies = ["" if i == j else f"{worth.synergy[i, j]:+z.4f}" for j in order]
        value_text = f"{worth.shapley[i]:.4f}"
        margin_text = f"{worth.shapley_margin[i]:.4f}"
        rows.append([names[i], value_text, margin_text, *synergies])
    return align_columns(rows, texts=1)


@dataclass(frozen=True, eq=False)
class Failures:
    """Values of a sensor set under every combination of k failing sensors.

    Attributes:
        intact: Value without failure.
        lost: Indices of the sensors that fail, a row for each combination.
        left: Value of the remaining sensors in each combination.
    """

    intact: float
    lost: Int64[np.ndarray, "k failing"]
    left: Float64[np.ndarray, " k"]

    @property
    def mean(self) -> float:
        """Mean value over the combinations."""
        return float(self.left.mean())

    @property
    def worst(self) -> float:
        """Lowest value of any combination."""
        return float(self.left.min())

    @property
    def most_missed(self) -> tuple[int, ...]:
        """Indices of the sensors whose failure leaves the lowest value."""
        return tuple(self.lost[self.left.argmin()].tolist())


def failures(
    value: SetFunction, chosen: Bool[np.ndarray, " candidates"], *, failing: int = 1
) -> Failures:
    """Values of a set under every combination of failing sensors.

    Args:
        value: Function that returns the value of each set, given as rows of booleans.
        chosen: True for the sensors of the set.
        failing: Number of sensors that fail together.

    Raises ValueError if the set has fewer sensors.
    """
    members = np.flatnonzero(chosen)
    if not 1 <= failing <= len(members):
        raise ValueError(
            f"from 1 to all {len(members)} sensors of the set can fail, got failing={failing}"
        )
    lost = np.array(list(combinations(members.tolist(), failing)))
    sets = np.repeat(chosen[None], len(lost) + 1, axis=0)  # the intact set first
    sets[np.arange(len(lost))[:, None] + 1, lost] = False  # row k + 1 without combination k
    values = np.asarray(value(sets), float)
    return Failures(intact=float(values[0]), lost=lost, left=values[1:])


def format_failures(cases: Sequence[Failures], names: Sequence[str]) -> str:
    """Table of mean and lowest value, and the worst failure, by number of failing sensors.

    Args:
        cases: Failures of one set, a line of the table each.
        names: Names of all sensors."""
    rows = [["failing", "intact", "mean", "worst", "without"]]
    for case in cases:
        failing_count = case.lost.shape[1]  # the same in all combinations
        figures = [f"{figure:.4f}" for figure in (case.intact, case.mean, case.worst)]
        most_missed = ", ".join(names[i] for i in case.most_missed)
        rows.append([f"N-{failing_count}", *figures, most_missed])
    return align_columns(rows, texts=1)


def _list_sets(values: np.ndarray) -> Bool[np.ndarray, "sets n"]:
    """All sets of n sensors, to which 2^n values belong in this order.

    Raises ValueError if the number of values is not 2^n with n <= 16, or a value is not finite."""
    n = len(values).bit_length() - 1  # of 2^n; -1 without a value
    if len(values) != 2 ** max(n, 0):
        raise ValueError(
            f"values must be given for all 2^n sets, the empty one first, got {len(values)} values"
        )
    sets = all_subsets(n)
    if not np.isfinite(values).all():
        first_row = int(np.flatnonzero(~np.isfinite(values))[0])
        members = np.flatnonzero(sets[first_row]).tolist()
        raise ValueError(f"values must be finite, but that of set {members} is not")
    return sets


def _compute_weights(n: int) -> Float64[np.ndarray, " sizes"]:
    """Weight s! (n-s-1)! / n! of each size s from 0 to n-1, then three zeros.

    The zeros are for sizes that callers read although no such set exists: n, -2 and -1."""
    weights = [factorial(s) * factorial(n - s - 1) / factorial(n) for s in range(n)]
    return np.array(weights + [0.0] * 3)


def williams_square(n: int) -> Int64[np.ndarray, "n n"]:
    """n orders (rows) of n sensors: each sensor once in each place, each pair adjacent twice.

    (Williams 1949)
    """
    position = np.arange(n)
    zigzag = np.where(position % 2, (position + 1) // 2, -(position // 2))  # 0, 1, -1, 2, -2, ...
    # row k is the zigzag from k on, modulo n
    return (position[:, None] + zigzag) % n
