"""Objects that belong to other frames than the images they stand beside: some frames earlier or later.

What moves tells: its points lie on the boxes of the frame they were measured in (`hypotheses.fit`), not on those of the
frames before or after it.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from toolkit.arrays import Float
from toolkit.datasets.doctor.hypotheses import ENOUGH, FITS, Rows, Suspicion, fit

MOST_FRAMES_OFF = 3
CLEARLY = 0.2  # what the fit must gain


def suspect_frames(
    clouds: Sequence[Float[np.ndarray, "_ 3"]],
    tables: Sequence[Rows],
    frames: Sequence[int],
    map_SE3_site: Float[np.ndarray, "4 4"],
) -> tuple[Suspicion | None, list[Rows]]:
    """By how many frames the objects are off, and the rows that belong to `frames`, whose moving points, site frame,
    the clouds are. tables: the rows of all frames of the file."""
    best: Suspicion | None = None
    rows = [tables[k] for k in frames]
    for off in [sign * n for n in range(1, MOST_FRAMES_OFF + 1) for sign in (1, -1)]:
        usable = [
            i for i, k in enumerate(frames) if 0 <= k + off < len(tables) and len(tables[k]) and len(tables[k + off])
        ]
        some = [clouds[i] for i in usable]
        if sum(map(len, some)) < ENOUGH:
            continue
        before = fit(some, [tables[frames[i]] for i in usable], map_SE3_site)
        after = fit(some, [tables[frames[i] + off] for i in usable], map_SE3_site)
        if after >= max(FITS, before + CLEARLY) and (best is None or after > best.after):
            count = f"{abs(off)} frame{'s' * (abs(off) > 1)}"
            mistake = f"labels lie about {count} {'behind' if off > 0 else 'ahead of'} the images"
            best = Suspicion(
                mistake, f"store objects/K as objects/{'K-' if off > 0 else 'K+'}{abs(off)}", before, after
            )
            rows = [tables[k + off] if 0 <= k + off < len(tables) else tables[k][:0] for k in frames]
    return best, rows
