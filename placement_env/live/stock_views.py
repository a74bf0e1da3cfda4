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

VIEW_COLUMNS = ("points", "distance", "sent", "far")


def join_views(unseen: Visibility, rows: Sequence[tuple[np.ndarray, ...]]) -> Visibility:
    """View of sensors from a row of points, distance, sent and far of each. unseen: the objects,
    without a sensor."""
    if not rows:
        return unseen
    return replace(
        unseen, **dict(zip(VIEW_COLUMNS, map(np.stack, zip(*rows, strict=True)), strict=True))
    )


class StockViews:
    """Views of the poses of a stock from panoramas, at one height of every pole first, those in the
    middle of the area before others. known: number of poses."""

    def __init__(self, preparation: Preparation) -> None:
        self._preparation = preparation
        self._stock = preparation.setting.pool
        self._rows: list[tuple[Int64[np.ndarray, " k"], Visibility]] = []
        self.known = 0
        heights = self._stock.factors[:, 1]
        middle = len(self._stock.axes.heights) // 2
        order = sorted(set(heights.tolist()), key=lambda height: abs(height - middle))
        middle_of = preparation.setting.place.area.reshape(2, 2).mean(axis=0)
        away = [float(np.hypot(*(mount.position[:2] - middle_of))) for mount in self._stock.mounts]
        groups = [
            np.flatnonzero((heights == height) & (self._stock.mount == mount))
            for height in order
            for mount in np.argsort(away, kind="stable")
        ]
        self._waiting = {int(group[0]): group for group in groups if len(group)}  # by first pose
        self._first: dict[int, int] = {}  # key of what is looked at first from each mount
        for key in self._waiting:
            self._first.setdefault(int(self._stock.mount[key]), key)

    def __getstate__(self) -> dict[str, object]:
        # threads change both
        return {**self.__dict__, "_rows": list(self._rows), "_waiting": dict(self._waiting)}

    def look_further(self) -> bool:
        """Make the views of the poses at one more height of a pole; False if all are known."""
        key = next(iter(list(self._waiting)), None)
        return key is not None and self._look(key)

    def at_least_coarse(self, patience: float, free: Bool[np.ndarray, " M"]) -> bool:
        """Make the views of the poses at one height of every free pole.

        Returns True if `patience` (s) ended before all were made."""
        end = time.monotonic() + patience
        for key in [
            key for mount, key in self._first.items() if free[mount] and key in self._waiting
        ]:
            if self._look(key) and time.monotonic() > end:
                return True
            time.sleep(0.001)  # for those who wait to cast rays
        return False

    def _look(self, key: int) -> bool:
        """Make the views of the poses of a key, once for all threads.

        Returns False if views are not looked up in panoramas."""
        live = self._preparation.live
        group = self._waiting.get(key)
        if live is not None and group is not None:
            seen = live.see(self._stock.select(group), reach="own")
            if self._waiting.pop(key, None) is not None:
                self._rows.append((group, seen))
                self.known += len(group)
        return live is not None

    def rank(
        self,
        base: Candidates,
        seen: Visibility,
        is_working: Bool[np.ndarray, " B"],
        objective: Callable[[Candidates, Visibility], Objective],
    ) -> list[int]:
        """Known poses that may join a set, the best first.

        base: sensors of the set; seen: their view; is_working: False for sensors that have
        failed."""
        rows = list(self._rows)
        if not rows:
            return []
        indices = np.concatenate([group for group, _ in rows])
        count = len(base)
        columns = {}
        for name in VIEW_COLUMNS:
            views = [getattr(view, name) for _, view in rows]
            columns[name] = np.concatenate([getattr(seen, name), *views])
        stock = self._stock.select(indices)
        names = {sensor.name for sensor in base.sensors}
        sensors = [
            replace(s, name=f"{s.name} of the stock") if s.name in names else s
            for s in stock.sensors
        ]
        aim = np.zeros((count + len(indices), 3))
        mount = np.concatenate([base.mount, stock.mount])
        candidates = Candidates.from_poses(
            [*base.sensors, *sensors], mount, aim, replace(self._stock, mounts=base.mounts)
        )
        scored = objective(candidates, replace(seen, **columns))
        sets = np.zeros((len(indices), len(candidates)), np.bool_)
        sets[:, :count] = True
        sets[np.arange(len(indices)), count + np.arange(len(indices))] = True
        fits = scored.feasible(sets)
        sets[:, :count] = is_working
        reward = np.where(fits, scored.scores(sets).reward, -np.inf)
        order = np.argsort(-reward, kind="stable")
        return indices[order[np.isfinite(reward[order])]].tolist()
