"""`StockViews`: views of the poses of the stock, made pole by pole, to suggest the best poses."""

import time
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from placement_env.candidates.candidates import Candidates
from placement_env.fidelity.preparation import Preparation
from placement_env.fidelity.visibility import Visibility
from placement_env.objective import Objective
from toolkit.arrays import Bool, Int64

VIEW_COLUMNS = ("points", "distance", "sent", "far")  # fields of `Visibility` with a row a sensor


def join_views(unseen: Visibility, rows: Sequence[tuple[np.ndarray, ...]]) -> Visibility:
    """View of several sensors on the same objects, joined from the row of each.

    unseen: view of the objects without a sensor; rows: points, distance, sent and far of each
    sensor, as arrays over objects or frames (fields of `Visibility`)."""
    if not rows:
        return unseen
    arrays = {}
    for k, name in enumerate(VIEW_COLUMNS):
        arrays[name] = np.stack([row[k] for row in rows])
    return replace(unseen, **arrays)


class StockViews:
    """Views of the poses of a stock from panoramas, made group by group.

    A group is all poses at one height of one pole. Groups at the middle height come first, and
    among them poles near the middle of the area. The stock is the preparation's candidates.

    Attributes:
        known: Number of poses whose views are made.
    """

    def __init__(self, preparation: Preparation) -> None:
        """Group the poses to choose from by height and mount, and order the groups for viewing.

        Heights near the middle of all come first, then mounts near the middle of the area.

        preparation: traffic, and setting with the poses (the stock)."""
        self._preparation = preparation
        self._stock = preparation.setting.pool
        # indices of poses in the stock, and their view
        self._viewed_groups: list[tuple[Int64[np.ndarray, " k"], Visibility]] = []
        self.known = 0
        # each pose's height, as an index in the stock's heights (column 1 of its factors)
        height_steps = self._stock.factors[:, 1]
        middle_step = len(self._stock.axes.heights) // 2
        xmin, ymin, xmax, ymax = preparation.setting.place.area.tolist()
        middle = np.array([(xmin + xmax) / 2, (ymin + ymax) / 2])
        # how far the mounts are from the middle of the area (m)
        distances = [
            float(np.hypot(*(mount.position[:2] - middle))) for mount in self._stock.mounts
        ]
        # indices of the poses at each height of each mount, in the order of viewing
        groups = []
        for step in sorted(set(height_steps.tolist()), key=lambda step: abs(step - middle_step)):
            for mount in np.argsort(distances, kind="stable"):
                is_in_group = (height_steps == step) & (self._stock.mount == mount)
                groups.append(np.flatnonzero(is_in_group))
        # groups without views, by the index of their first pose, which is their key
        self._waiting_groups = {int(group[0]): group for group in groups if len(group)}
        self._first_keys: dict[int, int] = {}  # key of the group that is viewed first, by mount
        for key in self._waiting_groups:
            self._first_keys.setdefault(int(self._stock.mount[key]), key)

    def __getstate__(self) -> dict[str, object]:
        """Fields to pickle, with copies of those that other threads change."""
        # copies, as other threads change both
        return {
            **self.__dict__,
            "_viewed_groups": list(self._viewed_groups),
            "_waiting_groups": dict(self._waiting_groups),
        }

    def look_further(self) -> bool:
        """Make the views of the poses at one more height of a pole.

        Returns False if all are known, or without panoramas."""
        # a list first, as other threads remove groups
        key = next(iter(list(self._waiting_groups)), None)
        return key is not None and self._view_group(key)

    def view_free_poles(self, patience: float, is_free: Bool[np.ndarray, " mounts"]) -> bool:
        """Make the views of the poses at one height of every free pole that lacks them.

        patience: time (s) for that; at least one is made. is_free: True for mounts that a sensor
        may use. Returns True if the time ended before all were made."""
        end = time.monotonic() + patience
        waiting_keys = [
            key
            for mount, key in self._first_keys.items()
            if is_free[mount] and key in self._waiting_groups
        ]
        for key in waiting_keys:
            if self._view_group(key) and time.monotonic() > end:
                return True
            time.sleep(0.001)  # lets other threads cast rays
        return False

    def _view_group(self, key: int) -> bool:
        """Make the views of one group of poses, once for all threads.

        key: index of the group's first pose. Returns False if views are not looked up in
        panoramas, so nothing was made."""
        panoramas = self._preparation.live
        group = self._waiting_groups.get(key)
        if panoramas is not None and group is not None:
            seen = panoramas.see(self._stock.select(group), reach="own")
            if self._waiting_groups.pop(key, None) is not None:  # no other thread was faster
                self._viewed_groups.append((group, seen))
                self.known += len(group)
        return panoramas is not None

    def rank(
        self,
        base: Candidates,
        seen: Visibility,
        is_working: Bool[np.ndarray, " sensors"],
        objective: Callable[[Candidates, Visibility], Objective],
    ) -> list[int]:
        """Indices in the stock of known poses that may join a set, the greatest reward first.

        base: sensors of the set; seen: their view; is_working: False for sensors that have failed,
        which take up room but see nothing; objective: function that returns the objective of
        candidates from their view."""
        viewed_groups = list(self._viewed_groups)  # a copy, as other threads append
        if not viewed_groups:
            return []
        indices = np.concatenate([group for group, _ in viewed_groups])
        base_count = len(base)
        columns = {}  # fields of the view of the base, then of the poses, a row each
        for name in VIEW_COLUMNS:
            arrays = [getattr(view, name) for _, view in viewed_groups]
            columns[name] = np.concatenate([getattr(seen, name), *arrays])
        stock = self._stock.select(indices)
        names = {sensor.name for sensor in base.sensors}
        sensors = [
            replace(s, name=f"{s.name} of the stock") if s.name in names else s
            for s in stock.sensors
        ]
        candidates = Candidates.from_poses(
            [*base.sensors, *sensors],
            mount=np.concatenate([base.mount, stock.mount]),
            # aims do not matter: the views are known
            aim=np.zeros((base_count + len(indices), 3)),
            pool=replace(self._stock, mounts=base.mounts),
        )
        pose_objective = objective(candidates, replace(seen, **columns))
        # one set for each pose: all sensors of the base and this pose
        pose_rows = np.arange(len(indices))
        sets = np.zeros((len(indices), len(candidates)), np.bool_)
        sets[:, :base_count] = True
        sets[pose_rows, base_count + pose_rows] = True
        fits = pose_objective.feasible(sets)  # failed sensors need room too
        sets[:, :base_count] = is_working
        reward = np.where(fits, pose_objective.scores(sets).reward, -np.inf)
        order = np.argsort(-reward, kind="stable")
        return indices[order[np.isfinite(reward[order])]].tolist()
