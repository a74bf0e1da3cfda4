"""A fidelity by its name: traffic, what each candidate sees of it, renders and detector, prepared when first needed."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np

from placement_env.fidelity import Fidelity
from toolkit.arrays import Float64
from toolkit.fusion import PAPER
from toolkit.objects import Detector
from toolkit.site import Site

if TYPE_CHECKING:
    from placement_env.candidates import Candidates
    from placement_env.traffic_frames import Traffic
    from placement_env.visibility import Visibility


def site_candidates(site: Site, candidates: Candidates | Literal["pool"] | None) -> Candidates:
    """The candidates themselves, the site's pool, or for None its own sensors."""
    from placement_env.candidates import paper_candidates, pool

    if candidates is None:
        return paper_candidates(site)
    return pool(site) if isinstance(candidates, str) else candidates


@dataclass(frozen=True, eq=False)
class Preparation:
    """What the fidelities of one objective are made from; its arguments are those of `Objective`."""

    site: Site
    candidates: Candidates
    frames: int
    scheme: str
    iou: float
    seed: int
    cache: str | Path | None
    workers: int
    detector: Detector | None

    @cached_property
    def traffic(self) -> Traffic:
        """The frames."""
        from placement_env.traffic_frames import traffic

        return traffic(self.site, self.frames, self.seed)

    @cached_property
    def visibility(self) -> Visibility:
        """What each candidate sees."""
        from placement_env.visibility import see

        return see(self.traffic, self.candidates, workers=self.workers, cache=self.cache)

    def sent(self, name: str) -> Float64[np.ndarray, " C"] | None:
        """kbit of points per frame of each candidate; None where the fidelity itself says it at no cost."""
        if name == "table":
            return None
        return np.asarray(self.visibility.sent.mean(axis=1, dtype=np.float64) * PAPER.bits_per_point / 1000)

    def fidelity(self, name: str) -> Fidelity:
        """The fidelity of that name."""
        if name == "coverage":
            return self._coverage()
        if name == "surrogate":
            return self._surrogate()
        if name == "detector":
            return self._detected()
        if name == "table":
            return self._table()
        raise ValueError(f"fidelity must be coverage, surrogate, detector or table, got {name!r}")

    def _coverage(self) -> Fidelity:
        from placement_env.coverage import Coverage

        return Coverage(self.visibility, self.scheme)

    def _surrogate(self) -> Fidelity:
        from placement_env.surrogate import Surrogate

        return Surrogate(self.visibility, self.scheme)

    def _detected(self) -> Fidelity:
        from placement_env.detection import Detected
        from placement_env.renders import Renders

        return Detected(Renders(self.traffic, self.candidates, self.cache), self.detector, self.scheme, self.iou)

    def _table(self) -> Fidelity:
        from placement_env.tables import TableFidelity, load_table

        return TableFidelity(load_table(self.site.name), self.scheme, self.iou)
