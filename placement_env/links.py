"""Rule for links, shared by searches, plans, live figures and environments.

The data that a sensor sends differs from frame to frame. Its load is the smallest amount that it
does not exceed in a stated share of the frames: `LINK_SHARE`, unless a setting asks for another.
Loads of sensors on one mount add up, and a link carries them if their sum is within its capacity.
Only points count: boxes fit any link. If only a mean is known, as in a table, it is the load.
"""

from typing import TypeVar

import numpy as np

from toolkit.arrays import Float64

LINK_SHARE = 0.95  # share of the frames in which a link must carry all data
ROUNDING_SHARE = 1e-9  # share of a capacity by which rounding may exceed it
Capacity = TypeVar("Capacity", float, np.ndarray)


def sent_in_most(
    kbit: Float64[np.ndarray, "*n frames"], share: float = LINK_SHARE
) -> Float64[np.ndarray, "*n"]:
    """Load (kbit per frame) of each sensor: data that it does not exceed in `share` of the frames.

    kbit: data sent in each frame, frames on the last axis; share: 0 to 1.

    >>> float(sent_in_most(np.array([100.0, 300.0, 200.0, 400.0]), 0.75))
    300.0
    """
    # this method takes one of the given amounts, without interpolation
    load = np.quantile(kbit, share, axis=-1, method="inverted_cdf")
    return np.asarray(load, np.float64)


def max_load(capacity: Capacity) -> Capacity:
    """Greatest load (kbit per frame) that links of a capacity carry: the capacity plus rounding."""
    return capacity * (1 + ROUNDING_SHARE)


def check_link_share(share: float) -> None:
    """Raise ValueError for a share of frames outside (0, 1]."""
    if not 0 < share <= 1:
        raise ValueError(
            f"link_share must lie above 0 and up to 1, got {share}: {LINK_SHARE} is usual, 1 is "
            "all frames"
        )


def describe_share(share: float) -> str:
    """Words for the share of frames in which a link must carry all data: "95 % of the frames"."""
    return "every frame" if share == 1 else f"{100 * share:.10g} % of the frames"
