"""Places on mounts: which sensors may stand together, where a mount may carry several.

A mount carries up to `Mount.max_sensors` sensors; what they send together goes over its one link, and the mount itself
is paid once.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from toolkit.arrays import Bool, Float64

if TYPE_CHECKING:
    from placement_env.candidates.candidates import Candidates

ROUNDED = 1e-9  # by which rounding may take a sum over the capacity of a link


def fit_together(
    candidates: Candidates, subsets: Bool[np.ndarray, "n C"], sent: Float64[np.ndarray, " C"] | None = None
) -> Bool[np.ndarray, " n"]:
    """Which sets leave no mount with more sensors than it has places, nor with more kbit per frame than its link
    carries. sent: by each candidate, None where that always fits; a link that one sensor has for itself is not looked
    at."""
    per_mount = candidates.per_mount(subsets)
    fits = np.asarray((per_mount <= candidates.places).all(axis=1))
    if sent is None or not candidates.several:
        return fits
    loads = np.zeros(per_mount.shape)
    row, candidate = subsets.nonzero()
    np.add.at(loads, (row, candidates.mount[candidate]), sent[candidate])
    return np.asarray(fits & ((loads <= candidates.links * (1 + ROUNDED)) | (per_mount <= 1)).all(axis=1))


def room_beside(
    candidates: Candidates, row: Bool[np.ndarray, " C"], sent: Float64[np.ndarray, " C"] | None = None
) -> Bool[np.ndarray, " C"]:
    """Which candidates may join a set: there is a place left on their mount, and room on its link. sent: as of
    `fit_together`."""
    count = np.bincount(candidates.mount[row], minlength=len(candidates.mounts))
    room = np.asarray((count < candidates.places)[candidates.mount] & ~row)
    if sent is None or not candidates.several:
        return room
    load = np.bincount(candidates.mount[row], sent[row], minlength=len(candidates.mounts))
    shared = (load[candidates.mount] + sent <= candidates.capacity * (1 + ROUNDED)) | (count[candidates.mount] == 0)
    return np.asarray(room & shared)


def added_prices(candidates: Candidates, row: Bool[np.ndarray, " C"]) -> Float64[np.ndarray, " C"]:
    """What each candidate adds to the price of a set: its sensor, and its mount unless that is paid already."""
    paid = np.zeros(len(candidates.mounts), np.bool_)
    paid[candidates.mount[row]] = True
    return np.where(paid[candidates.mount], candidates.model_prices, candidates.prices)
