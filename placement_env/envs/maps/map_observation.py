"""What an agent of `coview/SensorMap-v0` observes: maps and terms, nothing that was rendered.

"map": the `CHANNELS` of the raster's cells; "view": `VIEW` of each slot's candidate over the same cells, 0 where there
is never a vehicle; "candidates": `CANDIDATE_FEATURES`, then `TERMS` of each slot; "whole": `EPISODE`. Empty slots are 0
throughout.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from gymnasium.spaces import Box, Dict

from placement_env.candidates.outlook.ground_plan import CHANNELS, RASTER_CELLS
from placement_env.candidates.outlook.outlook import CANDIDATE_FEATURES, VIEW, Outlook
from placement_env.envs.maps.terms import Terms
from toolkit.arrays import Float32

TERMS = ("price", "link", "chosen", "allowed")
EPISODE = ("budget left", "budget", "steps left", "money left", "weight of kbit", "weight of price")
Observation = dict[str, np.ndarray]


def map_space(slots: int) -> Dict:
    """Of so many slots."""
    shapes = {
        "map": (len(CHANNELS), RASTER_CELLS, RASTER_CELLS),
        "view": (slots, len(VIEW), RASTER_CELLS, RASTER_CELLS),
        "candidates": (slots, len(CANDIDATE_FEATURES) + len(TERMS)),
        "whole": (len(EPISODE),),
    }
    return Dict({name: Box(-1.0, 1.0, shape, np.float32) for name, shape in shapes.items()})


def rasters(known: Outlook, slots: int) -> tuple[Float32[np.ndarray, "k G G"], Float32[np.ndarray, "slots v G G"]]:
    """ "map" and "view", which stay the same in an episode."""
    channels = np.ascontiguousarray(known.plan.channels.T).reshape(len(CHANNELS), RASTER_CELLS, RASTER_CELLS)
    view = np.zeros((slots, len(VIEW), RASTER_CELLS * RASTER_CELLS), np.float32)
    view[: len(known.view), :, known.plan.used] = known.view.transpose(0, 2, 1)
    return channels, view.reshape(slots, len(VIEW), RASTER_CELLS, RASTER_CELLS)


def observed(
    fixed: tuple[np.ndarray, np.ndarray],
    known: Outlook,
    terms: Terms,
    chosen: Sequence[int],
    *,
    steps_left: float,
) -> Observation:
    """The whole observation. fixed: of `rasters`. Prices, links (in Mbit), budget and money come as x / (x + 1),
    x / (x + 1), x / (x + 8) and x / (x + 8), 1 for any money; weights as shares of an AP for each Mbit, and for a unit
    of price, at most 1."""
    candidates = terms.candidates
    slots, count = fixed[1].shape[0], len(candidates)
    rows = np.zeros((slots, len(CANDIDATE_FEATURES) + len(TERMS)), np.float32)
    rows[:count, : len(CANDIDATE_FEATURES)] = known.features
    row = rows[:count, len(CANDIDATE_FEATURES) :]
    megabit = candidates.capacity / 1000
    row[:, 0], row[:, 1] = candidates.prices / (candidates.prices + 1), megabit / (megabit + 1)
    row[list(chosen), 2] = 1
    row[:, 3] = terms.allowed(chosen) & (len(chosen) < terms.budget)
    left = terms.most_price - terms.price(chosen)
    money = 1.0 if np.isinf(left) else left / (left + 8)
    whole: list[Any] = [
        1 - len(chosen) / terms.budget, terms.budget / (terms.budget + 8), steps_left, money,
        min(1.0, 1000 * terms.weights.comm), min(1.0, terms.weights.price),
    ]  # fmt: skip
    return {
        "map": fixed[0].copy(),
        "view": fixed[1].copy(),
        "candidates": rows,
        "whole": np.clip(np.array(whole, np.float32), -1, 1),
    }
