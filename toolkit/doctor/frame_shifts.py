"""Labels that are some frames ahead of or behind the images."""

from collections.abc import Sequence

import numpy as np

from toolkit.arrays import Float, Pose
from toolkit.doctor.moving_points import Rows, share_on_boxes
from toolkit.doctor.suspicions import MIN_EXPLAINED_FIT, MIN_MOVING_POINTS, Suspicion

MAX_FRAMES_OFF = 3  # largest shift that is tried
MIN_SHIFT_GAIN = 0.2  # least gain in fit for a suspicion of shifted frames


def suspect_frames(
    clouds: Sequence[Float[np.ndarray, "_ 3"]],
    tables: Sequence[Rows],
    frames: Sequence[int],
    map_SE3_site: Pose,
) -> tuple[Suspicion | None, list[Rows]]:
    """Find the number of frames by which objects are ahead of or behind the images.

    Args:
        clouds: moving points (m, site frame) of each frame that is looked at.
        tables: published rows of the objects of all frames of the file.
        frames: numbers, in the file, of the frames that are looked at.
        map_SE3_site: pose of the site in the map.

    Returns the mistake, None without one, and the rows that belong to `frames`, no rows for frames
    beyond the file."""
    best: Suspicion | None = None
    rows = [tables[k] for k in frames]  # a table for each frame looked at, at the best offset
    # 1, -1, 2, -2, ...: objects of frame k + offset are compared with the points of frame k
    for offset in [sign * n for n in range(1, MAX_FRAMES_OFF + 1) for sign in (1, -1)]:
        has_both_tables = [
            0 <= k + offset < len(tables) and len(tables[k]) and len(tables[k + offset])
            for k in frames
        ]
        # indices in `frames` and `clouds`, for frames with both tables
        usable_indices = np.flatnonzero(has_both_tables).tolist()
        usable_clouds = [clouds[i] for i in usable_indices]
        if sum(map(len, usable_clouds)) < MIN_MOVING_POINTS:
            continue
        stored_rows = [tables[frames[i]] for i in usable_indices]
        shifted_rows = [tables[frames[i] + offset] for i in usable_indices]
        fit_before = share_on_boxes(usable_clouds, stored_rows, map_SE3_site)
        fit_after = share_on_boxes(usable_clouds, shifted_rows, map_SE3_site)
        is_clear = fit_after >= max(MIN_EXPLAINED_FIT, fit_before + MIN_SHIFT_GAIN)
        if is_clear and (best is None or fit_after > best.fit_after):
            count = f"{abs(offset)} frame{'s' * (abs(offset) > 1)}"
            mistake = (
                f"labels lie about {count} {'behind' if offset > 0 else 'ahead of'} the images"
            )
            remedy = f"store objects/K as objects/{'K-' if offset > 0 else 'K+'}{abs(offset)}"
            best = Suspicion(
                mistake=mistake, remedy=remedy, fit_before=fit_before, fit_after=fit_after
            )
            rows = [
                tables[k + offset] if 0 <= k + offset < len(tables) else tables[k][:0]
                for k in frames
            ]
    return best, rows
