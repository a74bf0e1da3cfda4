"""Worth of sensors: shares of the AP, failures and marginal gains.

With v a set function, such as the AP of a sensor set, N the n sensors and s = |S|:

    Shapley value              φ(i)   = Σ s! (n-s-1)! / n!      [v(S+i) - v(S)]                        over S ∌ i
    Shapley interaction index  I(i,j) = Σ s! (n-s-2)! / (n-1)!  [v(S+i+j) - v(S+i) - v(S+j) + v(S)]    over S ∌ i, j

(Shapley 1953; Grabisch and Roubens 1999). The shares add up to v(N) - v(∅). `synergy` is I: above 0 two sensors are
worth more together than apart, below 0 one makes up for the other. Both are exact from the values of all 2^n sets, or
sampled: put the sensors in in random order; a sensor's gain averages to φ, and what two neighbours gain together
beyond their single gains averages to I. A round of the sampling is a Williams square under a random renaming: n orders
in which every sensor takes every place once and every two sensors are neighbours twice, so each round is an unbiased
sample of every φ and I, stratified by the size of S, and independent of the other rounds.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from math import factorial
from statistics import NormalDist

import numpy as np

from placement_env.protocol import Fidelity
from placement_env.subsets import SetFunction, all_subsets
from toolkit.arrays import Bool, Float64, Int64

FEWEST_ROUNDS = 8


@dataclass(frozen=True, eq=False)
class Worth:
    """Shapley values and synergies of n sensors.

    They are in the unit of the set function.

    synergy: symmetric, 0 on the diagonal; the margins: half widths of each figure's own confidence interval, 0 if
    exact; evaluations: number of sets scored.
    """

    shapley: Float64[np.ndarray, " n"]
    synergy: Float64[np.ndarray, "n n"]
    shapley_margin: Float64[np.ndarray, " n"]
    synergy_margin: Float64[np.ndarray, "n n"]
    evaluations: int


def shapley(values: Float64[np.ndarray, " sets"]) -> Float64[np.ndarray, " n"]:
    """Return each sensor's exact Shapley value.

    values: of all 2^n sets in the order of `all_subsets`. Raises ValueError if their number is not 2^n with n <= 16, or
    one is not finite.

    >>> shapley(np.array([0.0, 0.5, 0.25, 0.75]))
    array([0.5 , 0.25])
    """
    sets = _list_sets(values)
    n, size = sets.shape[1], sets.sum(axis=1)
    weight = _weights(n)
    return values * weight[size - 1] @ sets - values * weight[size] @ ~sets


def synergy(values: Float64[np.ndarray, " sets"]) -> Float64[np.ndarray, "n n"]:
    """Return the exact Shapley interaction index of each pair.

    It is 0 on the diagonal.

    Takes the values and raises the errors of `shapley`.

    >>> synergy(np.array([0.0, 0.5, 0.25, 1.0]))
    array([[0.  , 0.25],
           [0.25, 0.  ]])
    """
    sets = _list_sets(values)
    n, size = sets.shape[1], sets.sum(axis=1)
    weight = _weights(n - 1)
    inside, outside = sets.astype(float), (~sets).astype(float)
    one = inside.T @ (outside * (values * weight[size - 1])[:, None])
    both = inside.T @ (inside * (values * weight[size - 2])[:, None])
    neither = outside.T @ (outside * (values * weight[size])[:, None])
    index = both - one - one.T + neither
    np.fill_diagonal(index, 0.0)
    return index


def exact_worth(value: SetFunction, sensors: int) -> Worth:
    """Compute each sensor's worth from the values of all 2^n sets.

    Raises the errors of `shapley`.

    >>> exact_worth(lambda sets: sets @ np.array([0.5, 0.25]), 2).shapley
    array([0.5 , 0.25])
    """
    values = np.asarray(value(all_subsets(sensors)), float)
    return Worth(shapley(values), synergy(values), np.zeros(sensors), np.zeros((sensors, sensors)), len(values))


def estimate_worth(
    value: SetFunction, sensors: int, *, rounds: int = 32, confidence: float = 0.95, seed: int | np.random.Generator = 0
) -> Worth:
    """Estimate each sensor's worth from `rounds` independent Williams squares of orders.

    At most 2 n² sets are scored a round, each set once, all in one call. Margins are Student's over the rounds; as with
    any sample they miss what no round has seen, such as a rare set of great value.
    Raises ValueError for fewer than 8 rounds, no sensor, a confidence outside (0, 1), or values that are not finite.
    """
    if rounds < FEWEST_ROUNDS or sensors < 1 or not 0 < confidence < 1:
        raise ValueError(
            f"need at least {FEWEST_ROUNDS} rounds, 1 sensor and a confidence within (0, 1), "
            f"got {rounds}, {sensors} and {confidence}"
        )
    rng = np.random.default_rng(seed)
    square = _williams_square(sensors)
    orders = np.stack([rng.permutation(sensors)[square] for _ in range(rounds)])
    chains = np.concatenate([_prefixes(order) for order in orders])
    swaps = np.concatenate([_swaps(order) for order in orders])
    figures, evaluations = _score_once(value, np.concatenate([chains, swaps]), sensors)
    chain = figures[: len(chains)].reshape(rounds, sensors, sensors + 1)
    swap = figures[len(chains) :].reshape(rounds, sensors, sensors - 1)

    at = np.arange(rounds)[:, None, None]
    gains = np.zeros((rounds, sensors))
    np.add.at(gains, (at, orders), np.diff(chain) / sensors)
    together = np.zeros((rounds, sensors, sensors))
    first, second = orders[..., :-1], orders[..., 1:]
    joint = (chain[..., 2:] - chain[..., 1:-1] - swap + chain[..., :-2]) / 2
    np.add.at(together, (at, first, second), joint)
    together += together.swapaxes(1, 2)

    scale = _student(confidence, rounds - 1) / np.sqrt(rounds)
    return Worth(
        gains.mean(axis=0),
        together.mean(axis=0),
        scale * gains.std(axis=0, ddof=1),
        scale * together.std(axis=0, ddof=1),
        evaluations,
    )


def format_worth(worth: Worth, names: Sequence[str]) -> str:
    """Return a line per sensor, highest Shapley value first.

    It gives value, margin, and synergy with each other sensor.
    """
    order = np.argsort(-worth.shapley, kind="stable").tolist()
    table = [["sensor", "Shapley", "±", *(f"with {names[j]}" for j in order)]]
    for i in order:
        pairs = ["" if i == j else f"{worth.synergy[i, j]:+z.4f}" for j in order]
        table.append([names[i], f"{worth.shapley[i]:.4f}", f"{worth.shapley_margin[i]:.4f}", *pairs])
    return columns(table)


@dataclass(frozen=True, eq=False)
class Failures:
    """Values of a sensor set under every combination of k failing sensors.

    intact: value with no failure; lost: the sensors that fail, a row for each combination; left: value of the sensors
    that remain.
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
        """Least value of any combination."""
        return float(self.left.min())

    @property
    def most_missed(self) -> tuple[int, ...]:
        """The sensors whose failure leaves the least; the first of equal combinations."""
        return tuple(self.lost[self.left.argmin()].tolist())


def failures(value: SetFunction, chosen: Bool[np.ndarray, " C"], *, failing: int = 1) -> Failures:
    """Score a set under every combination of failures.

    failing: number of sensors that fail; 1 is N-1, 2 is N-2.

    Raises ValueError if the set does not have that many sensors.
    """
    members = np.flatnonzero(chosen)
    if not 1 <= failing <= len(members):
        raise ValueError(f"from 1 to all {len(members)} sensors of the set can fail, got failing={failing}")
    lost = np.array(list(combinations(members.tolist(), failing)))
    sets = np.repeat(chosen[None], len(lost) + 1, axis=0)
    sets[np.arange(len(lost))[:, None] + 1, lost] = False
    figures = np.asarray(value(sets), float)
    return Failures(float(figures[0]), lost, figures[1:])


def format_failures(cases: Sequence[Failures], names: Sequence[str]) -> str:
    """Return a line per number of failing sensors.

    It gives mean and least value, and the failure that leaves the least.
    """
    table = [["failing", "intact", "mean", "worst", "without"]]
    for case in cases:
        figures = [f"{figure:.4f}" for figure in (case.intact, case.mean, case.worst)]
        table.append([f"N-{case.lost.shape[1]}", *figures, ", ".join(names[i] for i in case.most_missed)])
    return columns(table)


@dataclass(frozen=True, eq=False)
class Marginal:
    """Marginal gain of each of C candidates beside a set.

    A member of the set is taken out of it instead of added.

    gain: AP; kbit: what the candidate adds to what is sent; per_kbit: AP per kbit, 0 without a gain, ±inf if a gain is
    free.
    """

    gain: Float64[np.ndarray, " C"]
    kbit: Float64[np.ndarray, " C"]
    per_kbit: Float64[np.ndarray, " C"]


def marginal(fidelity: Fidelity, chosen: Bool[np.ndarray, " C"]) -> Marginal:
    """Compute each candidate's gain and data beside a set."""
    flipped = np.eye(len(chosen), dtype=bool) ^ chosen
    figures = fidelity(np.concatenate([chosen[None], flipped]))
    gain, kbit = (np.where(chosen, of[0] - of[1:], of[1:] - of[0]) for of in (figures.ap, figures.kbit))
    with np.errstate(divide="ignore", invalid="ignore"):
        return Marginal(gain, kbit, np.where(gain == 0, 0.0, gain / kbit))


def format_marginal(gains: Marginal, names: Sequence[str]) -> str:
    """Return a line per candidate, greatest gain per kbit first."""
    table = [["sensor", "gain", "kbit", "gain/Mbit"]]
    table += [
        [names[i], f"{gains.gain[i]:+z.4f}", f"{gains.kbit[i]:.2f}", f"{1e3 * gains.per_kbit[i]:+z.4f}"]
        for i in np.argsort(-gains.per_kbit, kind="stable").tolist()
    ]
    return columns(table)


def columns(table: Sequence[Sequence[str]]) -> str:
    """Align rows of cells as columns, the first one to the left.

    >>> print(columns([["sensor", "AP"], ["north", "0.5"]]))
    sensor   AP
    north   0.5
    """
    widths = [max(map(len, column)) for column in zip(*table, strict=True)]
    sides = [str.ljust] + [str.rjust] * (len(widths) - 1)
    return "\n".join(
        "  ".join(side(cell, width) for side, cell, width in zip(sides, row, widths, strict=True)).rstrip()
        for row in table
    )


def _list_sets(values: np.ndarray) -> Bool[np.ndarray, "sets n"]:
    sensors = len(values).bit_length() - 1
    if len(values) != 2 ** max(sensors, 0):
        raise ValueError(f"values must be given for all 2^n sets, the empty one first, got {len(values)} values")
    sets = all_subsets(sensors)
    if not np.isfinite(values).all():
        wrong = int(np.flatnonzero(~np.isfinite(values))[0])
        raise ValueError(f"values must be finite, but that of set {np.flatnonzero(sets[wrong]).tolist()} is not")
    return sets


def _weights(n: int) -> Float64[np.ndarray, " sizes"]:
    """s! (n-s-1)! / n! for s below n, then zeros. So impossible sizes of sets, -2 and -1 among them, weigh 0."""
    return np.array([factorial(s) * factorial(n - s - 1) / factorial(n) for s in range(n)] + [0.0] * 3)


def _williams_square(n: int) -> Int64[np.ndarray, "n n"]:
    """n orders of n sensors (Williams 1949).

    Each takes each place once, each two are neighbours twice.

    >>> _williams_square(4)
    array([[0, 1, 3, 2],
           [1, 2, 0, 3],
           [2, 3, 1, 0],
           [3, 0, 2, 1]])
    """
    place = np.arange(n)
    zigzag = np.where(place % 2, (place + 1) // 2, -(place // 2))
    return (place[:, None] + zigzag) % n


def _prefixes(orders: Int64[np.ndarray, "m n"]) -> Bool[np.ndarray, "rows n"]:
    """Sets of the first 0, 1 … n sensors of each order."""
    place = np.argsort(orders, axis=1)
    return (place[:, None, :] < np.arange(orders.shape[1] + 1)[:, None]).reshape(-1, orders.shape[1])


def _swaps(orders: Int64[np.ndarray, "m n"]) -> Bool[np.ndarray, "rows n"]:
    """Sets of the first k sensors and sensor k + 2. k goes from 0 to n - 2."""
    place, k = np.argsort(orders, axis=1)[:, None, :], np.arange(orders.shape[1] - 1)[:, None]
    return ((place < k) | (place == k + 1)).reshape(-1, orders.shape[1])


def _score_once(
    value: SetFunction, sets: Bool[np.ndarray, "rows n"], sensors: int
) -> tuple[Float64[np.ndarray, " rows"], int]:
    """Value of each row, and the number of different rows. Equal rows are scored once."""
    packed, row_of = np.unique(np.packbits(sets, axis=1), axis=0, return_inverse=True)
    figures = np.asarray(value(np.unpackbits(packed, axis=1, count=sensors).astype(bool)), float)
    if not np.isfinite(figures).all():
        raise ValueError("values must be finite, but that of a sampled set is not: are there objects to find?")
    return figures[row_of.ravel()], len(packed)


def _student(confidence: float, freedom: int) -> float:
    """Two-sided quantile of Student's t (Abramowitz and Stegun 26.7.5).

    It is right to 1 % from 7 degrees of freedom at 99 %.
    """
    z = NormalDist().inv_cdf((1 + confidence) / 2)
    first, second = (z**3 + z) / 4, (5 * z**5 + 16 * z**3 + 3 * z) / 96
    third = (3 * z**7 + 19 * z**5 + 17 * z**3 - 15 * z) / 384
    return z + first / freedom + second / freedom**2 + third / freedom**3
