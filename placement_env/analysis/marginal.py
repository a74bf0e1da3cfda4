"""Marginal gains: what each candidate adds to a sensor set, in AP, in kbit and per kbit."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from placement_env.analysis.tables import columns
from placement_env.protocol import Fidelity
from toolkit.arrays import Bool, Float64


@dataclass(frozen=True, eq=False)
class Marginal:
    """What each of C candidates gains: on top of a set for those outside it, on top of its rest for those inside.
    kbit: what the candidate adds to what is sent; per_kbit: AP per kbit, 0 without a gain, ±inf if a gain is free."""

    gain: Float64[np.ndarray, " C"]
    kbit: Float64[np.ndarray, " C"]
    per_kbit: Float64[np.ndarray, " C"]


def marginal(fidelity: Fidelity, chosen: Bool[np.ndarray, " C"]) -> Marginal:
    """What each candidate gains and sends beside a chosen set, and the AP that each kbit buys."""
    flipped = np.eye(len(chosen), dtype=bool) ^ chosen
    figures = fidelity(np.concatenate([chosen[None], flipped]))
    gain, kbit = (np.where(chosen, of[0] - of[1:], of[1:] - of[0]) for of in (figures.ap, figures.kbit))
    with np.errstate(divide="ignore", invalid="ignore"):
        return Marginal(gain, kbit, np.where(gain == 0, 0.0, gain / kbit))


def format_marginal(gains: Marginal, names: Sequence[str]) -> str:
    """A line per candidate, of greatest gain per kbit first."""
    table = [["sensor", "gain", "kbit", "gain/Mbit"]]
    table += [
        [names[i], f"{gains.gain[i]:+z.4f}", f"{gains.kbit[i]:.2f}", f"{1e3 * gains.per_kbit[i]:+z.4f}"]
        for i in np.argsort(-gains.per_kbit, kind="stable").tolist()
    ]
    return columns(table)
